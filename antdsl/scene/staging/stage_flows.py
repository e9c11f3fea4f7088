"""Staging of flows and maps: checks names against the program, reads files, and converts values to millimetres."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.scene import setting as setting_data
from antdsl.scene import thing_models as model
from antdsl.scene.checks.entry_checks import report_unknown_name
from antdsl.scene.geometry.mesh_files import RawMesh, rotate_points, rotate_up_axis
from antdsl.scene.geometry.painted import PaintError, read_painted_values
from antdsl.scene.quantities import Quantity
from antdsl.scene.scene_kinds import find_flow_target, find_painted_surface, is_file_path
from antdsl.scene.setting import FlowTarget
from antdsl.scene.staging.stage_things import find_first_rotation, limit_vector_lengths, stage_usd_paint

if TYPE_CHECKING:
    from antdsl.scene.staging.stage_scene import SceneStaging

_DEFAULT_INTERVAL_SECONDS = 1.0  # s


def stage_flow(staging: SceneStaging, name: str, thing: model.FlowThing | model.PaintedThing) -> setting_data.FlowData | None:
    """Return a flow in mm and the scene's axes. On failure, report an error and return None."""
    if isinstance(thing, model.PaintedThing):
        return _stage_painted(staging, name, thing, 3)

    def convert_to_mm(value: Quantity | None) -> float | None:
        return None if value is None else value.to_millimetres(staging.scene.model.unit_mm)

    on = () if thing.on is None else (thing.on,)
    if isinstance(thing, model.BorderFlow):
        within = convert_to_mm(thing.within)
        assert within is not None
        return setting_data.BorderFlowData(
            on or (thing.border,), within, thing.falloff, thing.strength, convert_to_mm(thing.cell)
        )
    goal = find_flow_target(thing)
    assert goal is not None
    target = _stage_flow_target(staging, name, *goal)
    if target is None:
        return None
    if isinstance(thing, model.SolvedFlow):
        model_ = staging.scene.model
        every = (
            _DEFAULT_INTERVAL_SECONDS if thing.every is None else thing.every.to_base_units(model_.unit_mm, float(1 / model_.fps))
        )
        clearance = convert_to_mm(thing.room) or 0.0
        return setting_data.SolvedFlowData(
            target, thing.slope, clearance, dict(thing.maps), thing.crowding, every, thing.strength, convert_to_mm(thing.cell), on
        )
    assert isinstance(thing, model.SpreadFlow)
    direction, gather = goal[0], thing.gather if isinstance(thing, model.TangentFlow) else 0.0
    radius, cell = convert_to_mm(thing.radius), convert_to_mm(thing.cell)
    return setting_data.SpreadFlowData(direction, target, radius, thing.falloff, thing.strength, cell, on, gather)  # type: ignore[arg-type]


def _stage_flow_target(staging: SceneStaging, name: str, key: str, target: model.FlowTargetValue) -> FlowTarget | None:
    """Return the target of a flow in mm. On failure, report an error and return None. `key`: the scene key that has the target
    as its value."""
    scene, items = staging.scene, staging.items
    if not isinstance(target, str):
        return FlowTarget(np.array([model.convert_point(target, scene.model.unit_mm)]), np.zeros(1))
    if is_file_path(target):
        points = staging.read_points(target, 2 if key == "tangent" else 1, "world", name, key)
        if points is None:
            return None
        points = points * scene.model.unit_mm
        return FlowTarget(points, np.zeros(len(points)), is_line=len(points) > 1)
    if target in staging.curves:
        points = staging.curves[target][0]
        return FlowTarget(points, np.zeros(len(points)), is_line=True, name=target)
    of, which, target_items = target, None, items.get(target) or ()
    if not target_items:
        own = [(group, k) for group, each in items.items() for k, item in enumerate(each) if item.name == target]
        if not own:
            _report_no_target(staging, name, key, target)
            return None
        of, which = own[0]
        target_items = (items[of][which],)
    positions, radii = (np.array([getattr(i, key) for i in target_items], np.float64) for key in ("position", "radius"))
    return FlowTarget(positions, radii, name=of, item_index=which)


