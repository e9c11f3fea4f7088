"""Kernels for the capsules of bodies and the distance between two capsules."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.kernels import inlined, kernel, kernel_helper, prefetch, simd_range
from antdsl.machine_code.kernels.types import BOOL, F32, F64, I64, Array1, Array2, Strided2
from antdsl.numerics.kernel_vectors import Vec3, VectorColumns, dot, get_column, minus, plus, times
from antdsl.numerics.sorting import compact_indices

# radii around the axis within which neighbours are searched; more than 1, because the agent may still be moved
_SEARCH_DISTANCE_RADII = 1.6
_CANDIDATE_DISTANCE_WIDTHS = 1.5  # widths; pairs farther apart cannot touch in this substep
_OPPOSITE_SIDES_COSINE = -0.5  # cosine between two up directions; below it, the agents are on opposite sides of something
TILTED_COSINE = 0.94  # between two up directions, 20 degrees; below it, nearest points of whole bodies are found in space
NEVER_TILTED_COSINE = -2.0  # below every cosine: no pair counts as tilted
_COINCIDENT_AXES_WIDTHS = 1e-6  # widths; two axes this near to each other define no direction
_FLOAT32_ZERO = np.float32(0)
_AGENTS_PER_BATCH = 64  # agents with bounds computed in SIMD lanes
_EMPTY_PARTIAL_BOUNDS = np.repeat(
    [np.inf, -np.inf, 0.0], [4 * _AGENTS_PER_BATCH, 4 * _AGENTS_PER_BATCH, _AGENTS_PER_BATCH]
).reshape(9, _AGENTS_PER_BATCH)
_PREFETCH_GROUP_SIZE = 32  # number of pairs with rows prefetched before they are measured
_MAY_TOUCH_FLAG, _NO_AXIS_FLAG = 1, 2  # flags of a pair: it may touch; it has no separation axis
_NEAR_OVERLAP_FLAG, _OVERLAPPING_FLAG = 1, 2  # flags of a row: a neighbour overlaps another; the row itself overlaps another


NO_PERIOD = np.zeros(6)


class CapsuleArrays(NamedTuple):
    """The capsules of some rows. `middle` (3, k): the middles of their axes (mm). `axis_direction`, `up` (3, k): unit vectors.
    `half_length`, `radius` (k): half the length of the axis, and the radius (mm). `period` (6): widths (mm) of a periodic
    world, and their inverses; 0 along axes that do not wrap. `tilted_cosine`: if the up directions of a pair have a cosine
    below this, nearest points are computed in space instead of in a plane."""

    middle: Strided2[F64]
    axis_direction: Strided2[F64]
    up: Strided2[F64]
    half_length: Array1[F64]
    radius: Array1[F64]
    period: Array1[F64] = NO_PERIOD
    tilted_cosine: F64 = NEVER_TILTED_COSINE


class CrowdCapsules(NamedTuple):
    """The capsules of all agents, with the fields of `CapsuleArrays`. Vectors are stored as three columns, like registers."""

    middle: Array2[F64]
    axis_direction: VectorColumns
    up: VectorColumns
    half_length: Array1[F64]
    radius: Array1[F64]
    period: Array1[F64] = NO_PERIOD
    tilted_cosine: F64 = NEVER_TILTED_COSINE


class CapsuleShape(NamedTuple):
    """The capsule of a species, in body lengths.

    `length`, `width`: the size of the capsule. `height`: how far its axis is above the feet. `forward_offset`: how far its
    middle is ahead of the feet."""

    length: F64
    width: F64
    height: F64
    forward_offset: F64


class TrunkCapsules(NamedTuple):
    """The capsules of the trunks of all agents. The fields are those of `capsules.CapsuleCrowd`. `forward_offset`: the distance
    (mm) of each middle ahead of the feet."""

    half_length: Array1[F64]
    radius: Array1[F64]
    forward_offset: Array1[F64]
    reach: Array1[F64]
    middle: Array2[F64]


class CrowdBounds(NamedTuple):
    """The bounds of the capsules of a crowd: the least and greatest x, y and z of their middles, and the least and greatest reach
    (mm). NaN if any value is not finite."""

    lower_bounds: tuple[F64, F64, F64, F64]
    upper_bounds: tuple[F64, F64, F64, F64]


class TouchingPairCounts(NamedTuple):
    """Counts of the pairs of agents that may touch.

    `pair_count`: the number of pairs. `row_count`: the number of agents in pairs. `pairs_without_axis`: the number of pairs
    without a separation axis. `max_radius`: the largest radius (mm) of an agent in a pair."""

    pair_count: I64
    row_count: I64
    pairs_without_axis: I64
    max_radius: F64


@inlined
def _read_vector(vectors: VectorColumns, i: I64) -> Vec3:
    """Return element `i` of vectors that are stored as three float32 arrays."""
    return np.float64(vectors[0][i]), np.float64(vectors[1][i]), np.float64(vectors[2][i])


def make_empty_partial_bounds() -> NDArray[np.float64]:
    """Return the initial partial bounds for `place_trunks`: +inf for minima, -inf for maxima, and 0 for the number of values
    that are not finite."""
    return _EMPTY_PARTIAL_BOUNDS.copy()


@kernel
def place_trunks(
    position: Array2[F64], heading: VectorColumns, up: VectorColumns, size: Array1[F32], shape: CapsuleShape, first_index: I64,
    trunks: TrunkCapsules, partial_bounds: Array2[F64],
) -> CrowdBounds:  # fmt: skip
    """Compute the capsules of a species at positions (3, n) mm, and store them from index `first_index` on.

    Returns the bounds of this species and of all species before it. `partial_bounds` (9, 64): updated; column k collects the
    bounds of every 64th agent. `make_empty_partial_bounds` returns the initial values."""
    length, width, height, ahead = shape
    half, radius, shift, reach, middle = trunks
    for begin in range(0, size.size, _AGENTS_PER_BATCH):
        for i in simd_range(begin, min(begin + _AGENTS_PER_BATCH, size.size)):
            row, column = first_index + i, i - begin
            wide = np.float64(_FLOAT32_ZERO if size[i] <= 0 else size[i])
            radius[row] = wide * width * 0.5
            half[row] = max(wide * length * 0.5 - radius[row], 0.0)
            reach[row] = half[row] + radius[row] * _SEARCH_DISTANCE_RADII
            high, shift[row] = wide * height, wide * ahead
            above, forward = _read_vector(up, i), _read_vector(heading, i)
            for k in range(3):
                middle[k, row] = (position[k, i] + above[k] * high) + forward[k] * shift[row]
            numbers = (middle[0, row], middle[1, row], middle[2, row], reach[row])
            for k in range(4):
                partial_bounds[k, column] = min(partial_bounds[k, column], numbers[k])
                partial_bounds[4 + k, column] = max(partial_bounds[4 + k, column], numbers[k])
                partial_bounds[8, column] += numbers[k] - numbers[k]
    x, y, z, far = partial_bounds[0, 0], partial_bounds[1, 0], partial_bounds[2, 0], partial_bounds[3, 0]
    u, v, w, wide, unknown = (
        partial_bounds[4, 0],
        partial_bounds[5, 0],
        partial_bounds[6, 0],
        partial_bounds[7, 0],
        partial_bounds[8, 0],
    )
    for k in range(1, _AGENTS_PER_BATCH):
        x, y, z, far = (
            min(x, partial_bounds[0, k]),
            min(y, partial_bounds[1, k]),
            min(z, partial_bounds[2, k]),
            min(far, partial_bounds[3, k]),
        )
        u, v, w, wide = (
            max(u, partial_bounds[4, k]),
            max(v, partial_bounds[5, k]),
            max(w, partial_bounds[6, k]),
            max(wide, partial_bounds[7, k]),
        )
        unknown += partial_bounds[8, k]
    return CrowdBounds((x + unknown, y + unknown, z + unknown, far + unknown), (u, v, w, wide))


@inlined
def compute_mean_up(first_up: Vec3, second_up: Vec3) -> Vec3:
    """Return the unit vector halfway between two up directions; zero if these are opposite."""
    between = plus(first_up, second_up)
    factor = 0.0 if dot(first_up, second_up) < _OPPOSITE_SIDES_COSINE else 1 / np.sqrt(max(dot(between, between), 1e-12))
    return times(between, factor)


@inlined
def find_separation_axis(
    offset: Vec3, first_axis: Vec3, second_axis: Vec3, normal: Vec3, reach: F64, length: F64
) -> tuple[Vec3, F64, Vec3]:
    """Return the separation of two capsule axes: the vector between their nearest points, projected perpendicular to `normal`.

    Also return the height difference of these points along `normal`, and the projected vector between both middles. The
    nearest points of two segments are computed as in C. Ericson, Real-Time Collision Detection, 2005, 5.1.9. `offset`: from
    the second middle to the first. `first_axis`, `second_axis`: unit vectors along the axes. `reach`, `length`: their half
    lengths."""
    flat = minus(offset, times(normal, dot(offset, normal)))
    one, other = (
        minus(first_axis, times(normal, dot(first_axis, normal))),
        minus(second_axis, times(normal, dot(second_axis, normal))),
    )
    aa, bb, ab = max(dot(one, one), 1e-9), max(dot(other, other), 1e-9), dot(one, other)
    c, f = dot(one, flat), dot(other, flat)
    skew = aa * bb - ab * ab
    s = (ab * f - c * bb) / skew if skew > 1e-9 else 0.0
    s = min(max(s, -reach), reach)
    t = min(max((ab * s + f) / bb, -length), length)
    s = min(max((ab * t - c) / aa, -reach), reach)
    separation = minus(plus(offset, times(first_axis, s)), times(second_axis, t))
    over = dot(separation, normal)
    return minus(separation, times(normal, over)), over, flat


@kernel_helper
def _measure_capsule_gap(
    offset: Vec3, first_axis: Vec3, second_axis: Vec3, first_up: Vec3, second_up: Vec3, reach: F64, length: F64, radius_sum: F64,
    tilted_cosine: F64,
) -> tuple[F64, Vec3, BOOL]:  # fmt: skip
    """Return the gap (mm) and the separation axis of a pair, and whether there is no axis because both positions are equal.

    If the capsule axes cross, the separation axis is the direction between the middles. `tilted_cosine`: as in
    `CapsuleArrays`."""
    normal = compute_mean_up(first_up, second_up)
    separation, over, flat = find_separation_axis(offset, first_axis, second_axis, normal, reach, length)
    if dot(first_up, second_up) < tilted_cosine:
        # Across the normal, the nearest points of tilted axes are not the nearest in space, so the pair would seem clear.
        separation, _, _ = find_separation_axis(offset, first_axis, second_axis, (0.0, 0.0, 0.0), reach, length)
        over = dot(separation, normal)
        separation = minus(separation, times(normal, over))
    distance = np.sqrt(dot(separation, separation))
    margin = radius_sum * radius_sum - over * over
    gap = distance - np.sqrt(margin) if margin > 0 else np.inf
    lost = False
    if distance <= radius_sum * _COINCIDENT_AXES_WIDTHS:
        separation, distance = flat, np.sqrt(dot(flat, flat))
        lost = distance <= radius_sum * _COINCIDENT_AXES_WIDTHS
    size = max(distance, 1e-300)
    return gap, (separation[0] / size, separation[1] / size, separation[2] / size), lost


@inlined
def wrap_offset(offset: Vec3, period: Array1[F64]) -> Vec3:
    """Return the shortest periodic image of an offset between positions. Along axes without a period, it is unchanged."""
    return (
        offset[0] - period[0] * np.floor(offset[0] * period[3] + 0.5),
        offset[1] - period[1] * np.floor(offset[1] * period[4] + 0.5),
        offset[2] - period[2] * np.floor(offset[2] * period[5] + 0.5),
    )


@inlined
def _measure_row_gap(bodies: CapsuleArrays, offset: Vec3, p: I64, q: I64) -> tuple[F64, Vec3, BOOL]:
    """Measure the gap between the rows `p` and `q`, and return the result of `_measure_capsule_gap`. `offset`: from the middle
    of `q` to that of `p`."""
    _, ahead, up, half, radius, period, tilted = bodies
    a, b, u, v = get_column(ahead, p), get_column(ahead, q), get_column(up, p), get_column(up, q)
    return _measure_capsule_gap(wrap_offset(offset, period), a, b, u, v, half[p], half[q], radius[p] + radius[q], tilted)


@kernel_helper
def measure_listed_pairs(
    bodies: CapsuleArrays, displacement: Any, i: Array1[I64], j: Array1[I64], gap: Array1[F64], direction: Array2[F64],
    pair_numbers: Array1[I64], count: I64, lost_pairs: Array1[I64]
) -> I64:  # fmt: skip
    """Measure only the first `count` pairs of `pair_numbers`. Otherwise the same as `measure_pairs_of_changed_rows`."""
    middle = bodies.middle
    for n in simd_range(0, count):
        pair = pair_numbers[n]
        p, q = i[pair], j[pair]
        away = minus(
            plus(get_column(middle, p), get_column(displacement, p)), plus(get_column(middle, q), get_column(displacement, q))
        )
        gap[pair], (direction[0, pair], direction[1, pair], direction[2, pair]), nowhere = _measure_row_gap(bodies, away, p, q)
        lost_pairs[n] = 1 if nowhere else 0
    without = compact_indices(lost_pairs, count)
    for n in range(without):
        lost_pairs[n] = pair_numbers[lost_pairs[n]]
    return without


@kernel
def measure_pairs_of_changed_rows(
    bodies: CapsuleArrays, displacement: Strided2[F64], i: Array1[I64], j: Array1[I64], changed: Array1[BOOL],
    gap: Array1[F64], direction: Array2[F64], pair_numbers: Array1[I64], lost_pairs: Array1[I64]
) -> I64:  # fmt: skip
    """Measure the pairs with a `changed` row, and write their `gap` and `direction` (see
    `capsules.NearbyCapsulePairs.measure_gaps`). Returns the number of pairs without a separation axis; they are listed at the
    start of `lost_pairs`. `pair_numbers`: a work buffer."""
    for pair in simd_range(0, i.size):
        pair_numbers[pair] = 1 if changed[i[pair]] | changed[j[pair]] else 0
    return measure_listed_pairs(
        bodies, displacement, i, j, gap, direction, pair_numbers, compact_indices(pair_numbers, i.size), lost_pairs
    )


@kernel
def measure_pairs_before_step(
    bodies: CapsuleArrays, travel: Strided2[F64], i: Array1[I64], j: Array1[I64],
    gap: Array1[F64], direction: Array2[F64], depth: Array1[F64], lost_pairs: Array1[I64],
) -> I64:  # fmt: skip
    """Measure all pairs before the step, and write `gap`, `direction` and `depth` (see
    `capsules.NearbyCapsulePairs.measure_before_step`). Returns the number of pairs without a separation axis; they are listed
    at the start of `lost_pairs`."""
    middle, ahead, up, half, radius, _, _ = bodies
    for start in range(0, i.size, _PREFETCH_GROUP_SIZE):
        for pair in range(min(start + _PREFETCH_GROUP_SIZE, i.size), min(start + 2 * _PREFETCH_GROUP_SIZE, i.size)):
            for side in range(2):
                row = j[pair] if side else i[pair]
                for axis in range(3):
                    for vectors in (middle, travel, ahead, up):
                        prefetch(vectors, axis * depth.size + row)
                prefetch(half, row)
                prefetch(radius, row)
        for pair in simd_range(start, min(start + _PREFETCH_GROUP_SIZE, i.size)):
            p, q = i[pair], j[pair]
            away = minus(minus(get_column(middle, p), get_column(travel, p)), minus(get_column(middle, q), get_column(travel, q)))
            gap[pair], (direction[0, pair], direction[1, pair], direction[2, pair]), nowhere = _measure_row_gap(
                bodies, away, p, q
            )
            lost_pairs[pair] = 1 if nowhere else 0
    depth[:] = 0.0
    for pair in range(i.size):
        if gap[pair] < 0:
            p, q = i[pair], j[pair]
            depth[p], depth[q] = max(depth[p], -gap[pair]), max(depth[q], -gap[pair])
    return compact_indices(lost_pairs, i.size)


@kernel
def select_touching_pairs(
    crowd: CrowdCapsules, pair_keys: Array1[I64], i: Array1[I64], j: Array1[I64], gap: Array1[F64], direction: Array2[F64],
    flags: Array1[I64], rows: Array1[I64], row_indices: Array1[I64], all_pairs: BOOL, dead_zone_share: F64
) -> TouchingPairCounts:  # fmt: skip
    """Select the pairs (`i`, `j`) that may touch, and move them to the front of all pair arrays. Used by
    `capsules.find_near_pairs`. `flags`: receives the indices of pairs without a separation axis. `row_indices`: a work buffer.
    `all_pairs`: if False, select only pairs with a row that overlaps another row. The overlap must exceed `dead_zone_share`
    times the sum of both radii."""
    middle, ahead, up, half, radius, period, tilted = crowd
    for start in range(0, i.size, _PREFETCH_GROUP_SIZE):
        for pair in range(min(start + _PREFETCH_GROUP_SIZE, i.size), min(start + 2 * _PREFETCH_GROUP_SIZE, i.size)):
            for side in range(2):
                row = j[pair] if side else i[pair]
                for axis in range(3):
                    prefetch(middle, axis * pair_keys.size + row)
                    prefetch(ahead[axis], row)
                    prefetch(up[axis], row)
                prefetch(half, row)
                prefetch(radius, row)
                prefetch(pair_keys, row)
        for pair in simd_range(start, min(start + _PREFETCH_GROUP_SIZE, i.size)):
            p, q = i[pair], j[pair]
            if pair_keys[p] > pair_keys[q]:
                p, q = j[pair], i[pair]
            away, wide = wrap_offset(minus(get_column(middle, p), get_column(middle, q)), period), radius[p] + radius[q]
            a, b, u, w = _read_vector(ahead, p), _read_vector(ahead, q), _read_vector(up, p), _read_vector(up, q)
            far, v, nowhere = _measure_capsule_gap(away, a, b, u, w, half[p], half[q], wide, tilted)
            i[pair], j[pair], gap[pair], (direction[0, pair], direction[1, pair], direction[2, pair]) = p, q, far, v
            is_near = far < wide * _CANDIDATE_DISTANCE_WIDTHS or (tilted > -1.0 and far == np.inf)
            flags[pair] = (_NO_AXIS_FLAG if nowhere else _MAY_TOUCH_FLAG) if is_near else 0
    row_indices[:] = 0
    pairs, lost, widest = 0, 0, 0.0
    for pair in range(i.size):  # stored unconditionally: the branch would be hard to predict
        p, q, state = i[pair], j[pair], flags[pair]
        v = get_column(direction, pair)
        i[pairs], j[pairs], gap[pairs], flags[pairs] = p, q, gap[pair], state
        direction[0, pairs], direction[1, pairs], direction[2, pairs] = v
        pairs += 1 if state != 0 else 0
    for pair in range(pairs):
        p, q = i[pair], j[pair]
        widest = max(max(widest, radius[p]), radius[q])
        if all_pairs or gap[pair] < (radius[p] + radius[q]) * -dead_zone_share:
            row_indices[p], row_indices[q] = _OVERLAPPING_FLAG, _OVERLAPPING_FLAG
    if not all_pairs:
        near = pairs
        pairs = 0
        for pair in range(near):
            p, q, state = i[pair], j[pair], flags[pair]
            v = get_column(direction, pair)
            i[pairs], j[pairs], gap[pairs], flags[pairs] = p, q, gap[pair], state
            direction[0, pairs], direction[1, pairs], direction[2, pairs] = v
            one, other = row_indices[p], row_indices[q]
            if one == _OVERLAPPING_FLAG or other == _OVERLAPPING_FLAG:
                row_indices[p], row_indices[q] = max(one, _NEAR_OVERLAP_FLAG), max(other, _NEAR_OVERLAP_FLAG)
                pairs += 1
    count = 0
    for k in range(row_indices.size):
        mark = row_indices[k]
        rows[count], row_indices[k] = k, count
        count += 1 if mark != 0 else 0
    for pair in range(pairs):
        i[pair], j[pair] = row_indices[i[pair]], row_indices[j[pair]]
        nowhere = flags[pair] == _NO_AXIS_FLAG
        flags[lost] = pair
        lost += 1 if nowhere else 0
    return TouchingPairCounts(pairs, count, lost, widest)


@kernel
def gather_capsules(rows: Array1[I64], crowd: CrowdCapsules, target: CapsuleArrays) -> None:
    """Copy the capsules of `rows` from `crowd` to `target`."""
    middle, ahead, up, half, radius, _, _ = crowd
    for k in simd_range(0, rows.size):
        row = rows[k]
        target.half_length[k], target.radius[k] = half[row], radius[row]
        for axis in range(3):
            target.middle[axis, k] = middle[axis, row]
            target.axis_direction[axis, k], target.up[axis, k] = ahead[axis][row], up[axis][row]
