"""Kernels that find ground for feet. They cast rays from the hips of legs, and select the hits that a leg can reach. A seeker
is a foot that needs ground. Data of seekers are stored by column: positions (mm) as arrays (3, k), and lengths as float64[k].
Rays are short and use a `TriangleGrid`."""

from __future__ import annotations

from typing import Any

import numpy as np

from antdsl.casting.grid_rays import GridTables, find_first_hit, prefetch_rays
from antdsl.casting.nearest_faces import find_nearest_face
from antdsl.casting.ray_walks import RingTables, find_hit_by_walk, prefetch_first_face
from antdsl.casting.tolerances import FACE_BEYOND_GRID, MAX_SEARCH_RINGS, NEAREST_FACE_UNKNOWN
from antdsl.machine_code.kernels import allocate_scratch, inlined, kernel, simd_range
from antdsl.machine_code.kernels.types import BOOL, F32, F64, I16, I32, I64, U8, Array1, Array2, Array3
from antdsl.numerics.kernel_vectors import dot, get_column, minus, plus, store_column
from antdsl.numerics.sorting import compact_indices
from antdsl.runtime.feet.body_tables import prefetch_columns, read_footed_body
from antdsl.runtime.feet.feet_state import NO_GROUND_NUMBER
from antdsl.runtime.feet.gaits import HIP_POSITION_ROW, MAX_LEG_STRETCH, MAX_SINK_SHARE
from antdsl.runtime.feet.stepping import LIFTING_FOOT, REQUEST_LEG_BITS, REQUEST_LEG_MASK, LegTable, TrunkColumns
from antdsl.runtime.feet.trunk import rotate_point_by_slope

_F = np.float32
NEAR_HIT_LEG_SHARE = 0.3  # share of the leg length: a hit this near to the requested position is used
RAY_LENGTH_FACTOR = 1.6  # length of the first ray, as a multiple of the distance to the requested position
_PREFETCH_GROUP_SIZE = 64  # rays or requests that are prefetched together
_MIN_START_HEIGHT_SHARE = 0.2  # share of the leg length: least height of the search above a requested position

# Start face of a ray: number of the ground << REQUEST_FACE_BITS | face; -1 without a start face.
REQUEST_FACE_BITS, REQUEST_FACE_MASK = 32, 0xFFFFFFFF
HitColumns = tuple[Array1[F64], Array2[F64], Array1[I16], Array1[I32], Array2[F64]]  # as `GroundHits.columns`
# Hip, target position, up of the body, greatest distance of the foot joint from the hip, and its height above the ground.
SeekerColumns = tuple[Array2[F64], Array2[F64], Array2[F64], Array1[F64], Array1[F64]]


@kernel
def aim_first_rays(
    requests: Array1[I64],
    bodies: Array2[F64],
    covered_ground: Array3[F32],
    measures: tuple[LegTable, Array2[F64]],
    trunks: TrunkColumns,
    targets: tuple[Array2[F32], Array2[F32], Array2[F32], Array2[U8]],
    start_faces: Array1[I64],
    seekers: SeekerColumns,
    rays: tuple[Array2[F64], Array1[I64]],
    is_quick: Array1[BOOL],
    begin: I64,
    end: I64,
) -> None:
    """Compute the first ray of each request for ground: from the hip of the leg to the target position of its foot.

    Requests from `begin` to before `end` are processed. `requests`: agents and legs, encoded as `stepping.REQUEST_LEG_BITS`
    describes. `measures`: `Gaits.legs` and `Gaits.exact`. Writes the positions of hips at landing and the target positions of
    feet to `seekers`. Writes the displacements and start faces of the rays to `rays`. `start_faces`: the start face of each
    agent. `is_quick`: set for feet that lift now; they search again when they land."""
    legs, exact = measures
    count = legs.shape[1]
    target_x, target_z, left, what = targets
    steps, starts = rays
    hips, goals, ups, longest, soles = seekers
    for group in range(begin, end, _PREFETCH_GROUP_SIZE):
        stop = min(group + _PREFETCH_GROUP_SIZE, end)
        until = min(stop + _PREFETCH_GROUP_SIZE, end)
        if stop < until:
            following, last = requests[stop] >> REQUEST_LEG_BITS, (requests[until - 1] >> REQUEST_LEG_BITS) + 1
            prefetch_columns(bodies, 13, 8, following, last)
            prefetch_columns(covered_ground, 2 * count, 16, following, last)
            for each in (target_x, target_z, left):
                prefetch_columns(each, count, 16, following, last)
        for k in range(group, stop):
            i, leg = requests[k] >> REQUEST_LEG_BITS, requests[k] & REQUEST_LEG_MASK
            place, ahead, up, aside, size = read_footed_body(bodies, i)
            rise, slope = trunks[1], trunks[2]
            x, y, z = rotate_point_by_slope(
                (slope[0, i], slope[1, i]),
                (legs[HIP_POSITION_ROW, leg], legs[HIP_POSITION_ROW + 1, leg], legs[HIP_POSITION_ROW + 2, leg]),
            )
            frames = left[leg, i]
            a, c = np.float64(x + covered_ground[0, leg, i] * frames), np.float64(z + covered_ground[1, leg, i] * frames)
            b = np.float64(y + rise[i] / _F(size))
            to_x, to_z = np.float64(target_x[leg, i]), np.float64(target_z[leg, i])
            for axis in range(3):
                hip = place[axis] + ((a * ahead[axis] + b * up[axis]) + c * aside[axis]) * size
                goal = place[axis] + (to_x * ahead[axis] + to_z * aside[axis]) * size
                hips[axis, k], goals[axis, k], ups[axis, k] = hip, goal, up[axis]
                steps[axis, k] = (goal - hip) * RAY_LENGTH_FACTOR
            longest[k], soles[k] = exact[0, leg] * size * MAX_LEG_STRETCH, exact[1, leg] * size
            is_quick[k], starts[k] = what[leg, i] == LIFTING_FOOT, start_faces[i]


