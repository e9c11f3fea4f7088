"""Kernels that deflect and shorten paths until no two bodies meet on them."""

from __future__ import annotations

from antdsl.machine_code.kernels import kernel, simd_range
from antdsl.machine_code.kernels.types import BOOL, F64, I64, Array1, Array2
from antdsl.numerics.kernel_vectors import dot, get_column, minus, store_column, times
from antdsl.numerics.sorting import compact_indices
from antdsl.runtime.moving.contacts.impacts import NEVER, PathArrays, PathPairs, find_impact
from antdsl.runtime.moving.contacts.step_clamping import ClampBuffers, bend_along, compute_heavier_share, negate_vector

_MIN_STOPPING_OVERLAP_SHARE = 2e-3  # share of both radii; bodies with smaller overlaps slide along each other
_HEAVY_BODY_ENTRY_SHARE = 0.5  # share of both radii; how far a heavy body enters a light one and then pushes it


@kernel
def bend_paths(
    pairs: PathPairs,
    paths: PathArrays,
    approach: Array2[F64],
    magic: F64,
    buffers: ClampBuffers,
    cut: Array2[F64],
    stopped_rows: Array1[I64],
    changed: Array1[BOOL],
) -> I64:
    """Deflect paths at the impacts of `pairs`: a body continues from the impact along the other body.

    Returns the number of rows that are stopped.

    `approach` (3, n) mm: displacements in the previous period of equal length. A body follows a body that withdraws. The other
    arguments are as in `step_clamping.bend_along`."""
    for pair in simd_range(0, pairs.i.size):
        direction, over = get_column(pairs.direction, pair), 0
        for side in range(2):
            own, other = (pairs.j[pair], pairs.i[pair]) if side else (pairs.i[pair], pairs.j[pair])
            towards, time = -dot(direction, get_column(paths.displacement, own)), pairs.time[pair]
            far = max(towards, 0.0) * time + max(-dot(direction, get_column(approach, other)), 0.0) * (1 - time)
            pressed = (paths.radius[own] + paths.radius[other]) * _HEAVY_BODY_ENTRY_SHARE
            far += compute_heavier_share(paths.mass, own, other) * min(max(towards - far, 0.0), pressed)
            buffers.free_gaps[side, pair] = far
            over = 1 if towards - far > 0 else over
            direction = negate_vector(direction)
        buffers.pairs[pair] = over
    return bend_along(pairs.i, pairs.j, pairs.direction, paths.displacement, magic, buffers, cut, stopped_rows, changed)


@kernel
def find_next_impacts(
    pairs: PathPairs, paths: PathArrays, is_touched: Array1[BOOL], latest: Array1[BOOL], first: Array1[F64]
) -> I64:
    """Write the impacts of pairs with a row that `is_touched` to `pairs`, and the time of each row's first impact to `first` (n).

    Returns the number of impacts.
    `latest` (n): rows that have changed since the last call. Only impacts of their pairs are computed again."""
    for pair in range(pairs.i.size):
        p, q = pairs.i[pair], pairs.j[pair]
        if (latest[p] | latest[q]) & (is_touched[p] | is_touched[q]):
            moves = minus(get_column(paths.displacement, p), get_column(paths.displacement, q))
            heavier = max(compute_heavier_share(paths.mass, p, q), compute_heavier_share(paths.mass, q, p))
            share = 1 - _MIN_STOPPING_OVERLAP_SHARE - _HEAVY_BODY_ENTRY_SHARE * heavier
            pairs.time[pair], direction = find_impact(paths, p, q, moves, share)
            store_column(pairs.direction, pair, direction)
    count = 0
    first[:] = NEVER
    for pair in range(pairs.i.size):
        if pairs.time[pair] <= 1.0:
            count += 1
            for row in (pairs.i[pair], pairs.j[pair]):
                first[row] = min(first[row], pairs.time[pair])
    return count


@kernel
def shorten_paths(
    pairs: PathPairs, paths: PathArrays, first: Array1[F64], only_first: BOOL, stops_rows: BOOL, factor: Array1[F64],
    is_touched: Array1[BOOL], latest: Array1[BOOL],
) -> None:  # fmt: skip
    """Shorten the displacements of the rows that move towards another row up to their impact.

    The tangent plane at the impact then separates both bodies for the whole substep, even if paths become shorter. `only_first`:
    use only impacts that are the first of both rows, because later ones may not occur. `stops_rows`: stop the rows completely.
    `factor` (n): a work buffer. Sets the flags `is_touched` and `latest`."""
    factor[:] = 1.0
    for pair in range(pairs.i.size):
        time = pairs.time[pair]
        if time > 1.0:
            continue
        direction = get_column(pairs.direction, pair)
        for side in range(2):
            own, other = (pairs.j[pair], pairs.i[pair]) if side else (pairs.i[pair], pairs.j[pair])
            is_first = (first[own] == time) & (first[other] == time)
            if stops_rows or ((is_first | (not only_first)) and -dot(direction, get_column(paths.displacement, own)) > 0):
                factor[own] = min(factor[own], 0.0 if stops_rows else time)
            direction = negate_vector(direction)
    for k in simd_range(0, factor.size):
        latest[k] = factor[k] < 1.0
        is_touched[k] |= latest[k]
        store_column(paths.displacement, k, times(get_column(paths.displacement, k), factor[k]))


@kernel
def list_corrections(displacement: Array2[F64], travel: Array2[F64], rows: Array1[I64], corrections: Array2[F64]) -> I64:
    """Write the rows of which the displacement differs from `travel` (3, n) mm, and the differences. Return their number."""
    for k in simd_range(0, rows.size):
        path, step = get_column(displacement, k), get_column(travel, k)
        rows[k] = 1 if (path[0] != step[0]) | (path[1] != step[1]) | (path[2] != step[2]) else 0
    count = compact_indices(rows, rows.size)
    for n in range(count):
        store_column(corrections, n, minus(get_column(displacement, rows[n]), get_column(travel, rows[n])))
    return count
