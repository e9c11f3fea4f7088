"""Functions of vectors that are the rows of float64 arrays (n, 3). The three products of a dot product are always added in the
same order."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]


def make_columns_contiguous(v: Floats) -> Floats:
    """Return a copy (n, 3) of vectors in which each column is contiguous in memory."""
    return np.array(np.asarray(v, np.float64).T, order="C").T


def take_rows(v: Floats, rows: Rows) -> Floats:
    """Return the vectors at `rows` (ascending), in an array with contiguous columns."""
    if len(rows) == len(v):
        return v
    return v.T.take(rows, axis=1).T


def find_rows_in_box(place: Floats, low: Floats, high: Floats) -> Rows:
    """Return the row numbers, ascending, of the positions [n, 3] that are inside a box or on its surface. `low`, `high`: the
    box's corners [3] with the least and greatest coordinates."""
    inside = np.ones(len(place), np.bool_)
    for axis in range(3):
        coordinates = place[:, axis]
        inside &= (coordinates >= low[axis]) & (coordinates <= high[axis])
    return np.flatnonzero(inside)


def length(v: Floats) -> Floats:
    length: Floats = np.sqrt((v * v).sum(axis=1))
    return length


def dot(a: Floats, b: Floats) -> Floats:
    """Return the dot products (…) of vectors (…, 3)."""
    product = a * b
    total: Floats = (product[..., 0] + product[..., 1]) + product[..., 2]
    return total


def normalise(v: Floats) -> Floats:
    """Return vectors (…, 3) scaled to unit length; zero stays zero."""
    size = np.sqrt(dot(v, v))
    unit_vectors: Floats = v / np.where(size > 0, size, 1.0)[..., None]
    return unit_vectors


def normalise_or_fallback(v: Floats, fallback: Floats) -> Floats:
    """Return vectors (…, 3) scaled to unit length. A zero vector is replaced by the direction of `fallback`, which is
    broadcast."""
    size = np.sqrt(dot(v, v))[..., None]
    return np.where(
        size > 1e-9, v / np.maximum(size, 1e-9), normalise(np.broadcast_to(np.asarray(fallback, np.float64), v.shape))
    )


def compute_unit_tangents(v: Floats, normal: Floats) -> Floats:
    """Return the components of `v` perpendicular to the unit normals `normal`, scaled to length 1. All arrays are (n, 3)."""
    flat = v - (v * normal).sum(axis=1)[:, None] * normal
    level: Floats = flat / np.maximum(length(flat), 1e-12)[:, None]
    return level


def compute_view_axes(eye: Floats, aim: Floats, up: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the three unit axes (3,) of a camera at `eye` that looks at `aim`: right, up (both in its picture) and ahead.

    If `aim` is equal to `eye`, it looks along x. `up`: the direction that points to the top of the picture."""
    ahead = normalise_or_fallback(aim - eye, np.array([1.0, 0.0, 0.0]))
    upward = normalise_or_fallback(up, np.array([0.0, 1.0, 0.0]))
    right = np.cross(ahead, upward)
    if dot(right, right) < 1e-12:  # looking straight down: the picture's top is along the next axis
        right = np.cross(ahead, np.roll(upward, 1))
    right = normalise_or_fallback(right, np.array([1.0, 0.0, 0.0]))
    return right, np.cross(right, ahead), ahead
