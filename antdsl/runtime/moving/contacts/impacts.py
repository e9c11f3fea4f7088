"""Kernels for bodies that move far in a substep. They find which pairs collide on straight paths, and when.

The clearance of two capsules with constant orientation is a convex function of time on straight paths. So Newton's method from
the left never passes the first impact (conservative advancement, C. Ericson, Real-Time Collision Detection, 2005, 5.5.3)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from antdsl.machine_code.kernels import inlined, kernel, kernel_helper, load_consecutive, simd_range
from antdsl.machine_code.kernels.types import BOOL, F32, F64, I32, I64, Array1, Array2, Strided2
from antdsl.numerics.kernel_vectors import Vec3, VectorColumns, dot, get_column, minus, plus, store_column, times
from antdsl.runtime.moving.contacts.capsule_distances import compute_mean_up, find_separation_axis
from antdsl.senses.touching import Agents, find_span_end, find_span_start

# Radii. With shorter steps, no touching pair gets beyond the range of the pair search, if its depth is at most as below.
_LONG_STEP_RADII = 1.9
_LONG_STEP_HALF_LENGTHS_AND_RADII = 1.6  # radii; half the body length may lengthen a step up to this
NO_IMPACT_TIME = 2.0  # time of an impact that does not occur, in substeps
_MIN_FLAT_SHARE = 0.1  # share of both radii; bodies nearer than this along the ground are above each other
_GRAZING_DISTANCE_RADII = 2.0  # radii of both bodies; on shorter paths, touching bodies do not pass to the other side
_PASSING_DISTANCE_SHARE = 0.8  # share of both radii; bodies that graze each other farther out do not pass through each other
_IMPACT_ITERATIONS = 40  # iterations of Newton's method; only grazing paths need more than ten
_TOUCH_TOLERANCE = 1e-6  # share of both radii; a smaller clearance is an impact
_APPROACH_TOLERANCE = 1e-6  # share of the path; a slower approach does not count


class CapsulePaths(NamedTuple):
    """The capsules and straight paths of all agents in a substep.

    `middle` (3, n) mm: their middles at the start. `displacement` (3, n) mm: their displacements. `axis_direction`, `up` (3, n):
    unit vectors. `half_length`, `radius` (n) mm: size of the capsules. `path_sag` (n) mm: how far the path over curved ground
    deviates from the straight line. `mass` (n): the masses of the agents."""

    middle: Array2[F64]
    displacement: Array2[F64]
    axis_direction: Array2[F64]
    up: Array2[F64]
    half_length: Array1[F64]
    radius: Array1[F64]
    path_sag: Array1[F64]
    mass: Array1[F64]


class PathPairSearch(NamedTuple):
    """A search for pairs of paths. It has the fields of `touching.PairSearch` in the same order."""

    searching_agents: Agents
    agents: Agents
    cell_starts: Array1[I32]
    cells: I64
    span_offsets: Array1[I64]
    is_self_search: BOOL


class PathEncounters(NamedTuple):
    """Pairs of agents with paths that come near each other. `first_rows`, `second_rows` (m): their rows. `meeting_time` (m):
    when they collide, as a fraction of the substep.

    `separation_axis` (3, m): the unit vector from the second agent to the first when they collide."""

    first_rows: Array1[I64]
    second_rows: Array1[I64]
    meeting_time: Array1[F64]
    separation_axis: Array2[F64]


@kernel
def flag_long_steps(
    position: Strided2[F64],
    start_positions: Strided2[F64],
    half_length: Array1[F64],
    radius: Array1[F64],
    first_index: I64,
    flags: Array1[I64],
) -> I64:
    """Flag the agents of a species with steps so long that a contact along the path could be missed.

    Return their number. `position`, `start_positions` (n, 3) mm: positions at the end and at the start of the step.
    `half_length`, `radius`, `flags`: arrays of the crowd, in which the species starts at index `first_index`."""
    total = 0
    for k in simd_range(0, position.shape[0]):
        x, y, z = (
            position[k, 0] - start_positions[k, 0],
            position[k, 1] - start_positions[k, 1],
            position[k, 2] - start_positions[k, 2],
        )
        wide, squared = radius[first_index + k], (x * x + y * y) + z * z
        far = wide * _LONG_STEP_RADII + min(half_length[first_index + k], wide * _LONG_STEP_HALF_LENGTHS_AND_RADII)
        flags[first_index + k] = 1 if (squared > far * far) & (wide > 0) & np.isfinite(squared) else 0
    for k in range(position.shape[0]):
        total += flags[first_index + k]
    return total


@kernel
def fill_paths(
    position: Strided2[F64],
    start_positions: Strided2[F64],
    normal: Strided2[F32],
    axis_direction: VectorColumns,
    up: VectorColumns,
    mass: Array1[F32],
    first_index: I64,
    paths: CapsulePaths,
) -> None:
    """Write the paths of the agents of a species, from index `first_index` on.

    On entry, `paths.middle` contains the middles at the end. `position`, `start_positions` (n, 3) mm: positions at the end and
    at the start. `normal` (n, 3): normals of the ground at the start."""
    for k in simd_range(0, position.shape[0]):
        row = first_index + k
        x, y, z = (
            position[k, 0] - start_positions[k, 0],
            position[k, 1] - start_positions[k, 1],
            position[k, 2] - start_positions[k, 2],
        )
        path = (x, y, z)
        one = (np.float64(normal[k, 0]), np.float64(normal[k, 1]), np.float64(normal[k, 2]))
        other = (np.float64(up[0][k]), np.float64(up[1][k]), np.float64(up[2][k]))
        bend = minus(other, one)
        middle = minus(get_column(paths.middle, row), path)
        store_column(paths.middle, row, middle)
        store_column(paths.displacement, row, path)
        store_column(
            paths.axis_direction,
            row,
            (np.float64(axis_direction[0][k]), np.float64(axis_direction[1][k]), np.float64(axis_direction[2][k])),
        )
        between = compute_mean_up(one, other)
        for axis in range(3):
            paths.up[axis, row] = between[axis] if dot(between, between) > 0 else other[axis]
        # the distance of an arc from its chord
        paths.path_sag[row] = np.sqrt(dot(path, path)) * np.sqrt(dot(bend, bend)) * 0.25
        paths.mass[row] = max(np.float64(mass[k]), 1e-30)


@inlined
def _scale_along_normal(v: Vec3, normal: Vec3, factor: F64) -> Vec3:
    """Return the vector `v` with its component along `normal` multiplied by 1 - `factor`."""
    return minus(v, times(normal, dot(v, normal) * factor))


@kernel_helper
def find_impact(
    paths: CapsulePaths, first_row: I64, second_row: I64, relative_displacement: Vec3, share: F64
) -> tuple[F64, Vec3]:
    """Return the time at which two bodies collide, as a fraction of the substep, and the direction from the second to the
    first. The time is `NO_IMPACT_TIME` if they do not collide. The direction is along the ground. `relative_displacement`: the
    first displacement minus the second (mm). `share`: bodies collide if their distance is less than this fraction of the sum
    of their radii. On curved ground, heights have less weight, so that paths over a hill collide even if their chords do not."""
    wide = (paths.radius[first_row] + paths.radius[second_row]) * share
    sag = paths.path_sag[first_row] + paths.path_sag[second_row]
    between, part = (
        compute_mean_up(get_column(paths.up, first_row), get_column(paths.up, second_row)),
        1 - wide / max(wide + sag * 2, 1e-300),
    )
    away, a, b = (
        minus(get_column(paths.middle, first_row), get_column(paths.middle, second_row)),
        get_column(paths.axis_direction, first_row),
        get_column(paths.axis_direction, second_row),
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
    for _ in range(_IMPACT_ITERATIONS):
        middle = plus(away, times(relative_displacement, time))
        separation, _, _ = find_separation_axis(
            middle, a, b, (0.0, 0.0, 0.0), paths.half_length[first_row], paths.half_length[second_row]
        )
        size = max(np.sqrt(dot(separation, separation)), 1e-300)
        direction = times(separation, 1 / size)
        flat = minus(separation, times(between, dot(separation, between)))
        long = np.sqrt(dot(flat, flat))
        across = times(flat, 1 / long) if long > wide * _MIN_FLAT_SHARE else direction
        rate, gap = dot(direction, relative_displacement), size - wide
        if not rate < -far * _APPROACH_TOLERANCE:
            return NO_IMPACT_TIME, across
        if gap <= wide * _TOUCH_TOLERANCE:
            break
        time -= gap / rate
        if not time <= 1.0:
            return NO_IMPACT_TIME, across
    return time, across


@inlined
def _are_paths_near(paths: CapsulePaths, first_row: I64, second_row: I64) -> BOOL:
    """Return whether the paths of two bodies come near enough for the bodies to touch, even if the bodies are there at different
    times."""
    one, other = get_column(paths.displacement, first_row), get_column(paths.displacement, second_row)
    long, size = np.sqrt(dot(one, one)), np.sqrt(dot(other, other))
    away = minus(
        plus(get_column(paths.middle, first_row), times(one, 0.5)), plus(get_column(paths.middle, second_row), times(other, 0.5))
    )
    one, other = times(one, 1 / max(long, 1e-300)), times(other, 1 / max(size, 1e-300))
    separation, _, _ = find_separation_axis(away, one, other, (0.0, 0.0, 0.0), long * 0.5, size * 0.5)
    reach = (
        paths.half_length[first_row]
        + paths.half_length[second_row]
        + paths.radius[first_row]
        + paths.radius[second_row]
        + paths.path_sag[first_row]
        + paths.path_sag[second_row]
    )
    return dot(separation, separation) <= reach * reach


@kernel
def list_path_pairs(
    search: PathPairSearch,
    paths: CapsulePaths,
    rank_by_row: Array1[I64],
    active_rows: Array1[I64],
    only_impacts: BOOL,
    used_count: I64,
    pairs: PathEncounters,
) -> I64:
    """Append the pairs of agents with near paths to `pairs`, after its first `used_count` entries.

    Return the new number of pairs, or -1 if the arrays are too short. At least one agent of a pair is flagged in `active_rows`.
    `rank_by_row` (n): the row of a pair with the lower rank is the first. `only_impacts`: append only pairs that would pass
    through each other. For bodies that touch at the start, this is so only if they can pass to the other side."""
    (asks, asking_rows, asking_keys), (ordered, rows, _) = search.searching_agents, search.agents
    for at in range(asking_rows.size):
        (x, y, z, extent), a = load_consecutive(asks, 4 * at, 4), asking_rows[at]
        for span in range(search.span_offsets.size):
            key = asking_keys[at] + search.span_offsets[span]
            first = find_span_start(search.agents, search.cell_starts, search.cells, search.is_self_search, at, span, key)
            last = find_span_end(search.agents, search.cell_starts, search.cells, key)
            for n in range(first, last):
                b = rows[n]
                if active_rows[a] == 0 and active_rows[b] == 0:
                    continue
                (u, v, w, far) = load_consecutive(ordered, 4 * n, 4)
                u, v, w, reach = u - x, v - y, w - z, extent + far
                if (u * u + v * v) + w * w > reach * reach:
                    continue
                p, q = np.int64(a), np.int64(b)
                if rank_by_row[p] > rank_by_row[q]:
                    p, q = np.int64(b), np.int64(a)
                if not _are_paths_near(paths, p, q):
                    continue
                time, direction = NO_IMPACT_TIME, (0.0, 0.0, 0.0)
                if only_impacts:
                    moves = minus(get_column(paths.displacement, p), get_column(paths.displacement, q))
                    wide, far = paths.radius[p] + paths.radius[q], np.sqrt(dot(moves, moves))
                    if far < wide * _LONG_STEP_RADII:
                        continue
                    time, _ = find_impact(paths, p, q, moves, _PASSING_DISTANCE_SHARE)
                    if time > 1.0:
                        continue
                    time, direction = find_impact(paths, p, q, moves, 1.0)
                    if time > 1.0 or (time <= 0.0 and far < wide * _GRAZING_DISTANCE_RADII):
                        continue
                if used_count >= pairs.first_rows.size:
                    return -1
                pairs.first_rows[used_count], pairs.second_rows[used_count], pairs.meeting_time[used_count] = p, q, time
                store_column(pairs.separation_axis, used_count, direction)
                used_count += 1
    return used_count