def _report_no_target(staging: SceneStaging, name: str, key: str, target: str) -> None:
    """Report that the target of a flow is not an item. Report nothing if another message already explains why."""
    items = staging.items
    if not staging.report.ok:
        return
    if target in items:
        words, help = f"`{target}` has no items, so `{name}` leads nowhere", f"add one: `{target}: {{one: {{at: [0, 0, 0]}}}}`"
        staging.report.error("missing-thing", words, staging.scene.find_span("world", name, key), help)
        return
    known = [*items, *(item.name for each in items.values() for item in each)]
    report_unknown_name(staging.report, staging.scene, ("world", name, key), "no curve and no item is named", known, key=False)


def stage_map(staging: SceneStaging, name: str, thing: model.PaintedThing) -> setting_data.PaintedValues | None:
    """Return a map as values on the vertices or faces of a surface. On failure, report an error and return None."""
    return _stage_painted(staging, name, thing, 1)


def _stage_painted(staging: SceneStaging, name: str, thing: model.PaintedThing, width: int) -> setting_data.PaintedValues | None:
    """Return the values that are painted on a surface, one row per vertex or face of the staged surface. On failure, report an
    error and return None.

    Vertices and faces of the surface's file that staging has removed have no row. `width`: 1 for the numbers of a map, 3 for the
    vectors of a flow."""
    surfaces = staging.program.list_things_of_kind("surface")
    surface = thing.on or find_painted_surface(staging.scene, surfaces, thing) or surfaces[0]
    raw, mesh = staging.raw_meshes.get(surface), staging.scene.model.world.get(surface)
    if isinstance(mesh, model.UsdThing) and mesh.usd == thing.painted:
        values = stage_usd_paint(staging, name, thing, mesh, width)
        return None if values is None else setting_data.PaintedValues(surface, values, False)
    data = staging.read_file(thing.painted, limits.MAX_MESH_BYTES, "world", name, "painted")
    if data is None or raw is None or not isinstance(mesh, model.MeshThing | model.HeightThing):
        return None  # the error was reported with the mesh
    span = staging.scene.find_span("world", name, "painted")
    attribute = name if thing.attribute is None else thing.attribute
    try:
        rows = read_painted_values(data, thing.painted, attribute, width)
    except PaintError as error:
        staging.report.error("bad-paint", f"`{thing.painted}` {error}", span, error.help)
        return None
    own = _select_used_rows(rows, raw)
    if own is None:
        has = "`{}` has {:,} vertices and {:,} triangles".format(surface, *raw.file_counts)
        help = "paint on the surface's own mesh, with points in the same order"
        staging.report.error("bad-paint", f"`{thing.painted}` has {len(rows):,} values, and {has}", span, help)
        return None
    values, of_faces = own
    values = values * thing.strength
    if width == 3:
        up = staging.scene.model.up
        mirrored, own_up = (mesh.scale < 0, mesh.own_up or up) if isinstance(mesh, model.MeshThing) else (False, "y")
        values = values * (-1.0 if mirrored else 1.0)
        values = limit_vector_lengths(rotate_points(rotate_up_axis(values, own_up, up), find_first_rotation(staging, mesh)))
    return setting_data.PaintedValues(surface, values if width == 3 else values[:, 0], of_faces)


def _select_used_rows(rows: NDArray[np.float64], raw: RawMesh) -> tuple[NDArray[np.float64], bool] | None:
    """Return the rows for those vertices or faces of the file that are in the scene. `rows`: one row for each vertex or face of
    the file.

    Also return whether the rows are for faces. Return None if the number of rows matches neither vertices nor faces."""
    vertices, faces = raw.file_counts
    if len(rows) == vertices:
        return rows[raw.file_vertex_indices], False
    return (rows[raw.file_face_indices], True) if len(rows) == faces else None


def check_density_maps(staging: SceneStaging) -> None:
    """Report a crowd with a density map that is 0 everywhere or is painted on another surface."""
    for number, line in enumerate(staging.scene.model.crowd):
        name = line.place.density
        if name is None or name not in staging.maps:
            continue
        span = staging.scene.find_span("crowd", number, "place", "density")
        painted = staging.maps[name]
        if line.place.on not in (None, painted.surface):
            words = f"`{name}` is painted on `{painted.surface}`, but the crowd is placed on `{line.place.on}`"
            staging.report.error("bad-paint", words, span, f"write `on: {painted.surface}`")
        elif not (painted.values > 0).any():
            staging.report.error("bad-paint", f"`{name}` is 0 everywhere, so it cannot place agents", span)
