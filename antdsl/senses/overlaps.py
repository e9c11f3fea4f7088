"""How far bodies stand inside each other. Many in one place cost no more than as many side by side.

Each agent in turn looks through those before it that stand in the cells around its own, and then joins its cell's list. Cells are
found by a hash (M. Teschner et al., Optimized Spatial Hashing for Collision Detection of Deformable Objects, 2003): lists of two
cells that fall together are one, which adds pairs that are too far apart and changes nothing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.kernels import BOOL, F32, F64, I32, I64, Array1, inlined, kernel

Floats = NDArray[np.float32]

_CROWDED = 24  # pairs an agent on average, above which they are not all listed
_LISTS = 27  # cells around an agent, with its own
_ALONG = 2.0**40  # cells along an axis that whole numbers count
_WIDER = 1 + 1e-6  # than bodies reach, for distances are rounded
_BEYOND = np.float32(1.0 + 1e-5)  # a squared distance over this many squared rooms has a root over the room
_NEAREST = 8  # neighbours that are asked for first; twice as many again where these do not settle it


def worst_overlaps(x: Floats, y: Floats, z: Floats, radius: Floats) -> Floats:
    """Of each agent (float32[n], mm) how far it stands inside the worst of the others: 0 apart, 1 in one place.

    That is the greatest of 1 - distance / (sum of both radii), exactly, whatever the crowd: where agents stand so dense that a
    list of all pairs would grow with their square, nearest neighbours are asked for until no one farther off can be worse.
    """
    found = np.zeros(len(x), np.float32)
    widest = float(radius.max(initial=0.0))
    if not np.isfinite(widest) or widest <= 0:
        return found
    far = max(float(np.abs(axis).max(initial=0.0)) for axis in (x, y, z))
    if far < widest * _ALONG:
        # four to eight lists an agent: few cells fall together in one
        lists, others = np.full(4 << len(x).bit_length(), -1, np.int32), np.empty(len(x), np.int32)
        if worst(x, y, z, radius, 4 * widest * _WIDER, _CROWDED * _LISTS * len(x), lists, others, found):
            return found
        found.fill(0)
    rows = np.flatnonzero(np.isfinite(x) & np.isfinite(y) & np.isfinite(z) & np.isfinite(radius))
    place = np.stack([x[rows], y[rows], z[rows]], axis=1)
    found[rows] = _by_nearest(place, radius[rows])
    return found


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


@inlined
def _cell(place: F32, width: F64, back: F64) -> I64:
    """The cell of a place that is so many cells farther back."""
    return np.int64(np.floor(np.float64(place) / width - back))


@inlined
def _key(x: I64, y: I64, z: I64) -> I64:
    return (x * 73856093) ^ (y * 19349663) ^ (z * 83492791)


@kernel
def worst(
    x: Array1[F32],
    y: Array1[F32],
    z: Array1[F32],
    radius: Array1[F32],
    width: F64,
    most: I64,
    lists: Array1[I32],
    others: Array1[I32],
    found: Array1[F32],
) -> BOOL:
    """Write the worst overlap of each agent to `found`, which is zeros. `width`: of a cell (mm), no less than twice what any two
    bodies reach, so that those in reach are in two cells along each axis. `lists`, as many as a power of 2: the last agent of
    each, -1 for none; `others`: before each in its list. False where more than `most` pairs would have to be measured."""
    mask, pairs = lists.size - 1, 0
    for i in range(x.size):
        if not (np.isfinite(x[i]) and np.isfinite(y[i]) and np.isfinite(z[i]) and np.isfinite(radius[i])):
            continue
        cx, cy, cz = _cell(x[i], width, 0.5), _cell(y[i], width, 0.5), _cell(z[i], width, 0.5)
        here = found[i]
        for dx in range(2):
            for dy in range(2):
                for dz in range(2):
                    key = _key(cx + dx, cy + dy, cz + dz) & mask
                    j = lists[key]
                    while j >= 0:
                        pairs += 1
                        one, two, three = x[j] - x[i], y[j] - y[i], z[j] - z[i]
                        square = (one * one + two * two) + three * three
                        room = max(radius[i] + radius[j], np.float32(1e-9))
                        if not square > room * room * _BEYOND:
                            distance = np.sqrt(square)
                            if distance < room:
                                part = np.float32(1.0) - distance / room
                                here = max(here, part)
                                if part > found[j]:
                                    found[j] = part
                        j = others[j]
        found[i] = here
        if pairs > most:
            return False
        key = _key(_cell(x[i], width, 0.0), _cell(y[i], width, 0.0), _cell(z[i], width, 0.0)) & mask
        others[i] = lists[key]
        lists[key] = i
    return True
