"""Transforms from one space to another as matrices (…, 3, 4): rotation and scale, and a shift. Sums are explicit, so that every
point gets the same bits for any number of points."""

from __future__ import annotations

from decimal import Decimal, localcontext

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_TURN = Decimal("6.28318530717958647692528676655900576839433879875021164194988918")


def still(*shape: int) -> Floats:
    """Return identity transforms (*shape, 3, 4)."""
    made = np.zeros((*shape, 3, 4))
    made[..., [0, 1, 2], [0, 1, 2]] = 1.0
    return made


def of_parts(translation: Floats, rotation: Floats, scale: Floats) -> Floats:
    """Return the transform (3, 4) that scales, then rotates by a quaternion x y z w of any length, then shifts."""
    x, y, z, w = rotation / max(float(np.sqrt((rotation * rotation).sum())), 1e-30)
    made = still()
    made[:, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    made[:, :3] *= scale
    made[:, 3] = translation
    return made


def after(outer: Floats, inner: Floats) -> Floats:
    """The inner way first, then the outer."""
    made = product(outer[..., :3], inner)
    made[..., 3] += outer[..., 3]
    return made


def product(a: Floats, b: Floats) -> Floats:
    """Of matrices (…, j, 3) and (…, 3, k)."""
    found: Floats = (a[..., 0, None] * b[..., 0:1, :] + a[..., 1, None] * b[..., 1:2, :]) + a[..., 2, None] * b[..., 2:3, :]
    return found


def determinant(way: Floats) -> float:
    """Return the determinant of a transform (3, 4): the factor of volumes, negative if it mirrors."""
    return float(determinants(way))


def determinants(ways: Floats) -> Floats:
    """The same of ways (…, 3, 4)."""
    a, b, c = (ways[..., row, :3] for row in range(3))
    across = np.cross(b, c)
    found: Floats = (a[..., 0] * across[..., 0] + a[..., 1] * across[..., 1]) + a[..., 2] * across[..., 2]
    return found


def scale(way: Floats) -> float:
    """Return the factor of lengths, if it is the same in all directions."""
    with localcontext(prec=40):
        return float(abs(Decimal(determinant(way))) ** (Decimal(1) / 3)) if determinant(way) else 0.0


def cosine_and_sine(angle: float) -> tuple[float, float]:
    """Return cosine and sine of an angle in radians, correct to the last bit, by their series in decimal numbers."""
    with localcontext(prec=60):
        x = Decimal(angle) % _TURN
        term, found, k = Decimal(1), [Decimal(0), Decimal(0)], 0
        while abs(term) > Decimal(10) ** -50 or k < abs(x):
            found[k % 2] += term if k % 4 < 2 else -term
            k += 1
            term = term * x / k
        return float(found[0]), float(found[1])


def inverse(ways: Floats) -> Floats:
    """Return the inverses of transforms (…, 3, 4) that have one."""
    a, b, c = (ways[..., row, :3] for row in range(3))
    turn = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=-1) / determinants(ways)[..., None, None]
    return np.concatenate([turn, -product(turn, ways[..., 3:])], axis=-1)


def has_inverse(way: Floats) -> bool:
    """Return whether a transform has an inverse, that is, flattens nothing."""
    return bool(have_inverses(way))


def have_inverses(ways: Floats) -> NDArray[np.bool_]:
    """The same of ways (…, 3, 4)."""
    turn = ways[..., :3].reshape(*ways.shape[:-2], 9)
    square = (turn * turn).sum(axis=-1)
    is_large = np.abs(determinants(ways)) > 1e-12 * square * np.sqrt(square)
    return np.asarray(np.isfinite(ways).all(axis=(-2, -1)) & is_large)


def applied(way: Floats, points: Floats) -> Floats:
    """Apply one transform (3, 4) to points (n, 3), or to each its own (n, 3, 4)."""
    x, y, z = (points[:, axis, None] for axis in range(3))
    found: Floats = ((way[..., 0] * x + way[..., 1] * y) + way[..., 2] * z) + way[..., 3]
    return found


def different(points: Floats) -> tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.int64]]:
    """Return an order by x, y, z of points (n, 3); which points in that order differ from the one before; and for each point the
    index of its distinct point. Zero and minus zero are equal."""
    order = np.lexsort(points.T[::-1])
    ranked = points[order]
    new = np.ones(len(points), np.bool_)
    new[1:] = (ranked[1:] != ranked[:-1]).any(axis=1)
    which = np.empty(len(points), np.int64)
    which[order] = np.cumsum(new) - 1
    return order, new, which
