"""Runs a substep of a crowd in two loops over all agents.

`prepare_steps` does everything that precedes obstacles and walls. Then a loop, one for each kind of ground, walks agents and
updates them at their new positions."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from antdsl.ground.mesh.stretches import compute_final_pose
from antdsl.ground.mesh.walk import (  # fmt: skip
    FINISHED_STATUS,
    LEFT_OUT_STATUS,
    PREFETCH_GROUPS_AHEAD,
    WAITING_STATUS,
    move_waiting_agents_to_front,
    prefetch_faces,
    store_footing,
    store_waiting_agent,
    walk_agent,
)
from antdsl.ground.mesh.walkers import ClearanceTables, FootingArrays, SurfaceTables
from antdsl.ground.plane import walk_straight_on_plane
from antdsl.machine_code.kernels import inlined, kernel, load3, prefetch, simd_range
from antdsl.machine_code.kernels.types import BOOL, F32, F64, I32, I64, U8, Array1, Array2
from antdsl.numerics.kernel_vectors import Vec3, VectorColumns, dot, times
from antdsl.runtime.moving.clearance.walls_ahead import MAX_TILT_DISTANCE_HALF_LENGTHS, compute_half_length
from antdsl.runtime.moving.tilting import compute_stance
from antdsl.runtime.moving.velocities import (
    STANDING_BODY_STATE,
    ArrivalArrays,
    MotionInputs,
    MotionLimits,
    PushTimes,
    apply_push,
    update_arrived_agent,
)

_F = np.float32
_FLOAT32_ZERO = _F(0)


class IntendedMotion(NamedTuple):
    """The intended motion of agents in a substep.

    `velocity`: the intended velocity (mm/s). `step`: the displacement in `dt` (mm). `step_length`: the length of the step (mm).
    `level_heading`: the heading along the ground of agents that lean. `max_tilt`: the largest tilt (radians). `wall_reach`: how
    far ahead the agent searches for walls (mm). `state`: the state of the body, see `velocities`."""

    velocity: VectorColumns
    step: VectorColumns
    level_heading: VectorColumns
    step_length: Array1[F32]
    max_tilt: Array1[F32]
    wall_reach: Array1[F64]
    state: Array1[I32]


class PendingWalkStates(NamedTuple):
    """The walks of agents that `walk_triangles` leaves to a later walk.

    `float_values`, `integer_values`: the states of these walks. `statuses`: the status of every agent."""

    float_values: Array2[F64]
    integer_values: Array2[I64]
    statuses: Array1[U8]


@kernel
def prepare_steps(
    drive: MotionInputs,
    abilities: MotionLimits,
    has_min_speed: BOOL,
    min_speed: Array1[F32],
    size: Array1[F32],
    is_quarantined: Array1[BOOL],
    push_times: PushTimes,
    motion: IntendedMotion,
    begin: I64,
    end: I64,
) -> tuple[F64, F64]:
    """For agents `begin` to `end` (exclusive), compute the motion that they intend after their push.

    `has_min_speed`: whether `min_speed` applies. Returns the length of the longest finite step (mm; 0 if there is none), and the
    greatest size (mm; -inf if all sizes are NaN)."""
    heading, up, normal = drive.heading, drive.up, drive.ground_normal
    max_speed, max_turn, dt = abilities.max_speed, abilities.max_turn, push_times.dt
    to, step, looking, long, most, reach, state = motion
    for i in simd_range(begin, end):
        u = load3(normal, i)
        v = apply_push(drive, u, abilities, has_min_speed, min_speed, push_times, i)
        if is_quarantined[i]:
            v = (_FLOAT32_ZERO, _FLOAT32_ZERO, _FLOAT32_ZERO)
        displacement = times(v, dt)
        for k in range(3):
            to[k][i], step[k][i] = v[k], displacement[k]
        long[i] = np.sqrt(dot(displacement, displacement))
        compute_stance(i, up, heading, normal, max_speed, size, max_turn, dt, most, looking, state)
        reach[i] = MAX_TILT_DISTANCE_HALF_LENGTHS * compute_half_length(size[i])
    longest, greatest = _FLOAT32_ZERO, _F(-np.inf)
    for i in range(begin, end):
        longest = long[i] if long[i] > longest and np.isfinite(long[i]) else longest
        greatest = size[i] if size[i] > greatest else greatest
    return np.float64(longest), np.float64(greatest)


@inlined
def _choose_level_heading(heading: VectorColumns, headings: VectorColumns, state: Array1[I32], i: I64) -> Vec3:
    """Return the heading of agent `i` along the ground, in float64. For an agent that leans, it comes from `headings`."""
    if state[i] == STANDING_BODY_STATE:
        return np.float64(heading[0][i]), np.float64(heading[1][i]), np.float64(heading[2][i])
    return np.float64(headings[0][i]), np.float64(headings[1][i]), np.float64(headings[2][i])


@kernel
def walk_triangles(
    surface: SurfaceTables,
    clearances: ClearanceTables,
    footing: FootingArrays,
    size: Array1[F32],
    normal: Array2[F32],
    level_heading: VectorColumns,
    arrival: ArrivalArrays,
    pending_walks: PendingWalkStates,
    new_footing: FootingArrays,
    place: Array2[F64],
    begin: I64,
    end: I64,
) -> tuple[I64, I64, I64]:
    """Walk agents over triangles by their float32 steps.

    Update the agents that arrive as `update_arrived_rows` does. `footing`: footings before the walk. `new_footing`, `place`
    (n, 3): receive the new footings and positions (mm). `pending_walks`: receives the walks that must be continued later.
    Returns `begin`, and the numbers of waiting agents and of agents that are left out."""
    mesh, face, b1s, b2s, overs = footing
    first, step, how = surface.first_faces, arrival.step, pending_walks.statuses
    registers, heading, state = arrival.registers, arrival.registers.heading, arrival.body_stances.state
    for group in range(begin - 8 * PREFETCH_GROUPS_AHEAD, end, 8):
        # Columns need explicit prefetches: there are more than a processor prefetches automatically.
        k = group + 8 * PREFETCH_GROUPS_AHEAD
        for columns in (arrival.velocity, step, *registers, arrival.limits):
            for each in columns:
                prefetch(each, k)
        for each in (arrival.body_stances.max_tilt, size, state, b1s, b2s, overs, *new_footing):
            prefetch(each, k)
        for axis in range(3):
            prefetch(place, k + axis * new_footing.b1.size)
        for each in (normal, arrival.normals):
            prefetch(each, 3 * k)
            prefetch(each, 3 * k + 16)
        for each in (mesh, face):
            prefetch(each, k + 64)
        prefetch_faces(
            surface, mesh, face, max(group + 8 * PREFETCH_GROUPS_AHEAD, begin), min(group + 8 * PREFETCH_GROUPS_AHEAD + 8, end)
        )
        for i in simd_range(max(group, begin), min(group + 8, end)):
            how[i] = LEFT_OUT_STATUS
            if mesh[i] < 0 or face[i] < 0:
                continue
            displacement = (np.float64(step[0][i]), np.float64(step[1][i]), np.float64(step[2][i]))
            if not np.isfinite(displacement[0] + displacement[1] + displacement[2]):
                continue
            x, y, z = load3(normal, i)
            up = (np.float64(x), np.float64(y), np.float64(z))
            long, look = np.float64(size[i]), _choose_level_heading(heading, level_heading, state, i)
            f, weights = first[mesh[i]] + face[i], (b1s[i], b2s[i])
            walk = walk_agent(surface, clearances, True, f, weights, overs[i], long, displacement, look, up)
            if walk.stop.event:
                how[i] = WAITING_STATUS
                store_waiting_agent(pending_walks.float_values, pending_walks.integer_values, i, np.float64(size[i]), walk)
                continue
            how[i] = FINISHED_STATUS
            # No edge connects two meshes.
            store_footing(new_footing, i, mesh[i], walk.walker.face - first[mesh[i]], walk.height, walk.walker)
            pose = compute_final_pose(surface.face_table, walk.walker, walk.height)
            for k in range(3):
                place[k, i] = pose.position[k]
            update_arrived_agent(i, pose, walk.stop.followed_borders > 0, arrival)
    waiting, left = move_waiting_agents_to_front(how, pending_walks.float_values, pending_walks.integer_values, begin, end)
    return begin, waiting, left


@kernel
def walk_plane(
    plane: Array1[F64], level_heading: VectorColumns, arrival: ArrivalArrays, place: Array2[F64], begin: I64, end: I64
) -> None:
    """Walk agents from `begin` to before `end` along a plane, and update them as `update_arrived_rows` does. `place` (n, 3):
    receives the new positions (mm).

    `plane`: the unit normal of the plane."""
    at, step, heading, state = arrival.start, arrival.step, arrival.registers.heading, arrival.body_stances.state
    up = (plane[0], plane[1], plane[2])
    for i in simd_range(begin, end):
        displacement = (np.float64(step[0][i]), np.float64(step[1][i]), np.float64(step[2][i]))
        look = _choose_level_heading(heading, level_heading, state, i)
        pose, _ = walk_straight_on_plane(up, (at[i, 0], at[i, 1], at[i, 2]), displacement, look)
        for k in range(3):
            place[i, k] = pose.position[k]
        update_arrived_agent(i, pose, False, arrival)
