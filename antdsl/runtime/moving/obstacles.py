"""Keeps agents out of obstacles. A step that would move an agent's centre into an obstacle is shortened, and the rest of the
step slides along the obstacle."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.grid_rays import PREFETCH_GROUP_SIZE, GridTables, cast_feeler
from antdsl.casting.nearest_faces import measure_signed_distance, prefetch_cells_around, prefetch_face_lists_of_rows
from antdsl.casting.rays import RayScene
from antdsl.casting.tolerances import FACE_BEYOND_GRID
from antdsl.machine_code.kernels import BOOL, F32, I64, Array1, Array2, Strided2, allocate_scratch, inlined, kernel, simd_range
from antdsl.numerics import parallel
from antdsl.numerics import vectors as vec
from antdsl.numerics.kernel_vectors import Vec3F32, VectorColumns, dot, minus, plus, times
from antdsl.numerics.vectors import VectorArrays, VectorComponents
from antdsl.runtime.moving.clearance.obstacle_clearance import get_obstacle_clearance
from antdsl.runtime.world import Population, World

Floats = NDArray[np.float32]
Rows = NDArray[np.intp]
_F = np.float32
_FLOAT32_ZERO, _FLOAT32_HALF, _FLOAT32_ONE, _FLOAT32_INFINITY = _F(0), _F(0.5), _F(1), _F(np.inf)
_MIN_STEP_MM = _F(1e-9)  # a shorter step counts as no step
_MIN_VECTOR_LENGTH = _F(1e-12)  # as in `vectors.normalise_or_fallback`
_CENTRE_MARGIN_RADIUS_SHARE = _F(0.5)  # share of the radius; the distance that the centre keeps from a face ahead
_CLEARANCE_SLACK = _F(1e-4)  # as `obstacle_clearance`
_RADIUS_SLACK_FACTOR = _F(1) + _CLEARANCE_SLACK
_RAY_SLACK_FACTOR, _STEP_SLACK_FACTOR = 1 + 1e-6, _F(1) + _F(1e-6)  # larger than the rounding of a distance or of a path length


def slide_steps(world: World, population: Population, step: VectorArrays, up: VectorComponents, radius: Floats) -> VectorArrays:
    """Return the steps (mm) of all agents, deflected along obstacles ahead. `up`: the normals of the ground."""
    names = _list_obstacle_names(world)
    if names:
        place, began = (
            vec.get_vector_registers(population.now, "position"),
            _are_agents_at_step_start(population, world.options.threads),
        )
    for name in names:
        scene = get_obstacle_scene(world, name)
        clear = get_obstacle_clearance(world, population, name) if began else scene.measure_clearance(*place)
        step = _slide_along_obstacle(scene, place, step, up, radius, clear, world.options.threads)
    return step


def slide_rows(world: World, population: Population, rows: Rows, step: VectorArrays, up: VectorComponents) -> VectorArrays:
    """Return the steps of the agents at `rows`, deflected as by `slide_steps`. These agents have already moved in this step."""
    names = _list_obstacle_names(world)
    if names:
        place, radius, drift = _measure_distances_from_start(population, rows)
    for name in names:
        clear = get_obstacle_clearance(world, population, name).take(rows) - drift
        step = _slide_along_obstacle(get_obstacle_scene(world, name), place, step, up, radius, clear, world.options.threads)
    return step


def _measure_distances_from_start(population: Population, rows: Rows) -> tuple[VectorArrays, Floats, Floats]:
    """Return positions and radii of the agents at `rows`, and upper bounds of their distances from the step's start, in mm."""
    positions, start = (vec.get_vector_registers(registers, "position") for registers in (population.now, population.start))
    place, radius, drift = np.empty((3, len(rows)), np.float32), *np.empty((2, len(rows)), np.float32)
    measure_distance_from_start(rows, positions, start, population.now["radius"], place, radius, drift)
    return (place[0], place[1], place[2]), radius, drift


def _list_obstacle_names(world: World) -> list[str]:
    """Return the names of the obstacles."""
    return [name for name in world.plan.obstacles if name in world.obstacles]


def get_obstacle_scene(world: World, name: str) -> RayScene:
    """Return the mesh of an obstacle that agents cannot enter, which is not a solid."""
    scene = world.obstacles[name]
    assert isinstance(scene, RayScene)
    return scene


