"""Numbers with units as a scene writes them: `50 mm`, `20 %/s`, `12`. Text to value by the language's own table of units."""

from __future__ import annotations

import re
from dataclasses import dataclass
from math import isfinite

from antdsl import limits
from antdsl.program.model import Dim
from antdsl.program.vocabulary import UNITS

_NUMBER = re.compile(r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]{1,4})?", re.ASCII)
_UNIT = re.compile(r"([*/]?)([A-Za-z%]+)(?:\^([1-9]))?", re.ASCII)

NAMED_DIMS = {
    Dim(): "a plain number",
    Dim(length=1): "a length, such as `50 mm`",
    Dim(time=1): "a time, such as `2 s`",
    Dim(mass=1): "a mass, such as `3 g`",
    Dim(angle=1): "an angle, such as `30 deg`",
    Dim(length=1, time=-1): "a speed, such as `30 mm/s`",
    Dim(time=-1): "a rate, such as `20 /s`",
    Dim(length=1, time=-2, mass=1): "a force, such as `2 uN`",
    Dim(length=2): "an area, such as `4 mm*mm`",
    Dim(angle=1, time=-1): "a turning speed, such as `90 deg/s`",
}


def dim_words(dim: Dim) -> str:
    """A dimension as a person would say it."""
    if dim in NAMED_DIMS:
        return NAMED_DIMS[dim]
    parts = [f"{name}^{power:g}" for name, power in zip(dim._fields, dim, strict=True) if power]
    return "a value in " + " * ".join(parts)


class BadQuantity(ValueError):
    """Why a text is no quantity, in words that fit after the text in question."""


@dataclass(frozen=True, slots=True)
class Quantity:
    """`number` in base units (mm, s, g, rad), still to be multiplied by (mm per scene unit) ** u and dt ** step. `unit` as written."""

    number: float
    dim: Dim
    unit: str
    text: str
    u: int = 0
    step: int = 0

    @property
    def bare(self) -> bool:
        return not self.unit

    def base(self, unit_mm: float, dt: float) -> float:
        """The value in base units."""
        return self.number * unit_mm**self.u * dt**self.step

    def length(self, unit_mm: float) -> float:
        """Millimetres; a number without a unit is in scene units. Only for values checked to be lengths."""
        return self.number * unit_mm if self.bare else self.number * unit_mm**self.u


def parse_number(text: str) -> float:
    """A decimal number; BadQuantity says why not."""
    text = text.strip()
    if not _NUMBER.fullmatch(text):
        raise BadQuantity("is not a number")
    if sum(c.isdigit() for c in text) > limits.NUMBER_DIGITS:
        raise BadQuantity(f"has more than {limits.NUMBER_DIGITS} digits")
    value = float(text)
    if not isfinite(value) or (value == 0 and re.search(r"[1-9]", re.split("[eE]", text)[0])):
        raise BadQuantity("is not representable")
    return value


def parse_quantity(text: str) -> Quantity:
    """A number and its unit, `30 mm/s`; BadQuantity says why not."""
    text = text.strip()
    found = _NUMBER.match(text)
    if not found:
        raise BadQuantity("is not a number with a unit")
    number = parse_number(found[0])
    unit = text[found.end() :].strip()
    dim, factor, u, step = _unit(unit)
    value = number * factor
    if not isfinite(value):
        raise BadQuantity("is not representable")
    return Quantity(value, dim, unit, text, u, step)


def _unit(unit: str) -> tuple[Dim, float, int, int]:
    powers, factor, u, step = [0.0, 0.0, 0.0, 0.0], 1.0, 0, 0
    position = 0
    while position < len(unit):
        found = _UNIT.match(unit, position)
        if not found or (position > 0 and not found[1]) or (position == 0 and found[1] == "*"):
            raise BadQuantity(f"has an unknown unit `{unit}`")
        sign, name, power = -1 if found[1] == "/" else 1, found[2], int(found[3] or 1)
        if name not in UNITS:
            raise BadQuantity(f"has an unknown unit `{name}`")
        known = UNITS[name]
        powers = [p + sign * power * d for p, d in zip(powers, known.dim, strict=True)]
        factor *= known.factor ** (sign * power)
        u += sign * power * known.u
        step += sign * power * known.step
        position = found.end()
    return Dim(*powers), factor, u, step