@kernel
def cast_foot_rays_on_mesh(
    grid: GridTables,
    rings: RingTables,
    box: tuple[Array1[F64], Array1[F64]],
    number: I64,
    origins: Array2[F64],
    displacements: Array2[F64],
    starts: Array1[I64],
    hits: HitColumns,
    beyond_grid: Array1[I64],
    begin: I64,
    end: I64,
) -> tuple[I64, I64]:
    """Cast rays from `begin` to before `end` on one mesh. Write their hits to `hits` if they are nearer than previous hits.

    Returns `begin`, and the number of rays that are too long for the grid. The long rays are written to `beyond_grid` from
    index `begin` on. `number`: the number of the mesh in `FootGround`. `starts`: the start faces of rays on the mesh, if the
    mesh has `rings`; they are replaced by the faces that were hit. Rays without a start face use the grid."""
    shape, (least, greatest), count = grid[0], box, 0
    zero = shape[6], shape[7], shape[8]
    cells, rays = allocate_scratch(2 * _PREFETCH_GROUP_SIZE, I64), allocate_scratch(_PREFETCH_GROUP_SIZE, I64)
    for low in range(begin, end, _PREFETCH_GROUP_SIZE):
        high = min(low + _PREFETCH_GROUP_SIZE, end)
        for k in simd_range(low, high):
            inside = True
            for axis in range(3):
                tail, head = origins[axis, k], origins[axis, k] + displacements[axis, k]
                inside = inside and min(tail, head) <= greatest[axis] and max(tail, head) >= least[axis]
            rays[k - low] = 1 if inside else 0
            if rings[0].size > 0 and starts[k] >> REQUEST_FACE_BITS == number:
                prefetch_first_face(rings, starts[k] & REQUEST_FACE_MASK)
        if rings[0].size > 0:
            for k in simd_range(low, high):
                if starts[k] >> REQUEST_FACE_BITS == number:
                    a, w = get_column(origins, k), get_column(displacements, k)
                    t, named = find_hit_by_walk(grid, rings, starts[k] & REQUEST_FACE_MASK, minus(a, zero), w)
                    if named != NEAREST_FACE_UNKNOWN:
                        rays[k - low] = 0
                    if named >= 0:
                        starts[k] = number << REQUEST_FACE_BITS | named
                        _store_nearer_hit(hits, k, number, t, a, w)
        near = compact_indices(rays, high - low)
        for n in range(near):
            rays[n] += low
        prefetch_rays(grid, origins, zero, displacements, rays, cells, near)
        for n in range(near):
            ray = rays[n]
            a, w = get_column(origins, ray), get_column(displacements, ray)
            t, named = find_first_hit(grid, minus(a, zero), w)
            if named == FACE_BEYOND_GRID:
                beyond_grid[begin + count] = ray
                count += 1
            elif named >= 0:
                _store_nearer_hit(hits, ray, number, t, a, w)
    return begin, count