def _are_agents_at_step_start(population: Population, threads: int) -> bool:
    """Return whether all agents are still at their positions at the start of the step, as in the first substep."""
    now, start = vec.get_vector_registers(population.now, "position"), vec.get_vector_registers(population.start, "position")
    work, least = partial(are_vectors_equal, now, start), parallel.MIN_LIGHT_ITEMS_PER_THREAD
    return all(parallel.run_in_parts(work, len(population), threads, least))


def _slide_along_obstacle(
    scene: RayScene, place: VectorArrays, step: VectorArrays, up: VectorComponents, radius: Floats,
    clearance: Floats, threads: int,
) -> VectorArrays:  # fmt: skip
    """Return the steps (mm) of agents at `place`, deflected along one obstacle. `clearance`: lower bounds (mm) of the
    distances from it."""
    n, tables = len(radius), scene.get_tables()
    if tables is not None:
        (rows, hit_rows), columns, faces = np.empty((2, n), np.int64), np.empty((10, n), np.float32), np.empty((4, n), np.float32)
        normals = np.stack(up) if isinstance(up, tuple) else up
        work = partial(slide_steps_near_grid, tables, place, step, normals, radius, clearance, rows, columns, hit_rows, faces)
        parts = parallel.run_in_parts(work, n, threads, parallel.MIN_LIGHT_ITEMS_PER_THREAD)
        if not any([left for _, _, _, left in parts]):
            return _deflect_at_hits(scene, step, rows, columns, hit_rows, faces, parts, threads)
    rows, columns = np.empty(n, np.int64), np.empty((9, n), np.float32)
    parts = parallel.run_in_parts(partial(select_agents_near_obstacle, place, step, radius, clearance, rows, columns), n, threads)
    rows, columns = parallel.join_parts(parts, rows, columns)
    count, columns = len(rows), np.ascontiguousarray(columns)
    if not count:
        return step
    above = vec.take_rows(up, rows)
    size, margin, _, x, y, z, _, _, _ = columns
    gap, out = scene.measure_signed_distances(x, y, z, size + margin, threads)
    new_steps, going, rays = np.empty((3, count), np.float32), np.empty(count, np.int64), np.empty((9, count), np.float32)
    asking = slide_steps_outside_margins(columns, above, gap, out, new_steps, going, rays)
    a, b, c = new_steps
    if asking:
        px, py, pz, dx, dy, dz, reach, size, margin = rays[:, :asking]
        hits = scene.cast_feelers((px, py, pz), (dx, dy, dz), reach, threads)
        hit_rows = np.flatnonzero(hits.hit)
        if len(hit_rows):
            free = np.clip(hits.t[hit_rows] - margin[hit_rows], _F(0), size[hit_rows])
            normal = (hits.nx[hit_rows], hits.ny[hit_rows], hits.nz[hit_rows])
            _deflect_at_face(scene, (x, y, z), (a, b, c), above, columns[1], going[hit_rows], free, normal, threads)
    return _replace_rows(step, rows, new_steps)


def _deflect_at_hits(
    scene: RayScene, step: VectorArrays, rows: NDArray[np.int64], step_columns: Floats, hit_rows: NDArray[np.int64],
    hits: Floats, chunk_counts: list[tuple[int, int, int, int]], threads: int,
) -> VectorArrays:  # fmt: skip
    """Return `step` with `rows` taken from `step_columns`. Steps that still hit a face are deflected along this face."""
    rows, step_columns = parallel.join_parts(chunk_counts, rows, step_columns)
    if not len(rows):
        return step
    hit_rows, hits = parallel.join_parts([(begin, hit) for begin, _, hit, _ in chunk_counts], hit_rows, hits)
    if len(hit_rows):
        if len(chunk_counts) > 1:  # each chunk counts from its own start
            counts = [count for _, count, _, _ in chunk_counts]
            hit_rows = hit_rows + np.repeat(np.cumsum(counts) - counts, [hit for _, _, hit, _ in chunk_counts])
        free, *normal = hits
        place, new_steps, above = (step_columns[k : k + 3] for k in (0, 3, 6))
        _deflect_at_face(
            scene, place, new_steps, above, step_columns[9], hit_rows, free, (normal[0], normal[1], normal[2]), threads
        )
    return _replace_rows(step, rows, step_columns[3:6])


