"""Kernels that separate pairs of bodies. Sums over pairs are exact, so the order of pairs does not matter."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.kernels import (
    BOOL,
    F64,
    I64,
    Array1,
    Array2,
    Array3,
    Strided2,
    inlined,
    kernel,
    kernel_helper,
    simd_range,
)
from antdsl.numerics.kernel_vectors import Vec3, VectorColumns, dot, get_column, minus, plus, store_column, times
from antdsl.numerics.sorting import compact_indices
from antdsl.runtime.moving.contacts.capsule_distances import CapsuleArrays, measure_listed_pairs
from antdsl.runtime.moving.contacts.step_clamping import add_rounded_vector, negate_vector

DEAD_ZONE_SHARE = 5e-4  # share of both collision radii; smaller overlaps move no agent, so that resting agents stay at rest
SUM_BITS = 40  # bits of a term in a sum, below the largest overlap
_SHARE_RESOLUTION = 1 << 20  # shares are multiples of 1 / this number
_CONTACTS_OF_DENSE_AGENT = 3  # number of contacts along which lock values spread
_OUTER_SHARE_FACTOR = 10.0  # in a dense cluster, the outer agent moves more by this factor of the difference
# The same for agents that hardly overlap. There it must be small, because a pressing crowd must not be thrown about.
_SHALLOW_OUTER_SHARE_FACTOR = 1.0
_MIN_INNER_SHARE = 1 / 64  # least share of the displacement that the inner agent takes
_CLUSTER_OVERRELAXATION = 1.5  # in a dense cluster, an agent moves by this factor of the mean of its contacts
# square of the part of a displacement along the ground; below it, the displacement is not lengthened
_MIN_SQUARED_GROUND_PART = 0.1
# radii; agents with half this previous penetration depth begin to count as clustered, with 1.5 times it completely
_CLUSTER_DEPTH_RADII = 0.4
_RESTING_DISTANCE_SHARE = 0.01  # share of the allowed distance; an agent that moves less rests and presses no other
_FREE_AGENT_PUSH_SHARE = 0.3  # share of the allowed distance that others push an agent that was free
_FLOAT32_ONE, _MIN_VECTOR_LENGTH = np.float32(1), np.float32(1e-12)  # as in `vectors.normalise_or_fallback`
_ROUNDING_CONSTANT = 1.5 * 2.0 ** (52 - SUM_BITS)

# i, j, gap, direction, and which pairs count
ContactPairArrays = tuple[Array1[I64], Array1[I64], Array1[F64], Array2[F64], Array1[BOOL]]
# Masses, mobilities, reaches, depths and held flags; normals of the ground, `walked` and `cut`, as in `contacts`
ContactAgentArrays = tuple[
    Array1[F64], Array1[F64], Array1[F64], Array1[F64], Array1[BOOL], Strided2[F64], Strided2[F64], Strided2[F64]
]  # fmt: skip
# Work buffers. For rows: two vectors, seven numbers, three integers and a condition. For pairs: six numbers, two vectors and four
# integers. Also all pairs around each row, and where those of each row start, below 0 until they are requested.
SolverBuffers = tuple[
    Array2[F64], Array2[F64], Array2[F64], Array2[I64], Array1[BOOL], Array2[F64], Array3[F64], Array2[I64], Array1[I64],
    Array1[I64],
]  # fmt: skip

# rows of the float buffer of agents
(
    _WEIGHT_BUFFER_ROW, _DENSITY_BUFFER_ROW, _SPREAD_BUFFER_ROW, _INVERSE_MASS_ROW, _CLUSTER_SHARE_ROW, _MAX_CORRECTION_ROW,
    _PUSH_LIMIT_ROW
) = range(7)  # fmt: skip
_INDEX_BUFFER_ROW, _ROW_LIST_BUFFER_ROW, _CONTACTS_ROW = 0, 1, 2  # rows of the integer buffer of agents
_MISSING_ROW = -1  # a row that occurs in no pair of an outer iteration
# rows of the float buffer of pairs; the last two have one number per side
_DEAD_ZONE_ROW, _DEPTH_ROW, _GROUND_PART_ROW, _SHARE_ROW = 0, 1, 2, 4
_CHOSEN_PAIR_ROW, _FIRST_AGENT_ROW, _SECOND_AGENT_ROW, _TOUCHING_PAIR_ROW = range(4)  # rows of the integer buffer of pairs


def make_buffers(rows: int, pairs: int) -> tuple[NDArray[Any], ...]:
    """Return the buffers that `separate_pairs` needs. `rows`, `pairs`: the numbers of rows and of pairs."""
    return (
        np.empty((3, rows)), np.empty((3, rows)), np.empty((7, rows)), np.empty((3, rows), np.int64), np.empty(rows, np.bool_),
        np.empty((6, pairs)), np.empty((2, pairs, 3)), np.empty((4, pairs), np.int64), np.full(rows + 1, -1, np.int64),
        np.empty(2 * pairs, np.int64),
    )  # fmt: skip


@inlined
def _round_sum_term(term: F64) -> F64:
    return (term + _ROUNDING_CONSTANT) - _ROUNDING_CONSTANT


@kernel
def restore_headings(
    rows: Array1[I64], stopped_rows: Array1[I64], crowd_rows: Array1[I64], previous_heading: VectorColumns, up: VectorColumns,
    heading: VectorColumns, shift: Array1[F64], ahead: Array2[F64], middle: Array2[F64],
) -> None:  # fmt: skip
    """Reset the headings and trunks of `rows`, which belong to one species, to those before the substep.

    `stopped_rows`: the indices of these agents among all rows in pairs. `crowd_rows`: their rows in the crowd."""
    for n in simd_range(0, rows.size):
        row, k = rows[n], stopped_rows[n]
        above = (up[0][row], up[1][row], up[2][row])
        direction = (previous_heading[0][row], previous_heading[1][row], previous_heading[2][row])
        direction = minus(direction, times(above, dot(direction, above)))
        size = np.sqrt(dot(direction, direction))
        if size > _MIN_VECTOR_LENGTH and np.isfinite(size):
            direction = times(direction, _FLOAT32_ONE / size)
        else:
            direction = (heading[0][row], heading[1][row], heading[2][row])
        for axis in range(3):
            facing = np.float64(direction[axis])
            middle[axis, k] += (facing - ahead[axis, k]) * shift[crowd_rows[n]]
            ahead[axis, k], heading[axis][row] = facing, direction[axis]


@inlined
def _find_maximum(numbers: Array1[F64], count: I64) -> F64:
    most = numbers[0]
    for k in range(1, count):
        most = max(most, numbers[k])
    return most


@kernel_helper
def _distribute_overlap(
    pair_count: I64, count: I64, buffers: SolverBuffers, mobility: Array1[F64], cluster_share: Array1[F64]
) -> None:
    """Write to `buffers` the fractions of the overlap by which the first and the second agent of each pair move.

    Their sum is 1. Lighter agents and less locked agents move more. Only the first `pair_count` pairs of `buffers` and the first
    `count` rows are used. An agent is locked if it deeply overlaps agents that also deeply overlap others. How locked it is
    decreases from the middle of a dense cluster to its rim. The measure is the first eigenvector of the contact graph, computed
    by power iteration: overlaps are repeatedly added up along contacts."""
    locked, spread = buffers[2][_DENSITY_BUFFER_ROW], buffers[2][_SPREAD_BUFFER_ROW]
    numbers, first, second = buffers[5], buffers[7][_FIRST_AGENT_ROW], buffers[7][_SECOND_AGENT_ROW]
    depth = numbers[_DEPTH_ROW]
    deepest = _find_maximum(depth, pair_count)
    for k in range(count):
        locked[k] = 0.0
    for n in range(pair_count):
        if depth[n] > 0:
            part = _round_sum_term(depth[n] / deepest)
            locked[first[n]] += part
            locked[second[n]] += part
    for _ in range(_CONTACTS_OF_DENSE_AGENT):
        for k in range(count):
            spread[k] = locked[k]
        for n in range(pair_count):
            if depth[n] > 0:
                spread[first[n]] += locked[second[n]]
                spread[second[n]] += locked[first[n]]
        highest = _find_maximum(spread, count)
        for k in range(count):
            locked[k] = _round_sum_term(spread[k] / highest)
    for n in range(pair_count):
        p, q = first[n], second[n]
        outward = _SHALLOW_OUTER_SHARE_FACTOR + (_OUTER_SHARE_FACTOR - _SHALLOW_OUTER_SHARE_FACTOR) * max(
            cluster_share[p], cluster_share[q]
        )
        outer = 0.5 + outward * (locked[q] - locked[p]) / max(locked[p] + locked[q], 1e-300)
        outer = min(max(outer, _MIN_INNER_SHARE), 1 - _MIN_INNER_SHARE)
        one = mobility[p] * outer * numbers[_GROUND_PART_ROW, n]
        total = one + mobility[q] * (1 - outer) * numbers[_GROUND_PART_ROW + 1, n]
        part = np.rint(one / max(total, 1e-300) * _SHARE_RESOLUTION) / _SHARE_RESOLUTION
        numbers[_SHARE_ROW, n], numbers[_SHARE_ROW + 1, n] = part, 1 - part if total > 0 else 0.0


@inlined
def _limit_correction(correction: Vec3, middle: Vec3, limit: F64) -> Vec3:
    """Return `correction`, reduced if necessary so that the vector `middle` plus the result is at most `limit` (mm) long."""
    displacement = plus(middle, correction)
    size = np.sqrt(dot(displacement, displacement))
    if size > limit:
        return minus(times(displacement, limit / size), middle)
    return correction


@kernel
def separate_pairs(
    bodies: CapsuleArrays, pairs: ContactPairArrays, agents: ContactAgentArrays, displacement: Array2[F64],
    rounding_constant: F64,
    outer_iterations: I64, sweeps: I64, relaxation: F64, lost_pairs: Array1[I64], buffers: SolverBuffers,
) -> tuple[I64, I64]:  # fmt: skip
    """Separate overlapping pairs. Pairs are measured `outer_iterations` times; each time, there are `sweeps` sweeps.
    `relaxation`: the fraction of an overlap that a sweep removes. Changes the gaps, directions and selection of `pairs`, and
    `displacement` (mm). Stops if a pair has no separation axis. Returns the number of remaining outer iterations, and the
    number of pairs without an axis, which are written to `lost_pairs`."""
    radius = bodies.radius
    i, j, gap, direction, which = pairs
    number, row_list, changed = buffers[3][_INDEX_BUFFER_ROW], buffers[3][_ROW_LIST_BUFFER_ROW], buffers[4]
    chosen, touching, starts, row_pairs = buffers[7][_CHOSEN_PAIR_ROW], buffers[7][_TOUCHING_PAIR_ROW], buffers[8], buffers[9]
    for pair in simd_range(0, i.size):
        touching[pair] = 1 if which[pair] and gap[pair] < _compute_dead_zone_gap(radius, i, j, pair) else 0
    touch = compact_indices(touching, i.size)
    number[:] = _MISSING_ROW
    changed[:] = False
    alone = outer_iterations == 1 and sweeps == 1  # only agents that touch others move
    if touch and not alone and starts[0] < 0:
        _group_pairs_by_row(i, j, starts, row_pairs)
    for left in range(outer_iterations - 1, -1, -1):
        moved, rows = _run_outer_iteration(
            radius, pairs, touch, agents, displacement, rounding_constant, sweeps, relaxation, alone, buffers
        )
        if not moved or not left:
            break
        count, kept_count = 0, 0
        for k in range(rows):
            row = row_list[k]
            if changed[row]:
                for at in range(starts[row], starts[row + 1]):
                    pair = row_pairs[at]
                    if i[pair] == row or not changed[i[pair]]:
                        chosen[count] = pair
                        count += 1
        without = measure_listed_pairs(bodies, displacement, i, j, gap, direction, chosen, count, lost_pairs)
        for n in range(touch):
            pair = touching[n]
            touching[kept_count] = pair
            kept_count += 0 if changed[i[pair]] | changed[j[pair]] else 1
        for n in range(count):
            pair = chosen[n]
            which[pair], touching[kept_count] = True, pair
            kept_count += 1 if gap[pair] < _compute_dead_zone_gap(radius, i, j, pair) else 0
        touch = kept_count
        if without:
            return left, without
        for k in range(rows):
            changed[row_list[k]] = False
    return 0, 0


@inlined
def _compute_dead_zone_gap(radius: Array1[F64], first_indices: Array1[I64], second_indices: Array1[I64], pair: I64) -> F64:
    """Return the gap (mm) below which the pair number `pair` is separated. It is negative, because a small overlap is allowed."""
    return -((radius[first_indices[pair]] + radius[second_indices[pair]]) * DEAD_ZONE_SHARE)


@kernel_helper
def _group_pairs_by_row(
    first_indices: Array1[I64], second_indices: Array1[I64], starts: Array1[I64], row_pairs: Array1[I64]
) -> None:
    """List the pairs of each row k in `row_pairs`, from index `starts[k]` to before `starts[k + 1]`."""
    starts[:] = 0
    for pair in range(first_indices.size):
        starts[first_indices[pair]] += 1
        starts[second_indices[pair]] += 1
    total = 0
    for k in range(starts.size):
        total += starts[k]
        starts[k] = total
    for pair in range(first_indices.size):
        one, other = starts[first_indices[pair]] - 1, starts[second_indices[pair]] - 1
        row_pairs[one], row_pairs[other] = pair, pair
        starts[first_indices[pair]], starts[second_indices[pair]] = one, other


@kernel_helper
def _compute_row_limits(
    radius: Array1[F64], agents: ContactAgentArrays, row_list: Array1[I64], count: I64, row_limits: Array2[F64]
) -> None:
    """Write to `row_limits` four limits for each of the first `count` rows of `row_list`. They are mobility, membership in a
    dense cluster (0 to 1), largest distance from the start, and largest push by others (mm)."""
    mass, yields, reach, depth, held, _, walked, _ = agents
    light, heap_share, most, push_limit = (
        row_limits[_INVERSE_MASS_ROW], row_limits[_CLUSTER_SHARE_ROW], row_limits[_MAX_CORRECTION_ROW],
        row_limits[_PUSH_LIMIT_ROW]
    )  # fmt: skip
    for k in simd_range(0, count):
        row = row_list[k]
        displacement = get_column(walked, row)
        size = np.sqrt(dot(displacement, displacement))
        far = max(reach[row], size)
        most[k], push_limit[k] = far, min(far * _FREE_AGENT_PUSH_SHARE + depth[row], far) * yields[row]
        heap_share[k] = (
            1.0
            if size <= _RESTING_DISTANCE_SHARE * far
            else min(max(depth[row] / (radius[row] * _CLUSTER_DEPTH_RADII) - 0.5, 0.0), 1.0)
        )
        light[k] = 0.0 if held[row] else 1 / mass[row]


@kernel_helper
def _run_outer_iteration(
    radius: Array1[F64], pairs: ContactPairArrays, touching_pair_count: I64, agents: ContactAgentArrays,
    displacement: Array2[F64], rounding_constant: F64, sweeps: I64, relaxation: F64, only_touching: BOOL,
    buffers: SolverBuffers
) -> tuple[BOOL, I64]:  # fmt: skip
    """Run the sweeps of one outer iteration, for `touching_pair_count` touching pairs.

    With `only_touching`, only these pairs are used, else all pairs of their rows. Returns whether any row changed, and how
    many rows were visited. The visited rows are at the start of the row list in `buffers`, with a flag for each that changed."""
    i, j, gap, direction, which = pairs
    normal, walked, cut = agents[5], agents[6], agents[7]
    new_displacement, sums, of_rows, wholes, changed, numbers, side_directions, indices, starts, row_pairs = buffers
    light, heap_share, most, far = (
        of_rows[_INVERSE_MASS_ROW],
        of_rows[_CLUSTER_SHARE_ROW],
        of_rows[_MAX_CORRECTION_ROW],
        of_rows[_PUSH_LIMIT_ROW],
    )
    number, row_list, contacts = wholes[_INDEX_BUFFER_ROW], wholes[_ROW_LIST_BUFFER_ROW], wholes[_CONTACTS_ROW]
    weight, least = of_rows[_WEIGHT_BUFFER_ROW], numbers[_DEAD_ZONE_ROW]
    chosen, first, second, those = (
        indices[_CHOSEN_PAIR_ROW],
        indices[_FIRST_AGENT_ROW],
        indices[_SECOND_AGENT_ROW],
        indices[_TOUCHING_PAIR_ROW],
    )
    m, count = 0, 0
    if not touching_pair_count:
        return False, count
    for n in range(touching_pair_count):
        for side in range(2):
            k = j[those[n]] if side else i[those[n]]
            if number[k] < 0:
                number[k], row_list[count] = count, k
                count += 1
    if only_touching:
        for n in range(touching_pair_count):
            chosen[n] = those[n]
        m = touching_pair_count
    else:
        touching_count = count
        for k in range(touching_count):
            row = row_list[k]
            for at in range(starts[row], starts[row + 1]):
                pair = row_pairs[at]
                other_row = i[pair] + j[pair] - row
                slot = number[other_row]
                # avoid visiting a pair of two touching rows twice
                if which[pair] and (slot < 0 or slot >= touching_count or other_row > row):
                    if slot < 0:
                        number[other_row], row_list[count] = count, other_row
                        count += 1
                    chosen[m] = pair
                    m += 1
    for n in range(m):
        pair = chosen[n]
        least[n] = -_compute_dead_zone_gap(radius, i, j, pair)
        first[n], second[n] = number[i[pair]], number[j[pair]]
    for k in range(count):
        number[row_list[k]] = _MISSING_ROW
    _compute_row_limits(radius, agents, row_list, count, of_rows)
    for n in range(m):
        pair = chosen[n]
        numbers[_DEPTH_ROW, n] = -gap[pair] if gap[pair] < -least[n] else 0.0
        v = get_column(direction, pair)
        for side in range(2):
            up = get_column(normal, j[pair] if side else i[pair])
            along = minus(v, times(up, dot(v, up)))
            side_directions[side, n, 0], side_directions[side, n, 1], side_directions[side, n, 2] = along
            numbers[_GROUND_PART_ROW + side, n] = dot(along, along)
            v = negate_vector(v)
    _distribute_overlap(m, count, buffers, light, heap_share)
    for side in range(2):
        for n in range(m):
            factor = numbers[_SHARE_ROW + side, n] / max(numbers[_GROUND_PART_ROW + side, n], _MIN_SQUARED_GROUND_PART)
            for axis in range(3):
                side_directions[side, n, axis] *= factor
    for k in range(count):
        store_column(new_displacement, k, get_column(displacement, row_list[k]))
    for _ in range(sweeps):
        for k in range(count):
            sums[0, k], sums[1, k], sums[2, k], weight[k], contacts[k] = 0.0, 0.0, 0.0, 0.0, 0
        touching = False
        for n in range(m):
            pair, p, q = chosen[n], first[n], second[n]
            one, other = (
                minus(get_column(new_displacement, p), get_column(displacement, i[pair])),
                minus(get_column(new_displacement, q), get_column(displacement, j[pair])),
            )
            left = gap[pair] + dot(get_column(direction, pair), minus(one, other))
            if left < -least[n]:
                touching = True
                for side in range(2):
                    k = q if side else p
                    add_rounded_vector(
                        sums,
                        k,
                        times(
                            (side_directions[side, n, 0], side_directions[side, n, 1], side_directions[side, n, 2]),
                            left * -relaxation,
                        ),
                        rounding_constant,
                    )
                    weight[k] += numbers[_SHARE_ROW + side, n]
                    contacts[k] += 1
        if not touching:
            break
        for k in range(count):
            at = row_list[k]
            part = (1 + (_CLUSTER_OVERRELAXATION - 1) * heap_share[k] if contacts[k] > 1 else 1.0) / max(weight[k], 1.0)
            target = plus(get_column(new_displacement, k), times(get_column(sums, k), part))
            target = _limit_correction(target, negate_vector(get_column(cut, at)), far[k])
            store_column(new_displacement, k, _limit_correction(target, get_column(walked, at), most[k]))
    moved = False
    for k in range(count):
        for axis in range(3):
            changed[row_list[k]] |= new_displacement[axis, k] != displacement[axis, row_list[k]]
        moved |= changed[row_list[k]]
        store_column(displacement, row_list[k], get_column(new_displacement, k))
    return moved, count
