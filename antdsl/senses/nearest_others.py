"""Finds the nearest agents of any species around agents that stand on a ground.

The search visits the cells within the radius and lists candidates in scratch memory of the thread. When the list is full, only
the nearest candidates remain, and the search radius becomes smaller."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from antdsl.limits import MAX_QUERY_NEIGHBOURS
from antdsl.machine_code.kernels import (
    BOOL,
    F32,
    F64,
    I32,
    I64,
    Array1,
    Array2,
    allocate_scratch,
    bits_to_float,
    float_to_bits,
    inlined,
    kernel,
    kernel_helper,
    load_consecutive,
    simd_range,
)
from antdsl.numerics.kernel_vectors import (
    Vec3,
    VectorColumns,
    cross,
    dot,
    minus,
    normalise_or_perpendicular,
    project_to_plane,
    replace_non_finite_vector,
)
from antdsl.senses.cell_order import count_agents_before
from antdsl.senses.neighbours import (
    MAX_INT64,
    RADIUS_SLACK,
    SQUARED_RADIUS_SLACK,
    CellGridTables,
    find_first_cell,
    find_last_cell,
)

MAX_SEARCH_CANDIDATES = 576  # entries in each array of a search
_SPARE_CANDIDATE_COUNT = 48  # candidates in addition to twice the requested others, before the list is reduced
_DISTANCE_ZERO_BITS_MASK = (1 << 29) - 1  # mask of the last bits of a float64, which are 0 for a float32 value


class CrowdTables(NamedTuple):
    """The data of all agents in a grid, in the order of cells. Values that are not finite are stored as 0.

    `packed_up`: four entries per agent: x, y and z of its up direction, and its rank by species and id. `packed_motion`: four
    entries per agent: x, y and z of its velocity (mm/s), and its radius (mm). `name_ranks`: for each rank in `packed_up`, the
    agent's rank by species name and id. It is empty if there is only one species. `image_reach` (3): periodic images at this
    distance (mm) or farther along an axis are ignored; infinite if the scene has no images."""

    grid: CellGridTables
    packed_up: Array1[F32]
    packed_motion: Array1[F32]
    name_ranks: Array1[I32]
    image_reach: Array1[F32]


class NeighbourRequests(NamedTuple):
    """Agents of one species that search for other agents.

    `positions`: the position of each requester in the order of cells. `rows`: the row of each requester in its population.
    `radius`: the radius (mm) of each search. `max_others`: how many others each search may return. `heading`: x, y, z of the
    heading of each row of the species."""

    positions: Array1[I32]
    rows: Array1[I64]
    radius: Array1[F64]
    max_others: Array1[F64]
    heading: VectorColumns


class TangentPlane(NamedTuple):
    """The tangent plane of an agent's ground: unit vectors `up`, `ahead` (along its heading) and `left`."""

    up: Vec3
    ahead: Vec3
    left: Vec3


class CandidateMemory(NamedTuple):
    """Scratch memory of a search. Each array has room for `MAX_SEARCH_CANDIDATES` numbers.

    `candidates`: agents within the radius, as positions in the order of cells. `candidate_keys`, `distance_ranks`: the sort
    key of each candidate, and its rank by distance. `nearest_rows`, `nearest_keys`: the sorted result, which is the nearest
    agents (as positions in the order of cells) and their keys."""

    candidates: Array1[I64]
    candidate_keys: Array1[I64]
    distance_ranks: Array1[I64]
    nearest_rows: Array1[I64]
    nearest_keys: Array1[I64]


class RelativeAgent(NamedTuple):
    """Another agent in the tangent plane of a requester; x is ahead and y is to the left.

    `x`, `y`: relative position (mm).
    `vx`, `vy`: the requester's velocity minus the other agent's (mm/s).
    `radius_sum`: the sum of both radii (mm)."""

    x: F64
    y: F64
    vx: F64
    vy: F64
    radius_sum: F64


@inlined
def compute_tangent_plane(crowd: CrowdTables, requesters: NeighbourRequests, k: I64) -> TangentPlane:
    """Return the tangent plane of the ground below requester `k` at the start of the step."""
    x, y, z = requesters.heading
    row, up = requesters.rows[k], load_packed_vector(crowd.packed_up, requesters.positions[k])
    ahead = normalise_or_perpendicular(project_to_plane(replace_non_finite_vector(x[row], y[row], z[row]), up), up)
    return TangentPlane(up, ahead, cross(up, ahead))


@inlined
def load_packed_vector(packed_vectors: Array1[F32], position: I64) -> Vec3:
    """Return the vector of the agent at `position` in the order of cells: the first three of its four entries in
    `packed_vectors`."""
    x, y, z, _ = load_consecutive(packed_vectors, 4 * position, 4)
    return np.float64(x), np.float64(y), np.float64(z)


@inlined
def reset_candidates(memory: CandidateMemory) -> None:
    """Set all entries of `memory.candidates` to 0, so that each is a valid index."""
    for p in range(MAX_SEARCH_CANDIDATES):
        memory.candidates[p], memory.nearest_rows[p], memory.nearest_keys[p] = 0, 0, 0


