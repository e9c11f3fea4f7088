"""Numbers with units in scenes, such as `50 mm`, `20 %/s` and `12`, and ranges, such as `-0.25..0.25` and `1001..1240`.

Texts in scenes, command-line options and sweeps are parsed here, with the language's own table of units."""

from __future__ import annotations

import re
from dataclasses import dataclass
from math import isfinite

from antdsl import limits
from antdsl.program.model import Dimension
from antdsl.program.tables.units import find_unit_measure
from antdsl.source import Source, Span
from antdsl.syntax.mistakes.number_slips import COMMA_NUMBER_PATTERN, make_comma_diagnostic

_NUMBER_PATTERN = re.compile(r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]{1,4})?", re.ASCII)
_INTEGER_RANGE_PATTERN = re.compile(r"(-?[0-9]{1,9})(?:\s*\.\.\s*(-?[0-9]{1,9}))?", re.ASCII)


class QuantityError(ValueError):
    """Error for a text that is not a quantity. The message is a reason that fits after the text. `help`: what to write, if
    known."""

    def __init__(self, message: str, help: str = "") -> None:
        super().__init__(message)
        self.help = help


@dataclass(frozen=True, slots=True)
class Quantity:
    """A number with a dimension.

    `number`: the value in base units (mm, s, g, rad) is `number` · (mm per scene unit) ** `length_exponent` · dt ** `step`.
    `unit`: the unit as in the source. The names of these fields must not change, because state hashes include notes as text."""

    number: float
    dim: Dimension
    unit: str
    text: str
    length_exponent: float = 0
    step: float = 0

    @property
    def has_no_unit(self) -> bool:
        """Return whether the text has no unit."""
        return not self.unit

    def to_base_units(self, unit_mm: float, dt: float) -> float:
        """Return the value in base units. `unit_mm`: mm per scene unit. `dt`: seconds per step."""
        return float(self.number * unit_mm**self.length_exponent * dt**self.step)

    def to_millimetres(self, unit_mm: float) -> float:
        """Return the length in millimetres. `unit_mm`: mm per scene unit. A number without a unit is in scene units.

        The value must be a length; its dimension is not checked."""
        return float(self.number * unit_mm if self.has_no_unit else self.number * unit_mm**self.length_exponent)


def parse_number(text: str) -> float:
    """Return the value of a decimal number. Raises QuantityError with the reason if the text is not a number."""
    text = text.strip()
    _reject_comma(text)
    if not _NUMBER_PATTERN.fullmatch(text):
        raise QuantityError("is not a number")
    if sum(c.isdigit() for c in text) > limits.MAX_NUMBER_DIGITS:
        raise QuantityError(f"has more than {limits.MAX_NUMBER_DIGITS} digits")
    value = float(text)
    if not isfinite(value) or (value == 0 and re.search(r"[1-9]", re.split("[eE]", text)[0])):
        raise QuantityError("is not representable")
    return value


def split_quantity(text: str) -> tuple[str, str]:
    """Return the number and the unit in a text such as `30 mm/s`. The unit is not checked. Raises QuantityError with the
    reason."""
    text = text.strip()
    _reject_comma(text)
    match = _NUMBER_PATTERN.match(text)
    if not match:
        raise QuantityError("is not a number with a unit")
    return match[0], text[match.end() :].strip()


def parse_number_range(text: str) -> tuple[float, float]:
    """Return the two numbers in a text `A..B`. Raises QuantityError with the reason."""
    first, dots, last = text.partition("..")
    if not dots:
        raise QuantityError("is not a range")
    return parse_number(first), parse_number(last)


def parse_integer_range(text: str) -> tuple[int, int]:
    """Return the two integers in a text `A..B`. For a text `A`, return A twice. Raises QuantityError with the reason."""
    match = _INTEGER_RANGE_PATTERN.fullmatch(text.strip())
    if match is None:
        raise QuantityError("is not a range of whole numbers")
    return int(match[1]), int(match[2] or match[1])


def parse_quantity(text: str) -> Quantity:
    """Return the quantity that a text such as `30 mm/s` stands for. Raises QuantityError with the reason."""
    text = text.strip()
    digits, unit = split_quantity(text)
    number = parse_number(digits)
    if not unit:
        return Quantity(number, Dimension(), "", text)
    known = find_unit_measure(unit)
    if known is None:
        raise QuantityError(f"has an unknown unit `{unit}`")
    value = number * known.factor
    if not isfinite(value):
        raise QuantityError("is not representable")
    return Quantity(value, known.dim, unit, text, known.unit_power, known.step)


def _reject_comma(text: str) -> None:
    """Raise QuantityError for a decimal comma, as in `0,4mm`. The message is the same as in programs."""
    match = COMMA_NUMBER_PATTERN.match(text.lstrip("+-"))
    if match is not None:
        start = len(text) - len(text.lstrip("+-"))
        diagnostic = make_comma_diagnostic(Span(Source("", text), start, start + match.end()))
        better = None if diagnostic.fix is None else text[:start] + diagnostic.fix.text + text[start + match.end() :]
        raise QuantityError("has a comma in its number", f"write `{better}`" if better else diagnostic.help or "")
