"""`Body`: the mesh of one kind of agent, with the poses of its walk, and the turns that stand it on the ground."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.shapes import Mesh
from antdsl.numerics.vector_rows import unit_or

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """Length 1 along +x (where it heads), up +y, feet on y = 0, the origin between the feet.

    `poses` float32 (k, n, 3): the vertices at k equally spaced moments of one walking cycle; k = 1 when nothing moves.
    `faces` int32 (m, 3); `normals` float32 (n, 3), smooth within a part; `tint` float32 (n,): 1 takes the agent's colour,
    0 stays dark.
    `stride`: body lengths walked in one cycle."""

    name: str
    poses: NDArray[np.float32]
    faces: NDArray[np.int32]
    normals: NDArray[np.float32]
    tint: NDArray[np.float32]
    stride: float = 1.0

    def posed(self, walked: Array) -> NDArray[np.float32]:
        """Vertices (a, n, 3) of `a` agents that have `walked` (a,) body lengths; in between two poses by straight lines."""
        count = len(self.poses)
        if count == 1:
            return np.broadcast_to(self.poses[0], (len(walked), *self.poses.shape[1:]))
        at = (np.asarray(walked, np.float64) / self.stride % 1.0) * count
        first = np.minimum(at.astype(np.int64), count - 1)
        part = (at - first).astype(np.float32)[:, None, None]
        return np.asarray(self.poses[first] * (1 - part) + self.poses[(first + 1) % count] * part)


def vertex_normals(vertices: Array, faces: NDArray[np.int32]) -> NDArray[np.float32]:
    """Unit normals (n, 3) of vertices, faces weighted by their area; a vertex without faces gets +y."""
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.stack(
        [np.bincount(faces.reshape(-1), np.repeat(normal[:, axis], 3), minlength=len(vertices)) for axis in range(3)], axis=1
    )
    length = np.linalg.norm(total, axis=1, keepdims=True)
    total = np.where(length > 1e-20, total / np.maximum(length, 1e-20), np.array([0.0, 1.0, 0.0]))
    return total.astype(np.float32)


def rigid(name: str, mesh: Mesh, tint: NDArray[np.float32] | None = None) -> Body:
    """A body without moving parts."""
    vertices, faces = mesh
    shade = np.ones(len(vertices), np.float32) if tint is None else tint
    return Body(name, vertices[None].astype(np.float32), faces, vertex_normals(vertices, faces), shade)


def orientation(heading: Array, up: Array) -> Array:
    """Quaternions (n, 4) as x, y, z, w that turn +x to `heading` (n, 3) and +y to `up` (n, 3).

    `up` wins: the heading is first laid flat against it. Where the two give no frame (zero or parallel)
    any level heading is taken."""
    up = unit_or(up, np.array([0.0, 1.0, 0.0]))
    ahead = heading - up * (heading * up).sum(axis=1, keepdims=True)
    level = np.cross(up, np.where(np.abs(up[:, :1]) < 0.9, np.array([[1.0, 0.0, 0.0]]), np.array([[0.0, 0.0, 1.0]])))
    ahead = unit_or(ahead, level)
    side = np.cross(ahead, up)
    matrix = np.stack([ahead, up, side], axis=2)
    return _quaternion(matrix)


def turned(orient: Array, vectors: Array) -> Array:
    """`vectors` (n, …, 3) turned by the quaternions `orient` (n, 4) of the same row."""
    matrix = rotation(orient).astype(vectors.dtype)
    return np.asarray(np.einsum("nij,n...j->n...i", matrix, vectors, optimize=True))


def rotation(orient: Array) -> Array:
    """Matrices (n, 3, 3) of quaternions (n, 4) as x, y, z, w; a zero quaternion turns nothing."""
    length = np.linalg.norm(orient, axis=1, keepdims=True)
    q = np.where(length > 1e-12, orient / np.maximum(length, 1e-12), np.array([0.0, 0.0, 0.0, 1.0]))
    x, y, z, w = q.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=1) for row in rows], axis=1)


def _quaternion(m: Array) -> Array:
    """Of rotation matrices (n, 3, 3), from the largest of the four components, so that none is divided by a small one."""
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
