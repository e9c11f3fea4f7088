"""Reads the mesh of a surface, obstacle or solid from its file, and places the mesh in the scene."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from antdsl import limits
from antdsl.scene import setting as setting_data
from antdsl.scene.geometry.heights import compute_sampling_deviation, make_height_surface, read_heights
from antdsl.scene.geometry.mesh_files import RawMesh, check_mesh, make_size_checked_mesh, read_mesh, transform_raw_mesh
from antdsl.scene.geometry.mesh_text import MeshError
from antdsl.scene.paths import PathRefused
from antdsl.scene.staging.mesh_imports import close_solid, report_import_losses, weld_thing_mesh
from antdsl.scene.staging.size_checks import report_too_many_parts
from antdsl.scene.staging.stage_things import place_motion, read_moving_mesh, stage_usd_mesh
from antdsl.scene.thing_models import UNIT_MM, HeightThing, MeshThing, UsdThing, convert_point, convert_rotation

if TYPE_CHECKING:
    from antdsl.scene.staging.stage_scene import SceneStaging


def stage_mesh(staging: SceneStaging, name: str, value: MeshThing | HeightThing | UsdThing) -> setting_data.MeshData | None:
    """Return a mesh as it is at the first frame. On failure, report an error and return None. Its motion is stored in
    `staging.motion`."""
    scene, report = staging.scene, staging.report
    up, unit_mm = scene.model.up, scene.model.unit_mm
    if isinstance(value, UsdThing):
        key, display_name, factor, own_up = "prim", value.prim_path, value.scale, up
        geometry = stage_usd_mesh(staging, name, value)
    elif isinstance(value, HeightThing):
        key, display_name, factor, own_up = "height", value.height, 1.0, "y"
        geometry = _read_height_mesh(staging, name, value)
    else:
        key, display_name = "mesh", value.mesh
        factor, own_up = UNIT_MM[value.units or value.own_units or scene.model.units] * value.scale, value.own_up or up
        geometry = (
            read_moving_mesh(staging, name, value)
            if scene.roots.is_sequence(value.mesh)
            else _read_static_mesh(staging, name, value)
        )
    if geometry is None:
        return None
    raw, inner = geometry
    span = scene.find_span("world", name, key)
    try:
        mesh = transform_raw_mesh(
            raw, factor=factor, own_up=own_up, up=up, angles=convert_rotation(value), position=convert_point(value.at, unit_mm)
        )
        moving = place_motion(staging, value, raw, inner, factor, own_up)
        if moving is not None:
            rest, moves = moving
            mesh = make_size_checked_mesh(rest, mesh.faces)
            if moves is not None:
                staging.moves_by_mesh[name] = moves
    except MeshError as error:
        report.error("bad-mesh", f"the mesh `{display_name}` {error}", span, error.help)
        return None
    staging.raw_meshes[name] = raw
    mesh = weld_thing_mesh(staging, name, value, mesh)
    report_import_losses(staging, display_name, raw, span)
    return mesh


def _read_static_mesh(staging: SceneStaging, name: str, value: MeshThing) -> tuple[RawMesh, None] | None:
    """Return the mesh in a single file, and None as its motion, because it is static. After an error, return None instead of the
    pair."""
    data = staging.read_file(value.mesh, limits.MAX_MESH_BYTES, "world", name, "mesh")
    if data is None:
        return None
    try:
        return read_mesh(data, value.mesh, value.group, staging.make_sibling_reader(value.mesh)), None
    except PathRefused as error:
        words = f"the mesh `{value.mesh}` names a buffer: {error}"
        staging.report.error(error.code, words, staging.scene.find_span("world", name, "mesh"), error.help)
        return None
    except MeshError as why:
        key = "mesh" if value.group is None else "group"
        staging.report.error("bad-mesh", f"the mesh `{value.mesh}` {why}", staging.scene.find_span("world", name, key), why.help)
        return None


def _read_height_mesh(staging: SceneStaging, name: str, value: HeightThing) -> tuple[RawMesh, None] | None:
    """Return the mesh of a surface of height samples, in mm with y up, and None as its motion. After an error, return None
    instead of the pair."""
    data = staging.read_file(value.height, limits.MAX_MESH_BYTES, "world", name, "height")
    if data is None:
        return None
    unit_mm = staging.scene.model.unit_mm
    offset = 0.0 if value.offset is None else value.offset.to_millimetres(unit_mm)
    try:
        heights = offset + value.scale.to_millimetres(unit_mm) * read_heights(data, value.height, value.array, value.layer)
        x, z = (side.to_millimetres(unit_mm) for side in value.extent)
        raw = check_mesh(*make_height_surface(heights, (x, z)))
    except MeshError as error:
        span = staging.scene.find_span("world", name, "height")
        staging.report.error("bad-mesh", f"the heights `{value.height}` {error}", span, error.help)
        return None
    staging.deviations[name] = compute_sampling_deviation(heights)
    return raw, None


def stage_solid(staging: SceneStaging, name: str, value: MeshThing | UsdThing) -> setting_data.SolidData | None:
    """Return the data of a solid. On failure, report an error and return None.

    Too many voxels are reported before any voxel is created."""
    mesh = stage_mesh(staging, name, value)
    if mesh is None or value.voxel is None:  # the missing file was reported when the scene was checked
        return None
    edge = value.voxel.to_millimetres(staging.scene.model.unit_mm)
    across = [float(side) / edge + 1 for side in np.ptp(mesh.vertices, axis=0)]
    report_too_many_parts(
        staging, across[0] * across[1] * across[2], limits.MAX_VOXELS, f"`{name}`", "voxels", edge, "world", name, "voxel"
    )
    solid = setting_data.SolidData(mesh, edge)
    return close_solid(staging, name, value, solid) if staging.report.ok else solid
