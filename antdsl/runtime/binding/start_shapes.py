"""The shapes that crowds have at the start: ranks, curves, borders, volumes and clumps. Also the directions that agents face.

Positions and directions are for the current frame, because curves, surfaces and items may move."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import elementary
from antdsl.numerics import vectors as vec
from antdsl.numerics.vector_rows import normalise
from antdsl.runtime.binding.border_edges import BorderEdges, find_border_edges
from antdsl.runtime.world import World
from antdsl.scene.crowds.crowd_data import CrowdData, PlacementData, RanksData, VolumeData

Ids = NDArray[np.int64]
Floats = NDArray[np.float64]
Draw = Callable[[int], NDArray[np.float32]]  # draw number k of each agent, in [0, 1)
FULL_TURN = np.float32(2 * np.pi)
_PAIRS_PER_BLOCK = 1 << 20  # pairs of position and edge that are measured at once


def resolve_placement(world: World, place: PlacementData) -> PlacementData:
    """Return a place with its centre at the current position of the item that the scene names as the centre."""
    centre = place.centre_item
    if centre is None or centre.items not in world.setting.motion.items or centre.items not in world.items:
        return place
    x, y, z = (world.items[centre.items].position[centre.index] + world.origin).tolist()
    return replace(place, disc_centre=(x, y, z))


def has_placement_shape(place: PlacementData) -> bool:
    """Return whether the shape of a place is one of those in this module."""
    return any(part is not None for part in (place.ranks, place.curve_name, place.border_surface, place.volume, place.clumps))


def draw_shape_points(world: World, place: PlacementData, numbers: Ids, draw: Draw) -> Floats:
    """Return positions (n, 3; mm) on a line or an edge, in a volume or in ranks. They are relative to the world's origin.

    `numbers`: the number of each agent in its crowd line. `draw`: returns random numbers by their index."""
    if place.ranks is not None:
        return _compute_rank_positions(world, place, place.ranks, numbers)
    if place.volume is not None:
        return _draw_in_volume(place.volume, draw) - world.origin
    start, end = _find_curve_segments(world, place)
    step = end - start
    length = np.cumsum(np.sqrt((step * step).sum(axis=1)))
    if not len(length) or not length[-1] > 0:
        return np.broadcast_to(start[:1] if len(start) else np.zeros((1, 3)), (len(numbers), 3)).copy()
    along = draw(0).astype(np.float64) * length[-1]
    piece = np.minimum(np.searchsorted(length, along, side="right"), len(length) - 1)
    part = 1.0 - (length[piece] - along) / np.maximum(np.diff(length, prepend=0.0)[piece], 1e-300)
    points: Floats = start[piece] + np.clip(part, 0.0, 1.0)[:, None] * step[piece]
    return points if place.radius is None else points + draw_points_in_disc(world, place.radius, draw(1), draw(2))


def draw_points_in_disc(world: World, radius: float, u: NDArray[np.float32], v: NDArray[np.float32]) -> Floats:
    """Return offsets (n, 3; mm) from the centre of a horizontal disc, spread evenly over it. `u`, `v`: random numbers."""
    away, angle = np.sqrt(u).astype(np.float64) * radius, v * FULL_TURN
    up = vec.split_columns(np.broadcast_to(world.up, (len(u), 3)), np.float64)
    side = vec.find_perpendicular(up)
    ahead = vec.cross(up, side)
    return vec.stack_rows(vec.add(vec.scale(side, away * elementary.cos(angle)), vec.scale(ahead, away * elementary.sin(angle))))


def _draw_in_volume(volume: VolumeData, draw: Draw) -> Floats:
    u, v, w = (draw(k).astype(np.float64) for k in range(3))
    low: Floats = np.asarray(volume.low, np.float64)
    if volume.radius <= 0:
        return low + np.stack([u, v, w], axis=1) * (np.asarray(volume.high, np.float64) - low)
    height = 1.0 - 2.0 * u  # evenly distributed directions (Archimedes' hat-box theorem)
    flat, angle = np.sqrt(np.maximum(1.0 - height * height, 0.0)), draw(1) * FULL_TURN
    direction = np.stack([flat * elementary.cos(angle), height, flat * elementary.sin(angle)], axis=1)
    away = elementary.power(draw(2), np.float32(1 / 3)).astype(np.float64)
    points: Floats = low + direction * (away * volume.radius)[:, None]
    return points


def _find_curve_segments(world: World, place: PlacementData) -> tuple[Floats, Floats]:
    """Return the start and the end (m, 3) of each straight segment of the place's curve or border."""
    if place.curve_name is not None:
        samples = world.curves[place.curve_name].samples
        return (samples[:-1], samples[1:]) if len(samples) > 1 else (samples, samples)
    border = _find_surface_border(world, place)
    return border.start_points, border.end_points