@kernel
def find_nearest_on_mesh(
    grid: GridTables,
    box: tuple[Array1[F64], Array1[F64]],
    number: I64,
    points: Array2[F64],
    reach: Array1[F64],
    hits: HitColumns,
    beyond_grid: Array1[I64],
    begin: I64,
    end: I64,
) -> tuple[I64, I64]:
    """Write to `hits` the positions on one mesh that are nearest to `points`, within their `reach` (mm). Points from `begin` to
    before `end` are processed. Returns `begin`, and the number of points with a reach that is too long for the grid. These points
    are written to `beyond_grid` from index `begin` on. `number`: the number of the mesh in `FootGround`. `reach`: reduced to the
    distance of the position found."""
    shape, (low, high), count = grid[0], box, 0
    zero = shape[6], shape[7], shape[8]
    for k in range(begin, end):
        point, most, inside = get_column(points, k), reach[k], True
        for axis in range(3):
            inside = inside and point[axis] - most <= high[axis] and point[axis] + most >= low[axis]
        if inside and most > MAX_SEARCH_RINGS * shape[3]:
            beyond_grid[begin + count] = k
            count += 1
        elif inside:
            square, face, place = find_nearest_face(grid, minus(point, zero), most)
            if face >= 0 and np.sqrt(square) < most:
                reach[k] = np.sqrt(square)
                _store_hit_position(hits, k, number, reach[k], plus(place, zero))
    return begin, count


@inlined
def _store_nearer_hit(hits: Any, k: Any, number: Any, t: Any, a: Any, w: Any) -> None:
    """Store a hit of ray `k` on the mesh `number`, at the position `a` + `t` * `w`, unless the stored hit is nearer."""
    if t < hits[0][k]:
        _store_hit_position(hits, k, number, t, (a[0] + w[0] * t, a[1] + w[1] * t, a[2] + w[2] * t))


@inlined
def _store_hit_position(hits: Any, k: Any, number: Any, t: Any, position: Any) -> None:
    """Store a hit on a mesh that does not move as entry `k` of `hits`."""
    part, place, on, face, weight = hits
    part[k], on[k], face[k], weight[0, k], weight[1, k] = t, number, 0, 0.0, 0.0
    store_column(place, k, position)


@kernel
def mark_reachable_hits(
    seekers: SeekerColumns,
    hits: HitColumns,
    is_quick: Array1[BOOL],
    is_reachable: Array1[BOOL],
    rows: Array1[I64],
    begin: I64,
    end: I64,
) -> tuple[I64, I64]:
    """Set `is_reachable` for the hits that legs can reach.

    Find the seekers that have no reachable hit near their target position and are not `is_quick`. Write them to `rows`, from
    index `begin` on. Return `begin` and their number."""
    longest, count = seekers[3], 0
    for k in range(begin, end):
        if is_quick[k]:
            continue
        is_reachable[k] = _is_in_reach(seekers, hits, k, k)
        if not (is_reachable[k] and _measure_miss_distance(seekers, hits, k, k) <= NEAR_HIT_LEG_SHARE * longest[k]):
            rows[begin + count] = k
            count += 1
    return begin, count


@kernel
def aim_detour_rays(
    seekers: SeekerColumns,
    rows: Array1[I64],
    upper_starts: Array2[F64],
    level: Array2[F64],
    down_displacement: Array2[F64],
    origins: Array2[F64],
    begin: I64,
    end: I64,
) -> None:
    """Compute two rays for each of the seekers `rows`.

    The first leads from the hip to a point above the target position, the second down from this point. `origins`, `level`:
    start and displacement of the first ray. `upper_starts`, `down_displacement`: start and displacement of the second ray."""
    hips, goals, ups, longest, _ = seekers
    for n in range(begin, end):
        k = rows[n]
        hip, goal, up, leg = get_column(hips, k), get_column(goals, k), get_column(ups, k), longest[k]
        height = max(dot(minus(hip, goal), up), _MIN_START_HEIGHT_SHARE * leg)
        for axis in range(3):
            top = goal[axis] + up[axis] * height
            upper_starts[axis, n], level[axis, n], origins[axis, n] = top, top - hip[axis], hip[axis]
            down_displacement[axis, n] = -up[axis] * (2.0 * height + leg)