def _replace_rows(step: VectorArrays, rows: NDArray[np.int64], new_steps: Floats) -> VectorArrays:
    """Return a copy of the steps in which those of `rows` are replaced by `new_steps` (3, k)."""
    to = np.empty((3, len(step[0])), np.float32)
    write_replaced_steps(step, rows, new_steps, to)
    return to[0], to[1], to[2]


def _deflect_at_face(
    scene: RayScene, place: VectorComponents, step: VectorComponents, up: VectorComponents, margin: Floats,
    hit_rows: Rows,
    free_length: Floats, normal: VectorArrays, threads: int,
) -> None:  # fmt: skip
    """Deflect the steps of the agents `hit_rows` in place, along a face `free_length` mm ahead that has this `normal`."""
    u, intended_steps = vec.take_rows(up, hit_rows), vec.take_rows(step, hit_rows)
    size = vec.length(intended_steps)
    wall = vec.normalise_or_fallback(vec.project_to_plane(normal, u), normal)
    part = free_length / size
    rest = vec.scale(intended_steps, _F(1) - part)
    into = np.minimum(vec.dot(rest, wall), _F(0))
    new_steps = vec.add(vec.scale(intended_steps, part), vec.subtract(rest, vec.scale(wall, into)))
    # In a corner, sliding along one wall leads into the next: the step then ends at the free length.
    again, free_length, _ = _find_hits(scene, vec.take_rows(place, hit_rows), new_steps, margin[hit_rows], threads)
    if len(again):
        short = vec.take_rows(new_steps, again)
        short = vec.scale(short, free_length / vec.length(short))
        for component, value in zip(new_steps, short, strict=True):
            component[again] = value
    for component, value in zip(step, new_steps, strict=True):
        component[hit_rows] = value


def _find_hits(
    scene: RayScene, place: VectorArrays, step: VectorArrays, margin: Floats, threads: int
) -> tuple[Rows, Floats, VectorArrays]:
    """Return the agents that would hit a face during their step, the distance (mm) to the face, and the normal of the face."""
    size = vec.length(step)
    going = np.flatnonzero(size > _MIN_STEP_MM)
    size, margin = size[going], margin[going]
    direction = vec.scale(vec.take_rows(step, going), _F(1) / size)
    hits = scene.cast_feelers(vec.take_rows(place, going), direction, size + margin, threads)
    hit_rows = np.flatnonzero(hits.hit)
    free = np.clip(hits.t[hit_rows] - margin[hit_rows], _F(0), size[hit_rows])
    return going[hit_rows], free, (hits.nx[hit_rows], hits.ny[hit_rows], hits.nz[hit_rows])


@kernel
def are_vectors_equal(first: VectorColumns, second: VectorColumns, begin: I64, end: I64) -> BOOL:
    """Return whether two sets of vectors are equal, without any NaN, from index `begin` to before `end`."""
    is_same = True
    for i in range(begin, end):
        is_same = is_same and first[0][i] == second[0][i] and first[1][i] == second[1][i] and first[2][i] == second[2][i]
    return is_same


@inlined
def _measure_step(step: VectorColumns, radius: Array1[F32], clearance: Array1[F32], row: I64) -> tuple[F32, F32, BOOL]:
    """Return the length (mm) of an agent's step, the margin (mm) from obstacles, and whether the step may touch one."""
    vector = (step[0][row], step[1][row], step[2][row])
    size = np.sqrt(dot(vector, vector))
    margin = (_FLOAT32_ZERO if radius[row] <= 0 else radius[row]) * _CENTRE_MARGIN_RADIUS_SHARE
    return size, margin, size > _MIN_STEP_MM and clearance[row] <= (size + margin) * _RADIUS_SLACK_FACTOR + _CLEARANCE_SLACK


@inlined
def _slide_step_outside_margin(
    step: Vec3F32, up: Vec3F32, size: F32, margin: F32, clearance: F32, gap: F32, direction: Vec3F32
) -> tuple[Vec3F32, F32, BOOL]:
    """Return a step that keeps `margin` (mm) from a face `gap` mm away, its length, and whether it may still hit a face."""
    wall = minus(direction, times(up, dot(direction, up)))
    long = np.sqrt(dot(wall, wall))
    if long > _MIN_VECTOR_LENGTH and np.isfinite(long):
        wall = times(wall, _FLOAT32_ONE / long)
    else:
        wall = (_FLOAT32_ZERO, _FLOAT32_ZERO, _FLOAT32_ZERO)
    least, half = margin - gap, size * _FLOAT32_HALF
    least = (half if half < least else least) - dot(step, wall)
    if not least <= 0:
        step = plus(step, times(wall, least))
    long = np.sqrt(dot(step, step))
    if long > size:
        step = times(step, size / long)
    if gap < 0:
        clearance = _FLOAT32_INFINITY  # an agent inside the obstacle is not held
    elif not gap <= clearance:
        clearance = gap
    size = np.sqrt(dot(step, step))
    return step, size, size > _MIN_STEP_MM and clearance <= (size + margin) * _RADIUS_SLACK_FACTOR + _CLEARANCE_SLACK


