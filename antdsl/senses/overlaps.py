"""Measures how far bodies overlap. Many at one position cost no more than as many next to each other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.kernels import F32, I64, Array1, kernel
from antdsl.numerics.parallel import contiguous
from antdsl.senses.touching import find_all_touching

Floats = NDArray[np.float32]

_WIDER, _LEAST = 1 + 1e-6, 1e-9  # than bodies reach, for distances are rounded; mm, of bodies without a radius
_NEAREST = 8  # neighbours of the first query; each further query doubles the number until the result is certain


def worst_overlaps(x: Floats, y: Floats, z: Floats, radius: Floats) -> Floats:
    """Return how far each agent (float32[n], mm) overlaps its worst neighbour: 0 apart, 1 at one position.

    The value is the greatest of 1 - distance / (sum of both radii), exact for any crowd. In dense crowds, a list of all pairs
    would grow with the square of the number of agents. Therefore nearest neighbours are queried until none farther off can be
    worse."""
    x, y, z, radius = contiguous(x, y, z, radius)
    overlap, wide = np.zeros(len(x), np.float32), [each.astype(np.float64) for each in (x, y, z, radius)]
    pairs = find_all_touching((wide[0], wide[1], wide[2]), np.maximum(wide[3], 0) * _WIDER + _LEAST)
    if pairs is not None:
        fill_worst_overlaps(x, y, z, radius, pairs.i, pairs.j, overlap)
        return overlap
    rows = np.flatnonzero(np.isfinite(x) & np.isfinite(y) & np.isfinite(z) & np.isfinite(radius))
    place = np.stack([x[rows], y[rows], z[rows]], axis=1)
    overlap[rows] = _overlaps_by_nearest(place, radius[rows])
    return overlap


def _overlap_share(distance: Floats, one: Floats, other: Floats) -> Floats:
    radius_sum = np.maximum(one + other, np.float32(1e-9))
    part: Floats = np.clip(1 - distance / radius_sum, 0, 1)
    return part


def _overlaps_by_nearest(place: Floats, radius: Floats) -> Floats:
    """As `worst_overlaps`, for places [n,3] of a dense crowd."""
    from scipy.spatial import cKDTree

    # A tree cannot be cut between agents in one place; of these the widest stands for all, and all overlap wholly.
    order = np.lexsort((-radius, place[:, 2], place[:, 1], place[:, 0]))
    fresh = np.ones(len(order), np.bool_)
    fresh[1:] = (place[order][1:] != place[order][:-1]).any(axis=1)
    single, which = order[fresh], np.cumsum(fresh) - 1
    alone = np.bincount(which) == 1
    worst = np.ones(len(place), np.float32)
    overlap = np.where(alone, 0, 1).astype(np.float32)
    classes = np.frexp(radius[single])[1]
    for size in np.unique(classes)[::-1]:  # the small ones near a large one are many, and none of them far off is worse
        others = single[classes == size]
        tree, widest = cKDTree(place[others].astype(np.float64)), float(radius[others].max())
        pending_rows, count = np.flatnonzero(alone), _NEAREST
        while len(pending_rows):
            count = min(count, len(others))
            rows = single[pending_rows]
            away, near = tree.query(place[rows].astype(np.float64), count)
            away, near = away.reshape(len(rows), count), others[near.reshape(len(rows), count)]
            d = [place[near, axis] - place[rows, axis][:, None] for axis in range(3)]
            distance = np.sqrt((d[0] * d[0] + d[1] * d[1]) + d[2] * d[2])
            part = _overlap_share(distance, radius[rows][:, None], radius[near])
            part[near == rows[:, None]] = 0
            overlap[pending_rows] = np.maximum(overlap[pending_rows], part.max(axis=1))
            beyond = 1 - away[:, -1] / np.maximum(radius[rows].astype(np.float64) + widest, 1e-9)
            pending_rows = pending_rows[(beyond > overlap[pending_rows]) & (count < len(others))]
            count *= 2
    worst[order] = overlap[which]
    return worst


@kernel
def fill_worst_overlaps(
    x: Array1[F32], y: Array1[F32], z: Array1[F32], radius: Array1[F32], i: Array1[I64], j: Array1[I64], overlap: Array1[F32]
) -> None:
    """Write the worst overlap of each agent, from pairs of agents, to `overlap`, which is zero before."""
    for k in range(i.size):
        a, b = i[k], j[k]
        one, two, three = x[b] - x[a], y[b] - y[a], z[b] - z[a]
        distance = np.sqrt((one * one + two * two) + three * three)
        radius_sum = max(radius[a] + radius[b], np.float32(1e-9))
        if distance < radius_sum:
            part = np.float32(1.0) - distance / radius_sum
            overlap[a], overlap[b] = max(overlap[a], part), max(overlap[b], part)
