"""Turns a matched scene into a `Setting`: meshes and points are read, everything is converted to millimetres and the scene's
axes.

The memory that binding would need is computed first. Thus a request for a billion cells is rejected before any allocation."""

from __future__ import annotations

import hashlib
import posixpath
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.diagnostics import Report
from antdsl.program.model import Program
from antdsl.scene import setting as stage_of
from antdsl.scene.document import Key
from antdsl.scene.geometry.closed import check_sides
from antdsl.scene.geometry.heights import height_surface, read_heights, surface_deviation
from antdsl.scene.geometry.import_notes import MeshImport
from antdsl.scene.geometry.mesh_text import MeshError
from antdsl.scene.geometry.meshes import RawMesh, check_mesh, mesh_within_limits, placed, read_mesh
from antdsl.scene.geometry.points import POINT_BYTES, PointsError, read_points
from antdsl.scene.library_bodies import BODY_WORDS
from antdsl.scene.load import Scene
from antdsl.scene.model import UNIT_MM, CurveThing, HeightThing, MeshThing, UsdCamera, UsdThing, millimetres
from antdsl.scene.paths import PathRefused
from antdsl.scene.quantities import Quantity
from antdsl.scene.staging.item_placement import check_crowds, place_items
from antdsl.scene.staging.mesh_imports import (
    check_live_faces,
    close_solid,
    collect_imports,
    report_distances,
    report_losses,
    weld_thing,
)
from antdsl.scene.staging.moves import MeshMoves, Moves
from antdsl.scene.staging.size_checks import check_cells, check_scale, refuse_if_many
from antdsl.scene.staging.stage_crowd import length, place, stage_point, stage_walk
from antdsl.scene.staging.stage_flows import check_densities, stage_flows
from antdsl.scene.staging.stage_things import place_moves, read_moving_mesh, stage_curve, stage_usd_camera, stage_usd_mesh

