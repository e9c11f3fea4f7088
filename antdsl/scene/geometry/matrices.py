"""Transforms from one space to another, as matrices (…, 3, 4): rotation and scale, then translation.

Sums are written out, so that each point gets the same bits whatever the number of points."""

from __future__ import annotations

from decimal import Decimal, localcontext

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_FULL_TURN = Decimal("6.28318530717958647692528676655900576839433879875021164194988918")


def make_identity_transforms(*shape: int) -> Floats:
    """Return identity transforms, an array (*shape, 3, 4)."""
    transforms = np.zeros((*shape, 3, 4))
    transforms[..., [0, 1, 2], [0, 1, 2]] = 1.0
    return transforms


def make_transform(translation: Floats, rotation: Floats, scale: Floats) -> Floats:
    """Return the transform (3, 4) that scales, then rotates, then translates. `rotation`: a quaternion (x, y, z, w) of any
    length."""
    x, y, z, w = rotation / max(float(np.sqrt((rotation * rotation).sum())), 1e-30)
    transform = make_identity_transforms()
    transform[:, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    transform[:, :3] *= scale
    transform[:, 3] = translation
    return transform


def compose_transforms(outer: Floats, inner: Floats) -> Floats:
    """Return the transform that applies `inner` first, then `outer`."""
    composed = multiply_matrices(outer[..., :3], inner)
    composed[..., 3] += outer[..., 3]
    return composed


def multiply_matrices(a: Floats, b: Floats) -> Floats:
    """Return the product of matrices (…, j, 3) and (…, 3, k)."""
    result: Floats = (a[..., 0, None] * b[..., 0:1, :] + a[..., 1, None] * b[..., 1:2, :]) + a[..., 2, None] * b[..., 2:3, :]
    return result


def compute_determinant(transform: Floats) -> float:
    """Return the determinant of a transform (3, 4): the factor by which it scales volumes. It is negative if the transform
    mirrors."""
    return float(compute_determinants(transform))


def compute_determinants(transforms: Floats) -> Floats:
    """Return the determinants (…) of transforms (…, 3, 4)."""
    a, b, c = (transforms[..., row, :3] for row in range(3))
    across = np.cross(b, c)
    result: Floats = (a[..., 0] * across[..., 0] + a[..., 1] * across[..., 1]) + a[..., 2] * across[..., 2]
    return result


def find_uniform_scale(transform: Floats) -> float:
    """Return the factor by which a transform scales lengths. It must scale by the same factor in all directions."""
    with localcontext(prec=40):
        return float(abs(Decimal(compute_determinant(transform))) ** (Decimal(1) / 3)) if compute_determinant(transform) else 0.0


def compute_cosine_and_sine(angle: float) -> tuple[float, float]:
    """Return the cosine and sine of an angle in radians, correct to the last bit. They are computed from their series in decimal
    arithmetic."""
    with localcontext(prec=60):
        x = Decimal(angle) % _FULL_TURN
        term, sums, k = Decimal(1), [Decimal(0), Decimal(0)], 0
        while abs(term) > Decimal(10) ** -50 or k < abs(x):
            sums[k % 2] += term if k % 4 < 2 else -term
            k += 1
            term = term * x / k
        return float(sums[0]), float(sums[1])


def invert_transforms(transforms: Floats) -> Floats:
    """Return the inverses of transforms (…, 3, 4). All of them must be invertible."""
    a, b, c = (transforms[..., row, :3] for row in range(3))
    turn = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=-1) / compute_determinants(transforms)[..., None, None]
    return np.concatenate([turn, -multiply_matrices(turn, transforms[..., 3:])], axis=-1)


def has_inverse(transform: Floats) -> bool:
    """Return whether a transform has an inverse. A transform that flattens space has none."""
    return bool(find_invertible(transform))


def find_invertible(transforms: Floats) -> NDArray[np.bool_]:
    """Return whether each of the transforms (…, 3, 4) has an inverse."""
    turn = transforms[..., :3].reshape(*transforms.shape[:-2], 9)
    square = (turn * turn).sum(axis=-1)
    is_large = np.abs(compute_determinants(transforms)) > 1e-12 * square * np.sqrt(square)
    return np.asarray(np.isfinite(transforms).all(axis=(-2, -1)) & is_large)


def apply_transforms(transform: Floats, points: Floats) -> Floats:
    """Return the points after transforms. `transform`: (3, 4) for all points, or (n, 3, 4) with one transform per point."""
    x, y, z = (points[:, axis, None] for axis in range(3))
    result: Floats = ((transform[..., 0] * x + transform[..., 1] * y) + transform[..., 2] * z) + transform[..., 3]
    return result


def find_distinct_points(points: Floats) -> tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.int64]]:
    """Return the distinct points among points (n, 3), in sorted form. Zero and minus zero are equal.

    There are three results. The first is the order of the points by x, y and z. The second is a mask in this order, true where a
    point differs from the previous one. The third is, for each input point, the index of its distinct point."""
    order = np.lexsort(points.T[::-1])
    ranked = points[order]
    new = np.ones(len(points), np.bool_)
    new[1:] = (ranked[1:] != ranked[:-1]).any(axis=1)
    which = np.empty(len(points), np.int64)
    which[order] = np.cumsum(new) - 1
    return order, new, which
