"""The open borders of surfaces, as edges with a direction into the surface."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.mesh.topology import NO_LINKED_EDGE
from antdsl.ground.protocol import Floats, MeshSurfaces


class BorderEdges(NamedTuple):
    """Edges of the border of a surface, from `start_points` to `end_points` (m, 3; mm).

    `inward_direction` (m, 3): the unit vector from the edge into its face, perpendicular to the edge."""

    start_points: Floats
    end_points: Floats
    inward_direction: Floats


def find_border_edges(meshes: MeshSurfaces, is_chosen: NDArray[np.bool_]) -> BorderEdges:
    """Return the edges of chosen faces that belong to no other chosen face. `is_chosen`: a flag for each face of all surfaces."""
    vertices, faces, _, table = meshes.triangles
    half = np.flatnonzero((table.link[0] == NO_LINKED_EDGE) & np.repeat(is_chosen, 3))
    own, k = half // 3, half % 3
    start, end = vertices[faces[own, (k + 1) % 3]], vertices[faces[own, (k + 2) % 3]]
    edge = end - start
    length = np.sqrt((edge * edge).sum(axis=1))
    inward = np.cross(table.normal.T[own], edge / np.where(length > 0, length, 1.0)[:, None])
    return BorderEdges(start, end, inward)
