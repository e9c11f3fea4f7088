"""Vectors of compiled walks: three numbers each, summed in the order of `walk.dot` and `walk.cross`."""

from __future__ import annotations

import numpy as np

from antdsl.runtime.compiling import njit


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def at(table, k):  # type: ignore[no-untyped-def]
    """Three numbers of a table."""
    return table[k], table[k + 1], table[k + 2]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def plus(a, b):  # type: ignore[no-untyped-def]
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def minus(a, b):  # type: ignore[no-untyped-def]
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def times(a, factor):  # type: ignore[no-untyped-def]
    return a[0] * factor, a[1] * factor, a[2] * factor


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def dot(a, b):  # type: ignore[no-untyped-def]
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def cross(a, b):  # type: ignore[no-untyped-def]
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def more(a, b):  # type: ignore[no-untyped-def]
    """As np.fmax of a number that may be NaN and one that is not."""
    return a if a > b else b


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def less(a, b):  # type: ignore[no-untyped-def]
    """As np.fmin of the same."""
    return a if a < b else b


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def inside(b1, b2):  # type: ignore[no-untyped-def]
    """As `walk.inside`."""
    b1, b2 = min(max(b1, 0.0), 1.0), min(max(b2, 0.0), 1.0)
    total = b1 + b2
    if total > 1.0:
        return b1 / total, b2 / total
    return b1, b2


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def turned(v, before, after, direction):  # type: ignore[no-untyped-def]
    """As `walk.turned`, for one."""
    cosine = dot(before, after)
    if cosine < -1 + 1e-9:
        hinge = cross(before, direction)
        return minus(times(hinge, 2 * dot(hinge, v)), v)
    axis = cross(before, after)
    part = dot(axis, v) / (1 + cosine)
    return plus(plus(times(v, cosine), cross(axis, v)), times(axis, part))


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def level(c, s):  # type: ignore[no-untyped-def]
    """A direction in a face of unit length; along its first axis where nothing is left of it."""
    size = np.sqrt(c * c + s * s)
    if size > 1e-9:
        return c / size, s / size
    return 1.0, 0.0