def _find_surface_border(world: World, place: PlacementData) -> BorderEdges:
    """Return the edges of the open border of the place's surface; no edges if it has no border."""
    meshes = world.ground.meshes
    none = np.empty((0, 3))
    if meshes is None or place.border_surface not in meshes.names:
        return BorderEdges(none, none, none)
    return find_border_edges(meshes, meshes.triangles[2] == meshes.names.index(place.border_surface))


def _compute_rank_positions(world: World, place: PlacementData, ranks: RanksData, numbers: Ids) -> Floats:
    """Return the positions of agents in ranks. The first rank is in front, and the ranks are centred at the place."""
    middle = np.asarray(place.disc_centre or (0.0, 0.0, 0.0), np.float64) - world.origin
    up, facing = world.up, place.facing
    ahead = np.array([1.0, 0.0, 0.0]) if abs(up[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    if facing is not None:
        vector = np.asarray(facing.vector, np.float64)
        ahead = vector - world.origin - middle if facing.kind == "point" else vector
    flat = ahead - ((ahead[0] * up[0] + ahead[1] * up[1]) + ahead[2] * up[2]) * up
    ahead = normalise(flat[None])[0]
    right = np.cross(ahead, up)
    row, column = numbers // ranks.columns, numbers % ranks.columns
    across = (column - (ranks.columns - 1) / 2) * ranks.spacing_within
    back = ((ranks.rows - 1) / 2 - row) * ranks.spacing_between
    points: Floats = middle + across[:, None] * right + back[:, None] * ahead
    return points


def compute_facing(world: World, crowd: CrowdData, position: Floats) -> Floats | None:
    """Return the direction (n, 3) that each agent of a line faces at its position; 0 for agents without a direction.

    None if the scene sets no direction, so that headings are random."""
    place = resolve_placement(world, crowd.place)
    facing = place.facing
    if facing is None:
        return None
    vector = np.asarray(facing.vector, np.float64)
    if facing.kind == "direction":
        return np.broadcast_to(vector, position.shape)
    if facing.kind == "point":
        return vector - world.origin - position
    if place.border_surface is not None:
        border = _find_surface_border(world, place)
        nearest = _find_nearest_edges(border, position)
        if nearest is None:
            return np.zeros_like(position)
        directions = border.end_points - border.start_points if facing.kind == "along" else border.inward_direction
        return directions[nearest] * (-1.0 if facing.kind == "out" else 1.0)
    if place.curve_name is not None:
        closest = world.curves[place.curve_name].find_closest(*position.T)
        if facing.kind == "along":
            return np.stack([closest.tx, closest.ty, closest.tz], axis=1).astype(np.float64)
        centre = np.stack([closest.px, closest.py, closest.pz], axis=1).astype(np.float64)
    else:
        centre = np.broadcast_to(_find_placement_centre(place) - world.origin, position.shape)
    return (position - centre) * (1.0 if facing.kind == "out" else -1.0)


def _find_placement_centre(place: PlacementData) -> Floats:
    if place.volume is not None:
        low, high = (np.asarray(corner, np.float64) for corner in (place.volume.low, place.volume.high))
        return low if place.volume.radius > 0 else (low + high) / 2
    return np.asarray(place.disc_centre or place.ray_origin or (0.0, 0.0, 0.0), np.float64)


def _find_nearest_edges(border: BorderEdges, position: Floats) -> NDArray[np.intp] | None:
    """Return the index of the edge nearest to each position. None if there are no edges."""
    if not len(border.start_points):
        return None
    step = border.end_points - border.start_points
    square = np.maximum((step * step).sum(axis=1), 1e-300)
    nearest = np.empty(len(position), np.intp)
    rows = max(1, _PAIRS_PER_BLOCK // len(step))
    for begin in range(0, len(position), rows):
        away = position[begin : begin + rows, None, :] - border.start_points
        part = np.clip((away * step).sum(axis=2) / square, 0.0, 1.0)
        rest = away - part[:, :, None] * step
        nearest[begin : begin + rows] = (rest * rest).sum(axis=2).argmin(axis=1)
    return nearest