@kernel_helper
def find_nearest_others(crowd: CrowdTables, requesters: NeighbourRequests, k: I64, up: Vec3, memory: CandidateMemory) -> I64:
    """Write the nearest other agents of requester `k` to `memory.nearest_rows`, sorted by distance, species and id.

    Return their number. Only agents on the side of the ground that `up` points to are counted."""
    grid, agent = crowd.grid, requesters.positions[k]
    low, inverse, size = grid.low_corner, grid.cells_per_mm, grid.cells_per_axis
    x, y, z = grid.positions[0][agent], grid.positions[1][agent], grid.positions[2][agent]
    radius, requested = requesters.radius[k], requesters.max_others[k]
    if not (radius > 0.0 and requested >= 1.0 and math.isfinite(x) and math.isfinite(y) and math.isfinite(z)):
        return 0
    reach, max_count = (
        np.float32(radius),
        np.int64(requested if requested < float(MAX_QUERY_NEIGHBOURS) else float(MAX_QUERY_NEIGHBOURS)),
    )
    a, b, c = (
        np.float64(grid.axis_positions[0][agent]),
        np.float64(grid.axis_positions[1][agent]),
        np.float64(grid.axis_positions[2][agent]),
    )
    r = np.float64(reach) * RADIUS_SLACK + (1e-14 * max(max(abs(a), abs(b)), abs(c)) + 1e-18)
    a0, a1 = (find_first_cell(a - r, low[0], inverse[0], size[0]), find_last_cell(a + r, low[0], inverse[0], size[0]))
    b0, b1 = (find_first_cell(b - r, low[1], inverse[1], size[1]), find_last_cell(b + r, low[1], inverse[1], size[1]))
    c0, c1 = 0, 0
    if not (size[2] == 1 and abs(c - low[2]) <= grid.cell_widths[2]):
        c0, c1 = (find_first_cell(c - r, low[2], inverse[2], size[2]), find_last_cell(c + r, low[2], inverse[2], size[2]))
    count, capacity, square_limit = (
        0,
        2 * max_count + _SPARE_CANDIDATE_COUNT,
        reach * reach * SQUARED_RADIUS_SLACK + np.float32(1e-30),
    )
    for cz in range(c0, c1 + 1):
        for cy in range(b0, b1 + 1):
            line = (cz * size[1] + cy) * size[0]
            first = count_agents_before(grid.cell_starts, grid.keys, line + a0)
            last = count_agents_before(grid.cell_starts, grid.keys, line + max(a0, a1 + 1))
            while first < last:
                end = min(last, first + capacity - count)
                for p in range(first, end):  # always written, to avoid an unpredictable branch
                    dx, dy, dz = grid.positions[0][p] - x, grid.positions[1][p] - y, grid.positions[2][p] - z
                    memory.candidates[count] = p
                    count += (dx * dx + dy * dy) + dz * dz <= square_limit
                first = end
                if count + 8 > capacity:
                    count = _select_nearest_others(crowd, agent, reach, up, count, max_count, memory)
                    for p in range(count):
                        memory.candidates[p] = memory.nearest_rows[p]
                    if count == max_count:
                        farthest = np.float32(bits_to_float(memory.nearest_keys[max_count - 1] & ~_DISTANCE_ZERO_BITS_MASK))
                        square_limit = farthest * farthest * SQUARED_RADIUS_SLACK + np.float32(1e-30)
    return _select_nearest_others(crowd, agent, reach, up, count, max_count, memory)


@kernel_helper
def _select_nearest_others(
    crowd: CrowdTables, position: I64, reach: F32, up: Vec3, count: I64, max_others: I64, memory: CandidateMemory
) -> I64:
    """Write the nearest of the first `count` candidates to `memory.nearest_rows`, sorted. Return their number.

    `position`: the searching agent, as a position in the order of cells. `reach`: the radius (mm) of the search."""
    x, y, z, _ = load_consecutive(crowd.grid.packed_positions, 4 * position, 4)
    wide_x, wide_y, wide_z = crowd.image_reach[0], crowd.image_reach[1], crowd.image_reach[2]
    padded, good_count = max(count, (count + 5) & -8), 0
    for p in simd_range(0, padded):
        q: I64 = memory.candidates[p]
        u, v, w, _ = load_consecutive(crowd.grid.packed_positions, 4 * q, 4)
        ux, uy, uz, number = load_consecutive(crowd.packed_up, 4 * q, 4)
        dx, dy, dz = u - x, v - y, w - z
        length = np.sqrt((dx * dx + dy * dy) + dz * dz)
        side = dot(up, (np.float64(ux), np.float64(uy), np.float64(uz)))
        is_nearest_image = (abs(dx) < wide_x) & (abs(dy) < wide_y) & (abs(dz) < wide_z)
        is_candidate = (p < count) & (length <= reach) & (q != position) & (side > 0.0) & is_nearest_image
        memory.candidate_keys[p] = float_to_bits(np.float64(length)) | np.int64(number) if is_candidate else MAX_INT64
    for p in simd_range(0, padded):
        key, rank = memory.candidate_keys[p], 0
        for q in range(count):
            rank += memory.candidate_keys[q] < key
        memory.distance_ranks[p] = rank
    for p in range(count):
        memory.nearest_rows[memory.distance_ranks[p]], memory.nearest_keys[memory.distance_ranks[p]] = (
            memory.candidates[p],
            memory.candidate_keys[p],
        )
        good_count += memory.candidate_keys[p] < MAX_INT64
    return min(good_count, max_others)


