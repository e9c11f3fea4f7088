"""Units and dimensions: converts quantities to base units, and describes dimensions in words."""

from __future__ import annotations

import re
from dataclasses import dataclass

from antdsl.program.model import ChangeRate, Constant, Dimension, TypeKind, ValueType
from antdsl.program.tables.vocabulary import FORCE_DIMENSION, UNIT_BY_NAME
from antdsl.source import Span
from antdsl.syntax import nodes

_UNIT_PART_PATTERN = re.compile(r"([*/]?)([A-Za-z]+|%)(?:\^(\d+))?")


@dataclass(frozen=True, slots=True)
class UnitMeasure:
    """The value of one unit, in base units.

    It is `factor * u ** unit_power * dt ** step`. `u`: mm per scene unit. `dt`: seconds per step."""

    dim: Dimension
    factor: float
    unit_power: float
    step: float


def scale_dimension(dim: Dimension, power: float) -> Dimension:
    """Return the dimension of `a ** power`."""
    return Dimension(dim.length * power, dim.time * power, dim.mass * power, dim.angle * power)


def combine_dimensions(a: Dimension, b: Dimension, power: float = 1) -> Dimension:
    """Return the dimension of `a * b ** power`."""
    return Dimension(a.length + b.length * power, a.time + b.time * power, a.mass + b.mass * power, a.angle + b.angle * power)


def find_unit_measure(unit: str) -> UnitMeasure | None:
    """Return the value of a unit such as `mm/s`, `%/s`, `/step` or `mm^2/s`, or None for an unknown unit."""
    dim, factor, u, step, position = Dimension(), 1.0, 0.0, 0.0, 0
    text = unit.replace(" ", "")
    for part in _UNIT_PART_PATTERN.finditer(text):
        known = UNIT_BY_NAME.get(part[2])
        if part.start() != position or known is None:
            return None
        position = part.end()
        power = (-1 if part[1] == "/" else 1) * int(part[3] or 1)
        dim = combine_dimensions(dim, known.dim, power)
        factor *= known.factor**power
        u += known.unit_power * power
        step += known.step * power
    return UnitMeasure(dim, factor, u, step) if position == len(text) and text else None


def make_constant(value: float, unit: str, span: Span) -> Constant | None:
    """Return the number with a unit as a constant in base units, or None if the unit is unknown."""
    known = find_unit_measure(unit)
    if known is None:
        return None
    rate = ChangeRate.RUN if known.unit_power or known.step else ChangeRate.CONST
    return Constant(ValueType(TypeKind.NUMBER, known.dim), rate, span, value * known.factor, known.unit_power, known.step)


def make_number(value: float, span: Span) -> Constant:
    """Return the constant for a number without a unit."""
    return Constant(ValueType(TypeKind.NUMBER), ChangeRate.CONST, span, value)


_DIMENSION_NAMES: dict[Dimension, str] = {
    Dimension(): "number without a unit",
    Dimension(length=1): "length",
    Dimension(time=1): "time",
    Dimension(mass=1): "mass",
    Dimension(angle=1): "angle",
    Dimension(length=1, time=-1): "speed",
    Dimension(time=-1): "rate (amount per second)",
    Dimension(length=2): "area",
    Dimension(angle=1, time=-1): "turning speed",
    Dimension(length=1, time=-2): "acceleration",
    Dimension(length=2, time=-1): "spreading (area per second)",
    FORCE_DIMENSION: "force",
}


def choose_default_unit(dim: Dimension) -> str:
    """Return the usual unit of a dimension, such as `mm`, `deg/s` or `/s`. Return "" for a dimension without a unit."""
    if dim == FORCE_DIMENSION:
        return "uN"
    top: list[str] = []
    below: list[str] = []
    for unit, power in zip(("g", "mm", "deg", "s"), (dim.mass, dim.length, dim.angle, dim.time), strict=True):
        if power:
            text = unit if abs(power) == 1 else f"{unit}^{abs(power):g}"
            (top if power > 0 else below).append(text)
    return "*".join(top) + "".join("/" + unit for unit in below)


def add_article(words: str) -> str:
    """Return the words with `a` or `an` before them."""
    return ("an " if words[0] in "aeiou" else "a ") + words


def describe_dimension(dim: Dimension) -> str:
    """Return words that describe a dimension, such as `a length`, `a number without a unit` or `a value in mm*g`."""
    name = _DIMENSION_NAMES.get(dim)
    return add_article(name) if name else f"a value in `{choose_default_unit(dim)}`"


def format_number(value: float) -> str:
    """Return the usual text of a number, such as `30` or `0.05`."""
    return f"{value:.12g}"


def format_with_unit(value: float, dim: Dimension) -> str:
    """Return a number with the default unit of a dimension: `30 mm` for 30 and a length."""
    unit = choose_default_unit(dim)
    return f"{format_number(value)} {unit}".strip()


def find_unit_spelling(node: nodes.Expr) -> str:
    """Return the text of the first unit in an expression, or "" if there is none."""
    stack: list[object] = [node]
    while stack:
        part = stack.pop()
        if isinstance(part, nodes.Quantity):
            return part.unit
        if isinstance(part, nodes.Binary):
            stack += [part.right, part.left]
        elif isinstance(part, nodes.Unary):
            stack.append(part.operand)
        elif isinstance(part, nodes.Call):
            stack += [a.value for a in reversed(part.arguments) if isinstance(a, nodes.Argument)]
    return ""
