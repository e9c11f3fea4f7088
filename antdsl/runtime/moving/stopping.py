"""Kernels that deflect and shorten paths until no two bodies collide on them."""

from __future__ import annotations

from antdsl.machine_code.kernels import kernel, simd_range
from antdsl.machine_code.kernels.types import BOOL, F64, I64, Array1, Array2
from antdsl.numerics.kernel_vectors import dot, get_column, minus, store_column, times
from antdsl.numerics.sorting import compact_indices
from antdsl.runtime.moving.contacts.impacts import NO_IMPACT_TIME, CapsulePaths, PathEncounters, find_impact
from antdsl.runtime.moving.contacts.step_clamping import (
    ClampBuffers,
    compute_second_mass_share,
    deflect_along_limits,
    negate_vector,
)

_MIN_STOPPING_OVERLAP_SHARE = 2e-3  # share of both radii; bodies with smaller overlaps slide along each other
_HEAVY_BODY_ENTRY_SHARE = 0.5  # share of both radii; how far a heavy body enters a light one and then pushes it


@kernel
def deflect_paths_at_impacts(
    encounters: PathEncounters,
    paths: CapsulePaths,
    approach: Array2[F64],
    rounding_constant: F64,
    buffers: ClampBuffers,
    corrections: Array2[F64],
    stopped_rows: Array1[I64],
    is_changed: Array1[BOOL],
) -> I64:
    """Deflect paths at the impacts in `encounters`: from the impact on, a body continues along the other body.

    Returns the number of stopped rows. `approach` (3, n) mm: the displacements by the velocities before this substep, in the same
    time. A body may follow another body that moves away. The other arguments are as in `step_clamping.deflect_along_limits`."""
    for pair in simd_range(0, encounters.first_rows.size):
        direction, over = get_column(encounters.separation_axis, pair), 0
        for side in range(2):
            own, other = (
                (encounters.second_rows[pair], encounters.first_rows[pair])
                if side
                else (encounters.first_rows[pair], encounters.second_rows[pair])
            )
            towards, time = -dot(direction, get_column(paths.displacement, own)), encounters.meeting_time[pair]
            far = max(towards, 0.0) * time + max(-dot(direction, get_column(approach, other)), 0.0) * (1 - time)
            pressed = (paths.radius[own] + paths.radius[other]) * _HEAVY_BODY_ENTRY_SHARE
            far += compute_second_mass_share(paths.mass, own, other) * min(max(towards - far, 0.0), pressed)
            buffers.free_gaps[side, pair] = far
            over = 1 if towards - far > 0 else over
            direction = negate_vector(direction)
        buffers.pairs[pair] = over
    return deflect_along_limits(
        encounters.first_rows,
        encounters.second_rows,
        encounters.separation_axis,
        paths.displacement,
        rounding_constant,
        buffers,
        corrections,
        stopped_rows,
        is_changed,
    )


@kernel
def find_next_impacts(
    encounters: PathEncounters,
    paths: CapsulePaths,
    is_touched: Array1[BOOL],
    was_touched: Array1[BOOL],
    first_impact_time: Array1[F64],
) -> I64:
    """Compute the impacts of pairs with a row in `is_touched`, and write them to `encounters`. Write the time of each row's first
    impact to `first_impact_time` (n).

    Returns the number of impacts. `was_touched` (n): flags of rows that have changed since the last call. Only impacts of pairs
    with such a row are updated."""
    for pair in range(encounters.first_rows.size):
        p, q = encounters.first_rows[pair], encounters.second_rows[pair]
        if (was_touched[p] | was_touched[q]) & (is_touched[p] | is_touched[q]):
            moves = minus(get_column(paths.displacement, p), get_column(paths.displacement, q))
            heavier = max(compute_second_mass_share(paths.mass, p, q), compute_second_mass_share(paths.mass, q, p))
            share = 1 - _MIN_STOPPING_OVERLAP_SHARE - _HEAVY_BODY_ENTRY_SHARE * heavier
            encounters.meeting_time[pair], direction = find_impact(paths, p, q, moves, share)
            store_column(encounters.separation_axis, pair, direction)
    count = 0
    first_impact_time[:] = NO_IMPACT_TIME
    for pair in range(encounters.first_rows.size):
        if encounters.meeting_time[pair] <= 1.0:
            count += 1
            for row in (encounters.first_rows[pair], encounters.second_rows[pair]):
                first_impact_time[row] = min(first_impact_time[row], encounters.meeting_time[pair])
    return count


@kernel
def shorten_paths(
    encounters: PathEncounters, paths: CapsulePaths, first_impact_time: Array1[F64], only_first: BOOL, stops_rows: BOOL,
    path_factor: Array1[F64],
    is_touched: Array1[BOOL], was_touched: Array1[BOOL],
) -> None:  # fmt: skip
    """Shorten the displacements of rows that move towards another row, so that they end at the impact.

    The tangent plane at the impact then separates both bodies for the whole substep, even if paths become shorter.
    `only_first`: use only impacts that are the first one for both rows, because later ones may not occur. `stops_rows`: stop
    the rows completely instead. `path_factor` (n): a work buffer. Sets the flags `is_touched` and `was_touched`."""
    path_factor[:] = 1.0
    for pair in range(encounters.first_rows.size):
        time = encounters.meeting_time[pair]
        if time > 1.0:
            continue
        direction = get_column(encounters.separation_axis, pair)
        for side in range(2):
            own, other = (
                (encounters.second_rows[pair], encounters.first_rows[pair])
                if side
                else (encounters.first_rows[pair], encounters.second_rows[pair])
            )
            is_first = (first_impact_time[own] == time) & (first_impact_time[other] == time)
            if stops_rows or ((is_first | (not only_first)) and -dot(direction, get_column(paths.displacement, own)) > 0):
                path_factor[own] = min(path_factor[own], 0.0 if stops_rows else time)
            direction = negate_vector(direction)
    for k in simd_range(0, path_factor.size):
        was_touched[k] = path_factor[k] < 1.0
        is_touched[k] |= was_touched[k]
        store_column(paths.displacement, k, times(get_column(paths.displacement, k), path_factor[k]))


@kernel
def list_corrections(displacement: Array2[F64], travel: Array2[F64], rows: Array1[I64], corrections: Array2[F64]) -> I64:
    """Write to `rows` the rows with a displacement that differs from `travel` (3, n) mm, and to `corrections` the differences.
    Return the number of rows."""
    for k in simd_range(0, rows.size):
        path, step = get_column(displacement, k), get_column(travel, k)
        rows[k] = 1 if (path[0] != step[0]) | (path[1] != step[1]) | (path[2] != step[2]) else 0
    count = compact_indices(rows, rows.size)
    for n in range(count):
        store_column(corrections, n, minus(get_column(displacement, rows[n]), get_column(travel, rows[n])))
    return count