@inlined
def compute_relative_agent(crowd: CrowdTables, plane: TangentPlane, own_position: I64, other_position: I64) -> RelativeAgent:
    """Return the agent at `other_position` relative to the agent at `own_position`. Both are positions in the order of cells."""
    x, y, z, _ = load_consecutive(crowd.grid.packed_positions, 4 * own_position, 4)
    u, v, w, _ = load_consecutive(crowd.grid.packed_positions, 4 * other_position, 4)
    displacement = np.float64(u - x), np.float64(v - y), np.float64(w - z)
    relative = minus(
        load_packed_vector(crowd.packed_motion, own_position), load_packed_vector(crowd.packed_motion, other_position)
    )
    return RelativeAgent(
        dot(displacement, plane.ahead),
        dot(displacement, plane.left),
        dot(relative, plane.ahead),
        dot(relative, plane.left),
        np.float64(crowd.packed_motion[4 * own_position + 3]) + np.float64(crowd.packed_motion[4 * other_position + 3]),
    )


@inlined
def compare_agent_names(crowd: CrowdTables, position: I64, key: I64) -> F64:
    """Compare two agents by species name, then by id. Return -1 if the agent at `position` comes before the agent with the
    sort key `key`, else 1."""
    own_name, other = np.int64(crowd.packed_up[4 * position + 3]), key & _DISTANCE_ZERO_BITS_MASK
    if crowd.name_ranks.size > 0:
        own_name, other = crowd.name_ranks[own_name], crowd.name_ranks[other]
    return -1.0 if own_name < other else 1.0


@kernel
def pack_up_and_motion(
    position_by_row: Array1[I32], up: VectorColumns, velocity: VectorColumns, radius: Array1[F32], numbers: Array1[I32],
    table: Array1[F32], motion: Array1[F32], begin: I64, end: I64,
) -> None:  # fmt: skip
    """Write the fields `packed_up` and `packed_motion` of a `CrowdTables`, for rows from `begin` to before `end`. `numbers`:
    the rank of each row by species and id. `table`: the array for `packed_up`. `motion`: the array for `packed_motion`."""
    for row in range(begin, end):
        first, wide = 4 * position_by_row[row], np.isfinite(radius[row]) & (radius[row] > np.float32(0.0))
        u = replace_non_finite_vector(up[0][row], up[1][row], up[2][row])
        v = replace_non_finite_vector(velocity[0][row], velocity[1][row], velocity[2][row])
        for axis in range(3):
            table[first + axis], motion[first + axis] = np.float32(u[axis]), np.float32(v[axis])
        table[first + 3], motion[first + 3] = np.float32(numbers[row]), radius[row] if wide else np.float32(0.0)


@kernel
def fill_nearest_offsets(
    crowd: CrowdTables, requesters: NeighbourRequests, x: Array2[F64], y: Array2[F64], is_present: Array2[BOOL],
    axes: Array2[F64],
    begin: I64, end: I64,
) -> None:  # fmt: skip
    """Write the relative positions of the agents that are nearest to each requester from `begin` to before `end`.

    `x`, `y` (n, m): the distances ahead and to the left (mm). `is_present` (n, m): whether an entry of `x` and `y` is used.
    `axes` (6, n): receives two unit vectors per requester, the one ahead (x, y, z), then the one to the left."""
    memory = CandidateMemory(
        allocate_scratch(MAX_SEARCH_CANDIDATES, I64),
        allocate_scratch(MAX_SEARCH_CANDIDATES, I64),
        allocate_scratch(MAX_SEARCH_CANDIDATES, I64),
        allocate_scratch(MAX_SEARCH_CANDIDATES, I64),
        allocate_scratch(MAX_SEARCH_CANDIDATES, I64),
    )
    reset_candidates(memory)
    for k in range(begin, end):
        plane, agent = compute_tangent_plane(crowd, requesters, k), requesters.positions[k]
        axes[0, k], axes[1, k], axes[2, k] = plane.ahead
        axes[3, k], axes[4, k], axes[5, k] = plane.left
        for c in range(find_nearest_others(crowd, requesters, k, plane.up, memory)):
            other = compute_relative_agent(crowd, plane, agent, memory.nearest_rows[c])
            x[k, c], y[k, c], is_present[k, c] = other.x, other.y, True
