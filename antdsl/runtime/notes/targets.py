"""Targets of notes: points, items, agents, cameras, meshes and curves, relative to the world's origin."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.curves import SampledCurve
from antdsl.casting.obstacle import Obstacle
from antdsl.numerics.vector_rows import length
from antdsl.runtime.moving.moving_geometry import compute_vertices, make_sampled_curve
from antdsl.runtime.notes.active_notes import NotedAgents
from antdsl.runtime.sensing.selectable_agents import collect_selectable_frame
from antdsl.runtime.sensing.sensed_camera import SensedCamera
from antdsl.runtime.world import World
from antdsl.scene.notes.notes_model import PathNote
from antdsl.scene.notes.selection import select_rows
from antdsl.scene.notes.selectors import AgentName
from antdsl.scene.quantities import Quantity
from antdsl.scene.thing_models import convert_point
from antdsl.scene.values import PointValue

Floats = NDArray[np.float64]
_DROP_RAY_START_MM = 1e9  # mm, within which meshes are found


class TargetPoints(NamedTuple):
    """A target that consists of points (k, 3) in mm. `radii` (k,): the distance (mm) from each point that counts as reached."""

    points: Floats
    radii: Floats

    def find_nearest(self, position: Floats) -> tuple[Floats, Floats]:
        """Return the offset (n, 3) from each position to the nearest point, and the distance (n,) to the sphere with its radius
        (mm).

        Without points, offsets are 0 and distances nan."""
        if not len(self.points):
            return np.zeros_like(position), np.full(len(position), np.nan)
        from scipy.spatial import cKDTree

        nearest = cKDTree(self.points).query(position)[1]
        offset = self.points[nearest] - position
        return offset, np.maximum(length(offset) - self.radii[nearest], 0.0)


class NearestOnMesh(NamedTuple):
    """A target that is a mesh. Agents go to the point of the mesh nearest to them."""

    mesh: Obstacle

    def find_nearest(self, position: Floats) -> tuple[Floats, Floats]:
        """Return the offset (n, 3) from each position to the nearest point of the mesh, and its length (n,) in mm."""
        x, y, z = position.T
        hits = self.mesh.find_nearest_within(x, y, z, _DROP_RAY_START_MM)
        distance = np.where(hits.hit, hits.t, np.nan).astype(np.float64)
        return -np.stack([hits.nx, hits.ny, hits.nz], axis=1).astype(np.float64) * np.nan_to_num(distance)[:, None], distance


def find_ground_goal(world: World, target: PointValue | AgentName) -> TargetPoints | NearestOnMesh:
    """Return a target to which agents walk. Points and cameras are projected onto the ground. For a mesh, it is the nearest
    point."""
    mesh = find_target_mesh(world, target)
    if mesh is not None:
        return NearestOnMesh(world.obstacles[mesh])
    goal = find_target_points(world, target)
    is_ground_point = isinstance(target, AgentName) and find_target_camera(world, target) is None
    return goal if is_ground_point else TargetPoints(project_points_to_ground(world, goal.points), goal.radii)


def project_points_to_ground(world: World, points: Floats) -> Floats:
    """Project points (k, 3) onto the highest ground above or below them. Without such ground, return the nearest ground point."""
    return world.ground.position(world.ground.place_points(points, world.up)[0])


def find_target_points(world: World, target: PointValue | AgentName) -> TargetPoints:
    """Return the points of a target at the start of the step. A mesh is represented by its centre."""
    if not isinstance(target, AgentName):
        point = np.array([convert_point(target, world.setting.unit_mm)], np.float64) - world.origin
        return TargetPoints(point, np.zeros(1))
    items, camera, mesh = find_item_points(world, target.name), find_target_camera(world, target), find_target_mesh(world, target)
    if target.first is None and len(items.points):
        return items
    if camera is not None:
        return TargetPoints(camera.find_position(world.display_frame)[None], np.zeros(1))
    if mesh is not None:
        vertices = compute_vertices(world, mesh, world.display_frame)
        return TargetPoints((vertices.min(axis=0) + vertices.max(axis=0))[None] / 2, np.zeros(1))
    masks = select_rows(target, collect_selectable_frame(world))
    parts = [(world.populations[name], mask) for name, mask in masks.items()]
    return TargetPoints(
        np.concatenate([np.empty((0, 3)), *(p.position[mask] for p, mask in parts)]),
        np.concatenate([np.empty(0), *(p.start["radius"][mask].astype(np.float64) for p, mask in parts)]),
    )


def find_target_camera(world: World, target: PointValue | AgentName) -> SensedCamera | None:
    """Return the camera that a target names. None if it is a point, or if agents or items have the same name."""
    name = _find_name_of_other_target(world, target)
    return SensedCamera(world.setting.cameras[name], world.origin) if name in world.setting.cameras else None


def find_target_mesh(world: World, target: PointValue | AgentName) -> str | None:
    """Return the name of the mesh that a target names. None if it names no mesh, or if agents, items or a camera have this
    name."""
    name = _find_name_of_other_target(world, target)
    is_mesh = name in world.setting.obstacles or name in world.setting.surfaces
    return name if is_mesh and name not in world.setting.cameras else None


def _find_name_of_other_target(world: World, target: PointValue | AgentName) -> str:
    """Return the name of a target that is neither a point nor the name of agents or items; otherwise an empty text."""
    if not isinstance(target, AgentName) or target.first is not None:
        return ""
    lines = (crowd.name for crowd in world.setting.crowds)
    is_taken = target.name in world.populations or target.name in lines or len(find_item_points(world, target.name).points)
    return "" if is_taken else target.name


def find_item_points(world: World, name: str) -> TargetPoints:
    """Return the positions and radii of the item, or of all items, with this name."""
    for items_name, items in world.items.items():
        rows = np.arange(len(items)) if items_name == name else np.flatnonzero([each == name for each in items.names])
        if len(rows):
            return TargetPoints(items.position[rows], items.visible_values["radius"][rows].astype(np.float64))
    return TargetPoints(np.empty((0, 3)), np.empty(0))


class TargetCentres(NamedTuple):
    """The centres of a region: points (k, 3) in mm, and by species a mask of the agents that are centres."""

    points: Floats
    is_centre: Mapping[str, NDArray[np.bool_]]


def find_ball_centres(world: World, around: Any) -> TargetCentres:
    """Return the centres of a ball `around` a point, items, a camera, or agents.

    Agents are those that a selector selects at the start of the step."""
    if isinstance(around, tuple) and not isinstance(around, AgentName) and isinstance(around[0], Quantity):
        return TargetCentres(np.array([convert_point(around, world.setting.unit_mm)], np.float64) - world.origin, {})
    if isinstance(around, AgentName) and around.first is None:
        items = find_item_points(world, around.name).points
        if len(items):
            return TargetCentres(items, {})
        camera = find_target_camera(world, around)
        if camera is not None:
            return TargetCentres(camera.find_position(world.display_frame)[None], {})
    masks = select_rows(around, collect_selectable_frame(world))
    parts = [world.populations[name].position[mask] for name, mask in masks.items()]
    return TargetCentres(np.concatenate([np.empty((0, 3)), *parts]), masks)


def make_note_curve(world: World, curve: str | tuple[PointValue, ...]) -> SampledCurve:
    """Return a curve of the scene at its current position, or a curve through the given points."""
    if isinstance(curve, str):
        return world.curves[curve]
    return make_sampled_curve(
        np.array([convert_point(point, world.setting.unit_mm) for point in curve], np.float64) - world.origin
    )


def make_note_line(world: World, line: str | tuple[PointValue | AgentName, ...]) -> SampledCurve | None:
    """Return a curve of the scene, or a line through the centres of targets. None if fewer than two targets exist."""
    if isinstance(line, str):
        return make_note_curve(world, line)
    groups = (find_target_points(world, target).points for target in line)
    points = [group.mean(axis=0) for group in groups if len(group)]
    return make_sampled_curve(np.array(points)) if len(points) > 1 else None


class PointPerAgent(NamedTuple):
    """A target with a separate point for each agent (n, 3) in mm, or with one point (1, 3) for all agents."""

    points: Floats

    def find_nearest(self, position: Floats) -> tuple[Floats, Floats]:
        """Return the offset (n, 3) from each position (n, 3) to the agent's point, and its length (n,) in mm."""
        offset = self.points - position
        return offset, length(offset)


