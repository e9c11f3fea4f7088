"""Outlines of things as seen from above, in current and later frames. Outlines of meshes are convex polygons, those of items and
agents are circles, and those of cameras are points."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.vector_rows import find_rows_in_box
from antdsl.runtime.moving.moving_geometry import compute_vertices
from antdsl.runtime.notes.targets import find_target_camera
from antdsl.runtime.sensing.selectable_agents import collect_selectable_frame
from antdsl.runtime.sensing.sensed_camera import SensedCamera
from antdsl.runtime.world import World
from antdsl.scene.notes.selection import select_rows
from antdsl.scene.notes.selectors import AgentName, AnySelector

Floats = NDArray[np.float64]
_PAIRS_PER_BLOCK = 1 << 18  # pairs of a point and an edge that are measured at once


class WidenedPolygon(NamedTuple):
    """A convex polygon in the ground's two axes, with corners (k, 2) mm in order, widened by `margin` mm.

    One or two corners stand for a point or a line."""

    corners: Floats
    margin: float


def find_outlines_of_thing(world: World, thing: AnySelector, frame: int) -> list[WidenedPolygon]:
    """Return the outlines of a mesh, items, a camera or agents at a frame. For agents, positions are extrapolated from
    velocities. All other outlines are cached, because later steps need the same frames."""
    assert world.notes is not None
    if find_agents_in_thing(world, thing):
        return _predict_outlines_of_agents(world, thing, frame)
    assert isinstance(thing, AgentName)
    name = thing.name
    cache, key = world.notes.outlines, (name, frame if is_thing_moving(world, thing) else 0)
    if key not in cache:
        for old in [each for each in cache if each[1] < world.frame]:
            del cache[old]
        cache[key] = _compute_outlines_of_obstacle(world, name, frame)
    return cache[key]


def find_agents_in_thing(world: World, thing: AnySelector) -> Mapping[str, NDArray[np.bool_]]:
    """Return, by species, a mask of the agents of which a thing consists. Empty for meshes, items and cameras."""
    setting, name = world.setting, thing.name if isinstance(thing, AgentName) and thing.first is None else ""
    items = (each for group, members in setting.items.items() for each in (group, *(item.name for item in members)))
    if name and (name in setting.obstacles or name in setting.surfaces or name in items or _find_camera_of_thing(world, thing)):
        return {}
    return select_rows(thing, collect_selectable_frame(world))


def is_thing_moving(world: World, thing: AnySelector) -> bool:
    """Return whether a thing may have other positions in other frames."""
    camera = _find_camera_of_thing(world, thing)
    return camera.data.is_moving if camera is not None else bool(world.setting.motion or find_agents_in_thing(world, thing))


def _find_camera_of_thing(world: World, thing: AnySelector) -> SensedCamera | None:
    return find_target_camera(world, thing) if isinstance(thing, AgentName) else None


def _predict_outlines_of_agents(world: World, thing: AnySelector, frame: int) -> list[WidenedPolygon]:
    axes, seconds = find_horizontal_axes(world), max(frame - world.frame, 0) * world.dt
    outlines = []
    for name, mask in find_agents_in_thing(world, thing).items():
        population, rows = world.populations[name], np.flatnonzero(mask)
        places = population.position[rows] + population.read_vector("velocity")[rows].astype(np.float64) * seconds
        radii = population.now["radius"][rows].tolist()
        outlines += [WidenedPolygon(place[None, axes], radius) for place, radius in zip(places, radii, strict=True)]
    return outlines


def _compute_outlines_of_obstacle(world: World, name: str, frame: int) -> list[WidenedPolygon]:
    axes = find_horizontal_axes(world)
    setting = world.setting
    if name in setting.obstacles or name in setting.surfaces:
        return [WidenedPolygon(_compute_convex_hull(compute_vertices(world, name, frame)[:, axes]), 0.0)]
    camera = find_target_camera(world, AgentName(name))
    if camera is not None:
        return [WidenedPolygon(camera.find_position(frame)[None, axes], 0.0)]
    outlines = []
    for group, items in setting.items.items():
        tracks = setting.motion.items.get(group)
        for k, item in enumerate(items):
            if name in (group, item.name):
                position = item.position if tracks is None else setting.motion.find_positions(tracks, frame)[k]
                outlines.append(WidenedPolygon((np.asarray(position) - world.origin)[None, axes], item.radius))
    return outlines


def find_horizontal_axes(world: World) -> NDArray[np.intp]:
    """Return the two axes along the ground: x and z, or x and y. Up is the third."""
    return np.flatnonzero(np.arange(3) != int(np.abs(world.up).argmax()))


def compute_outline_centre(world: World, outlines: list[WidenedPolygon]) -> Floats:
    """Return the centre (3,) of outlines along the ground's axes. Its component along the world's up is 0."""
    centre = np.zeros(3)
    centre[find_horizontal_axes(world)] = (
        np.mean([outline.corners.mean(axis=0) for outline in outlines], axis=0) if outlines else 0.0
    )
    return centre


def measure_distances_to_outlines(
    world: World, outlines: list[WidenedPolygon], position: Floats, reach: float
) -> tuple[Floats, Floats]:
    """Return the distance (n,) mm of each position (n, 3) from the nearest outline, negative inside, and the direction out of the
    outline (n, 3). Beyond `reach` (mm), the distance is inf."""
    axes = find_horizontal_axes(world)
    nearest, outward = np.full(len(position), np.inf), np.zeros((len(position), 3))
    for outline in outlines:
        far = outline.margin + reach
        low, high = np.full(3, -np.inf), np.full(3, np.inf)
        low[axes], high[axes] = outline.corners.min(axis=0) - far, outline.corners.max(axis=0) + far
        every = find_rows_in_box(position, low, high)
        for first in range(0, len(every), max(1, _PAIRS_PER_BLOCK // len(outline.corners))):
            rows = every[first : first + max(1, _PAIRS_PER_BLOCK // len(outline.corners))]
            distance, out = _measure_distances_to_polygon(outline.corners, position[np.ix_(rows, axes)])
            distance -= outline.margin
            nearer = np.flatnonzero(distance < nearest[rows])
            nearest[rows[nearer]] = distance[nearer]
            outward[np.ix_(rows[nearer], axes)] = out[nearer]
    return np.where(nearest <= reach, nearest, np.inf), outward


def _compute_convex_hull(points: Floats) -> Floats:
    """Return the corners of the convex hull of points (n, 2), counter-clockwise. Source: A. M. Andrew, Another efficient
    algorithm for convex hulls in two dimensions, IPL 1979."""
    ordered = np.unique(points, axis=0)
    chains = []
    for chain_points in (ordered, ordered[::-1]):
        chain: list[tuple[float, float]] = []
        for x, y in chain_points.tolist():
            while len(chain) > 1 and _is_right_turn(chain[-2], chain[-1], (x, y)):
                chain.pop()
            chain.append((x, y))
        chains += chain[:-1] if len(ordered) > 1 else chain[:1]
    return np.array(chains).reshape(-1, 2)


def _is_right_turn(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> bool:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) <= 0


def _measure_distances_to_polygon(corners: Floats, points: Floats) -> tuple[Floats, Floats]:
    """Return the distance (n,) of each point (n, 2) from a convex polygon, negative inside, and the direction outwards (n, 2)."""
    edge = np.roll(corners, -1, axis=0) - corners
    square = edge[:, 0] * edge[:, 0] + edge[:, 1] * edge[:, 1]
    divisor = np.where(square > 0, square, 1.0)
    x, y = (points[:, None, k] - corners[:, k] for k in range(2))
    share = np.clip((x * edge[:, 0] + y * edge[:, 1]) / divisor, 0.0, 1.0)
    away_x, away_y = x - share * edge[:, 0], y - share * edge[:, 1]
    distances = np.sqrt(away_x * away_x + away_y * away_y)
    size = np.sqrt(divisor)
    depths = (x * edge[:, 1] - y * edge[:, 0]) / size
    rows, nearest, shallowest = np.arange(len(points)), distances.argmin(axis=1), depths.argmax(axis=1)
    distance, depth = distances[rows, nearest], depths[rows, shallowest]
    out = np.stack([away_x[rows, nearest], away_y[rows, nearest]], axis=1) / np.where(distance > 0, distance, np.inf)[:, None]
    inner = (np.stack([edge[:, 1], -edge[:, 0]], axis=1) / size[:, None])[shallowest]
    is_inside = (depth <= 0) & (len(corners) > 2)
    return np.where(is_inside, depth, distance), np.where(is_inside[:, None], inner, out)
