"""Ways from one space to another as matrices (…, 3, 4): a turn and scale, and a shift. Sums are written out, so that every point
gets the same bits whatever the number of points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def still(*shape: int) -> Floats:
    """Ways (*shape, 3, 4) that leave everything where it is."""
    made = np.zeros((*shape, 3, 4))
    made[..., [0, 1, 2], [0, 1, 2]] = 1.0
    return made


def after(outer: Floats, inner: Floats) -> Floats:
    """The inner way first, then the outer."""
    turn = outer[..., :3] @ inner[..., :3]
    shift = (outer[..., :3] @ inner[..., 3:])[..., 0] + outer[..., 3]
    return np.concatenate([turn, shift[..., None]], axis=-1)


def inverse(way: Floats) -> Floats:
    """The way back of one way (3, 4) that has a size."""
    turn = np.linalg.inv(way[:, :3])
    return np.concatenate([turn, -(turn @ way[:, 3:])], axis=1)


def has_inverse(way: Floats) -> bool:
    """Whether there is a way back: the way flattens nothing."""
    size = float(np.linalg.norm(way[:, :3]))
    return bool(np.isfinite(way).all() and abs(np.linalg.det(way[:, :3])) > 1e-12 * size**3)


def applied(way: Floats, points: Floats) -> Floats:
    """Points (n, 3) by one way (3, 4), or each by its own (n, 3, 4)."""
    x, y, z = (points[:, axis, None] for axis in range(3))
    found: Floats = ((way[..., 0] * x + way[..., 1] * y) + way[..., 2] * z) + way[..., 3]
    return found
