"""Measures the distances of nodes from the nearest triangle, in a narrow band around the surface.

Distances are exact next to triangles. Farther away, the nearest triangle is propagated from node to node."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.solid.bricks import NODES_PER_BRICK

Floats = NDArray[np.float64]
Index = NDArray[np.int64]
Distances = NDArray[np.float32]

# Voxels: nodes up to this distance are measured to all triangles; corners of cells at the surface are nearer
EXACT_DISTANCE_VOXELS = 1.75
FAR_DISTANCE = np.float32(1e9)  # distance of nodes beyond the band
_PAIRS_PER_CHUNK = 1 << 15  # pairs of a node and a triangle per chunk, so that they fit into the processor's cache
_NEIGHBOUR_STEPS = ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1))


def compute_node_distances(shape: tuple[int, int, int], near_bricks: Index, corners: Floats, band: float) -> Distances:
    """Return the distances (voxels) of the nodes of the bricks `near_bricks`, float32[bricks * 4096]. Nodes beyond `band` have
    FAR_DISTANCE.

    `corners`: float64[n,3,3], the triangles in voxels. Nodes next to a triangle are measured first. Then the other nodes are
    measured, layer by layer outwards. Such a node is measured only to the triangles that are nearest to its neighbours (Bridson,
    Fluid Simulation for Computer Graphics, 2015, section 4.2)."""
    field = _NodeDistanceField(shape, near_bricks, corners)
    for nodes, triangle in iterate_nodes_near_triangles(corners):
        field.measure_distances(nodes, triangle, False)
    front = field.pop_nearer_nodes()
    while front.size:
        front = front[field.distances[front] < band]
        around = field.split_node_numbers(front)
        nodes = [
            np.concatenate(parts) for parts in zip(*(_shift_columns(around, step) for step in _NEIGHBOUR_STEPS), strict=True)
        ]
        field.measure_distances(nodes, np.tile(field.nearest_triangles[front], len(_NEIGHBOUR_STEPS)), True)
        front = field.pop_nearer_nodes()
    return field.distances


def _shift_columns(columns: list[Index], step: tuple[int, ...]) -> list[Index]:
    """Return the columns of node coordinates, shifted by `step`."""
    return [column + by for column, by in zip(columns, step, strict=True)]


def iterate_nodes_near_triangles(corners: Floats) -> Iterator[tuple[list[Index], Index]]:
    """Yield the nodes near each triangle: the columns of their coordinates, and the triangle of each node. Such nodes are near
    the triangle's plane, and project into the triangle or near its outline. The search goes along grid lines parallel to the axis
    nearest to the normal, because a triangle crosses few of these."""
    edges = corners[:, [1, 2]] - corners[:, :1]
    normal = np.cross(edges[:, 0], edges[:, 1])
    # a triangle without area is skipped: its sides belong to other triangles
    axes = np.where(normal.any(axis=1), np.abs(normal).argmax(axis=1), -1)
    for axis in range(3):
        which = np.flatnonzero(axes == axis)
        others = [k for k in range(3) if k != axis]
        flat = corners[which][:, :, others]
        low = np.ceil(flat.min(axis=1) - EXACT_DISTANCE_VOXELS).astype(np.int64)
        count = np.floor(flat.max(axis=1) + EXACT_DISTANCE_VOXELS).astype(np.int64) - low + 1
        slope = normal[which]
        for t, u, v in iterate_lattice_points(low, count, _PAIRS_PER_CHUNK):
            near = _select_projected_inside(flat, t, u, v)
            t, u, v = t[near], u[near], v[near]
            first = corners[which[t], 0]
            level = (
                first[:, axis]
                - ((u - first[:, others[0]]) * slope[t, others[0]] + (v - first[:, others[1]]) * slope[t, others[1]])
                / slope[t, axis]
            )
            lean = np.abs(slope[t, axis]) / np.sqrt((slope[t] ** 2).sum(axis=1))
            reach = EXACT_DISTANCE_VOXELS / lean
            lowest = np.ceil(level - reach).astype(np.int64)
            count_up = np.maximum(np.floor(level + reach).astype(np.int64) - lowest + 1, 0)
            which_line = np.repeat(np.arange(t.size), count_up)
            nodes: list[Index] = [u, u, u]
            nodes[axis] = lowest[which_line] + enumerate_within_groups(count_up)
            nodes[others[0]], nodes[others[1]] = u[which_line], v[which_line]
            yield nodes, which[t[which_line]]


def _select_projected_inside(projected_points: Floats, t: Index, u: Index, v: Index) -> Index:
    """Return the indices of the points that are inside their projected triangle, or near its outline.

    `projected_points` (k, 3, 2): the corners of triangles in a plane. `t`, `u`, `v`: the triangle and the plane coordinates of
    each point."""
    inside = np.ones(t.size, bool)
    turn = np.sign(
        (projected_points[:, 1, 0] - projected_points[:, 0, 0]) * (projected_points[:, 2, 1] - projected_points[:, 0, 1])
        - (projected_points[:, 1, 1] - projected_points[:, 0, 1]) * (projected_points[:, 2, 0] - projected_points[:, 0, 0])
    )
    for i, j in ((0, 1), (1, 2), (2, 0)):
        eu, ev = (
            (projected_points[:, j, 0] - projected_points[:, i, 0]) * turn,
            (projected_points[:, j, 1] - projected_points[:, i, 1]) * turn,
        )
        least = (eu * projected_points[:, i, 1] - ev * projected_points[:, i, 0]) - EXACT_DISTANCE_VOXELS * 1.001 * np.sqrt(
            eu * eu + ev * ev
        )
        inside &= eu.take(t) * v - ev.take(t) * u >= least.take(t)
    return np.flatnonzero(inside)


class _NodeDistanceField:
    """The nodes of some bricks: their distances, and the nearest triangle of each node."""

    def __init__(self, shape: tuple[int, int, int], near_bricks: Index, corners: Floats) -> None:
        self._shape = shape
        self._near_bricks = near_bricks
        self._index_of_brick = np.full(
            math.prod(shape), -1, np.int32
        )  # index of each brick's nodes in the arrays, in units of 4096
        self._index_of_brick[near_bricks] = np.arange(near_bricks.size)
        self._triangle_data = _pack_triangle_data(corners)
        self._has_come_nearer = np.zeros(near_bricks.size * NODES_PER_BRICK, bool)
        self.distances: Distances = np.full(near_bricks.size * NODES_PER_BRICK, FAR_DISTANCE, np.float32)
        self.nearest_triangles = np.full(near_bricks.size * NODES_PER_BRICK, -1, np.int32)

    def pop_nearer_nodes(self) -> Index:
        """Return the nodes with distances that have decreased since the last call, as indices into the arrays."""
        changed_nodes = np.flatnonzero(self._has_come_nearer)
        self._has_come_nearer[changed_nodes] = False
        return changed_nodes

    def split_node_numbers(self, at: Index) -> list[Index]:
        """Convert indices into the arrays to node coordinates, as columns."""
        local = at & (NODES_PER_BRICK - 1)
        brick = np.unravel_index(self._near_bricks[at >> 12], self._shape)
        within = (local >> 8, (local >> 4) & 15, local & 15)
        return [(b << 4) + w for b, w in zip(brick, within, strict=True)]

    def measure_distances(self, nodes: list[Index], triangle: NDArray[np.integer], only_unmeasured: bool) -> None:
        """Measure the distance of each node from its triangle, and store it if it is less than before. With `only_unmeasured`,
        omit nodes that already have a distance."""
        parts = [
            self._compute_nearer_distances(
                [n[a : a + _PAIRS_PER_CHUNK] for n in nodes], triangle[a : a + _PAIRS_PER_CHUNK], only_unmeasured
            )
            for a in range(0, len(triangle), _PAIRS_PER_CHUNK)
        ]
        for at, away, name in parts:
            nearer = np.flatnonzero(away < self.distances.take(at))
            at, away, name = at[nearer], away[nearer], name[nearer]
            np.minimum.at(self.distances, at, away)
            best = np.flatnonzero(away == self.distances.take(at))
            self.nearest_triangles[at[best]] = name[best]
            self._has_come_nearer[at] = True

    def _compute_nearer_distances(
        self, nodes: list[Index], triangle: NDArray[np.integer], only_unmeasured: bool
    ) -> tuple[Index, Distances, NDArray[np.integer]]:
        """Return the nodes for which `triangle` is nearer than their stored triangle: array indices, distances and triangles.
        Nodes outside the bricks are ignored.

        With `only_unmeasured`, nodes that already have a distance from a close triangle are omitted. Otherwise, distances above
        EXACT_DISTANCE_VOXELS are omitted."""
        x, y, z = nodes
        nx, ny, nz = self._shape
        inside = (x >= 0) & (x < nx * 16) & (y >= 0) & (y < ny * 16) & (z >= 0) & (z < nz * 16)
        slot = self._index_of_brick.take(((x >> 4) * ny + (y >> 4)) * nz + (z >> 4), mode="clip").astype(np.int64)
        inside &= slot >= 0
        at = (slot << 12) + (((x & 15) << 8) + ((y & 15) << 4) + (z & 15))
        if only_unmeasured:
            safe_index = np.where(inside, at, 0)
            inside &= (self.distances.take(safe_index) > EXACT_DISTANCE_VOXELS) & (
                self.nearest_triangles.take(safe_index) != triangle
            )
        rows = np.flatnonzero(inside)
        at, triangle = at[rows], triangle[rows]
        away = _compute_distances(self._triangle_data, triangle, [x[rows], y[rows], z[rows]])
        if not only_unmeasured:
            # Beyond that distance, a triangle that was not tested may be nearer.
            sure = np.flatnonzero(away <= EXACT_DISTANCE_VOXELS)
            at, away, triangle = at[sure], away[sure], triangle[sure]
        return at, away, triangle


def _pack_triangle_data(corners: Floats) -> Floats:
    """Return the values that distance measurements need of each triangle, (27, n): corners, edges, in-plane normals of edges, and
    inverse squared lengths."""
    a, b, c = (np.ascontiguousarray(corners[:, k].T) for k in range(3))
    edges = (b - a, c - b, a - c)
    normal = np.cross(edges[0], edges[1], axis=0)
    area = (normal * normal).sum(axis=0)
    flat = area > 0
    unit = normal / np.sqrt(np.where(flat, area, 1.0))
    rows = [unit]
    for corner, edge in zip((a, b, c), edges, strict=True):
        square = (edge * edge).sum(axis=0)
        rows += [corner, edge, 1.0 / np.where(square > 0, square, 1.0)[None]]
    return np.concatenate(rows)


def _compute_distances(measures: Floats, triangle: NDArray[np.integer], nodes: list[Index]) -> Distances:
    """Return the distance of each node from its triangle. If the node projects into the triangle, this is the distance from the
    plane, otherwise that from the nearest edge."""
    m = measures.take(triangle, axis=1)
    nx, ny, nz = m[0], m[1], m[2]
    inside: NDArray[np.bool_] | bool = True
    nearest: Floats | float = np.inf
    height: Floats | float = 0.0
    for k in range(3):
        ax, ay, az, ex, ey, ez, inverse = m[3 + 7 * k : 10 + 7 * k]
        px, py, pz = nodes[0] - ax, nodes[1] - ay, nodes[2] - az
        s = ((px * ex + py * ey) + pz * ez) * inverse
        np.clip(s, 0.0, 1.0, out=s)
        if k == 0:
            height = (px * nx + py * ny) + pz * nz
        # The normal times the edge points inwards, which gives the side of the edge.
        turn = (px * (ny * ez - nz * ey) + py * (nz * ex - nx * ez)) + pz * (nx * ey - ny * ex)
        inside = inside & (turn >= 0)
        px -= s * ex
        py -= s * ey
        pz -= s * ez
        nearest = np.minimum(nearest, (px * px + py * py) + pz * pz)
    inside = inside & ((nx * nx + ny * ny + nz * nz) > 0.5)
    return np.where(inside, np.abs(height), np.sqrt(nearest)).astype(np.float32)


def iterate_lattice_points(low: Index, count: Index, batch_size: int) -> Iterator[tuple[Index, Index, Index]]:
    """Yield all lattice points of rectangles, in batches of about `batch_size`: the number of each point's rectangle, and its two
    coordinates.

    Rectangles start at `low` (n, 2) and have `count` (n, 2) points along each axis."""
    count = np.maximum(count, 0)
    rows = np.repeat(np.arange(len(low)), count[:, 0])
    u = low[rows, 0] + enumerate_within_groups(count[:, 0])
    wide = count[rows, 1]
    ends = np.cumsum(wide)
    a = 0
    while a < rows.size:
        b = max(int(np.searchsorted(ends, (ends[a - 1] if a else 0) + batch_size, side="right")), a + 1)
        name = np.repeat(rows[a:b], wide[a:b])
        yield name, np.repeat(u[a:b], wide[a:b]), low[name, 1] + enumerate_within_groups(wide[a:b])
        a = b


def enumerate_within_groups(counts: Index) -> Index:
    """Return the numbers from 0 to each count (exclusive), concatenated: counts [2, 3] give [0, 1, 0, 1, 2]."""
    return np.arange(int(counts.sum())) - np.repeat(np.cumsum(counts) - counts, counts)
