"""Computes the cost and direction of the cheapest path over triangles to a goal, at every point. Paths first follow edges
(shortest paths in a graph), and are then straightened across triangles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Index = NDArray[np.int64]
Flags = NDArray[np.bool_]

_MAX_BAND_ITERATIONS = 40  # maximum number of iterations for a band of points, because its points depend on each other
_MAX_PASSES = 8  # maximum number of passes over all bands, because the order of the points changes
_CONVERGENCE_TOLERANCE = 0.01  # share of the median edge length; smaller changes end the iteration


@dataclass(frozen=True, slots=True, eq=False)
class WalkableSurface:
    """The surface on which paths are computed: `triangles` (t, 3) between `points` (n, 3; mm).

    `is_walkable` (t,): whether a path can cross each triangle. `point_links` (k, 2): pairs of adjacent points on different
    surfaces, between which paths can cross."""

    points: Floats
    triangles: Index
    is_walkable: Flags
    point_links: Index


def compute_path_costs(surface: WalkableSurface, cost: Floats, start: Index, start_costs: Floats) -> Floats:
    """Return the cost of the cheapest path from each point to the goal; inf if there is no path.

    `cost` (t,): the cost per mm within each triangle. `start`: the points next to the goal, at which paths end. `start_costs`:
    the cost from each of these points to the goal.

    Dijkstra's shortest paths along edges give an upper bound for each point. In ascending order of this bound, the cost of
    each point is then recomputed from the opposite edges of its triangles. The wave front is straight within a triangle (R.
    Kimmel and J. A. Sethian, Computing geodesic paths on manifolds, PNAS 95, 1998, p. 8432). At obtuse corners, this update
    does not apply, and the bound along edges remains."""
    bound = _compute_edge_costs(surface, cost, start, start_costs)
    halves = _make_opposite_edges(surface, cost)
    tolerance = _CONVERGENCE_TOLERANCE * float(np.median(halves.length)) if len(halves.length) else 0.0
    for _ in range(_MAX_PASSES):
        previous_bound = bound.copy()
        _lower_costs_across_triangles(bound, halves)
        _lower_costs_along_links(surface, cost, bound)
        is_reachable = np.isfinite(bound)
        if (previous_bound[is_reachable] - bound[is_reachable]).max(initial=0.0) <= tolerance:
            break
    return bound


def compute_directions(surface: WalkableSurface, path_costs: Floats) -> Floats:
    """Return the unit direction (n, 3) in which `path_costs` decreases at each point. It is the area-weighted mean over the
    point's triangles. It is zero at the goal and where there is no path."""
    corners, values = surface.points[surface.triangles], path_costs[surface.triangles]
    is_usable = surface.is_walkable & np.isfinite(values).all(axis=1)
    corners, values, triangles = corners[is_usable], values[is_usable], surface.triangles[is_usable]
    area_vectors = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    twice = np.sqrt((area_vectors * area_vectors).sum(axis=1))
    normal = area_vectors / np.where(twice > 0, twice, 1.0)[:, None]
    uphill = np.zeros_like(normal)
    for k in range(3):
        edge = corners[:, (k + 2) % 3] - corners[:, (k + 1) % 3]
        uphill += (values[:, k] - values[:, 0])[:, None] * np.cross(normal, edge)
    downhill = -_normalise_rows(uphill) * twice[:, None]
    total = np.stack(
        [sum(np.bincount(triangles[:, k], downhill[:, axis], len(surface.points)) for k in range(3)) for axis in range(3)], axis=1
    )
    return _normalise_rows(total)


def _normalise_rows(v: Floats) -> Floats:
    """Return the vectors `v` (n, 3) scaled to length 1. Vectors that are much shorter than the longest one become 0."""
    size = np.sqrt((v * v).sum(axis=1))
    return v / np.where(size > 1e-12 * size.max(initial=0.0) + 1e-300, size, np.inf)[:, None]


# --- along edges -----------------------------------------------------------------------------------------------------


