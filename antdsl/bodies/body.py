"""Computes rotations that align bodies with the ground, and vertex normals of meshes."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.vector_rows import normalise_or_fallback

Array = NDArray[np.float64]


def compute_vertex_normals(vertices: Array, faces: NDArray[np.int32]) -> NDArray[np.float32]:
    """Return unit vertex normals (n, 3): the mean normals of adjacent faces, weighted by area. A vertex without faces gets +y."""
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.stack(
        [np.bincount(faces.reshape(-1), np.repeat(normal[:, axis], 3), minlength=len(vertices)) for axis in range(3)], axis=1
    )
    length = np.linalg.norm(total, axis=1, keepdims=True)
    total = np.where(length > 1e-20, total / np.maximum(length, 1e-20), np.array([0.0, 1.0, 0.0]))
    return total.astype(np.float32)


def normalise_normals(normals: NDArray[Any], tolerance: float = 0.0) -> NDArray[np.float32]:
    """Return normals (n, 3) scaled to length 1. A normal with a length that differs from 1 by at most `tolerance` is not
    changed. A normal of length 0 becomes +y."""
    wide = normals.astype(np.float64)
    length = np.sqrt((wide * wide).sum(axis=1, keepdims=True))
    scaled = np.where(np.abs(length - 1.0) > tolerance, wide / np.maximum(length, 1e-12), wide)
    return np.where(length > 1e-12, scaled, np.array([0.0, 1.0, 0.0])).astype(np.float32)


def build_orientations(heading: Array, up: Array) -> Array:
    """Return quaternions (n, 4) as x, y, z, w that rotate +x to `heading` (n, 3) and +y to `up` (n, 3).

    The rotated +y equals `up` exactly: the heading is first projected onto the plane perpendicular to `up`. If the two vectors
    are parallel or one is zero, any heading perpendicular to `up` is used.
    """
    up = normalise_or_fallback(up, np.array([0.0, 1.0, 0.0]))
    ahead = heading - up * (heading * up).sum(axis=1, keepdims=True)
    level = np.cross(up, np.where(np.abs(up[:, :1]) < 0.9, np.array([[1.0, 0.0, 0.0]]), np.array([[0.0, 0.0, 1.0]])))
    ahead = normalise_or_fallback(ahead, level)
    side = np.cross(ahead, up)
    matrix = np.stack([ahead, up, side], axis=2)
    return _matrices_to_quaternions(matrix)


def rotate_vectors(orient: Array, vectors: Array) -> Array:
    """Return vectors (n, …, 3), each row rotated by its quaternion in `orient` (n, 4)."""
    matrix = build_rotation_matrices(orient).astype(vectors.dtype)
    return np.asarray(np.einsum("nij,n...j->n...i", matrix, vectors, optimize=True))


def build_rotation_matrices(orient: Array) -> Array:
    """Return rotation matrices (n, 3, 3) of quaternions (n, 4) as x, y, z, w. A zero quaternion becomes the identity."""
    length = np.linalg.norm(orient, axis=1, keepdims=True)
    q = np.where(length > 1e-12, orient / np.maximum(length, 1e-12), np.array([0.0, 0.0, 0.0, 1.0]))
    x, y, z, w = q.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=1) for row in rows], axis=1)


def _matrices_to_quaternions(m: Array) -> Array:
    """Return quaternions (n, 4) of rotation matrices (n, 3, 3). The largest of the four components is computed first, so that no
    divisor is small."""
    xx, yy, zz = m[:, 0, 0], m[:, 1, 1], m[:, 2, 2]
    squares = np.stack([1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz, 1 + xx + yy + zz], axis=1)
    a, b, c = m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]
    d, e, f = m[:, 0, 1] + m[:, 1, 0], m[:, 0, 2] + m[:, 2, 0], m[:, 1, 2] + m[:, 2, 1]
    rows = np.stack(
        [
            np.stack([squares[:, 0], d, e, a], axis=1),
            np.stack([d, squares[:, 1], f, b], axis=1),
            np.stack([e, f, squares[:, 2], c], axis=1),
            np.stack([a, b, c, squares[:, 3]], axis=1),
        ],
        axis=1,
    )
    best = np.take_along_axis(rows, squares.argmax(axis=1)[:, None, None], axis=1)[:, 0]
    best = best / np.linalg.norm(best, axis=1, keepdims=True)
    return np.asarray(np.where(best[:, 3:] < 0, -best, best))
