"""Conversion of a checked scene to a `Setting`. Meshes and points are read, and values are converted to mm in the scene's axes.

The memory that binding needs is computed first, so that a request for a billion cells is rejected before anything is allocated.
"""

from __future__ import annotations

import hashlib
import posixpath
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.diagnostics import Report
from antdsl.program.model import Program
from antdsl.scene import setting as setting_data
from antdsl.scene.camera_models import DEFAULT_CAMERA_NAME
from antdsl.scene.checks.wrap_checks import make_periodic_box
from antdsl.scene.document import PathKey
from antdsl.scene.geometry.closed_meshes import check_obstacle_sides
from antdsl.scene.geometry.import_notes import MeshImport
from antdsl.scene.geometry.mesh_files import RawMesh
from antdsl.scene.geometry.points import MAX_POINT_FILE_BYTES, PointsError, read_points
from antdsl.scene.load import Scene
from antdsl.scene.paths import PathRefused
from antdsl.scene.quantities import Quantity
from antdsl.scene.scene_kinds import SCENE_KINDS
from antdsl.scene.staging.item_placement import check_crowds, place_items
from antdsl.scene.staging.mesh_imports import check_live_faces, check_origin_distances, collect_imports
from antdsl.scene.staging.motion import GeometryMotion, MeshMotion
from antdsl.scene.staging.periodic_surfaces import fit_surfaces_to_box
from antdsl.scene.staging.size_checks import check_sizes
from antdsl.scene.staging.stage_cameras import stage_cameras
from antdsl.scene.staging.stage_crowd import stage_crowd
from antdsl.scene.staging.stage_fields import stage_field_starts
from antdsl.scene.staging.stage_flows import check_density_maps, stage_flow, stage_map
from antdsl.scene.staging.stage_meshes import stage_mesh, stage_solid
from antdsl.scene.staging.stage_shapes import convert_length
from antdsl.scene.staging.stage_things import stage_curve
from antdsl.scene.thing_models import UP_VECTORS


@dataclass(slots=True)
class SceneStaging:
    """A setting under construction. It collects the data of all things, a report, and a hash of each file that was read."""

    scene: Scene
    program: Program
    report: Report = field(default_factory=Report)
    hashes: dict[str, str] = field(default_factory=dict)
    surfaces: dict[str, setting_data.MeshData] = field(default_factory=dict)
    obstacles: dict[str, setting_data.MeshData] = field(default_factory=dict)
    solids: dict[str, setting_data.SolidData] = field(default_factory=dict)
    curves: dict[str, NDArray[np.float64]] = field(default_factory=dict)  # (frames, k, 3); a single frame if static
    items: dict[str, tuple[setting_data.ItemData, ...]] = field(default_factory=dict)
    item_tracks: dict[str, NDArray[np.float64]] = field(default_factory=dict)  # positions (frames, n, 3) of items that move
    flows: dict[str, setting_data.FlowData] = field(default_factory=dict)
    maps: dict[str, setting_data.PaintedValues] = field(default_factory=dict)
    raw_meshes: dict[str, RawMesh] = field(default_factory=dict)  # meshes as in their files
    moves_by_mesh: dict[str, MeshMotion] = field(default_factory=dict)  # by mesh
    # mm, for height surfaces: the largest distance of triangles from bilinear patches
    deviations: dict[str, float] = field(default_factory=dict)
    closures: dict[str, Any] = field(default_factory=dict)  # collected USD files, by name
    weld_counts: dict[str, int] = field(default_factory=dict)  # vertices merged with others, by mesh

    def read_group_entry(self, group: str, name: str, value: Any) -> Any:
        """Return the data of a thing for the mapping `group` in the setting. On failure, report an error and return None."""
        return READER_BY_GROUP[group](self, name, value)

    def read_file(self, text: str, max_bytes: int, *path: PathKey) -> bytes | None:
        """Return the bytes of a file. On failure, report an error at the location that names the file, and return None."""
        try:
            data = self.scene.roots.read_file(text, max_bytes)
        except PathRefused as error:
            self.report.error(error.code, str(error), self.scene.find_span(*path), error.help)
            return None
        self.hashes[text] = hashlib.blake2b(data, digest_size=16).hexdigest()
        return data

    def make_sibling_reader(self, text: str) -> Callable[[str, int], bytes]:
        """Return a function that reads the files to which a file of the scene refers. Their names are relative to the folder of
        that file.

        The function raises PathRefused for files outside the allowed folders."""
        root, colon, path = text.rpartition(":")
        folder = posixpath.dirname(path)

        def read_sibling(name: str, cap: int) -> bytes:
            full_path = root + colon + (posixpath.normpath(posixpath.join(folder, name)) if name[:1] != "/" else name)
            data = self.scene.roots.read_file(full_path, cap)
            self.hashes[full_path] = hashlib.blake2b(data, digest_size=16).hexdigest()
            return data

        return read_sibling

    def read_points(self, text: str, min_count: int, *path: PathKey) -> NDArray[np.float64] | None:
        """Return at least `min_count` points from a JSON file, in the file's own units. On failure, report an error and return
        None."""
        data = self.read_file(text, MAX_POINT_FILE_BYTES, *path)
        if data is None:
            return None
        try:
            return read_points(data, min_count)
        except PointsError as error:
            self.report.error("bad-points", f"`{text}` {error}", self.scene.find_span(*path), "write `[[0, 0, 0], [50, 0, 0]]`")
            return None

    def find_sequence(self, text: str, *path: PathKey) -> dict[int, str] | None:
        """Return the files of a path with `####` by frame. On failure, report an error and return None."""
        try:
            return self.scene.roots.find_sequence(text)
        except PathRefused as error:
            self.report.error(error.code, str(error), self.scene.find_span(*path), error.help)
            return None


