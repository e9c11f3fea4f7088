"""Functions of vectors that are stored by component: as three arrays, or as one array (3, n). The three products of a dot
product are added in a fixed order, so that every machine gives the same bits."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
VectorArrays = tuple[Array, Array, Array]
VectorComponents = VectorArrays | list[Array] | Array


def dot(a: VectorComponents, b: VectorComponents) -> Array:
    total: Array = (a[0] * b[0] + a[1] * b[1]) + a[2] * b[2]
    return total


def cross(a: VectorComponents, b: VectorComponents) -> VectorArrays:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def compute_stacked_cross(a: VectorComponents, b: VectorComponents) -> Array:
    """Return the cross products of `a` and `b` as one array (3, n)."""
    return np.stack(cross(a, b))


def add(a: VectorComponents, b: VectorComponents) -> VectorArrays:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def subtract(a: VectorComponents, b: VectorComponents) -> VectorArrays:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def scale(a: VectorComponents, s: Array | float | np.floating[Any]) -> VectorArrays:
    """Multiply vectors by one number, or each vector by its own number."""
    return a[0] * s, a[1] * s, a[2] * s


def length(a: VectorComponents) -> Array:
    return np.sqrt(dot(a, a))


def select_vectors(condition: Array, a: VectorArrays, b: VectorArrays) -> VectorArrays:
    """Return the vectors of `a` where the condition is true, and those of `b` elsewhere."""
    return np.where(condition, a[0], b[0]), np.where(condition, a[1], b[1]), np.where(condition, a[2], b[2])


def copy(a: VectorArrays) -> VectorArrays:
    """Return a copy of the three arrays."""
    return np.array(a[0]), np.array(a[1]), np.array(a[2])


def take_rows(a: VectorComponents, rows: NDArray[np.integer[Any]] | NDArray[np.bool_] | slice) -> VectorArrays:
    """Return the selected vectors: copies, or views if `rows` is a slice."""
    return a[0][rows], a[1][rows], a[2][rows]


def project_to_plane(a: VectorComponents, up: VectorComponents) -> VectorArrays:
    """Return the component of `a` perpendicular to the unit vector `up`."""
    return subtract(a, scale(up, dot(a, up)))


def normalise_or_fallback(a: VectorArrays, fallback: VectorArrays, min_length: float = 1e-12) -> VectorArrays:
    """Return vectors scaled to length 1, or `fallback` for vectors shorter than `min_length`."""
    size = length(a)
    has_length = (size > min_length) & np.isfinite(size)
    return select_vectors(has_length, scale(a, 1 / np.where(has_length, size, 1)), fallback)


def rotate_between_normals(v: Array, source: Array, target: Array, direction: Array) -> Array:
    """Return the vectors `v` after the smallest rotations that take the unit normals `source` to `target`. For opposite
    normals, the rotation passes through `direction`."""
    cosine = dot(source, target)
    opposite = cosine < -1 + 1e-9
    axis = compute_stacked_cross(source, target)
    part = dot(axis, v) / np.where(opposite, 1.0, 1 + cosine)
    rotated = cosine * v + compute_stacked_cross(axis, v) + part * axis
    hinge = compute_stacked_cross(source, direction)
    return np.where(opposite, 2 * dot(hinge, v) * hinge - v, rotated)


def find_perpendicular(up: VectorArrays) -> VectorArrays:
    """Return a unit vector perpendicular to a unit vector."""
    steep = np.abs(up[0]) > 0.9
    zero, one = np.zeros_like(up[0]), np.ones_like(up[0])
    axis = select_vectors(steep, (zero, one, zero), (one, zero, zero))
    side = project_to_plane(axis, up)
    return scale(side, 1 / length(side))


def split_columns(a: NDArray[Any], dtype: type[np.floating[Any]]) -> VectorArrays:
    """Return the columns of an array (n, 3) as three arrays."""
    return np.ascontiguousarray(a[:, 0], dtype), np.ascontiguousarray(a[:, 1], dtype), np.ascontiguousarray(a[:, 2], dtype)


def get_vector_registers(registers: Mapping[str, Array], name: str) -> VectorArrays:
    """Return the registers of the vector `name`: the arrays `name.x`, `name.y` and `name.z`, without copies."""
    return _build_register_getter(name)(registers)


@cache
def _build_register_getter(name: str) -> Callable[[Mapping[str, Array]], VectorArrays]:
    return itemgetter(f"{name}.x", f"{name}.y", f"{name}.z")


def stack_rows(a: VectorArrays) -> NDArray[np.float64]:
    """Return three component arrays as one float64 array (n, 3) with contiguous columns."""
    columns = np.empty((3, len(a[0])))
    for column, component in zip(columns, a, strict=True):
        column[:] = component
    return columns.T
