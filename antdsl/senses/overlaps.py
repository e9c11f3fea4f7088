"""How far bodies stand inside each other. Many in one place cost no more than as many side by side."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.numerics import compiled
from antdsl.senses.neighbours import CellGrid

Floats = NDArray[np.float32]

_CROWDED = 24  # pairs an agent on average, above which they are not all listed
_LISTS = 27  # cells around an agent, with its own
_ALONG = 2.0**40  # cells along an axis that whole numbers count
_WIDER = 1 + 1e-6  # than bodies reach, for distances are rounded
_NEAREST = 8  # neighbours that are asked for first; twice as many again where these do not settle it


def worst_overlaps(x: Floats, y: Floats, z: Floats, radius: Floats) -> Floats:
    """Of each agent (float32[n], mm) how far it stands inside the worst of the others: 0 apart, 1 in one place.

    That is the greatest of 1 - distance / (sum of both radii), exactly, whatever the crowd: where agents stand so dense that a
    list of all pairs would grow with their square, nearest neighbours are asked for until no one farther off can be worse.
    """
    worst = np.zeros(len(x), np.float32)
    widest = float(radius.max(initial=0.0))
    if not np.isfinite(widest) or widest <= 0:
        return worst
    far = max(float(np.abs(axis).max(initial=0.0)) for axis in (x, y, z))
    if compiled.wanted(len(x)) and far < widest * _ALONG:
        from antdsl.senses.overlaps_compiled import worst as looked_through

        # four to eight lists an agent: few cells fall together in one
        lists, others = np.full(4 << len(x).bit_length(), -1, np.int32), np.empty(len(x), np.int32)
        if looked_through(x, y, z, radius, 4 * widest * _WIDER, _CROWDED * _LISTS * len(x), lists, others, worst):
            return worst
        worst.fill(0)
    rows = np.flatnonzero(np.isfinite(x) & np.isfinite(y) & np.isfinite(z) & np.isfinite(radius))
    place = np.stack([x[rows], y[rows], z[rows]], axis=1)
    if _pairs_at_most(place, 2 * widest) <= _CROWDED * len(rows):
        found = CellGrid(x, y, z, np.arange(len(x)), 2 * widest).pairs(None, 2 * widest)
        if np.bincount(found.i, minlength=1).max() < limits.NEIGHBOURS:
            np.maximum.at(worst, found.i, _inside(found.distance, radius[found.i], radius[found.j]))
            return worst
    worst[rows] = _by_nearest(place, radius[rows])
    return worst


def _pairs_at_most(place: Floats, cell: float) -> float:
    """About how many pairs of places [n,3] are within a cell's width: all those in one cell."""
    if not len(place):
        return 0.0
    cells = np.floor((place - place.min(axis=0)) / np.float32(cell)).astype(np.int64)
    key = (cells[:, 0] * 73_856_093) ^ (cells[:, 1] * 19_349_663) ^ (cells[:, 2] * 83_492_791)
    count = np.unique(key, return_counts=True)[1].astype(np.float64)
    return float((count * count).sum())


def _inside(distance: Floats, one: Floats, other: Floats) -> Floats:
    room = np.maximum(one + other, np.float32(1e-9))
    part: Floats = np.clip(1 - distance / room, 0, 1)
    return part


def _by_nearest(place: Floats, radius: Floats) -> Floats:
    """As `worst_overlaps`, for places [n,3] of a dense crowd."""
    from scipy.spatial import cKDTree

    # A tree cannot be cut between agents in one place; of these the widest stands for all, and all overlap wholly.
    order = np.lexsort((-radius, place[:, 2], place[:, 1], place[:, 0]))
    fresh = np.ones(len(order), np.bool_)
    fresh[1:] = (place[order][1:] != place[order][:-1]).any(axis=1)
    single, which = order[fresh], np.cumsum(fresh) - 1
    alone = np.bincount(which) == 1
    worst = np.ones(len(place), np.float32)
    found = np.where(alone, 0, 1).astype(np.float32)
    classes = np.frexp(radius[single])[1]
    for size in np.unique(classes)[::-1]:  # the small ones near a large one are many, and none of them far off is worse
        others = single[classes == size]
        tree, widest = cKDTree(place[others].astype(np.float64)), float(radius[others].max())
        asked, count = np.flatnonzero(alone), _NEAREST
        while len(asked):
            count = min(count, len(others))
            rows = single[asked]
            away, near = tree.query(place[rows].astype(np.float64), count)
            away, near = away.reshape(len(rows), count), others[near.reshape(len(rows), count)]
            d = [place[near, axis] - place[rows, axis][:, None] for axis in range(3)]
            distance = np.sqrt((d[0] * d[0] + d[1] * d[1]) + d[2] * d[2])
            part = _inside(distance, radius[rows][:, None], radius[near])
            part[near == rows[:, None]] = 0
            found[asked] = np.maximum(found[asked], part.max(axis=1))
            beyond = 1 - away[:, -1] / np.maximum(radius[rows].astype(np.float64) + widest, 1e-9)
            asked = asked[(beyond > found[asked]) & (count < len(others))]
            count *= 2
    worst[order] = found[which]
    return worst
