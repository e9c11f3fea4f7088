"""Reciprocal collision avoidance in the tangent plane of an agent's ground. For each agent, finds the collision-free velocity
that is nearest to the agent's wish, for a given time horizon.

Source: J. van den Berg, S. Guy, M. Lin, D. Manocha, Reciprocal n-Body Collision Avoidance, Robotics Research, Springer Tracts
in Advanced Robotics 70, 2011, p. 3-19.

Each neighbour limits the velocity to a half-plane. Each of the two agents makes half of the necessary change (section 4). An
incremental linear program finds the nearest point that is in all half-planes and in the circle of the greatest speed.
Constraints are added one by one, beginning with the nearest neighbour. If no point satisfies all of them, the program finds
the point that violates them least (section 5.3).

All values are float64, computed with scalar sums, products, quotients and roots only. So an agent's result has the same bits,
whichever other agents are computed with it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.kernels import (
    BOOL,
    F32,
    F64,
    I64,
    Array1,
    Array2,
    allocate_scratch,
    inlined,
    kernel,
    kernel_helper,
    simd_range,
)
from antdsl.numerics import elementary
from antdsl.numerics.kernel_vectors import dot, replace_non_finite_vector
from antdsl.senses import nearest_others as others
from antdsl.senses.nearest_others import MAX_SEARCH_CANDIDATES, CandidateMemory, CrowdTables, NeighbourRequests, RelativeAgent

_FULL_TURN = 2 * np.pi
_EQUAL_GAP_TOLERANCE = 1e-4  # rad; gaps that differ by less count as equally wide
Floats = NDArray[np.float64]
Column = Array1[F64]
BorderColumns = tuple[Column, Column, Column, Column, Array1[I64]]  # px, py, dx, dy of borders, and 1 for a valid border

_MAX_PARALLEL_SINE = 1e-9  # sine of the angle between two borders; below it, they count as parallel
_MIN_LENGTH = 1e-30
_MAX_HORIZON_SECONDS = 1e6  # s, upper limit of a horizon
_MAX_SPEED = 1e9  # mm/s, upper limit of speeds


class WishedVelocities(NamedTuple):
    """The velocities that the requesting agents want to have.

    `velocity`: x, y, z of each requester's wish (mm/s). `horizon`: how far ahead (s) each requester avoids collisions.
    `max_speed`: the greatest speed (mm/s) of each row of the requesters' species."""

    velocity: tuple[Column, Column, Column]
    horizon: Column
    max_speed: Array1[F32]


