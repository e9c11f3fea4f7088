"""Computes height and tilt of trunks.

They follow a plane through the ground below the feet, smoothed and limited. Lengths are body lengths, float32; sums are taken
in the order of legs. The plane is a least-squares fit with equal weights, without hanging feet."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.kernels import inlined
from antdsl.runtime.feet.feet_state import NO_GROUND_NUMBER, SWING_PHASE_OF_STANDING_FOOT
from antdsl.runtime.feet.gaits import FOOT_Y_ROW, HIP_POSITION_ROW, SQUARED_LENGTH_ROW

Floats = NDArray[np.float32]
_F = np.float32
_ZERO, _ONE, _INFINITE = _F(0), _F(1), _F(np.inf)

MAX_TRUNK_SLOPE = _F(0.35)  # maximum slope of the trunk relative to the body's up: 19 degrees
MAX_RISE_HIP_SHARE = 0.3  # share of the hip height: maximum offset of the trunk
TRUNK_SETTLING_SECONDS, TRUNK_RISING_SECONDS = (
    0.06,
    0.2,
)  # time constants (s) of a new tilt or lower height, and of a greater height
_PLANE_FIT_DAMPING = _F(0.02)  # damping (squared length): keeps a plane through feet that are close together level
_MIN_PLANE_FEET = _F(3)  # least number of feet for a plane; with fewer, the trunk does not tilt
_MIN_SQUARED_SLOPE = _F(1e-6)


@inlined
def fit_plane_to_feet(points: Any, ground_numbers: Any, legs: Any, i: Any) -> Any:
    """Fit a plane to the ground below the feet of agent `i`. Return its height, and its slopes ahead and aside.

    `points` [3, L, n]: the ground position of each foot. `ground_numbers` [L, n]: the thing that the foot stands on, as in
    `FeetState.on`."""
    count, mean_x, mean_y, mean_z = _ZERO, _ZERO, _ZERO, _ZERO
    for leg in range(legs):
        weight = _ONE if ground_numbers[leg, i] != NO_GROUND_NUMBER else _ZERO
        count = count + weight
        mean_x, mean_y = mean_x + points[0, leg, i] * weight, mean_y + points[1, leg, i] * weight
        mean_z = mean_z + points[2, leg, i] * weight
    per = _ONE / max(count, _ONE)
    mean_x, mean_y, mean_z = mean_x * per, mean_y * per, mean_z * per
    xx, zz, xz, xy, zy = _ZERO, _ZERO, _ZERO, _ZERO, _ZERO
    for leg in range(legs):
        weight = _ONE if ground_numbers[leg, i] != NO_GROUND_NUMBER else _ZERO
        x, y = (points[0, leg, i] - mean_x) * weight, (points[1, leg, i] - mean_y) * weight
        z = (points[2, leg, i] - mean_z) * weight
        xx, zz, xz, xy, zy = xx + x * x, zz + z * z, xz + x * z, xy + x * y, zy + z * y
    xx, zz, xz, xy, zy = xx * per + _PLANE_FIT_DAMPING, zz * per + _PLANE_FIT_DAMPING, xz * per, xy * per, zy * per
    determinant = xx * zz - xz * xz
    ahead, aside = _ZERO, _ZERO
    if count >= _MIN_PLANE_FEET:
        ahead, aside = (zz * xy - xz * zy) / determinant, (xx * zy - xz * xy) / determinant
    by = min(_ONE, MAX_TRUNK_SLOPE / max(np.sqrt(ahead * ahead + aside * aside), _MIN_SQUARED_SLOPE))
    ahead, aside = ahead * by, aside * by
    height = (mean_y - ahead * mean_x) - aside * mean_z if count > _ZERO else _ZERO
    return height, ahead, aside


@inlined
def compute_lowered_trunk_rise(points: Any, swing_phases: Any, legs: Any, rise: Any, slope: Any, min_rise: Any, i: Any) -> Any:
    """Return the rise of a trunk that leans by `slope`, lowered as far as necessary for the legs to reach the standing feet.
    It is not lowered below `min_rise`."""
    most = _INFINITE
    for leg in range(legs.shape[1]):
        x, y, z = rotate_point_by_slope(
            slope, (legs[HIP_POSITION_ROW, leg], legs[HIP_POSITION_ROW + 1, leg], legs[HIP_POSITION_ROW + 2, leg])
        )
        dx, dz = points[0, leg, i] - x, points[2, leg, i] - z
        square = legs[SQUARED_LENGTH_ROW, leg] - dx * dx - dz * dz
        if swing_phases[leg, i] == SWING_PHASE_OF_STANDING_FOOT and square > _ZERO:
            most = min(most, points[1, leg, i] + legs[FOOT_Y_ROW, leg] + np.sqrt(max(square, _ZERO)) - y)
    return max(min(rise, most), min(rise, min_rise))


@inlined
def rotate_point_by_slope(slope: Any, point: Any) -> Any:
    """Return a point of a trunk after the rotation that takes the trunk's up direction to the normal of a plane.

    `slope`: the plane's two slopes, along the body's ahead and aside axes."""
    x, y, z = point
    a, b = -slope[0], -slope[1]  # the normal (a, 1, b), divided by its length
    size = _ONE / np.sqrt((a * a + _ONE) + b * b)
    nx, ny, nz = a * size, size, b * size
    by = _ONE / (_ONE + ny)
    # R = 1 + [v] + [v][v] / (1 + n·y), v = y × n = (nz, 0, -nx)
    skew = nx * nz * by
    return (
        x * (_ONE - nx * nx * by) + y * nx - z * skew,
        -x * nx + y * ny - z * nz,
        -x * skew + y * nz + z * (_ONE - nz * nz * by),
    )


def compute_slope_quaternions(slope: Floats) -> Floats:
    """Return the rotations of trunks as unit quaternions (x, y, z, w), float32[n, 4]. `slope` [2, n]: the slopes ahead and
    aside."""
    a, b = -slope[0].astype(np.float64), -slope[1].astype(np.float64)
    size = 1 / np.sqrt((a * a + 1) + b * b)
    x, y, z = b * size, np.zeros_like(a), -a * size
    w = 1 + size
    long = np.sqrt(((x * x + y * y) + z * z) + w * w)
    return np.stack([x / long, y / long, z / long, w / long], axis=1).astype(np.float32)
