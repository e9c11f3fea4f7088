"""Height and tilt of the trunk: a plane through the ground below the feet, smoothed and bounded."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.runtime.feet.gaits import REACHED
from antdsl.scene.setting import LegsData

Floats = NDArray[np.float32]

STEEPEST = 0.35  # rise over run of the trunk against the body's own up: 19 degrees
HIGHEST = 0.3  # of the height of the hips: how much higher or lower the trunk may be
_SLACK, _SLOWLY = 0.06, 0.2  # s, of the way to a new tilt or lower height, and to a greater height: steps do not bounce
_STIFF = 0.02  # square of a length: what keeps a plane through feet that stand close together level
_PLANE = 3  # feet that a plane needs: who has fewer does not tilt


def fitted(
    legs: LegsData, beside: tuple[Floats, Floats, Floats], held: NDArray[np.bool_], rise: Floats, slope: Floats, dt: float
) -> tuple[Floats, Floats]:
    """The rise [n] and the slopes [2, n] of the trunk on the way from those before to the plane through the ground of the feet.

    `beside`: where the feet's ground is from each agent, ahead, above and aside, [n, L]; `held`: which of these are ground. All
    in body lengths. Least squares, feet weighted alike; feet that hang do not count."""
    weight = held.astype(np.float32)
    count = summed(weight)
    per = np.float32(1) / np.maximum(count, np.float32(1))
    middle = [summed(part * weight) * per for part in beside]
    x, y, z = ((part - mean[:, None]) * weight for part, mean in zip(beside, middle, strict=True))
    xx, zz, xz = summed(x * x) * per + np.float32(_STIFF), summed(z * z) * per + np.float32(_STIFF), summed(x * z) * per
    xy, zy = summed(x * y) * per, summed(z * y) * per
    whole = xx * zz - xz * xz
    known = count >= np.float32(_PLANE)
    tilted = [np.where(known, part / whole, np.float32(0)) for part in (zz * xy - xz * zy, xx * zy - xz * xy)]
    steep = np.sqrt(tilted[0] * tilted[0] + tilted[1] * tilted[1])
    by = np.minimum(np.float32(1), np.float32(STEEPEST) / np.maximum(steep, np.float32(1e-6)))
    tilted = [part * by for part in tilted]
    height = np.float32(np.maximum((legs.hip[:, 1] - legs.foot[:, 1]).max(), 1e-3) * HIGHEST)
    higher = (middle[1] - tilted[0] * middle[0]) - tilted[1] * middle[2]
    higher = np.clip(np.where(count > 0, higher, np.float32(0)), -height, height)
    step, up = np.float32(dt / (dt + _SLACK)), np.float32(dt / (dt + _SLOWLY))
    turned = np.stack([s + (t - s) * step for s, t in zip(slope, tilted, strict=True)])
    return (rise + (higher - rise) * np.where(higher > rise, up, step)).astype(np.float32), turned.astype(np.float32)


def lowered(
    legs: LegsData,
    beside: tuple[Floats, Floats, Floats],
    stands: NDArray[np.bool_],
    rise: Floats,
    hips: tuple[Floats, Floats, Floats],
) -> Floats:
    """The rise of trunks that come down as far as the legs of feet that stand ask for; `hips` as they lean, at no rise."""
    most = np.full(len(rise), np.inf, np.float32)
    for k, length in enumerate(legs.length * REACHED):
        x, y, z = (part[:, k] for part in beside)
        dx, dz = x - hips[0][:, k], z - hips[2][:, k]
        square = np.float32(length * length) - dx * dx - dz * dz
        free = y + np.float32(legs.foot[k, 1]) + np.sqrt(np.maximum(square, np.float32(0))) - hips[1][:, k]
        most = np.where(stands[:, k] & (square > 0), np.minimum(most, free), most)
    least = np.float32(-HIGHEST * max(float((legs.hip[:, 1] - legs.foot[:, 1]).max()), 1e-3))
    return np.asarray(np.maximum(np.minimum(rise, most), np.minimum(rise, least)), np.float32)


def leant(points: NDArray[np.float64], slope: Floats) -> tuple[Floats, Floats, Floats]:
    """Points [L, 3] of the body, each [n, L], of trunks whose up is turned by the shortest way to the normal of a plane that
    slopes by [2, n] ahead and aside."""
    a, b = -slope[0], -slope[1]  # the normal is (a, 1, b) by its length
    size = np.float32(1) / np.sqrt((a * a + np.float32(1)) + b * b)
    nx, ny, nz = a * size, size, b * size
    by = np.float32(1) / (np.float32(1) + ny)
    p = points.astype(np.float32)
    x, y, z = p.T[:, :, None]
    # R = 1 + [v] + [v][v] / (1 + n·y), v = y × n = (nz, 0, -nx)
    skew = nx * nz * by
    return (
        (x * (1 - nx * nx * by) + y * nx - z * skew).T,
        (-x * nx + y * ny - z * nz).T,
        (-x * skew + y * nz + z * (1 - nz * nz * by)).T,
    )


def quaternions(slope: Floats) -> Floats:
    """The same turns as unit quaternions float32[n, 4], x y z w."""
    a, b = -slope[0].astype(np.float64), -slope[1].astype(np.float64)
    size = 1 / np.sqrt((a * a + 1) + b * b)
    x, y, z = b * size, np.zeros_like(a), -a * size
    w = 1 + size
    long = np.sqrt(((x * x + y * y) + z * z) + w * w)
    return np.stack([x / long, y / long, z / long, w / long], axis=1).astype(np.float32)


def summed(parts: NDArray[Any]) -> Floats:
    """Sums [n] over feet, in one order."""
    total: Floats = parts[:, 0].astype(np.float32)
    for k in range(1, parts.shape[1]):
        total += parts[:, k]
    return total