class ObstacleHitCounts(NamedTuple):
    """Counts for a range of agents that starts at `first_row`.

    `touching_count`: agents with a step that may touch an obstacle. `hit_count`: those that hit it although their steps were
    changed to keep the margin. `unknown_count`: agents for which the grid has no answer."""

    first_row: I64
    touching_count: I64
    hit_count: I64
    unknown_count: I64


@kernel
def slide_steps_near_grid(
    grid: GridTables, place: VectorColumns, step: VectorColumns, up: Strided2[F32], radius: Array1[F32],
    clearance: Array1[F32], rows: Array1[I64], columns: Array2[F32], hit_rows: Array1[I64], hits: Array2[F32], begin: I64,
    end: I64
) -> ObstacleHitCounts:  # fmt: skip
    """Deflect the steps of agents from `begin` to before `end` that may touch an obstacle. The outputs are written from index
    `begin` on. `rows`: these agents. `columns` [10, n]: position, deflected step, `up` of the ground, margin. `hit_rows`: the
    agents that still hit a face. `hits` [4, n]: free length of the step (mm) and normal of the face. `clearance`: a lower
    bound (mm) of the distance. Agents outside the obstacle are left out if its nearest face is out of range: their steps do
    not change."""
    asking = begin
    for i in range(begin, end):
        _, _, may_touch = _measure_step(step, radius, clearance, i)
        if may_touch:
            rows[asking] = i
            asking += 1
    count, hit, left = 0, 0, 0
    cubes = allocate_scratch(9 * PREFETCH_GROUP_SIZE, I64)
    for low in range(begin, asking, PREFETCH_GROUP_SIZE):
        high = min(low + PREFETCH_GROUP_SIZE, asking)
        for n in range(low, high):
            i = rows[n]
            prefetch_cells_around(grid, (place[0][i], place[1][i], place[2][i]), cubes, n - low)
        prefetch_face_lists_of_rows(grid, cubes, 9 * (high - low))
        for n in range(low, high):
            i = rows[n]
            size, margin, _ = _measure_step(step, radius, clearance, i)
            at, above = (place[0][i], place[1][i], place[2][i]), (up[0, i], up[1, i], up[2, i])
            reach = np.float64((size + margin) * _RADIUS_SLACK_FACTOR + _CLEARANCE_SLACK) * _RAY_SLACK_FACTOR
            gap, out = measure_signed_distance(grid, at, reach)
            if gap == _FLOAT32_INFINITY:
                continue
            left += 1 if gap != gap else 0
            new_step, size, may_touch = _slide_step_outside_margin(
                (step[0][i], step[1][i], step[2][i]), above, size, margin, clearance[i], gap, out
            )
            k = begin + count
            rows[k], columns[9, k] = i, margin
            for axis in range(3):
                columns[axis, k], columns[3 + axis, k], columns[6 + axis, k] = at[axis], new_step[axis], above[axis]
            if may_touch:
                normal, face = cast_feeler(grid, at, times(new_step, _FLOAT32_ONE / size), size + margin)
                left += 1 if face == FACE_BEYOND_GRID else 0
                if face >= 0:
                    h = begin + hit
                    free = _F(normal[3]) - margin
                    free = _FLOAT32_ZERO if free < _FLOAT32_ZERO else size if free > size else free
                    hit_rows[h], hits[0, h] = count, free
                    hits[1, h], hits[2, h], hits[3, h] = _F(normal[0]), _F(normal[1]), _F(normal[2])
                    hit += 1
            count += 1
    return ObstacleHitCounts(begin, count, hit, left)


