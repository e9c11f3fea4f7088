"""Positions of the world's items at each frame. Items are at points, on surfaces, on moving surfaces, or at points of a USD
file."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.elementary import atan2_float64
from antdsl.program.model import Dimension, TypeKind, WorldThing
from antdsl.scene import setting as setting_data
from antdsl.scene.looks import LAMP_LOOK_WORD
from antdsl.scene.staging.mesh_cache import cache_per_mesh
from antdsl.scene.staging.stage_things import compute_item_positions, follow_surface, list_simulated_frames, stage_usd_items
from antdsl.scene.staging.usd_values import UsdFile, read_in_base_units, warn_misspelled_names
from antdsl.scene.thing_models import ItemThing, LampThing, UsdThing

if TYPE_CHECKING:
    from antdsl.scene.staging.stage_scene import SceneStaging

DEFAULT_ITEM_RADIUS = 10.0  # mm


def place_items(
    staging: SceneStaging, name: str, value: UsdThing | LampThing | dict[str, ItemThing]
) -> tuple[setting_data.ItemData, ...] | None:
    """Return the items that the entry `name` of `world` defines, at the first frame. On failure, report an error and return None.

    Their motion is stored in `staging.item_tracks`."""
    if isinstance(value, UsdThing):
        return _place_usd_items(staging, name, value, staging.program.world[name])
    if isinstance(value, LampThing):
        return (_place_lamp(staging, name, value),)
    model = staging.scene.model
    dt = float(1 / model.fps)
    items, tracks = [], []
    for item, placing in value.items():
        track = _place_item(staging, name, item, placing)
        if track is None:
            continue
        radius = None if placing.radius is None else placing.radius.to_millimetres(model.unit_mm)
        attributes = {key: quantity.to_base_units(model.unit_mm, dt) for key, quantity in (placing.model_extra or {}).items()}
        position = to_point_tuple(track[0])
        radius = DEFAULT_ITEM_RADIUS if radius is None else radius
        items.append(setting_data.ItemData(item, position, radius, attributes, placing.look))
        tracks.append(track)
    frames = max((len(track) for track in tracks), default=1)
    if frames > 1:
        staging.item_tracks[name] = np.stack([np.broadcast_to(track, (frames, 3)) for track in tracks], axis=1)
    return tuple(items)


def _place_lamp(staging: SceneStaging, name: str, thing: LampThing) -> setting_data.ItemData:
    """Return a lamp at the first frame, as the only item with its name. Its motion is stored in `staging.item_tracks`."""
    track = compute_item_positions(staging, name, None, thing)
    if len(track) > 1:
        staging.item_tracks[name] = track[:, None]
    radius = DEFAULT_ITEM_RADIUS if thing.radius is None else thing.radius.to_millimetres(staging.scene.model.unit_mm)
    return setting_data.ItemData(name, to_point_tuple(track[0]), radius, {}, LAMP_LOOK_WORD, thing.power, thing.colour)


def _place_item(staging: SceneStaging, name: str, item: str, thing: ItemThing) -> NDArray[np.float64] | None:
    """Return the position of an item at each frame (frames, 3), or at one frame if it is static.

    An item with `on` lies on the surface, even if the surface moves. With keys, it is dropped onto the surface at each key
    position. If it misses the surface, report an error and return None."""
    track = compute_item_positions(staging, name, item, thing)
    mesh = staging.surfaces.get(thing.on) if thing.on is not None else None
    if mesh is None or thing.on is None:
        return track
    moves, tall = staging.moves_by_mesh.get(thing.on), 1 if staging.scene.model.up == "y" else 2
    track = track.copy()
    for k, place in enumerate(track):
        frame_mesh = (
            mesh if moves is None or k == 0 else setting_data.MeshData(moves.compute_vertices(mesh.vertices, k), mesh.faces)
        )
        height = find_surface_height(frame_mesh, to_point_tuple(place), staging.scene.model.up)
        if height is None:
            words = f"`{item}` is neither above nor below `{thing.on}`"
            if k:
                words += f" at frame {list_simulated_frames(staging)[k]}"
            span = staging.scene.find_span("world", name, item, "keys" if k else "at")
            staging.report.error("off-surface", words, span, "move it, or leave out `on`")
            return None
        place[tall] = height
    return follow_surface(mesh, moves, to_point_tuple(track[0])) if moves is not None and not thing.keys else track


def check_crowds(staging: SceneStaging, crowds: Sequence[setting_data.CrowdData]) -> None:
    """Warn about a crowd that would start where there is no surface. Its agents start at the nearest surface points instead."""
    for crowd in crowds:
        if crowd.count and is_away_from_surfaces(crowd.place, staging, staging.scene.model.up):
            words = f"there is no surface where `{crowd.species}` starts, so it starts at the nearest point"
            ball = ", write a larger `radius`" if crowd.place.is_by_area else ""
            help = f"move it with `around`{ball}, or check the `units` of the mesh"
            staging.report.warning("off-surface", words, staging.scene.find_span("crowd", crowd.line_index, "place"), help)


def is_away_from_surfaces(
    placement: setting_data.PlacementData, things: SceneStaging | setting_data.WorldSetting, up: str
) -> bool:
    """Return whether no surface is above or below the disc in which a crowd starts.

    For a placement by area, return instead whether no surface reaches into the ball in which the crowd starts. Without a disc or
    surfaces, return False."""
    if placement.disc_centre is None or placement.radius is None:
        return False
    grounds = {**things.surfaces, **{name: solid.mesh for name, solid in things.solids.items()}}
    usual = things.surfaces if placement.is_by_area and things.surfaces else grounds
    meshes = [grounds[name] for name in placement.surfaces or usual if name in grounds]
    axes = (0, 1, 2) if placement.is_by_area else (0, 2) if up == "y" else (0, 1)
    return len(meshes) > 0 and not any(_is_in_reach(mesh, placement.disc_centre, placement.radius, axes) for mesh in meshes)


@cache_per_mesh
def _is_in_reach(mesh: setting_data.MeshData, middle: setting_data.PointMm, radius: float, axes: tuple[int, ...]) -> bool:
    """Return whether a mesh reaches into a ball. `axes`: the axes in which distances are measured. If one axis is left out, the
    ball becomes an infinite cylinder along this axis."""
    faces = _find_near_faces(mesh, middle, axes, radius)
    corners = np.zeros((len(faces), 3, 3))
    corners[:, :, : len(axes)] = (mesh.vertices[:, axes] - np.array(middle)[list(axes)])[faces]
    square = radius * radius * (1.0 + 1e-12)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size, inside = (across * across).sum(axis=1), np.ones(len(faces), np.bool_)
    for k in range(3):
        start, edge = corners[:, k], corners[:, (k + 1) % 3] - corners[:, k]
        length = np.maximum((edge * edge).sum(axis=1), 1e-300)
        nearest = start + np.clip(-(start * edge).sum(axis=1) / length, 0.0, 1.0)[:, None] * edge
        if ((nearest * nearest).sum(axis=1) <= square).any():
            return True
        inside &= (np.cross(edge, -start) * across).sum(axis=1) >= 0
    height = (corners[:, 0] * across).sum(axis=1)
    return bool((inside & (size > 0) & (height * height <= square * size)).any())


def _place_usd_items(
    staging: SceneStaging, name: str, value: UsdThing, thing: WorldThing
) -> tuple[setting_data.ItemData, ...] | None:
    """Return points or empties of a USD file as items, or None after an error.

    The radius and each attribute are taken from the file if it has them, otherwise from `each`, otherwise from the defaults."""
    points = stage_usd_items(staging, name, value)
    if points is None:
        return None
    model = staging.scene.model
    dt = float(1 / model.fps)
    each = {key: quantity.to_base_units(model.unit_mm, dt) for key, quantity in (value.each.model_extra or {}).items()}
    radius = None if value.each.radius is None else value.each.radius.to_millimetres(model.unit_mm)
    own = {a.name: a.type.dimension for a in thing.attributes if a.type.kind is TypeKind.NUMBER}
    file = UsdFile(staging, value.usd, staging.scene.find_span("world", name, "usd"), points)
    columns = {key: read_in_base_units(file, key, dim) for key, dim in own.items()}
    wide = read_in_base_units(file, "radius", Dimension(length=1)) * abs(value.scale)
    for key, column in zip(_list_turn_attributes(value), _make_turn_columns(model.up, value, points.ahead), strict=True):
        columns[key] = np.where(np.isfinite(columns[key]), columns[key], column)
    warn_misspelled_names(file, name, [*own, "radius"])
    items = []
    for number, item in enumerate(points.names):
        attributes = {key: float(column[number]) for key, column in columns.items() if np.isfinite(column[number])}
        sizes = (points.radius[number], wide[number], DEFAULT_ITEM_RADIUS if radius is None else radius)
        size = next(float(size) for size in sizes if np.isfinite(size) and size > 0)
        items.append(
            setting_data.ItemData(item, to_point_tuple(points.positions[0, number]), size, {**each, **attributes}, value.look)
        )
    if len(points.positions) > 1:
        staging.item_tracks[name] = points.positions
    return tuple(items)


def _list_turn_attributes(value: UsdThing) -> tuple[str, ...]:
    return () if value.turn is None else value.turn if isinstance(value.turn, tuple) else (value.turn,)


def _make_turn_columns(up: str, value: UsdThing, ahead: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Return one column for each attribute in the key `turn`, with the directions `ahead` of the empties.

    Three attributes receive a unit vector. One attribute receives its angle from +x about the scene's up, counted to the left.
    Columns are nan for points without a direction. The angle is also nan if the direction is straight up or down."""
    if value.turn is None:
        return []
    size = np.sqrt((ahead[:, 0] * ahead[:, 0] + ahead[:, 1] * ahead[:, 1]) + ahead[:, 2] * ahead[:, 2])
    x, y, z = (np.where(size > 0, ahead[:, k] / np.where(size > 0, size, 1.0), np.nan) for k in range(3))
    if isinstance(value.turn, tuple):
        return [x, y, z]
    left = -z if up == "y" else y
    level = np.sqrt(x * x + left * left)
    return [np.where(level > 1e-6, atan2_float64(left, x), np.nan)]