@kernel
def fill_clear_velocities(
    crowd: CrowdTables,
    requesters: NeighbourRequests,
    wishes: WishedVelocities,
    dt: F64,
    velocities: Array2[F32],
    begin: I64,
    end: I64,
) -> None:
    """Write the velocities that avoid collisions to `velocities` (3, n; mm/s), for requesters from `begin` to before `end`.
    Each velocity is parallel to the ground and at most `max_speed`. Of all velocities that avoid collisions within the horizon,
    it is the nearest to the wish. The other agents are assumed to make half of each change. Agents that overlap separate within
    `dt` s."""
    memory = CandidateMemory(
        allocate_scratch(MAX_SEARCH_CANDIDATES, I64),
        allocate_scratch(MAX_SEARCH_CANDIDATES, I64),
        allocate_scratch(MAX_SEARCH_CANDIDATES, I64),
        allocate_scratch(MAX_SEARCH_CANDIDATES, I64),
        allocate_scratch(MAX_SEARCH_CANDIDATES, I64),
    )
    borders = (
        allocate_scratch(MAX_SEARCH_CANDIDATES, F64),
        allocate_scratch(MAX_SEARCH_CANDIDATES, F64),
        allocate_scratch(MAX_SEARCH_CANDIDATES, F64),
        allocate_scratch(MAX_SEARCH_CANDIDATES, F64),
        allocate_scratch(MAX_SEARCH_CANDIDATES, I64),
    )
    line_buffers = (
        allocate_scratch(MAX_SEARCH_CANDIDATES, F64),
        allocate_scratch(MAX_SEARCH_CANDIDATES, F64),
        allocate_scratch(MAX_SEARCH_CANDIDATES, F64),
        allocate_scratch(MAX_SEARCH_CANDIDATES, F64),
        allocate_scratch(MAX_SEARCH_CANDIDATES, I64),
    )
    others.reset_candidates(memory)
    for k in range(begin, end):
        plane, agent = others.compute_tangent_plane(crowd, requesters, k), requesters.positions[k]
        count = others.find_nearest_others(crowd, requesters, k, plane.up, memory)
        velocity, (a, b, c) = others.load_packed_vector(crowd.packed_motion, agent), wishes.velocity
        wish, speed = replace_non_finite_vector(a[k], b[k], c[k]), np.float64(wishes.max_speed[requesters.rows[k]])
        own_x, own_y = dot(velocity, plane.ahead), dot(velocity, plane.left)
        horizon = min(wishes.horizon[k], _MAX_HORIZON_SECONDS) if wishes.horizon[k] > 0.0 else _MAX_HORIZON_SECONDS
        for n in simd_range(0, max(count, (count + 5) & -8)):  # a remainder of one or two is faster without SIMD
            q, key = memory.nearest_rows[n] if n < count else agent, memory.nearest_keys[n] if n < count else 0
            other, side = others.compute_relative_agent(crowd, plane, agent, q), others.compare_agent_names(crowd, agent, key)
            write_velocity_border(other, side, n, own_x, own_y, horizon, dt, borders)
        fastest = min(speed if speed > 0.0 else 0.0, _MAX_SPEED)
        x, y = find_nearest_allowed_velocity(borders, line_buffers, count, fastest, dot(wish, plane.ahead), dot(wish, plane.left))
        for axis in range(3):
            velocities[axis, k] = np.float32(plane.ahead[axis] * x + plane.left[axis] * y)


@inlined
def write_velocity_border(
    other: RelativeAgent, preferred_side: F64, index: I64, own_x: F64, own_y: F64, horizon: F64, dt: F64, borders: BorderColumns
) -> None:
    """Write to entry `index` of `borders` the half-plane of velocities that the neighbour `other` allows.

    If the half-plane is not finite, the entry has no direction and allows every velocity. `preferred_side`: the direction to use
    if both agents have the same position and velocity. `own_x`, `own_y`: the agent's velocity. `horizon`: the time (s) for which
    agents that do not overlap avoid a collision. `dt`: the time (s) in which overlapping agents separate."""
    px, py, dx, dy, is_valid = borders
    x, y, r = other.x, other.y, other.radius_sum
    square, square_radius = x * x + y * y, r * r
    is_separate = square > square_radius
    seconds = horizon if is_separate else dt
    wx, wy = other.vx - x / seconds, other.vy - y / seconds
    size = math.sqrt(wx * wx + wy * wy)
    projection = wx * x + wy * y
    is_round = not is_separate or (projection < 0.0 and projection * projection > square_radius * (size * size))
    leg = math.sqrt(max(square - square_radius, 0.0))
    hand = 1.0 if x * wy - y * wx > 0.0 else -1.0
    # Divisions take most of the time: one per component, for the round end or for the leg.
    divisor = size if is_round else (square if square > _MIN_LENGTH else 1.0)
    ahead = (wy if is_round else hand * (x * leg - hand * (y * r))) / divisor
    side_y = (-wx if is_round else hand * (hand * (x * r) + y * leg)) / divisor
    if is_round and not size > _MIN_LENGTH:
        ahead, side_y = 0.0, preferred_side
    change, reach = r / seconds - size, other.vx * ahead + other.vy * side_y
    border_x = own_x + 0.5 * (change * -side_y if is_round else reach * ahead - other.vx)
    border_y = own_y + 0.5 * (change * ahead if is_round else reach * side_y - other.vy)
    is_finite = math.isfinite(border_x) and math.isfinite(border_y) and math.isfinite(ahead) and math.isfinite(side_y)
    px[index], py[index] = border_x if is_finite else 0.0, border_y if is_finite else 0.0
    dx[index], dy[index], is_valid[index] = ahead if is_finite else 0.0, side_y if is_finite else 0.0, is_finite


