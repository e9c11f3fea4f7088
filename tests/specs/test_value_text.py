"""Values in messages: coordinates of positions near the zero point and far from it."""

from __future__ import annotations

import pytest

from antdsl.specs.value_text import format_position


@pytest.mark.parametrize(
    ("position", "origin", "unit_mm", "text"),
    [
        ((88.1234, 10.2, -51.6999), (0, 0, 0), 1, "88.12, 10.2, -51.7"),
        ((88123.456, 1e-9, -0.0), (0, 0, 0), 1, "88123.5, 0, 0"),
        ((12.34, -3, 0), (530e6, 0, -4e6), 1, "530000012.34, -3, -4000000"),
        ((12.34, 1, 0), (530e6, 0, 0), 1000, "530000.01234, 0.001, 0"),
        ((float("nan"), float("inf"), 1), (530e6, 0, 0), 1, "nan, inf, 1"),
    ],
)
def test_coordinates_have_four_digits_relative_to_the_origin(
    position: tuple[float, ...], origin: tuple[float, ...], unit_mm: float, text: str
) -> None:
    assert format_position(position, origin, unit_mm) == text
