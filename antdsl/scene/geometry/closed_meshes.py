"""Checks whether triangles form a closed body, and which of their sides faces outward.

Both results depend on how often, and in which directions, triangles traverse each edge."""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import stored_tables
from antdsl.scene.staging.mesh_cache import cache_per_mesh

if TYPE_CHECKING:
    from antdsl.scene.setting import MeshData, SolidData
    from antdsl.scene.staging.stage_scene import SceneStaging

Floats = NDArray[np.float64]
Index = NDArray[np.int64]

_WELD_VOXELS_PER_EXTENT = 16.0  # resolution of rounding: corners nearer than a millionth of the extent coincide


def round_to_voxels(corners: Floats) -> tuple[Index, int]:
    """Return triangle corners as integers, and the number of integer units per voxel. `corners` float64[n, 3, 3]: in voxels.

    Corners that are rounded to the same integers count as one point."""
    extent = max(float(np.abs(corners).max()), 1.0)
    # Products of two sides stay below 2**62.
    grain = 1 << min(16, 29 - math.ceil(math.log2(extent)))
    return np.round(corners * grain).astype(np.int64), grain


def count_open_edges_and_sides(corners: Index) -> tuple[int, bool]:
    """Return how many edges belong to an odd number of triangles. Also return whether each edge is traversed equally often in
    both directions.

    `corners` int64[n, 3, 3]: the corners of triangles as integers. Corners at equal positions are one corner."""
    _, direction, first, count = _group_edges(corners)
    direction_sums = np.add.reduceat(direction, first) if len(direction) else np.zeros(0)
    return int((count % 2).sum()), not direction_sums.any()


def count_inward_pieces(vertices: Floats, faces: NDArray[np.int32]) -> tuple[int, int]:
    """Return how many closed pieces of a mesh face inward, and how many have an inconsistent orientation.

    Faces that share an edge belong to one piece, unless the edge has more than two faces. An inward piece within the box of
    another piece is a cavity, which does not count."""
    if not len(faces):
        return 0, 0
    corners = vertices[faces]
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    face, direction, first, count = _group_edges(
        round_to_voxels((corners - low) * (_WELD_VOXELS_PER_EXTENT / max(float((high - low).max()), 1e-12)))[0]
    )
    one = first[count == 2]
    odd = direction[one] == direction[one + 1]  # faces with the same winding traverse their common edge in opposite directions
    piece = _find_components(len(faces), face[one], face[one + 1])
    open_ = np.zeros(len(faces), bool)
    open_[piece[face[np.repeat(count % 2 == 1, count)]]] = True
    mixed = np.zeros(len(faces), bool)
    mixed[piece[face[one[odd]]]] = True
    a, b, c = np.moveaxis(corners - (low + high) / 2, 1, 0)
    size = np.bincount(piece, (np.cross(a, b) * c).sum(axis=1), len(faces))
    closed = ~open_ & (np.bincount(piece, minlength=len(faces)) > 3)
    inward = np.flatnonzero(closed & ~mixed & (size < 0))
    bottom, top = np.full((len(faces), 3), np.inf), np.full((len(faces), 3), -np.inf)
    np.minimum.at(bottom, piece, corners.min(axis=1))
    np.maximum.at(top, piece, corners.max(axis=1))
    around = np.flatnonzero(closed)
    hollow = [((bottom[around] < bottom[k]) & (top[around] > top[k])).all(axis=1).any() for k in inward]
    return len(inward) - int(sum(hollow)), int((mixed & ~open_).sum())


def _find_components(node_count: int, first_nodes: Index, second_nodes: Index) -> Index:
    """Return, for each node, the smallest index of a node in its connected component. `first_nodes`, `second_nodes`: the two
    ends of each edge.

    S. Zhang et al., FastSV, SIAM PP 2020."""
    label = np.arange(node_count)
    while (is_separate := label[first_nodes] != label[second_nodes]).any():
        first_nodes, second_nodes = first_nodes[is_separate], second_nodes[is_separate]
        least, most = np.minimum(label[first_nodes], label[second_nodes]), np.maximum(label[first_nodes], label[second_nodes])
        np.minimum.at(label, most, least)
        while (label != (shorter := label[label])).any():
            label = shorter
    return label


