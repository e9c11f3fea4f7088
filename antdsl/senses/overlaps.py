"""Measures how far the bodies of agents overlap. The measurement stays fast even if many bodies are at one position."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.kernels import BOOL, F32, I32, I64, Array1, kernel, load_consecutive
from antdsl.numerics.parallel import make_contiguous
from antdsl.senses.cell_order import Columns
from antdsl.senses.touching import Agents, find_span_end, find_span_start, iterate_neighbour_searches

Floats = NDArray[np.float32]

_REACH_SLACK, _MIN_REACH_MM = 1 + 1e-6, 1e-9  # factor for rounded distances; mm, reach of bodies without a radius
_MAX_PAIRS_PER_AGENT = 640  # mean number of pairs per agent; above it, a nearest-neighbour tree is faster
_FIRST_QUERY_NEIGHBOURS = 8  # neighbours of the first query; each further query doubles the number until the result is certain


def measure_worst_overlaps(x: Floats, y: Floats, z: Floats, radius: Floats) -> Floats:
    """Return each agent's greatest overlap with another agent, float32[n]: 0 without overlap, 1 if both have the same
    position. `x`, `y`, `z`, `radius`: float32[n] mm. The overlap of a pair is 1 - distance / (sum of both radii), at least 0.
    In dense crowds, a list of all pairs would grow with the square of the number of agents. So these crowds are measured by
    nearest-neighbour queries, until no agent farther away can overlap more."""
    x, y, z, radius = make_contiguous(x, y, z, radius)
    overlap, wide = np.zeros(len(x), np.float32), [each.astype(np.float64) for each in (x, y, z, radius)]
    budget = _MAX_PAIRS_PER_AGENT * len(x)
    for search in iterate_neighbour_searches((wide[0], wide[1], wide[2]), np.maximum(wide[3], 0) * _REACH_SLACK + _MIN_REACH_MM):
        budget = fill_worst_overlaps(*search, (x, y, z), radius, budget, overlap)
        if budget < 0:
            break
    else:
        return overlap
    rows = np.flatnonzero(np.isfinite(x) & np.isfinite(y) & np.isfinite(z) & np.isfinite(radius))
    place = np.stack([x[rows], y[rows], z[rows]], axis=1)
    overlap[rows] = _measure_overlaps_by_nearest(place, radius[rows])
    return overlap


def _compute_overlap_share(distance: Floats, first: Floats, second: Floats) -> Floats:
    """Return the overlap 1 - distance / (sum of both radii), clamped to 0 to 1. `first`, `second`: the radii of the two agents
    (mm)."""
    radius_sum = np.maximum(first + second, np.float32(1e-9))
    part: Floats = np.clip(1 - distance / radius_sum, 0, 1)
    return part


def _measure_overlaps_by_nearest(place: Floats, radius: Floats) -> Floats:
    """Compute the result of `measure_worst_overlaps` by nearest-neighbour queries, for agents at `place` [n,3]."""
    from scipy.spatial import cKDTree

    # A tree cannot separate agents at one position. The widest represents them all, and all overlap completely.
    order = np.lexsort((-radius, place[:, 2], place[:, 1], place[:, 0]))
    fresh = np.ones(len(order), np.bool_)
    fresh[1:] = (place[order][1:] != place[order][:-1]).any(axis=1)
    single, groups = order[fresh], np.cumsum(fresh) - 1
    is_single = np.bincount(groups) == 1
    worst = np.ones(len(place), np.float32)
    overlap = np.where(is_single, 0, 1).astype(np.float32)
    classes = np.frexp(radius[single])[1]
    for size in np.unique(classes)[::-1]:  # a large agent has many small neighbours, of which only near ones matter
        others = single[classes == size]
        tree, widest = cKDTree(place[others].astype(np.float64)), float(radius[others].max())
        pending_rows, count = np.flatnonzero(is_single), _FIRST_QUERY_NEIGHBOURS
        while len(pending_rows):
            count = min(count, len(others))
            rows = single[pending_rows]
            distances, near = tree.query(place[rows].astype(np.float64), count)
            distances, near = distances.reshape(len(rows), count), others[near.reshape(len(rows), count)]
            d = [place[near, axis] - place[rows, axis][:, None] for axis in range(3)]
            distance = np.sqrt((d[0] * d[0] + d[1] * d[1]) + d[2] * d[2])
            part = _compute_overlap_share(distance, radius[rows][:, None], radius[near])
            part[near == rows[:, None]] = 0
            overlap[pending_rows] = np.maximum(overlap[pending_rows], part.max(axis=1))
            next_overlap = 1 - distances[:, -1] / np.maximum(radius[rows].astype(np.float64) + widest, 1e-9)
            pending_rows = pending_rows[(next_overlap > overlap[pending_rows]) & (count < len(others))]
            count *= 2
    worst[order] = overlap[groups]
    return worst


@kernel
def fill_worst_overlaps(
    searching_agents: Agents, agents: Agents, cell_starts: Array1[I32], cells: I64, span_offsets: Array1[I64],
    is_self_search: BOOL,
    position: Columns, radius: Array1[F32], max_pairs: I64, overlap: Array1[F32],
) -> I64:  # fmt: skip
    """Update each agent's entry of `overlap` with its greatest overlap among the pairs of a search.

    Returns `max_pairs` minus the number of pairs; a negative result means that the measurement stopped before the last pair.
    The arguments before `position` are the fields of a `PairSearch`."""
    (query_positions, query_rows, query_keys), (ordered, rows, _) = searching_agents, agents
    for agent in range(query_rows.size):
        (x, y, z, wide), a = load_consecutive(query_positions, 4 * agent, 4), query_rows[agent]
        for span in range(span_offsets.size):
            key = query_keys[agent] + span_offsets[span]
            first, last = (
                find_span_start(agents, cell_starts, cells, is_self_search, agent, span, key),
                find_span_end(agents, cell_starts, cells, key),
            )
            max_pairs -= max(last - first, 0)
            if max_pairs < 0:
                return max_pairs
            for n in range(first, last):
                (u, v, w, far) = load_consecutive(ordered, 4 * n, 4)
                u, v, w, reach = u - x, v - y, w - z, wide + far
                if (u * u + v * v) + w * w <= reach * reach:
                    b = rows[n]
                    one, two, three = (
                        position[0][b] - position[0][a],
                        position[1][b] - position[1][a],
                        position[2][b] - position[2][a],
                    )
                    distance = np.sqrt((one * one + two * two) + three * three)
                    radius_sum = max(radius[a] + radius[b], np.float32(1e-9))
                    if distance < radius_sum:
                        part = np.float32(1.0) - distance / radius_sum
                        overlap[a], overlap[b] = max(overlap[a], part), max(overlap[b], part)
    return max_pairs