_UP = {"y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


@dataclass(slots=True)
class Staging:
    """A setting under construction: the report, and a hash of the bytes of each file that was read."""

    scene: Scene
    program: Program
    report: Report = field(default_factory=Report)
    hashes: dict[str, str] = field(default_factory=dict)
    raw: dict[str, RawMesh] = field(default_factory=dict)  # surfaces and obstacles as their files have them
    moves: dict[str, MeshMoves] = field(default_factory=dict)  # by mesh
    deviations: dict[str, float] = field(default_factory=dict)  # mm, of surfaces of heights: triangles from bilinear patches
    closures: dict[str, Any] = field(default_factory=dict)  # USD files that were collected, by name
    welds: dict[str, int] = field(default_factory=dict)  # vertices that were moved onto others, by mesh

    def read_file(self, text: str, cap: int, *path: Key) -> bytes | None:
        """Return a file's bytes; or report an error at the path that names it and return None."""
        try:
            data = self.scene.roots.read(text, cap)
        except PathRefused as refused:
            self.report.error(refused.code, str(refused), self.scene.span(*path), refused.help)
            return None
        self.hashes[text] = hashlib.blake2b(data, digest_size=16).hexdigest()
        return data

    def sibling_reader(self, text: str) -> Callable[[str, int], bytes]:
        """Return a reader of files that a file of the scene names relative to its own folder. It raises PathRefused for files
        elsewhere."""
        root, colon, path = text.rpartition(":")
        folder = posixpath.dirname(path)

        def read(name: str, cap: int) -> bytes:
            full_path = root + colon + (posixpath.normpath(posixpath.join(folder, name)) if name[:1] != "/" else name)
            data = self.scene.roots.read(full_path, cap)
            self.hashes[full_path] = hashlib.blake2b(data, digest_size=16).hexdigest()
            return data

        return read

    def points(self, text: str, least: int, *path: Key) -> NDArray[np.float64] | None:
        """Return at least `least` points of a JSON file, in the file's own units; or report an error and return None."""
        data = self.read_file(text, POINT_BYTES, *path)
        if data is None:
            return None
        try:
            return read_points(data, least)
        except PointsError as why:
            self.report.error("bad-points", f"`{text}` {why}", self.scene.span(*path), "write `[[0, 0, 0], [50, 0, 0]]`")
            return None

    def find_sequence(self, text: str, *path: Key) -> dict[int, str] | None:
        """Return the files of a path with `####` by frame; or report an error and return None."""
        try:
            return self.scene.roots.sequence(text)
        except PathRefused as refused:
            self.report.error(refused.code, str(refused), self.scene.span(*path), refused.help)
            return None


def stage(
    scene: Scene, program: Program, overrides: Mapping[str, Quantity] | None = None
) -> tuple[stage_of.Setting | None, Report, dict[str, str]]:
    """Return the setting, the report, and a hash of each file read. `overrides`: params from the user."""
    staging = Staging(scene, program)
    model = scene.model
    surfaces = _stage_meshes(staging, "surface")
    check_live_faces(staging, surfaces)
    obstacles = _stage_meshes(staging, "obstacle")
    for name, mesh in obstacles.items():
        check_sides(staging, name, mesh)
    solids = _stage_solids(staging)
    if staging.report.ok:
        check_cells(staging, {**surfaces, **{name: solid.mesh for name, solid in solids.items()}})
        check_scale(staging, surfaces, solids)
    curves = _stage_curves(staging)
    laid = {name: entry for name in model.world if (entry := place_items(staging, name, surfaces)) is not None}
    items = {name: entry for name, (entry, _) in laid.items()}
    flows, maps = stage_flows(staging, items, {name: entry[0] for name, entry in curves.items()})
    item_points = {item.name: item.position for group in items.values() for item in group} | {
        name: group[0].position for name, group in items.items() if group
    }
    crowds = tuple(
        stage_of.CrowdData(
            line.species,
            line.count,
            place(staging, item_points, line.place, "crowd", number, "place"),
            number,
            stage_walk(scene, line.walk),
            line.body if line.body and line.body in BODY_WORDS else "",
            line.layers(),
        )
        for number, line in enumerate(model.crowd)
    )
    check_densities(staging, maps)
    check_crowds(staging, crowds, surfaces, solids)
    camera = stage_usd_camera(staging, model.camera) if isinstance(model.camera, UsdCamera) else None
    starts = {
        name: stage_of.FieldStart(
            start.start,
            stage_point(staging, item_points, start.around, start.radius, "fields", name),
            length(scene, start.radius),
        )
        for name, start in model.fields.items()
    }
    if not staging.report.ok:
        return None, staging.report, staging.hashes
    dt = float(1 / model.fps)
    param_values = {**model.set, **(overrides or {})}
    params = {name: value.to_base_units(model.unit_mm, dt) for name, value in param_values.items() if name in program.params}
    setting = stage_of.Setting(
        fps=model.fps,
        substeps=model.substeps,
        by_rays=model.stick == "rays",
        orient=model.orient,
        contacts=model.contacts,
        up=_UP[model.up],
        unit_mm=model.unit_mm,
        seed=model.seed,
        first_frame=model.frames.first - model.preroll,
        surfaces=surfaces,
        obstacles=obstacles,
        items=items,
        curves={name: entry[0] for name, entry in curves.items()},
        flows=flows,
        maps=maps,
        crowds=crowds,
        params=params,
        field_start=starts,
        solids=solids,
        moves=Moves(
            first=model.frames.first - model.preroll,
            meshes={name: moves for name, moves in staging.moves.items() if name in {**surfaces, **obstacles}},
            items={name: entry for name, (_, entry) in laid.items() if len(entry) > 1},
            curves={name: entry for name, entry in curves.items() if len(entry) > 1},
        ),
        camera=camera,
        detail=_stage_detail(scene, camera),
        deviations=staging.deviations,
        imports=collect_imports(staging, {**surfaces, **obstacles, **{name: solid.mesh for name, solid in solids.items()}}),
        spans={name: scene.span("world", name) for name in model.world},
    )
    report_distances(staging, setting)
    return setting, staging.report, staging.hashes


def import_reports(scene: Scene, program: Program) -> dict[str, MeshImport]:
    """Return the report on each mesh that can be read, even if the scene has errors."""
    staging = Staging(scene, program)
    still = {**_stage_meshes(staging, "surface"), **_stage_meshes(staging, "obstacle")}
    return collect_imports(staging, {**still, **{name: solid.mesh for name, solid in _stage_solids(staging).items()}})


def _stage_detail(scene: Scene, camera: stage_of.CameraData | None) -> stage_of.DetailData | None:
    """`camera`: one that a file brought."""
    model = scene.model
    if model.lod is None or model.camera is None or isinstance(model.camera, str):
        return None
    near, far = model.lod.near.length(model.unit_mm), length(scene, model.lod.far)
    if camera is not None:
        camera_positions = camera.at
    else:
        assert not isinstance(model.camera, UsdCamera)
        camera_positions = np.array([millimetres(model.camera.at, model.unit_mm)])
    return stage_of.DetailData(camera_positions, near, float("inf") if far is None else far, model.frames.first)


def _stage_meshes(staging: Staging, kind: str) -> dict[str, stage_of.MeshData]:
    meshes = {}
    for name, thing in staging.program.world.items():
        value = staging.scene.model.world.get(name)
        if thing.kind == kind and isinstance(value, MeshThing | HeightThing | UsdThing):
            mesh = _stage_mesh(staging, name, value)
            if mesh is not None:
                meshes[name] = mesh
    return meshes


def _stage_mesh(staging: Staging, name: str, value: MeshThing | HeightThing | UsdThing) -> stage_of.MeshData | None:
    """Return a mesh as at the first frame; its motion goes into `staging.moves`."""
    scene, report = staging.scene, staging.report
    up, unit_mm = scene.model.up, scene.model.unit_mm
    if isinstance(value, UsdThing):
        key, display_name, factor, own_up = "prim", value.path, value.scale, up
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
            else _read_still_mesh(staging, name, value)
        )
    if geometry is None:
        return None
    raw, inner = geometry
    span = scene.span("world", name, key)
    try:
        mesh = placed(
            raw,
            factor=factor,
            own_up=own_up,
            up=up,
            angles=tuple(angle.number for angle in value.rotate) if value.rotate else (0.0, 0.0, 0.0),  # type: ignore[arg-type]
            at=millimetres(value.at, unit_mm) if value.at else (0.0, 0.0, 0.0),
        )
        moving = place_moves(staging, value, raw, inner, factor, own_up)
        if moving is not None:
            rest, moves = moving
            mesh = mesh_within_limits(rest, mesh.faces)
            if moves is not None:
                staging.moves[name] = moves
    except MeshError as why:
        report.error("bad-mesh", f"the mesh `{display_name}` {why}", span, why.help)
        return None
    staging.raw[name] = raw
    mesh = weld_thing(staging, name, value, mesh)
    report_losses(staging, display_name, raw, span)
    return mesh


