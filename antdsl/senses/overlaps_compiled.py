"""How far bodies stand inside each other, in one pass over the agents: as `overlaps` finds it, the same bits.

Each agent in turn looks through those before it that stand in the cells around its own, and then joins its cell's list. Cells are
found by a hash (M. Teschner et al., Optimized Spatial Hashing for Collision Detection of Deformable Objects, 2003): lists of two
cells that fall together are one, which adds pairs that are too far apart and changes nothing."""

import numpy as np

from antdsl.machine_code.kernels import F32, F64, I32, I64, Array1, inlined, kernel

_BEYOND = np.float32(1.0 + 1e-5)  # a squared distance over this many squared rooms has a root over the room


@inlined
def _cell(place, width, back):  # type: ignore[no-untyped-def]
    """The cell of a place that is so many cells farther back."""
    return np.int64(np.floor(np.float64(place) / width - back))


@inlined
def _key(x, y, z):  # type: ignore[no-untyped-def]
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
) -> bool:
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
