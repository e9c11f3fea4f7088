"""Moves the moving things of a world to a frame, together with the agents that they carry or push.

All results depend only on the frame and on the agents' positions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.curves import SampledCurve
from antdsl.casting.rays import RayScene
from antdsl.ground.moving import FaceAxes, MovingGround
from antdsl.ground.protocol import Footing, GroundMove
from antdsl.numerics import vectors as vec
from antdsl.numerics.vectors import VectorArrays
from antdsl.runtime.moving.obstacles import get_obstacle_scene
from antdsl.runtime.periodic_world import wrap_world
from antdsl.runtime.world import AXES, Population, World

_CURVE_SPACING_MM = 1.0  # queries for the nearest point and direction split a curve into pieces of this length
_OBSTACLE_MARGIN_SHARE = np.float32(0.5)  # share of the radius that a moving obstacle keeps from an agent's centre
_MAX_PUSH_DIRECTIONS = 4  # directions tried per step to leave an obstacle
_F = np.float32


def move_geometry(world: World) -> None:
    """Move all moving things to the next frame. Agents move with their ground, and then out of obstacles that have reached
    them. In a periodic world, agents that have left the box are first moved back into it."""
    wrap_world(world)
    if not world.setting.motion:
        return
    ground = get_moving_ground(world)
    standing = [(p, *_find_agents_on_moving_ground(ground, p)) for p in world.populations.values() if len(p)]
    pose_geometry(world, world.frame + 1)
    for population, rows, previous_axes in standing:
        if ground is not None and previous_axes is not None and len(rows):
            _carry_agents_with_ground(ground, population, rows, previous_axes)
    for name in world.plan.obstacles:
        if name in world.setting.motion.meshes and name in world.obstacles:
            for population, _, _ in standing:
                _push_agents_out_of_obstacle(world, population, name)


def pose_geometry(world: World, frame: int) -> None:
    """Move all moving things to their positions at a frame of the scene. Agents retain their footing and position."""
    moves = world.setting.motion
    if not moves:
        return
    set_ground_pose(world, frame)
    for name in moves.meshes:
        if name in world.obstacles:
            world.obstacles[name] = _make_ray_scene(world, name, frame)
            if world.detail_levels is not None and name in world.setting.obstacles:
                world.detail_levels.update_boxes(name, compute_vertices(world, name, frame))
    for name, tracks in moves.items.items():
        if name in world.items:
            items = world.items[name]
            items.position = moves.find_positions(tracks, frame) - world.origin
            for k, axis in enumerate(AXES):
                items.visible_values[axis] = items.position[:, k].astype(np.float32)
    for name, tracks in moves.curves.items():
        if name in world.curves:
            world.curves[name] = make_sampled_curve(moves.find_positions(tracks, frame) - world.origin)
    world.clearances.clear()


def get_moving_ground(world: World) -> MovingGround | None:
    """Return the ground if it consists of meshes and some of them move, else None."""
    meshes = world.ground.meshes
    return meshes if isinstance(meshes, MovingGround) else None


def set_ground_pose(world: World, frame: int) -> None:
    """Move only the ground to a frame, without updating the scenes for raycasts. This suffices for callers that read a world but
    cast no rays."""
    ground = get_moving_ground(world)
    if ground is not None:
        moved = [name for name in world.setting.motion.meshes if name in world.setting.surfaces]
        ground.set_mesh_vertices({name: compute_vertices(world, name, frame) for name in moved})


def compute_vertices(world: World, name: str, frame: int) -> NDArray[np.float64]:
    """Return the vertices of the mesh `name` at a frame of the scene, in the world's coordinates."""
    moves, setting = world.setting.motion, world.setting
    mesh = setting.surfaces[name] if name in setting.surfaces else setting.obstacles[name]
    if name not in moves.meshes:
        return mesh.vertices - world.origin
    return moves.meshes[name].compute_vertices(mesh.vertices, frame - moves.first) - world.origin


def make_sampled_curve(points: NDArray[np.float64]) -> SampledCurve:
    """Return a curve through `points`, sampled for nearest-point queries."""
    return SampledCurve(points, _CURVE_SPACING_MM)