def to_point_tuple(point: NDArray[np.float64]) -> setting_data.PointMm:
    """Return a point as three Python floats."""
    return float(point[0]), float(point[1]), float(point[2])


def _find_near_faces(
    mesh: setting_data.MeshData, point: setting_data.PointMm, axes: Sequence[int], reach: float = 0.0
) -> NDArray[np.int32]:
    """Return the faces (m, 3) of which the bounding box comes within about `reach` (mm) of a point. `axes`: the axes along which
    this is tested."""
    near = np.ones(len(mesh.faces), np.bool_)
    for axis in axes:
        a, b, c = (np.ascontiguousarray(mesh.vertices[:, axis])[mesh.faces[:, k]] for k in range(3))
        low, high = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
        slack = 1e-6 * (high - low) + reach
        near &= (low - slack <= point[axis]) & (point[axis] <= high + slack)
    faces: NDArray[np.int32] = mesh.faces[near]
    return faces


@cache_per_mesh
def find_surface_height(mesh: setting_data.MeshData, point: setting_data.PointMm, up: str) -> float | None:
    """Return the highest coordinate of a mesh on the vertical line through a point, or None if the line misses the mesh."""
    flat, tall = ([0, 2], 1) if up == "y" else ([0, 1], 2)
    corners = mesh.vertices[_find_near_faces(mesh, point, flat)]
    plan = corners[:, :, flat] - np.array(point)[flat]
    # twice the areas of the triangles between the point and each edge, seen from above
    across = [plan[:, i, 0] * plan[:, (i + 1) % 3, 1] - plan[:, i, 1] * plan[:, (i + 1) % 3, 0] for i in range(3)]
    double_area = across[0] + across[1] + across[2]
    inside = (np.abs(double_area) > 1e-12) & np.all(
        [part * np.sign(double_area) >= -1e-12 * np.abs(double_area) for part in across], axis=0
    )
    if not inside.any():
        return None
    heights = corners[inside, :, tall]
    weights = np.stack([across[1][inside], across[2][inside], across[0][inside]], axis=1) / double_area[inside, None]
    return float((heights * weights).sum(axis=1).max())