def _compute_edge_costs(surface: WalkableSurface, cost: Floats, start: Index, start_costs: Floats) -> Floats:
    """Return the cost of the shortest path from each point to the goal, along edges of walkable triangles and along links."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra

    n = len(surface.points)
    sides = surface.triangles[surface.is_walkable]
    a = np.concatenate([sides[:, k] for k in range(3)])
    b = np.concatenate([sides[:, (k + 1) % 3] for k in range(3)])
    price = np.tile(cost[surface.is_walkable], 3)
    low, high = np.minimum(a, b), np.maximum(a, b)
    order = np.lexsort((price, high, low))
    low, high, price = low[order], high[order], price[order]
    fresh = np.concatenate(([True], (low[1:] != low[:-1]) | (high[1:] != high[:-1]))) if len(low) else np.zeros(0, bool)
    low, high, price = low[fresh], high[fresh], price[fresh]
    step = surface.points[high] - surface.points[low]
    weight = np.sqrt((step * step).sum(axis=1)) * price
    rows = [low, surface.point_links[:, 0], np.full(len(start), n)]
    columns = [high, surface.point_links[:, 1], start]
    # start costs plus one, because the graph ignores links of length 0
    weights = [weight, _compute_link_costs(surface, cost), start_costs + 1.0]
    # 32 bits: older SciPy versions need them, and there are far fewer points
    ends = tuple(np.concatenate(numbers).astype(np.int32) for numbers in (rows, columns))
    graph = coo_array((np.concatenate(weights), ends), shape=(n + 1, n + 1))
    costs: Floats = dijkstra(graph.tocsr(), directed=False, indices=n)[:n]
    bound: Floats = np.maximum(costs - 1.0, 0.0)
    return bound


def _compute_link_costs(surface: WalkableSurface, cost: Floats) -> Floats:
    """Return the cost of each link, which is its length times the median cost per mm of the walkable triangles."""
    step = surface.points[surface.point_links[:, 1]] - surface.points[surface.point_links[:, 0]]
    usual = float(np.median(cost[surface.is_walkable])) if surface.is_walkable.any() else 1.0
    price: Floats = np.maximum(np.sqrt((step * step).sum(axis=1)), 1e-9) * usual
    return price


def _lower_costs_along_links(surface: WalkableSurface, cost: Floats, costs: Floats) -> None:
    """Lower `costs` in place along links. The cost at one end becomes at most the cost at the other end plus the cost of the
    link."""
    price = _compute_link_costs(surface, cost)
    for a, b in ((0, 1), (1, 0)):
        np.minimum.at(costs, surface.point_links[:, b], costs[surface.point_links[:, a]] + price)


# --- across triangles ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class _OppositeEdges:
    """The corners of all walkable triangles, each with the opposite edge of its triangle.

    `corner_point`: the point at the corner. `edge_start`, `edge_end`: the points at the ends of the opposite edge. `length`:
    the length (mm) of that edge. `perpendicular_foot`: the distance (mm) from `edge_start` to the foot of the perpendicular
    from the corner. `height`: the length (mm) of the perpendicular. `cost`: the cost per mm in the triangle."""

    corner_point: Index
    edge_start: Index
    edge_end: Index
    length: Floats
    perpendicular_foot: Floats
    height: Floats
    cost: Floats

    def select_rows(self, rows: NDArray[np.intp] | NDArray[np.bool_] | slice) -> _OppositeEdges:
        """Return only the entries at `rows`."""
        ends = self.corner_point[rows], self.edge_start[rows], self.edge_end[rows]
        return _OppositeEdges(*ends, self.length[rows], self.perpendicular_foot[rows], self.height[rows], self.cost[rows])


def _make_opposite_edges(surface: WalkableSurface, cost: Floats) -> _OppositeEdges:
    """Return the corners and opposite edges of all walkable triangles with an area above 0. `cost` (t,): the cost per mm in
    each triangle."""
    t = surface.triangles[surface.is_walkable]
    corner_point, one, two = (np.concatenate([t[:, (k + shift) % 3] for k in range(3)]) for shift in range(3))
    edge, side = surface.points[two] - surface.points[one], surface.points[corner_point] - surface.points[one]
    length = np.sqrt((edge * edge).sum(axis=1))
    foot = (edge * side).sum(axis=1) / np.where(length > 0, length, 1.0)
    height = np.sqrt(np.maximum((side * side).sum(axis=1) - foot * foot, 0.0))
    has_area = (length > 0) & (height > 0)
    return _OppositeEdges(corner_point, one, two, length, foot, height, np.tile(cost[surface.is_walkable], 3)).select_rows(
        has_area
    )


def _lower_costs_across_triangles(costs: Floats, edges: _OppositeEdges) -> None:
    """Lower `costs` in place where a straight path across a triangle is cheaper. Points are processed in bands of ascending
    cost."""
    is_reachable = np.isfinite(costs)
    rank = np.empty(len(costs), np.int64)
    rank[np.argsort(costs, kind="stable")] = np.arange(len(costs))
    bands = max(1, int(2 * np.sqrt(is_reachable.sum())))
    band = rank * bands // max(1, int(is_reachable.sum()))
    usable = np.flatnonzero(is_reachable[edges.corner_point] & is_reachable[edges.edge_start] & is_reachable[edges.edge_end])
    usable = usable[np.lexsort((usable, edges.corner_point[usable], band[edges.corner_point[usable]]))]
    ordered = edges.select_rows(usable)
    ends = np.searchsorted(band[ordered.corner_point], np.arange(bands + 1))
    for first, last in zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True):
        if first < last:
            part = ordered.select_rows(slice(first, last))
            begin = np.flatnonzero(np.concatenate(([True], part.corner_point[1:] != part.corner_point[:-1])))
            points = part.corner_point[begin]
            for _ in range(_MAX_BAND_ITERATIONS):
                lower = np.minimum(costs[points], np.minimum.reduceat(_compute_corner_costs(costs, part), begin))
                if np.array_equal(lower, costs[points]):
                    break
                costs[points] = lower


def _compute_corner_costs(costs: Floats, edges: _OppositeEdges) -> Floats:
    """Return, for each corner, the least cost of a path that reaches it straight across the triangle from a point of the
    opposite edge."""
    from_one, rise = costs[edges.edge_start], (costs[edges.edge_end] - costs[edges.edge_start]) / edges.length
    share = np.clip(rise / edges.cost, -1 + 1e-12, 1 - 1e-12)
    left = np.clip(edges.perpendicular_foot - share * edges.height / np.sqrt(1 - share * share), 0.0, edges.length)
    offset = edges.perpendicular_foot - left
    return from_one + rise * left + edges.cost * np.sqrt(offset * offset + edges.height * edges.height)
