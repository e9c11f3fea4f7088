"""Finds walls ahead of agents, and how far bodies tilt in front of these walls. Walls are parts of the ground that the next steps
may reach. A body of length L tilts linearly over a distance of L in front of a wall. Its head is L/2 ahead of its feet, so it
does not enter a wall at an angle of up to 90 degrees. For an overhanging wall, the distance is multiplied by angle / sine."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.kernels import BOOL, F32, F64, I32, I64, Array1, Array2, Strided2, inlined, kernel, simd_range
from antdsl.numerics import vectors as vec
from antdsl.numerics.elementary_loops import atan2
from antdsl.numerics.kernel_vectors import VectorColumns, cross, dot, get_column, minus, plus, times
from antdsl.numerics.vectors import VectorArrays
from antdsl.runtime.moving.velocities import FACE_REGISTER, STANDING_BODY_STATE
from antdsl.runtime.world import Population, World

Floats = NDArray[np.float64]
# Rays: the agent, half a body, the step (mm), the ray's direction and the ground's normal.
WallRays = tuple[Array1[I64], Array1[F64], Array1[F64], Strided2[F64], Strided2[F64]]

_F = np.float32
# cosine of the smallest turn of the ground that counts as a wall; less is smooth, or a slope
_WALL_TURN_COSINE = 0.7071067811865476
_RAY_HEIGHT_BODY_LENGTHS = 0.03  # body lengths; height above the feet of a ray that searches for walls
_SAME_RAY_COSINE = 0.97  # cosine of the angle between heading and step; above it, one ray serves both
_MIN_BUFFER_AGENTS = 512  # buffers have space for at least this number of agents
MAX_TILT_DISTANCE_HALF_LENGTHS = 3.0  # half bodies; a body tilts within this distance before a wall, at most


class WallsAhead(NamedTuple):
    """Walls ahead of some agents; lengths are in mm.

    `normals` (3, k): the wall's normals on the side of the agents. `directions` (3, k): directions towards the walls.
    `angles`: the angles between ground and wall (radians). `distances`: the distances of the feet from the wall.
    `tilt_distances`: the distance over which the body tilts. `half_lengths`: half of the body's length."""

    normals: Floats
    directions: Floats
    angles: Floats
    distances: Floats
    tilt_distances: Floats
    half_lengths: Floats


NO_WALLS = WallsAhead(*np.empty((2, 3, 0)), *np.empty((4, 0)))


def find_walls(
    world: World,
    population: Population,
    level_headings: VectorArrays,
    step: VectorArrays,
    reach: Floats,
    body_states: NDArray[np.int32],
) -> WallsAhead:
    """Return the walls within `reach` (mm) of agents, in the direction of their heading along the ground or of their `step`
    (mm).

    Of two walls, the one that tilts the body further is used. The direction of the step is not searched if an agent faces
    another direction and walks backward, because its head is on the other side. `body_states`: for each agent with a wall,
    receives the number of the wall. `level_headings`: on entry, the headings of leaning agents along the ground; on return,
    those of all agents that search for walls."""
    meshes = world.ground.meshes
    if meshes is None:
        return NO_WALLS
    rows = meshes.find_rows_near_slopes(population.footing, population.position, reach, world.options.threads)
    if not len(rows):
        return NO_WALLS
    now, most = (
        population.now,
        max(_MIN_BUFFER_AGENTS, 1 << len(rows).bit_length()),
    )  # reuse the memory while the number of searching agents is similar
    (which,) = population.get_buffers("looks", 1, (2 * most,), np.int64)
    halves, sizes = population.get_buffers("sizes", 2, (2 * most,), np.float64)
    ahead, normal, origin, ray = population.get_buffers("ways", 4, (3, 2 * most), np.float64)
    looks = (which, halves, sizes, ahead, normal)
    face, heading = (
        vec.get_vector_registers(now, "~face") if FACE_REGISTER in now else step,
        vec.get_vector_registers(now, "heading"),
    )
    directions = BodyDirections(heading, level_headings, body_states, step, FACE_REGISTER in now, face)
    count = write_wall_rays(rows, now["size"], population.position, population.normal, directions, looks, origin, ray)
    hit, part, wall = meshes.find_hit_normals(origin[:, :count].T, ray[:, :count].T, world.options.threads)
    if not len(hit):
        return NO_WALLS
    lengths, wall_normals, along = np.empty((4, len(hit))), *np.empty((2, 3, len(hit)))
    count = write_walls(len(rows), looks, hit, part, wall, wall_normals, along, *lengths, body_states)
    return WallsAhead(wall_normals[:, :count], along[:, :count], *lengths[:, :count])


@inlined
def compute_half_length(size: F32) -> F64:
    """Return half of a body's size (mm); 0 if the size is not a valid number."""
    long = np.float64(_F(0) if size <= 0 else size)
    return long / 2 if np.isfinite(long) else 0.0


@kernel
def write_wall_reach(size: Array1[F32], reach: Array1[F64]) -> None:
    """Write to `reach` how far ahead (mm) bodies search for walls. `size`: the sizes of the bodies (mm)."""
    for i in simd_range(0, size.size):
        reach[i] = MAX_TILT_DISTANCE_HALF_LENGTHS * compute_half_length(size[i])


class BodyDirections(NamedTuple):
    """The headings and steps of agents.

    `level_heading`: the headings along the ground of agents that lean according to `state`. `step`: the steps (mm). `has_facing`:
    whether `facing` contains directions that agents face instead of their path."""

    heading: VectorColumns
    level_heading: VectorColumns
    state: Array1[I32]
    step: VectorColumns
    has_facing: BOOL
    facing: VectorColumns