@kernel_helper
def find_nearest_allowed_velocity(
    borders: BorderColumns, line_buffers: BorderColumns, border_count: I64, max_speed: F64, wished_x: F64, wished_y: F64
) -> tuple[F64, F64]:
    """Return x and y of the velocity that is nearest to the wish (`wished_x`, `wished_y`) among those that the first
    `border_count` borders allow. If they allow none, return the velocity that violates them least. `line_buffers`: work
    memory."""
    size = math.sqrt(wished_x * wished_x + wished_y * wished_y)
    part = 1.0
    if size > max_speed:
        part = max_speed / (size if size > 0.0 else 1.0)
    vx, vy, failed_border = _find_point_on_borders(
        borders, border_count, max_speed, wished_x, wished_y, wished_x * part, wished_y * part, False
    )
    if failed_border < border_count:
        vx, vy = _find_least_violation(borders, line_buffers, border_count, max_speed, vx, vy, failed_border)
    return vx, vy


@inlined
def _compute_border_violation(borders: BorderColumns, border_index: I64, x: F64, y: F64) -> F64:
    """Return by how much (mm/s) the velocity (`x`, `y`) violates border `border_index`; a positive result means that the border
    forbids the velocity."""
    px, py, dx, dy, _ = borders
    violation: float = dx[border_index] * (py[border_index] - y) - dy[border_index] * (px[border_index] - x)
    return violation


@kernel_helper
def _find_point_on_borders(
    borders: BorderColumns, border_count: I64, max_speed: F64, wished_x: F64, wished_y: F64, x: F64, y: F64, seek_farthest: BOOL
) -> tuple[F64, F64, I64]:
    """Find the allowed velocity nearest to the wish (`wished_x`, `wished_y`).

    Return its x and y, and the index of the first border that cannot be satisfied; `border_count` if all can. The search
    starts from (`x`, `y`), within the circle of radius `max_speed`. With `seek_farthest`, it finds the allowed velocity that
    is farthest in the direction (`wished_x`, `wished_y`)."""
    px, py, dx, dy, _ = borders
    best_x, best_y = x, y
    for k in range(border_count):
        if not _compute_border_violation(borders, k, best_x, best_y) > 0.0:
            continue
        middle = px[k] * dx[k] + py[k] * dy[k]
        discriminant = middle * middle + max_speed * max_speed - (px[k] * px[k] + py[k] * py[k])
        if not discriminant >= 0.0:
            return best_x, best_y, k
        half = math.sqrt(discriminant)
        low, high = -middle - half, -middle + half
        for q in range(k):
            cross = dx[k] * dy[q] - dy[k] * dx[q]
            offset = dx[q] * (py[k] - py[q]) - dy[q] * (px[k] - px[q])
            if abs(cross) <= _MAX_PARALLEL_SINE:
                if offset < 0.0:
                    return best_x, best_y, k
                continue
            # Either bound is equally likely: both are computed, so no branch has to be predicted.
            parameter, is_upper_end = offset / cross, cross > 0.0
            high = min(high, parameter if is_upper_end else np.inf)
            low = max(low, -np.inf if is_upper_end else parameter)
        if not low <= high:
            return best_x, best_y, k
        t = high
        if seek_farthest:
            if not wished_x * dx[k] + wished_y * dy[k] > 0.0:
                t = low
        else:
            t = min(max(dx[k] * (wished_x - px[k]) + dy[k] * (wished_y - py[k]), low), high)
        best_x, best_y = px[k] + t * dx[k], py[k] + t * dy[k]
    return best_x, best_y, border_count


