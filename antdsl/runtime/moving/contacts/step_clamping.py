"""Limits steps that lead into other agents. Such a step is first deflected along the other agent, then shortened. Each agent
walks at most half of the free gap."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.kernels import BOOL, F64, I64, Array1, Array2, inlined, kernel, kernel_helper, simd_range
from antdsl.numerics.kernel_vectors import Vec3, dot, get_column, minus, store_column, times
from antdsl.numerics.sorting import compact_indices
from antdsl.runtime.moving.contacts.capsules import NearbyCapsulePairs

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]
Flags = NDArray[np.bool_]

_SUM_BITS = 40  # bits of a term in a sum, below the largest overlap
_STOPPED_DISTANCE_SHARE = 0.5  # share of the step; an agent that can walk less is stopped
_MAX_DEFLECTIONS = 3  # deflections of a step along agents ahead, before it is shortened


def clamp_approaching_steps(
    nearby_pairs: NearbyCapsulePairs, approach: Floats, mass: Floats, displacement: Floats, gap: Floats, direction: Floats
) -> tuple[Floats, Rows, Flags]:
    """Deflect and shorten the steps `displacement` (3, k) mm so that no agent enters another.

    Returns the corrections (3, k) mm, the stopped rows, and flags (k) of rows with shortened or stopped steps. An agent is
    stopped if less than half of its step remains. `approach` (3, k) mm: the displacements by the velocities before this substep,
    in the same time. `gap` (m), `direction` (3, m): gaps and separation axes of pairs before the steps. As in J. van den Berg et
    al., Reciprocal n-Body Collision Avoidance, 2011, each agent independently stays within half-planes. It walks towards a
    neighbour by at most half of the gap. If the neighbour continues its previous displacement away from the agent, this distance
    is added. Since each agent observes its half, no iteration is needed, and a pressing crowd comes to rest. The step of a
    heavier agent is shortened less."""
    magic = compute_rounding_constant(displacement)
    rows, pairs = len(nearby_pairs.rows), len(gap)
    (short, sums), part, changed = np.empty((2, 3, rows)), np.empty(rows), np.empty(rows, np.bool_)
    meeting_counts, bent_rows, stopped = np.empty((3, rows), np.intp)
    buffers = ClampBuffers(np.empty((2, pairs)), sums, part, meeting_counts, bent_rows, np.empty(pairs, np.intp))
    count = _deflect_steps(
        nearby_pairs.first_indices,
        nearby_pairs.second_indices,
        gap,
        direction,
        approach,
        mass,
        displacement,
        magic,
        buffers,
        short,
        stopped,
        changed,
    )
    return short, stopped[:count], changed


def compute_rounding_constant(terms: Floats) -> float:
    """Return the rounding constant for `add_rounded_vector`. It defines the quantum to which `terms` (3, k) are rounded before
    they are added."""
    most = max(terms.max(), -terms.min(), 1e-30)
    return float(np.ldexp(1.5, int(np.frexp(most)[1]) + 2 - _SUM_BITS + 52))


@inlined
def add_rounded_vector(sums: Array2[F64], column: I64, v: Vec3, rounding_constant: F64) -> None:
    """Round a vector to the quantum that `rounding_constant` defines, and add it to column `column` of `sums`."""
    for axis in range(3):
        sums[axis, column] += (v[axis] + rounding_constant) - rounding_constant


@inlined
def negate_vector(v: Vec3) -> Vec3:
    return -v[0], -v[1], -v[2]


@inlined
def compute_second_mass_share(mass: Array1[F64], first: I64, second: I64) -> F64:
    """Return by how much the first of two rows is heavier: 0 if it is not heavier, almost 1 if it is much heavier."""
    return 1 - min(2 * mass[second] / (mass[first] + mass[second]), 1.0)


class ClampBuffers(NamedTuple):
    """Work buffers for m pairs of k rows. `free_gaps` is (2, m), `step_sums` (3, k); `step_share`, `contact_counts` and
    `deflected_rows` are (k), `pairs` is (m)."""

    free_gaps: Array2[F64]
    step_sums: Array2[F64]
    step_share: Array1[F64]
    contact_counts: Array1[I64]
    deflected_rows: Array1[I64]
    pairs: Array1[I64]


@kernel_helper
def deflect_along_limits(
    first_indices: Array1[I64],
    second_indices: Array1[I64],
    direction: Array2[F64],
    travel: Array2[F64],
    rounding_constant: F64,
    buffers: ClampBuffers,
    corrections: Array2[F64],
    stopped_rows: Array1[I64],
    is_changed: Array1[BOOL],
) -> I64:
    """Deflect and shorten steps at the limits in `buffers.free_gaps`.

    Return the number of stopped rows. On entry, `buffers.pairs` flags the pairs with a step beyond a limit. `corrections` (3,
    k): receives the corrections (mm). `is_changed`: receives flags of changed rows. `stopped_rows`: receives the stopped rows
    at its start. After a pass over all pairs, only pairs with a deflected row are visited again, because no other step has
    changed."""
    free, sums, part, meeting_counts, bent_rows, pairs = buffers
    count, rows = compact_indices(pairs, first_indices.size), 0
    meeting_counts[:] = 0
    part[:] = 1.0
    for k in simd_range(0, part.size):
        store_column(corrections, k, get_column(travel, k))
    for bend in range(_MAX_DEFLECTIONS):
        has_overlap = False
        for n in range(count):
            pair = pairs[n]
            pair_direction = get_column(direction, pair)
            for side in range(2):
                k = second_indices[pair] if side else first_indices[pair]
                over = -dot(pair_direction, get_column(corrections, k)) - free[side, pair]
                if over > 0:
                    if meeting_counts[k] == 0:
                        sums[0, k], sums[1, k], sums[2, k] = 0.0, 0.0, 0.0
                        if bend == 0:
                            bent_rows[rows] = k
                            rows += 1
                    add_rounded_vector(sums, k, times(pair_direction, over), rounding_constant)
                    meeting_counts[k] += 1
                    has_overlap = True
                pair_direction = negate_vector(pair_direction)
        if not has_overlap:
            break
        for n in range(rows):
            k = bent_rows[n]
            if meeting_counts[k]:
                for axis in range(3):
                    corrections[axis, k] += sums[axis, k] / meeting_counts[k]
        if bend == 0:
            for pair in simd_range(0, first_indices.size):
                pairs[pair] = 1 if (meeting_counts[first_indices[pair]] != 0) | (meeting_counts[second_indices[pair]] != 0) else 0
            count = compact_indices(pairs, first_indices.size)
        for n in range(rows):
            meeting_counts[bent_rows[n]] = 0
    for n in range(count):
        pair = pairs[n]
        pair_direction = get_column(direction, pair)
        for side in range(2):
            k = second_indices[pair] if side else first_indices[pair]
            towards = -dot(pair_direction, get_column(corrections, k))
            if towards > free[side, pair]:
                part[k] = min(part[k], free[side, pair] / max(towards, 1e-300))
            pair_direction = negate_vector(pair_direction)
    for k in simd_range(0, part.size):
        way_on = get_column(travel, k)
        step = times(get_column(corrections, k), part[k])
        short = minus(step, way_on)
        store_column(corrections, k, short)
        held = dot(step, step) < _STOPPED_DISTANCE_SHARE * _STOPPED_DISTANCE_SHARE * dot(way_on, way_on)
        stopped_rows[k] = 1 if held else 0
        is_changed[k] = held | (short[0] != 0) | (short[1] != 0) | (short[2] != 0)
    return compact_indices(stopped_rows, part.size)


@kernel
def _deflect_steps(
    first_indices: Array1[I64],
    second_indices: Array1[I64],
    gap: Array1[F64],
    direction: Array2[F64],
    approach: Array2[F64],
    mass: Array1[F64],
    travel: Array2[F64],
    rounding_constant: F64,
    buffers: ClampBuffers,
    corrections: Array2[F64],
    stopped_rows: Array1[I64],
    is_changed: Array1[BOOL],
) -> I64:
    """Deflect and shorten steps, as described for `clamp_approaching_steps`. Return the number of stopped rows. The other
    results are those of `deflect_along_limits`."""
    free, pairs = buffers.free_gaps, buffers.pairs
    for pair in simd_range(0, first_indices.size):
        pair_direction, over = get_column(direction, pair), 0
        for side in range(2):
            own, other = (second_indices[pair], first_indices[pair]) if side else (first_indices[pair], second_indices[pair])
            towards = -dot(pair_direction, get_column(travel, own))
            far = max(gap[pair], 0.0) * 0.5 + max(-dot(pair_direction, get_column(approach, other)), 0.0)
            far += compute_second_mass_share(mass, own, other) * max(towards - far, 0.0)
            free[side, pair] = far
            over = 1 if towards - far > 0 else over
            pair_direction = negate_vector(pair_direction)
        pairs[pair] = over
    return deflect_along_limits(
        first_indices, second_indices, direction, travel, rounding_constant, buffers, corrections, stopped_rows, is_changed
    )