def measure_ground_velocity(world: World, population: Population) -> NDArray[np.float64] | None:
    """Return the velocities (n, 3) mm/s, in the last step, of the ground points below agents. Return None if no ground moves."""
    ground, moves = get_moving_ground(world), world.setting.motion
    if ground is None:
        return None
    speed = np.zeros((len(population), 3))
    footing = population.footing
    for number, name in enumerate(ground.names):
        rows = np.flatnonzero(footing.mesh == number) if name in moves.meshes else np.empty(0, np.int64)
        if len(rows):
            corner = world.setting.surfaces[name].faces[footing.face[rows]]
            displacement = compute_vertices(world, name, world.frame) - compute_vertices(world, name, world.frame - 1)
            a, b, c = (displacement[corner[:, k]] for k in range(3))
            b1, b2 = footing.b1[rows, None], footing.b2[rows, None]
            speed[rows] = (a + b1 * (b - a) + b2 * (c - a)) / world.dt
    return speed


def compute_agent_rest_positions(world: World, population: Population) -> NDArray[np.float64]:
    """Return the rest positions (n, 3) mm of the ground points below agents. Fields define their cells at rest positions."""
    return compute_rest_positions(world, population.footing, population.position)


def compute_rest_positions(world: World, footing: Footing, place: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rest positions (n, 3) mm of ground points. `footing`: the points as footings. `place` (n, 3) mm: their current
    positions."""
    ground = get_moving_ground(world)
    if ground is None:
        return place
    place = place.copy()
    rows = ground.find_rows_on_moving_meshes(footing.mesh)
    place[rows] = ground.compute_rest_positions(footing.select_rows_on_meshes(rows))
    return place


def rotate_from_rest(world: World, population: Population, rows: NDArray[np.intp] | slice, vectors: VectorArrays) -> VectorArrays:
    """Rotate vectors near agents from the rest pose of the ground to its current pose. `vectors`, and the result: three float32
    arrays."""
    ground = get_moving_ground(world)
    if ground is None:
        return vectors
    on = ground.find_rows_on_moving_meshes(population.footing.mesh[rows])
    if not len(on):
        return vectors
    footing = population.footing.select_rows_on_meshes(np.arange(len(population))[rows][on])
    turned = _rotate_vectors(
        ground.compute_rest_axes(footing),
        ground.compute_axes(footing),
        np.stack([np.asarray(v, np.float64)[on] for v in vectors]),
    )
    turned_vectors = vec.copy(vectors)
    for component, value in zip(turned_vectors, turned, strict=True):
        component[on] = value
    return turned_vectors


def move_from_rest(world: World, population: Population, rows: NDArray[np.intp] | slice, positions: VectorArrays) -> VectorArrays:
    """Return the current positions of points near agents. `positions`: the points (mm) as they are while the ground is in its
    rest pose. Arguments and results are three float32 arrays. All ground near an agent is assumed to have moved with the agent's
    own face."""
    ground = get_moving_ground(world)
    if ground is None:
        return positions
    on = ground.find_rows_on_moving_meshes(population.footing.mesh[rows])
    if not len(on):
        return positions
    standing = population.footing.select_rows_on_meshes(np.arange(len(population))[rows][on])
    rest_points = np.stack([np.asarray(p, np.float64)[on] for p in positions])
    away = _rotate_vectors(
        ground.compute_rest_axes(standing), ground.compute_axes(standing), rest_points - ground.compute_rest_positions(standing).T
    )
    current_positions = vec.copy(positions)
    for component, value in zip(current_positions, ground.position(standing).T + away, strict=True):
        component[on] = value
    return current_positions


def _make_ray_scene(world: World, name: str, frame: int) -> RayScene:
    setting = world.setting
    mesh = setting.surfaces[name] if name in setting.surfaces else setting.obstacles[name]
    return RayScene(compute_vertices(world, name, frame), mesh.faces, is_short_lived=True)


def _find_agents_on_moving_ground(
    ground: MovingGround | None, population: Population
) -> tuple[NDArray[np.intp], FaceAxes | None]:
    """Return the rows of agents on moving ground, and the axes of their faces before the ground moves."""
    if ground is None:
        return np.empty(0, np.intp), None
    rows = ground.find_rows_on_moving_meshes(population.footing.mesh)
    return rows, ground.compute_axes(population.footing.select_rows_on_meshes(rows))


def _carry_agents_with_ground(
    ground: MovingGround, population: Population, rows: NDArray[np.intp], previous_axes: FaceAxes
) -> None:
    """After the ground has moved, move and rotate agents along with their face. This changes position, up, heading
    and velocity."""
    footing = population.footing.select_rows_on_meshes(rows)
    next_axes = ground.compute_axes(footing)
    now = population.now
    turned = {
        name: _rotate_vectors(previous_axes, next_axes, _read_vectors(population, name, rows))
        for name in ("up", "heading", "velocity")
    }
    up = np.ascontiguousarray(ground.compute_upright_normals(footing, turned["up"].T).T)
    heading = turned["heading"] - up * (turned["heading"] * up).sum(axis=0)
    size = np.sqrt((heading * heading).sum(axis=0))
    turned["heading"] = np.where(size > 1e-12, heading / np.where(size > 0, size, 1.0), turned["heading"])
    turned["up"] = up
    place = ground.position(footing)
    population.position[rows] = place
    turned["position"] = place.T
    for name, value in turned.items():
        for axis, component in zip(AXES, value, strict=True):
            now[f"{name}.{axis}"][rows] = component


def _rotate_vectors(previous_axes: FaceAxes, next_axes: FaceAxes, v: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the vectors `v` (3, n) rotated from one frame to another: along `next_axes`, the results have the components that
    `v` has along `previous_axes`."""
    parts = [(a[0] * v[0] + a[1] * v[1]) + a[2] * v[2] for a in previous_axes]
    turned: NDArray[np.float64] = (parts[0] * next_axes[0] + parts[1] * next_axes[1]) + parts[2] * next_axes[2]
    return turned


def _read_vectors(population: Population, name: str, rows: NDArray[np.intp]) -> NDArray[np.float64]:
    return np.stack([population.now[f"{name}.{axis}"][rows] for axis in AXES]).astype(np.float64)


def _push_agents_out_of_obstacle(world: World, population: Population, name: str) -> None:
    """Move agents out of an obstacle that has reached them. They walk away from its nearest face until they keep their margin."""
    scene, now = get_obstacle_scene(world, name), population.now
    place = vec.get_vector_registers(now, "position")
    margin = np.maximum(now["radius"], _F(0)) * _OBSTACLE_MARGIN_SHARE
    rows = np.flatnonzero(scene.measure_clearance(*place) <= margin)
    for _ in range(_MAX_PUSH_DIRECTIONS):
        if not len(rows):
            return
        gap, out = scene.measure_signed_distances(*vec.take_rows(place, rows), margin[rows], world.options.threads)
        need = margin[rows] - gap
        pressed_rows = np.flatnonzero(need > _F(1e-4) * np.maximum(margin[rows], _F(1e-6)))
        if not len(pressed_rows):
            return
        rows, need = rows[pressed_rows], need[pressed_rows]
        up, heading = (
            vec.take_rows(vec.get_vector_registers(now, "up"), rows),
            vec.take_rows(vec.get_vector_registers(now, "heading"), rows),
        )
        away = vec.project_to_plane((out[0][pressed_rows], out[1][pressed_rows], out[2][pressed_rows]), up)
        level = vec.length(away)
        # a face directly above gives no direction along the ground: use the heading
        away = vec.normalise_or_fallback(away, heading)
        far = need / np.maximum(level, _F(0.25))
        moved = world.ground.move(
            population.footing.select_rows(rows),
            vec.stack_rows(vec.scale(away, far)),
            vec.stack_rows(heading),
            vec.stack_rows(up),
            now["size"][rows].astype(np.float64),
            world.options.threads,
        )
        _apply_move(population, rows, moved)


def _apply_move(population: Population, rows: NDArray[np.intp], move: GroundMove) -> None:
    """Move the agents at `rows` to the positions of `move`, and project their velocity onto the ground there."""
    footing = population.footing.copy()  # a copy: a snapshot may share the previous footing
    footing.write_rows(rows, move.footing)
    population.footing = footing
    population.position[rows] = move.position
    velocity = _read_vectors(population, "velocity", rows)
    up = np.asarray(move.up).T
    flat = velocity - up * (velocity * up).sum(axis=0)
    for name, value in (("position", move.position.T), ("up", up), ("heading", move.heading.T), ("velocity", flat)):
        for axis, component in zip(AXES, value, strict=True):
            population.now[f"{name}.{axis}"][rows] = component