def _group_edges(corners: Index) -> tuple[Index, Index, Index, Index]:
    """Sort all sides of triangles by the edge to which they belong. Return the sides and the edges as four arrays.

    For each side: the index of its triangle, and its direction along the edge (1 or -1). For each edge: the index of its first
    side, and its number of sides."""
    points = corners.reshape(-1, 3)
    order = np.lexsort(points.T)
    ranked = points[order]
    new = np.concatenate(([False], (ranked[1:] != ranked[:-1]).any(axis=1)))
    name = np.empty(len(points), np.int64)
    name[order] = np.cumsum(new)
    a = name.reshape(-1, 3)
    b = a[:, [1, 2, 0]]
    real = a != b
    face = np.repeat(np.arange(len(a)), 3).reshape(-1, 3)[real]
    a, b = a[real], b[real]
    edge = np.minimum(a, b) * len(points) + np.maximum(a, b)
    order = np.argsort(edge, kind="stable")
    first = np.flatnonzero(np.concatenate(([True], np.diff(edge[order]) != 0))) if len(order) else np.zeros(0, np.int64)
    return face[order], np.where(a < b, 1, -1)[order], first, np.diff(np.append(first, len(order)))


@cache_per_mesh
def _count_inward_pieces_of_mesh(mesh: MeshData) -> tuple[int, int]:
    """Return the result of `count_inward_pieces` for a mesh."""
    return count_inward_pieces(mesh.vertices, mesh.faces)


def check_obstacle_sides(staging: SceneStaging) -> None:
    """Warn about obstacles with pieces that face inward. Such pieces would confine agents instead of keeping them outside."""
    for name, mesh in staging.obstacles.items():
        inward, mixed = _count_inward_pieces_of_mesh(mesh)
        if inward or mixed:
            words = (
                f"parts of the obstacle `{name}` point inward"
                if inward
                else f"faces of the obstacle `{name}` point both in and out"
            )
            help = "flip faces so that all point outward; ignore this if the obstacle is a room that encloses agents"
            staging.report.warning("inside-out", words, staging.scene.find_span("world", name), help)


@cache_per_mesh
def count_border_edges(mesh: MeshData) -> int:
    """Return the number of edges of a mesh that belong to exactly one triangle."""
    corners = mesh.vertices[mesh.faces]
    tables = stored_tables.get_or_compute("border edges", len(corners), (corners,), partial(_make_border_edge_table, corners))
    return int(tables["count"][0])


def _make_border_edge_table(corners: Floats) -> stored_tables.Tables:
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    _, _, _, count = _group_edges(
        round_to_voxels((corners - low) * (_WELD_VOXELS_PER_EXTENT / max(float((high - low).max()), 1e-12)))[0]
    )
    return {"count": np.array([(count == 1).sum()], np.int64)}


def find_edges_with_odd_faces(vertices: Floats, faces: NDArray[np.int32], grain: float) -> tuple[Index, Floats]:
    """Return the edges (k, 2) that have an odd number of faces, and the positions (p, 3) to which their indices refer.

    Corners that are nearer to each other than about `grain` share one position."""
    corners = vertices[faces].reshape(-1, 3)
    cells = round_to_voxels((corners - corners.min(axis=0)).reshape(-1, 3, 3) / grain)[0].reshape(-1, 3)
    _, first, name = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    a = name.reshape(-1, 3)
    ends = np.sort(np.stack([a, np.roll(a, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    edges, count = np.unique(ends[ends[:, 0] != ends[:, 1]], axis=0, return_counts=True)
    return edges[count % 2 == 1], corners[first]


def count_open_solid_edges(solid: SolidData) -> int:
    """Return the number of edges of a solid that have an odd number of triangles. A solid with such edges has no defined
    inside."""
    corners = solid.mesh.vertices[solid.mesh.faces]
    loose, _ = count_open_edges_and_sides(round_to_voxels((corners - corners.min(axis=(0, 1))) / solid.voxel)[0])
    return loose
