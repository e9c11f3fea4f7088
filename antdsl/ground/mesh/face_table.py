"""A packed table of faces for compiled walks. All values of a face are adjacent in memory, because agents visit faces in any
order."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.mesh.topology import MeshTopology

Floats = NDArray[np.float64]

FLOATS_PER_FACE_ROW = 40  # five complete cache lines
# Numbers in the order in which a walk reads them, four at a time. EDGES has four numbers per edge: its direction (two numbers),
# its link, and one other number: the face's mesh or one of the first two smooth normals. SMOOTH has the other seven of nine.
(
    AXIS1_OFFSET,
    AXIS2_OFFSET,
    NORMAL_OFFSET,
    RATE1_OFFSET,
    RATE2_OFFSET,
    SHEAR_OFFSET,
    EDGES_OFFSET,
    MESH_OFFSET,
    CORNER_OFFSET,
    EDGE1_OFFSET,
    EDGE2_OFFSET,
    SMOOTH_NORMALS_OFFSET,
) = 0, 3, 6, 9, 10, 11, 12, 15, 24, 27, 30, 33
EDGE_COSINE_INDEX, EDGE_SINE_INDEX, EDGE_LINK_INDEX = 0, 1, 2  # offsets from EDGES + 4 * edge
OPEN_BORDER_LINK = -2  # link of a border with nothing beyond it, see `open_borders`


def pack_face_table(table: MeshTopology, mesh_by_face: NDArray[np.int32]) -> Floats:
    """Return the packed table of m faces, float64[40 m]. It includes the mesh of each face, and its links on the normal's
    side."""
    m = table.rate1.size
    space = np.empty(FLOATS_PER_FACE_ROW * m + 8)
    start = -space.ctypes.data % 64 // 8
    result = space[start : start + FLOATS_PER_FACE_ROW * m]
    pack_face_rows(result, table, mesh_by_face, slice(0, m))
    return result


def pack_face_rows(packed_table: Floats, table: MeshTopology, mesh_by_face: NDArray[np.int32], rows: slice) -> None:
    """Write the values of the faces `rows` into a packed table."""
    m = rows.stop - rows.start
    halves = slice(3 * rows.start, 3 * rows.stop)
    edges = np.empty((m, 3, 4))
    for k, values in enumerate((table.edge_c, table.edge_s, table.link[0])):
        edges[:, :, k] = values[halves].reshape(m, 3)
    edges[:, 0, 3], edges[:, 1:, 3] = mesh_by_face[rows], table.smooth[:2, rows].T
    parts: list[NDArray[Any]] = [v[:, rows].T for v in (table.axis1, table.axis2, table.normal)]
    parts += [v[rows].reshape(m, 1) for v in (table.rate1, table.rate2, table.shear)]
    parts += [edges.reshape(m, 12)]
    parts += [v[:, rows].T for v in (table.corner, table.edge1, table.edge2, table.smooth[2:])]
    np.concatenate(parts, axis=1, out=packed_table.reshape(-1, FLOATS_PER_FACE_ROW)[rows])


def mark_border_links(packed_table: Floats, half: NDArray[np.int64], link: int) -> None:
    """Set the link of the half-edges `half`, which have no neighbour, to NO_LINKED_EDGE or OPEN_BORDER_LINK in a packed table."""
    packed_table.reshape(-1, FLOATS_PER_FACE_ROW)[half // 3, EDGES_OFFSET + 4 * (half % 3) + EDGE_LINK_INDEX] = link