def _read_still_mesh(staging: Staging, name: str, value: MeshThing) -> tuple[RawMesh, None] | None:
    data = staging.read_file(value.mesh, limits.MESH_BYTES, "world", name, "mesh")
    if data is None:
        return None
    try:
        return read_mesh(data, value.mesh, value.group, staging.sibling_reader(value.mesh)), None
    except PathRefused as refused:
        words = f"the mesh `{value.mesh}` names a buffer: {refused}"
        staging.report.error(refused.code, words, staging.scene.span("world", name, "mesh"), refused.help)
        return None
    except MeshError as why:
        key = "mesh" if value.group is None else "group"
        staging.report.error("bad-mesh", f"the mesh `{value.mesh}` {why}", staging.scene.span("world", name, key), why.help)
        return None


def _read_height_mesh(staging: Staging, name: str, value: HeightThing) -> tuple[RawMesh, None] | None:
    """A surface of samples, in mm, y up."""
    data = staging.read_file(value.height, limits.MESH_BYTES, "world", name, "height")
    if data is None:
        return None
    unit_mm = staging.scene.model.unit_mm
    offset = 0.0 if value.offset is None else value.offset.length(unit_mm)
    try:
        heights = offset + value.scale.length(unit_mm) * read_heights(data, value.height, value.array, value.layer)
        x, z = (side.length(unit_mm) for side in value.extent)
        raw = check_mesh(*height_surface(heights, (x, z)))
    except MeshError as why:
        span = staging.scene.span("world", name, "height")
        staging.report.error("bad-mesh", f"the heights `{value.height}` {why}", span, why.help)
        return None
    staging.deviations[name] = surface_deviation(heights)
    return raw, None


def _stage_solids(staging: Staging) -> dict[str, stage_of.SolidData]:
    """Return the solids. A request for too many voxels is rejected before any is created."""
    scene, solids = staging.scene, {}
    for name, mesh in _stage_meshes(staging, "solid").items():
        value = scene.model.world[name]
        # without a voxel: complained about when the scene was matched
        if not isinstance(value, MeshThing | UsdThing) or value.voxel is None:
            continue
        edge = value.voxel.length(scene.model.unit_mm)
        across = [float(side) / edge + 1 for side in np.ptp(mesh.vertices, axis=0)]
        refuse_if_many(
            staging, across[0] * across[1] * across[2], limits.VOXELS, f"`{name}`", "voxels", edge, "world", name, "voxel"
        )
        solids[name] = stage_of.SolidData(mesh, edge)
        if staging.report.ok:
            solids[name] = close_solid(staging, name, value, solids[name])
    return solids


def _stage_curves(staging: Staging) -> dict[str, NDArray[np.float64]]:
    """Return the points (frames, k, 3) of each curve, a single frame if it is static."""
    curves = {}
    for name, value in staging.scene.model.world.items():
        thing = staging.program.world.get(name)
        if isinstance(value, CurveThing) or (isinstance(value, UsdThing) and thing is not None and thing.kind == "curve"):
            positions = stage_curve(staging, name, value)
            if positions is not None:
                curves[name] = positions
    return curves