@kernel
def write_wall_rays(
    rows: Array1[I64],
    size: Array1[F32],
    position: Strided2[F64],
    normal: Array2[F32],
    directions: BodyDirections,
    wall_rays: WallRays,
    origin: Array2[F64],
    displacement: Array2[F64],
) -> I64:
    """Write the rays with which agents search for walls to `origin` and `displacement` (3, ..), with further data in
    `wall_rays`. Return their number. The first rays are along the heading over the ground, one for each of `rows`. Then come
    rays along the step, for agents that step sideways and do not walk backward. The buffers have space for two rays per row.
    On entry, `directions.level_heading` is set for leaning agents; on return, for all `rows`."""
    which, halves, sizes, aheads, normals = wall_rays
    heading, looking, state, step, faces, face = directions
    count = rows.size
    for k in range(rows.size):
        i, half = rows[k], compute_half_length(size[rows[k]])
        if state[i] == STANDING_BODY_STATE:
            looking[0][i], looking[1][i], looking[2][i] = heading[0][i], heading[1][i], heading[2][i]
        up = (np.float64(normal[i, 0]), np.float64(normal[i, 1]), np.float64(normal[i, 2]))
        ahead = (np.float64(looking[0][i]), np.float64(looking[1][i]), np.float64(looking[2][i]))
        direction = (np.float64(step[0][i]), np.float64(step[1][i]), np.float64(step[2][i]))
        direction = minus(direction, times(up, dot(direction, up)))
        step_length = np.sqrt(dot(direction, direction))
        if step_length > 1e-9:
            long = max(step_length, 1e-300)
            direction = (direction[0] / long, direction[1] / long, direction[2] / long)
        else:
            direction = ahead
        same = dot(direction, ahead)
        aside = same < _SAME_RAY_COSINE
        if aside and faces and same < 0 and (face[0][i] != 0 or face[1][i] != 0 or face[2][i] != 0):
            aside = False
        place = (position[i, 0], position[i, 1], position[i, 2])
        start = plus(place, times(up, 2 * _RAY_HEIGHT_BODY_LENGTHS * half))
        reach = MAX_TILT_DISTANCE_HALF_LENGTHS * half
        at = k
        for turn in range(2):
            if turn == 0 or aside:
                which[at], halves[at], sizes[at] = i, half, step_length
                for axis in range(3):
                    aheads[axis, at], normals[axis, at] = ahead[axis], up[axis]
                    origin[axis, at], displacement[axis, at] = start[axis], ahead[axis] * reach
            if turn == 0 and aside:
                at = count
                count += 1
                ahead = direction
    return count


@kernel
def write_walls(
    heading_ray_count: I64,
    wall_rays: WallRays,
    hit_rays: Array1[I64],
    hit_fractions: Array1[F64],
    hit_normals: Strided2[F64],
    wall_normals: Array2[F64],
    wall_directions: Array2[F64],
    wall_angles: Array1[F64],
    distances: Array1[F64],
    tilt_distances: Array1[F64],
    half_lengths: Array1[F64],
    state: Array1[I32],
) -> I64:
    """Write the fields of `WallsAhead` for agents with a wall ahead, and return the number of walls.

    `hit_rays`: ascending indices of the rays that hit something. The first `heading_ray_count` rays are along the heading. Of
    two walls, the one that needs more tilt is used. The number of the agent's wall is written to `state`."""
    which, halves, sizes, aheads, normals = wall_rays
    middle = 0
    while middle < hit_rays.size and hit_rays[middle] < heading_ray_count:
        middle += 1
    one, two, count = 0, middle, 0
    while one < middle or two < hit_rays.size:
        row = 0
        if one < middle and (two >= hit_rays.size or which[hit_rays[one]] <= which[hit_rays[two]]):
            row = which[hit_rays[one]]
        else:
            row = which[hit_rays[two]]
        best, has_wall = 0.0, False
        for turn in range(2):
            k, own = -1, False
            if turn == 0:
                own = one < middle and which[hit_rays[one]] == row
                k = one
                one += 1 if own else 0
            else:
                own = two < hit_rays.size and which[hit_rays[two]] == row
                k = two
                two += 1 if own else 0
            if own:
                h = hit_rays[k]
                direction, up = get_column(aheads, h), get_column(normals, h)
                normal = get_column(hit_normals, k)
                if dot(normal, direction) > 0:
                    normal = (-normal[0], -normal[1], -normal[2])
                cosine, aside = dot(up, normal), cross(up, normal)
                sine = max(np.sqrt(dot(aside, aside)), 1e-6)
                turned = np.float64(atan2(_F(sine), _F(cosine)))
                long = halves[h] * min(max(turned / sine, 2.0), MAX_TILT_DISTANCE_HALF_LENGTHS)
                high, reach = 2 * _RAY_HEIGHT_BODY_LENGTHS * halves[h], MAX_TILT_DISTANCE_HALF_LENGTHS * halves[h]
                away = max(hit_fractions[k] * reach - high * cosine / sine, 0.0)
                tilt = (1.0 - away / long) * turned
                if cosine < _WALL_TURN_COSINE and away < long + 2 * sizes[h] and (not has_wall or tilt > best):
                    best, has_wall = tilt, True
                    wall_angles[count], distances[count], tilt_distances[count], half_lengths[count] = (
                        turned,
                        away,
                        long,
                        halves[h],
                    )
                    for axis in range(3):
                        wall_normals[axis, count], wall_directions[axis, count] = normal[axis], direction[axis]
        if has_wall:
            state[row] = count
            count += 1
    return count
