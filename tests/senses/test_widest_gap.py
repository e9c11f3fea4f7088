"""`find_widest_gap`: the example of the document that it comes from, and all cases by hand."""

from __future__ import annotations

import numpy as np
import pytest

from antdsl.senses.clear_velocity import find_widest_gaps


def gap_bearing(*bearings: float) -> float | None:
    """Bearing in degrees, above 0 to the left, of the way that is found for neighbours at some bearings."""
    angle = np.radians(np.array(bearings, np.float64))
    x, y = find_widest_gaps(np.cos(angle)[None], np.sin(angle)[None], np.ones((1, len(bearings)), np.bool_))
    return float(np.degrees(np.arctan2(y[0], x[0]))) if x[0] or y[0] else None


@pytest.mark.parametrize(
    ("bearings", "expected"),
    [
        ((), None),
        ((30,), -150),  # one: straight away from it
        ((0, -90), 135),  # east and south, facing east: north-west
        ((90, -90), 0),  # ahead and behind are as wide: ahead
        ((0, 180), 90),  # left and right are as wide, and as far from straight ahead: left
        ((10, 20, -30, 170), -110),  # 170 to -30 by way of 180
        ((45, 135, -135, -45), 0),
    ],
)
def test_the_middle_of_the_widest_gap(bearings: tuple[float, ...], expected: float | None) -> None:
    assert gap_bearing(*bearings) == (None if expected is None else pytest.approx(expected, abs=1e-3))


def test_absent_and_coincident_agents_do_not_count() -> None:
    x, y = find_widest_gaps(np.array([[1.0, 0.0, -1.0]]), np.zeros((1, 3)), np.array([[True, True, False]]))
    assert (x[0], abs(y[0])) == (pytest.approx(-1.0), pytest.approx(0.0, abs=1e-6))