def find_positions_along_curve(
    world: World, along: str | tuple[PointValue, ...], ranks: NDArray[np.int64], count: int
) -> PointPerAgent:
    """Return positions (n, 3) on the ground for agents with ranks (n,) along a curve, if `count` agents are spread evenly along
    it."""
    curve = make_note_curve(world, along)
    return PointPerAgent(project_points_to_ground(world, _interpolate_curve(curve, (ranks + 0.5) / max(count, 1) * curve.length)))


def rank_agents_along_curve(
    world: World, along: str | tuple[PointValue, ...], species: Sequence[NotedAgents]
) -> list[NDArray[np.int64]]:
    """Return the ranks (k,) of the agents along a curve, as one array per species. All species share one order.

    Agents are ordered by the nearest point of the curve, then by species and id."""
    from scipy.spatial import cKDTree

    counts = [len(agents.rows) for agents in species]
    position = np.concatenate([agents.population.position[agents.rows] for agents in species])
    ids, numbers = np.concatenate([agents.ids for agents in species]), np.repeat(np.arange(len(species)), counts)
    nearest = cKDTree(make_note_curve(world, along).samples).query(position)[1] if len(position) else np.empty(0, np.int64)
    ranks = np.empty(len(ids), np.int64)
    ranks[np.lexsort((ids, numbers, nearest))] = np.arange(len(ids))
    return np.split(ranks, np.cumsum(counts)[:-1])


def find_path_points(world: World, note: PathNote, ids: NDArray[np.int64], frame: int, delays: NDArray[np.int64]) -> Floats:
    """Return the ground points where the agents of a `path` note must be in a frame: (n, 3), or (1, 3) if it is one point for
    all.

    `delays` (n,): their delays. With a spacing, agents follow each other in the order of their ids. Agents for which the path has
    not begun are on its straight extension."""
    curve, (first, last) = make_note_curve(world, note.along), note.frames
    own_frames = np.full(1, frame) if note.delay_rule is None else frame - delays
    distance = np.clip((own_frames - first) / max(last - first, 1), 0.0, 1.0) * curve.length
    if note.spacing is not None:
        distance = distance - np.argsort(np.argsort(ids)) * note.spacing.to_millimetres(world.setting.unit_mm)
    return project_points_to_ground(world, _interpolate_curve(curve, distance))


def _interpolate_curve(curve: SampledCurve, distance: Floats) -> Floats:
    """Return the points (n, 3) of a curve at distances (n,) mm from its beginning. Beyond its ends, it continues straight."""
    last_segment = max(len(curve.samples) - 2, 0)
    at = distance / max(curve.length, 1e-9) * (last_segment + 1)
    segment = np.clip(np.floor(at), 0, last_segment).astype(np.intp)
    starts, ends = curve.samples[segment], curve.samples[np.minimum(segment + 1, len(curve.samples) - 1)]
    points: Floats = starts + (at - segment)[:, None] * (ends - starts)
    return points