@kernel
def choose_nearest_hits(
    seekers: SeekerColumns,
    rows: Array1[I64],
    hits: HitColumns,
    is_reachable: Array1[BOOL],
    level_hits: HitColumns,
    down_hits: HitColumns,
    lost_rows: Array1[I64],
    reach: Array1[F64],
    begin: I64,
    end: I64,
) -> tuple[I64, I64]:
    """Write the hit that is nearest to the target position to `hits`, among the hits of the first ray and of both rays of
    `aim_detour_rays`. Returns `begin`, and the number of seekers without a near enough hit. These are written to `lost_rows`
    from index `begin` on, as indices into `rows`. For each, `reach` receives the distance (mm) within which another position
    on the ground would be better."""
    longest = seekers[3]
    count = 0
    for n in range(begin, end):
        k = rows[n]
        least = np.inf
        if is_reachable[k]:
            least = _measure_miss_distance(seekers, hits, k, k)
        if not least < np.inf:
            _clear_hit(hits, k)
        if np.isfinite(level_hits[0][n]):
            if _is_in_reach(seekers, level_hits, k, n):
                miss = _measure_miss_distance(seekers, level_hits, k, n)
                if miss < least:
                    least = miss
                    _copy_hit(hits, k, level_hits, n)
        elif _is_in_reach(seekers, down_hits, k, n):
            miss = _measure_miss_distance(seekers, down_hits, k, n)
            if miss < least:
                least = miss
                _copy_hit(hits, k, down_hits, n)
        if least > 2.0 * NEAR_HIT_LEG_SHARE * longest[k]:
            lost_rows[begin + count], reach[begin + count] = n, min(longest[k], least)
            count += 1
    return begin, count


@kernel
def accept_visible_positions(
    seekers: SeekerColumns,
    rows: Array1[I64],
    nearest_hits: HitColumns,
    sight_hits: HitColumns,
    hits: HitColumns,
    begin: I64,
    end: I64,
) -> None:
    """Copy nearest positions on the ground, `nearest_hits`, to `hits` if the leg reaches them and they are visible from the
    hip. `rows`: the seekers to which they belong. `sight_hits`: the hits of rays from the hip to these positions."""
    for n in range(begin, end):
        k = rows[n]
        gap = minus(get_column(sight_hits[1], n), get_column(nearest_hits[1], n))
        sight = not np.isfinite(sight_hits[0][n]) or np.sqrt(dot(gap, gap)) < 1e-3 * seekers[3][k]
        if sight and _is_in_reach(seekers, nearest_hits, k, n):
            _copy_hit(hits, k, nearest_hits, n)


@kernel
def store_footholds(
    requests: Array1[I64],
    seekers: SeekerColumns,
    hits: HitColumns,
    place: Array3[F64],
    thing_numbers: Array2[I16],
    face: Array2[I32],
    weight: Array3[F64],
    begin: I64,
    end: I64,
) -> None:
    """Store the hits for the requests as new footholds. If there is no hit, the foot hangs at its target position."""
    for k in range(begin, end):
        i, leg = requests[k] >> REQUEST_LEG_BITS, requests[k] & REQUEST_LEG_MASK
        foothold = get_column(seekers[1], k) if hits[2][k] == NO_GROUND_NUMBER else get_column(hits[1], k)
        for axis in range(3):
            place[axis, leg, i] = foothold[axis]
        thing_numbers[leg, i], face[leg, i] = hits[2][k], hits[3][k]
        weight[0, leg, i], weight[1, leg, i] = hits[4][0, k], hits[4][1, k]


@inlined
def _is_in_reach(seekers: Any, hits: Any, k: Any, n: Any) -> Any:
    """Return whether seeker `k` can reach hit `n`. It can if the distance from hip to foot joint would be at most the leg
    length."""
    hip, up, leg, sole = get_column(seekers[0], k), get_column(seekers[2], k), seekers[3][k], seekers[4][k]
    place = get_column(hits[1], n)
    joint = place[0] + up[0] * sole, place[1] + up[1] * sole, place[2] + up[2] * sole
    away = minus(joint, hip)
    high = dot(away, up)
    low = max(abs(high) - (MAX_SINK_SHARE * leg if high < 0 else 0.0), 0.0)  # the trunk is lowered for a long step
    return np.isfinite(hits[0][n]) and (dot(away, away) - high * high) + low * low <= leg * leg


@inlined
def _measure_miss_distance(seekers: Any, hits: Any, k: Any, n: Any) -> Any:
    """Return the distance (mm) of hit `n` from the target position of seeker `k`."""
    gap = minus(get_column(hits[1], n), get_column(seekers[1], k))
    return np.sqrt(dot(gap, gap))


@inlined
def _copy_hit(target_hits: Any, k: Any, hits: Any, n: Any) -> None:
    target_hits[0][k], target_hits[2][k], target_hits[3][k] = hits[0][n], hits[2][n], hits[3][n]
    target_hits[4][0, k], target_hits[4][1, k] = hits[4][0, n], hits[4][1, n]
    store_column(target_hits[1], k, get_column(hits[1], n))


@inlined
def _clear_hit(hits: Any, k: Any) -> None:
    hits[0][k], hits[2][k], hits[3][k] = np.inf, NO_GROUND_NUMBER, 0
    hits[4][0, k], hits[4][1, k] = 0.0, 0.0
    store_column(hits[1], k, (0.0, 0.0, 0.0))