@kernel_helper
def _find_least_violation(
    borders: BorderColumns, line_buffers: BorderColumns, border_count: I64, max_speed: F64, x: F64, y: F64, failed_border: I64
) -> tuple[F64, F64]:
    """Return x and y of the velocity that violates the borders least. The search starts from (`x`, `y`), a velocity that all
    borders before `failed_border` allow. `line_buffers`: work memory. `max_speed`: limits the velocity (mm/s)."""
    px, py, dx, dy, is_valid = borders
    qx, qy, ex, ey, _ = line_buffers
    best_x, best_y, deepest = x, y, 0.0
    for k in range(failed_border, border_count):
        if is_valid[k] == 0 or not _compute_border_violation(borders, k, best_x, best_y) > deepest:
            continue
        for q in simd_range(0, (k + 7) & -8):
            cross = dx[k] * dy[q] - dy[k] * dx[q]
            level = abs(cross) <= _MAX_PARALLEL_SINE
            part = (dx[q] * (py[k] - py[q]) - dy[q] * (px[k] - px[q])) / (1.0 if level else cross)
            qx[q] = 0.5 * (px[k] + px[q]) if level else px[k] + part * dx[k]
            qy[q] = 0.5 * (py[k] + py[q]) if level else py[k] + part * dy[k]
            wx, wy = dx[q] - dx[k], dy[q] - dy[k]
            size = math.sqrt(wx * wx + wy * wy)
            opposed = not (level and dx[k] * dx[q] + dy[k] * dy[q] > 0.0)
            usable = is_valid[q] != 0 and size > _MIN_LENGTH and opposed
            divisor = size if size > _MIN_LENGTH else 1.0
            ex[q], ey[q] = wx / divisor if usable else 0.0, wy / divisor if usable else 0.0
        nx, ny, failed_line = _find_point_on_borders(
            line_buffers, k, max_speed, -dy[k], dx[k], -dy[k] * max_speed, dx[k] * max_speed, True
        )
        if failed_line == k:
            best_x, best_y = nx, ny
        deepest = _compute_border_violation(borders, k, best_x, best_y)
    return best_x, best_y


def find_widest_gaps(x: Floats, y: Floats, is_present: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """Return the direction towards the middle of the widest gap between neighbours, as seen by each agent.

    The result is a unit vector: its components ahead and to the left, float64[n] each. `x`, `y` float64[n,m]: positions of
    neighbours, ahead and to the left. `is_present` [n,m]: whether each neighbour exists. With a single neighbour, the direction
    is opposite to that neighbour. Of equally wide gaps, the one nearest to straight ahead is chosen, then the one to the left.
    Without neighbours, the result is 0."""
    n, width = x.shape
    if not width:
        return np.zeros(n), np.zeros(n)
    is_present = is_present & ((x != 0) | (y != 0))  # an agent at the same position has no bearing
    bearing = elementary.atan2(y.astype(np.float32), x.astype(np.float32)).astype(np.float64)
    bearing = np.sort(np.where(is_present, bearing, np.inf), axis=1)
    has_neighbour = np.isfinite(bearing)
    count = has_neighbour.sum(axis=1)
    following = np.concatenate([bearing[:, 1:], np.full((n, 1), np.inf)], axis=1)
    last = has_neighbour & ~np.isfinite(following)
    following = np.where(last, bearing[:, :1] + _FULL_TURN, following)
    gap = np.where(has_neighbour, following, 0.0) - np.where(has_neighbour, bearing, 0.0)
    middle = np.where(has_neighbour, bearing, 0.0) + gap / 2
    middle = np.where(middle > np.pi, middle - _FULL_TURN, middle)
    wide = has_neighbour & (gap >= gap.max(axis=1, keepdims=True) - _EQUAL_GAP_TOLERANCE)
    deviation = np.where(wide, np.abs(middle), np.inf)
    best = wide & (deviation <= deviation.min(axis=1, keepdims=True) + _EQUAL_GAP_TOLERANCE)
    chosen = np.where(best, middle, -np.inf).max(axis=1)  # angles to the left are positive
    angle = np.where(count > 0, chosen, 0.0).astype(np.float32)
    weight = np.where(count > 0, 1.0, 0.0)
    return elementary.cos(angle).astype(np.float64) * weight, elementary.sin(angle).astype(np.float64) * weight
