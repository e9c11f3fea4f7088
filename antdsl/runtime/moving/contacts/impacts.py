"""Kernels for bodies that move far in a substep: which pairs meet on straight paths, and when.

The clearance of two capsules with constant orientation is a convex function of time on straight paths. So Newton's method from
the left never passes the first impact (conservative advancement, C. Ericson, Real-Time Collision Detection, 2005, 5.5.3)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from antdsl.machine_code.kernels import inlined, kernel, kernel_helper, load_consecutive, simd_range
from antdsl.machine_code.kernels.types import BOOL, F32, F64, I32, I64, Array1, Array2, Strided2
from antdsl.numerics.kernel_vectors import Vec3, VectorColumns, dot, get_column, minus, plus, store_column, times
from antdsl.runtime.moving.contacts.capsule_distances import find_separation, mean_up
from antdsl.senses.touching import Agents, find_span_end, find_span_start

# Radii. With shorter steps, no touching pair gets beyond the range of the pair search, if its depth is at most as below.
_LONG_STEP_RADII = 1.9
_LONG_STEP_HALVES_RADII = 1.6  # radii; half the body length may lengthen a step up to this
NEVER = 2.0  # time of an impact that does not occur, in substeps
_MIN_FLAT_SHARE = 0.1  # share of both radii; bodies nearer than this along the ground are above each other
_GRAZE_RADII = 2.0  # radii of both bodies; on shorter paths, touching bodies do not pass to the other side
_PASS_SHARE = 0.8  # share of both radii; bodies that graze each other farther out do not pass through each other
_ITERATIONS = 40  # iterations of Newton's method; only grazing paths need more than ten
_TOUCH_TOLERANCE = 1e-6  # share of both radii; a smaller clearance is an impact
_APPROACH_TOLERANCE = 1e-6  # share of the path; a slower approach does not count


class PathArrays(NamedTuple):
    """Capsules and straight paths of all agents in a substep.

    `middle`, `displacement` (3, n) mm: middles at the start, and displacements. `ahead`, `up` (3, n): unit vectors.
    `half`, `radius` (n) mm: size of the capsules. `sag` (n) mm: how far the path on curved ground leaves the straight line.
    `mass` (n)."""

    middle: Array2[F64]
    displacement: Array2[F64]
    ahead: Array2[F64]
    up: Array2[F64]
    half: Array1[F64]
    radius: Array1[F64]
    sag: Array1[F64]
    mass: Array1[F64]


class PathSearch(NamedTuple):
    """A search for pairs, with the fields of `touching.PairSearch` in the same order."""

    requester: Agents
    agents: Agents
    starts: Array1[I32]
    cells: I64
    shifts: Array1[I64]
    is_self_search: BOOL


class PathPairs(NamedTuple):
    """Pairs of agents with near paths. `i`, `j` (m): their rows. `time` (m): when they meet, as a share of the substep.

    `direction` (3, m): the unit vector from the second agent to the first when they meet."""

    i: Array1[I64]
    j: Array1[I64]
    time: Array1[F64]
    direction: Array2[F64]


@kernel
def flag_long_steps(
    place: Strided2[F64], start_positions: Strided2[F64], half: Array1[F64], radius: Array1[F64], first: I64, flags: Array1[I64]
) -> I64:
    """Flag the agents of a species with steps so long that a contact along the path may be missed. Return their number.

    `place`, `start_positions` (n, 3) mm: end and start. `half`, `radius`, `flags`: arrays of the crowd, in which the species
    starts at index `first`."""
    total = 0
    for k in simd_range(0, place.shape[0]):
        x, y, z = place[k, 0] - start_positions[k, 0], place[k, 1] - start_positions[k, 1], place[k, 2] - start_positions[k, 2]
        wide, squared = radius[first + k], (x * x + y * y) + z * z
        far = wide * _LONG_STEP_RADII + min(half[first + k], wide * _LONG_STEP_HALVES_RADII)
        flags[first + k] = 1 if (squared > far * far) & (wide > 0) & np.isfinite(squared) else 0
    for k in range(place.shape[0]):
        total += flags[first + k]
    return total


@kernel
def fill_paths(
    place: Strided2[F64],
    start_positions: Strided2[F64],
    normal: Strided2[F32],
    ahead: VectorColumns,
    up: VectorColumns,
    mass: Array1[F32],
    first: I64,
    paths: PathArrays,
) -> None:
    """Write the paths of the agents of a species, from index `first` on. On entry, `paths.middle` has the middles at the end.

    `place`, `start_positions` (n, 3) mm: end and start. `normal` (n, 3): normals of the ground at the start."""
    for k in simd_range(0, place.shape[0]):
        row = first + k
        x, y, z = place[k, 0] - start_positions[k, 0], place[k, 1] - start_positions[k, 1], place[k, 2] - start_positions[k, 2]
        path = (x, y, z)
        one = (np.float64(normal[k, 0]), np.float64(normal[k, 1]), np.float64(normal[k, 2]))
        other = (np.float64(up[0][k]), np.float64(up[1][k]), np.float64(up[2][k]))
        bend = minus(other, one)
        middle = minus(get_column(paths.middle, row), path)
        store_column(paths.middle, row, middle)
        store_column(paths.displacement, row, path)
        store_column(paths.ahead, row, (np.float64(ahead[0][k]), np.float64(ahead[1][k]), np.float64(ahead[2][k])))
        between = mean_up(one, other)
        for axis in range(3):
            paths.up[axis, row] = between[axis] if dot(between, between) > 0 else other[axis]
        paths.sag[row] = np.sqrt(dot(path, path)) * np.sqrt(dot(bend, bend)) * 0.25  # the distance of an arc from its chord
        paths.mass[row] = max(np.float64(mass[k]), 1e-30)


@inlined
def _scale_along_normal(v: Vec3, normal: Vec3, part: F64) -> Vec3:
    """Return a vector with its component along `normal` reduced by the share `part`."""
    return minus(v, times(normal, dot(v, normal) * part))


@kernel_helper
def find_impact(paths: PathArrays, p: I64, q: I64, relative_displacement: Vec3, share: F64) -> tuple[F64, Vec3]:
    """Return the time at which two bodies meet (a share of the substep), and the direction from the second to the first.

    The time is `NEVER` if they do not meet. The direction is along the ground.
    `relative_displacement` (mm): the relative displacement. `share`: the share of both radii that counts as contact. On curved
    ground, heights count less. So two arcs over one hill meet although their chords do not."""
    wide, sag = (paths.radius[p] + paths.radius[q]) * share, paths.sag[p] + paths.sag[q]
    between, part = mean_up(get_column(paths.up, p), get_column(paths.up, q)), 1 - wide / max(wide + sag * 2, 1e-300)
    away, a, b = (
        minus(get_column(paths.middle, p), get_column(paths.middle, q)),
        get_column(paths.ahead, p),
        get_column(paths.ahead, q),
    )
    away, relative_displacement = (
        _scale_along_normal(away, between, part),
        _scale_along_normal(relative_displacement, between, part),
    )
    a, b, far, time = (
        _scale_along_normal(a, between, part),
        _scale_along_normal(b, between, part),
        np.sqrt(dot(relative_displacement, relative_displacement)),
        0.0,
    )
    across = (0.0, 0.0, 0.0)
    for _ in range(_ITERATIONS):
        middle = plus(away, times(relative_displacement, time))
        separation, _, _ = find_separation(middle, a, b, (0.0, 0.0, 0.0), paths.half[p], paths.half[q])
        size = max(np.sqrt(dot(separation, separation)), 1e-300)
        direction = times(separation, 1 / size)
        flat = minus(separation, times(between, dot(separation, between)))
        long = np.sqrt(dot(flat, flat))
        across = times(flat, 1 / long) if long > wide * _MIN_FLAT_SHARE else direction
        rate, gap = dot(direction, relative_displacement), size - wide
        if not rate < -far * _APPROACH_TOLERANCE:
            return NEVER, across
        if gap <= wide * _TOUCH_TOLERANCE:
            break
        time -= gap / rate
        if not time <= 1.0:
            return NEVER, across
    return time, across


@inlined
def _are_paths_near(paths: PathArrays, p: I64, q: I64) -> BOOL:
    """Return whether the paths of two bodies come close enough, at any times, that the bodies may touch."""
    one, other = get_column(paths.displacement, p), get_column(paths.displacement, q)
    long, size = np.sqrt(dot(one, one)), np.sqrt(dot(other, other))
    away = minus(plus(get_column(paths.middle, p), times(one, 0.5)), plus(get_column(paths.middle, q), times(other, 0.5)))
    one, other = times(one, 1 / max(long, 1e-300)), times(other, 1 / max(size, 1e-300))
    separation, _, _ = find_separation(away, one, other, (0.0, 0.0, 0.0), long * 0.5, size * 0.5)
    reach = paths.half[p] + paths.half[q] + paths.radius[p] + paths.radius[q] + paths.sag[p] + paths.sag[q]
    return dot(separation, separation) <= reach * reach


@kernel
def list_path_pairs(
    search: PathSearch,
    paths: PathArrays,
    rank: Array1[I64],
    active: Array1[I64],
    only_impacts: BOOL,
    used_count: I64,
    pairs: PathPairs,
) -> I64:
    """Append the pairs with an `active` row and near paths to the first `used_count` pairs of `pairs`. Return the new number of
    pairs, or -1 if the arrays are too short.

    `rank` (n): defines which row of a pair is the first. `only_impacts`: append only pairs that pass through each other. Bodies
    that touch at the start count only if they can pass to the other side."""
    (asks, asking_rows, asking_keys), (ordered, rows, _) = search.requester, search.agents
    for at in range(asking_rows.size):
        (x, y, z, extent), a = load_consecutive(asks, 4 * at, 4), asking_rows[at]
        for span in range(search.shifts.size):
            key = asking_keys[at] + search.shifts[span]
            first = find_span_start(search.agents, search.starts, search.cells, search.is_self_search, at, span, key)
            last = find_span_end(search.agents, search.starts, search.cells, key)
            for n in range(first, last):
                b = rows[n]
                if active[a] == 0 and active[b] == 0:
                    continue
                (u, v, w, far) = load_consecutive(ordered, 4 * n, 4)
                u, v, w, reach = u - x, v - y, w - z, extent + far
                if (u * u + v * v) + w * w > reach * reach:
                    continue
                p, q = np.int64(a), np.int64(b)
                if rank[p] > rank[q]:
                    p, q = np.int64(b), np.int64(a)
                if not _are_paths_near(paths, p, q):
                    continue
                time, direction = NEVER, (0.0, 0.0, 0.0)
                if only_impacts:
                    moves = minus(get_column(paths.displacement, p), get_column(paths.displacement, q))
                    wide, far = paths.radius[p] + paths.radius[q], np.sqrt(dot(moves, moves))
                    if far < wide * _LONG_STEP_RADII:
                        continue
                    time, _ = find_impact(paths, p, q, moves, _PASS_SHARE)
                    if time > 1.0:
                        continue
                    time, direction = find_impact(paths, p, q, moves, 1.0)
                    if time > 1.0 or (time <= 0.0 and far < wide * _GRAZE_RADII):
                        continue
                if used_count >= pairs.i.size:
                    return -1
                pairs.i[used_count], pairs.j[used_count], pairs.time[used_count] = p, q, time
                store_column(pairs.direction, used_count, direction)
                used_count += 1
    return used_count
