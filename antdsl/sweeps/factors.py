"""The factors of a sweep. A factor has a list of single values (`30mm,60mm`), or a range of values (`30mm..90mm`)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import floor

import numpy as np

from antdsl.diagnostics import Report
from antdsl.scene.quantities import QuantityError, parse_number, split_quantity

_SIGNIFICANT_DIGITS = 6  # digits of a value that was drawn from a range


@dataclass(frozen=True, slots=True)
class Factor:
    """A setting that a sweep varies, with its values.

    `levels`: the single values; empty for a range.
    `low`, `high`: the ends of a range, as numbers in `unit`."""

    name: str
    levels: tuple[str, ...] = ()
    low: float = 0.0
    high: float = 0.0
    unit: str = ""

    @property
    def short_name(self) -> str:
        """Return the factor's name without the name of its species or field."""
        return self.name.rpartition(".")[2]

    def format_value_at(self, share: float) -> str:
        """Return the value at a position in the range or in the list of levels, as text. `share`: the position, from 0 (first)
        to 1 (last). In a list of levels, each level covers an equal part of the range 0 to 1."""
        if self.levels:
            return self.levels[min(floor(share * len(self.levels)), len(self.levels) - 1)]
        return self._format_value(self.low + share * (self.high - self.low))

    def find_end_values(self) -> tuple[str, ...]:
        """Return the values that must be checked: each level, or the two ends of the range. If both ends are allowed, so are all
        values between them."""
        return self.levels or (self._format_value(self.low), self._format_value(self.high))

    def parse_number(self, text: str) -> float:
        """Return a value in the range as a number in `unit`. `text`: the value with its unit."""
        return float(text[: len(text) - len(self.unit)])

    def _format_value(self, value: float) -> str:
        return np.format_float_positional(float(f"{value:.{_SIGNIFICANT_DIGITS}g}"), trim="-") + self.unit


def parse_factors(text_by_name: Mapping[str, str]) -> tuple[list[Factor], Report]:
    """Return the factors of a sweep, and a report about factors that cannot be read. `text_by_name`: the values of each factor
    as `A,B,C` or `A..B`, by factor name."""
    report = Report()
    parsed_factors = [
        _parse_range(name, text, report) if ".." in text else _parse_levels(name, text, report)
        for name, text in text_by_name.items()
    ]
    return [factor for factor in parsed_factors if factor is not None], report


def _parse_levels(name: str, text: str, report: Report) -> Factor | None:
    parts = tuple(part.strip() for part in text.split(","))
    if all(parts) and len(set(parts)) == len(parts):
        return Factor(name, parts)
    words = f"write values with commas between them, each once: `--vary {name}=1,2,3`"
    report.error(
        "wrong-value", f"`--vary {name}={text}` has {'an empty value' if not all(parts) else 'a value twice'}", None, words
    )
    return None


def _parse_range(name: str, text: str, report: Report) -> Factor | None:
    flag = f"`--vary {name}={text}`"
    try:
        (first, first_unit), (last, unit) = map(split_quantity, text.split("..") if text.count("..") == 1 else ("", ""))
    except QuantityError:
        usual = f"write `--vary {name}=30mm..90mm`, or separate values: `--vary {name}=30mm,60mm`"
        report.error("wrong-value", f"{flag} is not a range of two numbers", None, usual)
        return None
    if first_unit not in ("", unit):
        advice = f"write both ends in one unit: `--vary {name}={first}{first_unit}..90{first_unit}`"
        report.error("units-differ", f"{flag} begins in `{first_unit}` and ends in `{unit or 'no unit'}`", None, advice)
        return None
    try:
        low, high = parse_number(first), parse_number(last)
    except QuantityError as error:
        report.error("wrong-value", f"an end of {flag} {error}", None, error.help or f"write `--vary {name}=30mm..90mm`")
        return None
    if low >= high:
        swapped_advice = (
            f"write `--vary {name}={last}{unit}..{first}{unit}`" if low > high else "write one value, or a wider range"
        )
        report.error(
            "empty-range", f"{flag} ends before it begins" if low > high else f"{flag} has no width", None, swapped_advice
        )
        return None
    return Factor(name, (), low, high, unit)


def build_end_points(factors: Iterable[Factor]) -> list[dict[str, str]]:
    """Return the smallest set of points in which each end value of each factor occurs. A point maps factor names to values."""
    chosen = list(factors)
    value_count = max((len(factor.find_end_values()) for factor in chosen), default=0)
    return [
        {factor.name: factor.find_end_values()[min(k, len(factor.find_end_values()) - 1)] for factor in chosen}
        for k in range(value_count)
    ]