# By mapping of the setting.
READER_BY_GROUP: Mapping[str, Callable[[SceneStaging, str, Any], Any]] = {
    "surfaces": stage_mesh, "obstacles": stage_mesh, "solids": stage_solid, "curves": stage_curve, "items": place_items,
    "flows": stage_flow, "maps": stage_map,
}  # fmt: skip
CHECK_BY_GROUP: Mapping[str, Callable[[SceneStaging], None]] = {
    "surfaces": check_live_faces, "obstacles": check_obstacle_sides, "solids": check_sizes,
}  # fmt: skip


_MESH_GROUPS = ("surfaces", "obstacles", "solids")


def _stage_things(staging: SceneStaging, *groups: str) -> None:
    """Stage the things of some groups, in the order of the program. Curves and items are staged in the order of the scene,
    because caches store them in this order."""
    program, scene = staging.program.world, staging.scene.model.world
    for name in scene if groups[0] in ("curves", "items") else program:
        kind, value = SCENE_KINDS.get(program[name].kind) if name in program else None, scene.get(name)
        if kind is not None and kind.group in groups and isinstance(value, kind.models):
            data = kind.stage_thing(staging, name, value)
            if data is not None:
                getattr(staging, kind.group)[name] = data
    for group in groups:
        if group in CHECK_BY_GROUP:
            CHECK_BY_GROUP[group](staging)


def build_setting(
    scene: Scene, program: Program, overrides: Mapping[str, Quantity] | None = None
) -> tuple[setting_data.WorldSetting | None, Report, dict[str, str]]:
    """Return the setting, the report, and a hash of each file that was read. The setting is None if there are errors.

    `overrides`: the params that the user sets."""
    staging = SceneStaging(scene, program)
    model = scene.model
    for group in (*_MESH_GROUPS, "curves", "items"):
        _stage_things(staging, group)
    fit_surfaces_to_box(staging)
    _stage_things(staging, "flows", "maps")  # first, because they contain curves and items
    item_points = {item.name: item.position for group in staging.items.values() for item in group} | {
        name: group[0].position for name, group in staging.items.items() if group
    }
    crowds = tuple(stage_crowd(staging, item_points, number) for number in range(len(model.crowd)))
    check_density_maps(staging)
    check_crowds(staging, crowds)
    cameras = stage_cameras(staging)
    starts = stage_field_starts(staging, item_points)
    if not staging.report.ok:
        return None, staging.report, staging.hashes
    dt = float(1 / model.fps)
    param_values = {**model.set, **(overrides or {})}
    params = {name: value.to_base_units(model.unit_mm, dt) for name, value in param_values.items() if name in program.params}
    things: dict[str, Any] = {group: getattr(staging, group) for group in READER_BY_GROUP}
    things["curves"] = {name: positions[0] for name, positions in staging.curves.items()}
    setting = setting_data.WorldSetting(
        fps=model.fps,
        substeps=model.substeps,
        uses_rays=model.stick == "rays",
        orient=model.orient,
        contacts=model.contacts,
        up=UP_VECTORS[model.up],
        unit_mm=model.unit_mm,
        seed=model.seed,
        lamp_strength=model.light.lamps,
        first_frame=model.frames.first - model.preroll,
        crowds=crowds,
        params=params,
        field_start=starts,
        motion=GeometryMotion(
            first=model.frames.first - model.preroll,
            meshes={name: moves for name, moves in staging.moves_by_mesh.items() if name not in staging.solids},
            items=staging.item_tracks,
            curves={name: positions for name, positions in staging.curves.items() if len(positions) > 1},
        ),
        cameras=cameras,
        level_of_detail=_stage_level_of_detail(scene, cameras.get(DEFAULT_CAMERA_NAME)),
        deviations=staging.deviations,
        imports=collect_imports(staging),
        spans={name: scene.find_span("world", name) for name in model.world},
        notes=model.notes,
        period=make_periodic_box(scene),
        **things,
    )
    check_origin_distances(staging, setting)
    return setting, staging.report, staging.hashes


def collect_import_reports(scene: Scene, program: Program) -> dict[str, MeshImport]:
    """Return the import report of each mesh that can be read, even if the scene has errors."""
    staging = SceneStaging(scene, program)
    for group in _MESH_GROUPS:
        _stage_things(staging, group)
    return collect_imports(staging)


def _stage_level_of_detail(scene: Scene, camera: setting_data.CameraData | None) -> setting_data.DetailLevelData | None:
    """Return the level of detail, or None if the scene has none. `camera`: the scene's default camera."""
    lod = scene.model.lod
    if lod is None or camera is None:
        return None
    near, far = lod.near.to_millimetres(scene.model.unit_mm), convert_length(scene, lod.far)
    return setting_data.DetailLevelData(camera.at, near, float("inf") if far is None else far, camera.first)
