"""Fast loops over all agents: positions and sides of footings, and the greatest displacement and size.

Positions are computed from vertices instead of a table of faces. Neighbouring faces share vertices, so less memory is read than
with such a table."""

import numpy as np

from antdsl.machine_code.kernels import BOOL, F64, I8, I32, I64, Array1, Array2, kernel, prefetch

_PREFETCH_GROUP_SIZE = 64  # footings with vertices prefetched together


@kernel
def write_footing_positions(
    vertices: Array1[F64],
    faces: Array2[I32],
    normal: Array2[F64],
    first_faces: Array1[I64],
    mesh: Array1[I32],
    face: Array1[I32],
    b1: Array1[F64],
    b2: Array1[F64],
    heights: Array1[F64],
    place: Array2[F64],
) -> BOOL:
    """Write the position of each footing to `place` [n,3]; it is 0 for agents without a footing. Return whether all face numbers
    are valid.

    `first_faces`: the index in `faces` and `normal` (3, m) at which the faces of each mesh begin. `vertices`: three numbers per
    vertex."""
    for begin in range(0, mesh.size, _PREFETCH_GROUP_SIZE):
        end = min(begin + _PREFETCH_GROUP_SIZE, mesh.size)
        for n in range(end, min(end + _PREFETCH_GROUP_SIZE, mesh.size)):
            if mesh[n] >= 0 and face[n] >= 0 and mesh[n] < first_faces.size:
                prefetch(faces, 3 * (first_faces[mesh[n]] + face[n]))
        for n in range(begin, end):
            if mesh[n] >= 0 and face[n] >= 0:
                if mesh[n] >= first_faces.size:
                    return False
                f = first_faces[mesh[n]] + face[n]
                if f >= faces.shape[0]:
                    return False
                for corner in range(3):
                    prefetch(vertices, 3 * faces[f, corner])
        for n in range(begin, end):
            x, y, z = 0.0, 0.0, 0.0
            if mesh[n] >= 0 and face[n] >= 0:
                f = first_faces[mesh[n]] + face[n]
                i, j, k = 3 * faces[f, 0], 3 * faces[f, 1], 3 * faces[f, 2]
                p, q, h = b1[n], b2[n], heights[n]
                x, y, z = vertices[i], vertices[i + 1], vertices[i + 2]
                x = (x + p * (vertices[j] - x)) + q * (vertices[k] - x)
                y = (y + p * (vertices[j + 1] - y)) + q * (vertices[k + 1] - y)
                z = (z + p * (vertices[j + 2] - z)) + q * (vertices[k + 2] - z)
                if h != 0.0 or x == 0.0 or y == 0.0 or z == 0.0:  # otherwise no value changes, not even the sign of zero
                    x, y, z = x + h * normal[0, f], y + h * normal[1, f], z + h * normal[2, f]
            place[n, 0], place[n, 1], place[n, 2] = x, y, z
    return True


@kernel
def write_footing_sides(
    mesh: Array1[I32],
    face: Array1[I32],
    first_faces: Array1[I64],
    side_by_face: Array1[I8],
    sides: Array1[I8],
    begin: I64,
    end: I64,
) -> None:
    """Write the side (axis direction) of the face of each footing, for agents `begin` to `end` (exclusive). It is 0 for agents
    without a footing. `first_faces`: the index in `side_by_face` at which the faces of each mesh begin."""
    for n in range(begin, end):
        if mesh[n] >= 0 and face[n] >= 0:
            sides[n] = side_by_face[first_faces[mesh[n]] + face[n]]
        else:
            sides[n] = 0


@kernel
def find_max_step_and_size(displacements: Array2[F64], sizes: Array1[F64]) -> tuple[F64, F64]:
    """Return the greatest squared length of the finite vectors (3, n), and the greatest size. Without finite vectors, the length
    is 0. If all sizes are NaN, the size is NaN."""
    most, widest = 0.0, np.nan
    for k in range(sizes.size):
        square = (displacements[0, k] * displacements[0, k] + displacements[1, k] * displacements[1, k]) + displacements[
            2, k
        ] * displacements[2, k]
        if square < np.inf:
            most = max(most, square)
        if not widest >= sizes[k] and sizes[k] == sizes[k]:
            widest = sizes[k]
    return most, widest