@kernel
def write_replaced_steps(step: VectorColumns, rows: Array1[I64], new_steps: Strided2[F32], target: Array2[F32]) -> None:
    """Copy the steps to `target` (3, n), with those of `rows` replaced by `new_steps` (3, k)."""
    for i in simd_range(0, step[0].size):
        target[0, i], target[1, i], target[2, i] = step[0][i], step[1][i], step[2][i]
    for k in range(rows.size):
        target[0, rows[k]], target[1, rows[k]], target[2, rows[k]] = new_steps[0, k], new_steps[1, k], new_steps[2, k]


@kernel
def select_agents_near_obstacle(
    place: VectorColumns,
    step: VectorColumns,
    radius: Array1[F32],
    clearance: Array1[F32],
    rows: Array1[I64],
    columns: Array2[F32],
    begin: I64,
    end: I64,
) -> tuple[I64, I64]:
    """Find the agents from `begin` to before `end` with a step that may touch an obstacle. Return `begin` and their number.
    `clearance`: a lower bound (mm) of the distance from the obstacle. From index `begin` on, writes the agents to `rows`. The
    rows of `columns` [9, ..] receive the length of the step, the margin (mm), `clearance`, the position and the step."""
    count = begin
    for i in range(begin, end):
        size, margin, may_touch = _measure_step(step, radius, clearance, i)
        if may_touch:
            rows[count], columns[0, count], columns[1, count], columns[2, count] = i, size, margin, clearance[i]
            for k in range(3):
                columns[3 + k, count], columns[6 + k, count] = place[k][i], step[k][i]
            count += 1
    return begin, count - begin


@kernel
def slide_steps_outside_margins(
    columns: Array2[F32],
    up_columns: VectorColumns,
    gaps: Array1[F32],
    direction: Array2[F32],
    new_steps: Array2[F32],
    moving_rows: Array1[I64],
    rays: Array2[F32],
) -> I64:
    """Change the steps of agents found by `select_agents_near_obstacle` to stay outside the margin from the nearest face. Write
    them to `new_steps` [3, n]. `up_columns`: the normals of the ground. `gaps`, `direction` [3, n]: distance (mm) and direction
    of the nearest face. Returns the number of agents that may hit it. Writes them to `moving_rows`, and position, direction,
    range, step and margin to `rays` [9, n]."""
    count = 0
    for i in range(gaps.size):
        margin, up, away = (
            columns[1, i],
            (up_columns[0][i], up_columns[1][i], up_columns[2][i]),
            (direction[0, i], direction[1, i], direction[2, i]),
        )
        step, size, may_touch = _slide_step_outside_margin(
            (columns[6, i], columns[7, i], columns[8, i]), up, columns[0, i], margin, columns[2, i], gaps[i], away
        )
        new_steps[0, i], new_steps[1, i], new_steps[2, i] = step
        if may_touch:
            moving_rows[count] = i
            inverse = _FLOAT32_ONE / size
            for k in range(3):
                rays[k, count], rays[3 + k, count] = columns[3 + k, i], step[k] * inverse
            rays[6, count], rays[7, count], rays[8, count] = size + margin, size, margin
            count += 1
    return count


@kernel
def scale_velocities_with_steps(
    intended_step: VectorColumns, step: VectorColumns, velocity: VectorColumns, steps_per_second: F32, begin: I64, end: I64
) -> None:
    """For agents with a step that differs from `intended_step`, set the velocity to the step times `steps_per_second`. Agents
    from `begin` to before `end` are processed."""
    for i in simd_range(begin, end):
        if step[0][i] != intended_step[0][i] or step[1][i] != intended_step[1][i] or step[2][i] != intended_step[2][i]:
            for k in range(3):
                velocity[k][i] = step[k][i] * steps_per_second


@kernel
def measure_distance_from_start(
    rows: Array1[I64],
    place: VectorColumns,
    start: VectorColumns,
    radii: Array1[F32],
    positions: Array2[F32],
    radius: Array1[F32],
    drift: Array1[F32],
) -> None:
    """Write positions (3, k) and radii of agents, and upper bounds `drift` (mm) of their distances from the step's start."""
    for k in simd_range(0, rows.size):
        row = rows[k]
        to = (place[0][row], place[1][row], place[2][row])
        displacement = minus(to, (start[0][row], start[1][row], start[2][row]))
        positions[0, k], positions[1, k], positions[2, k] = to
        radius[k], drift[k] = radii[row], np.sqrt(dot(displacement, displacement)) * _STEP_SLACK_FACTOR
