"""Writes the world of a shot as USD: static, moving and dug meshes, items, fields, and the camera."""

from __future__ import annotations

from typing import Any

import numpy as np

from antdsl.bodies.body import compute_vertex_normals
from antdsl.bodies.shapes import build_item_mesh
from antdsl.numerics.vector_rows import normalise_or_fallback
from antdsl.outputs.cache.manifest_parts import LensEntry
from antdsl.outputs.gallery import Gallery
from antdsl.outputs.pictures.light import decode_srgb
from antdsl.outputs.pictures.model import Item, Picture, Solid, Trail
from antdsl.outputs.scene_cameras import SceneCameras, find_camera_axes
from antdsl.outputs.usd.lights import LightWriter
from antdsl.outputs.usd.materials import MaterialBinder
from antdsl.outputs.usd.values import (
    MATERIALS_PATH,
    ROOT_PATH,
    Array,
    StageOutput,
    ValueSamples,
    add_mesh,
    compute_box,
    make_unique,
    to_identifier,
    to_integer_array,
    to_vector_array,
)
from antdsl.scene.geometry.usd import import_pxr_module
from antdsl.scene.looks import KIND_BY_LOOK, SURFACE_KINDS
from antdsl.scene.scene_model import UNIT_MM
from antdsl.scene.setting import SENSOR_WIDTH_MM

_CREASE_COSINE = np.cos(np.radians(40.0))  # edges that are sharper stay sharp


class WorldWriter:
    """Writer of everything in the world except agents."""

    def __init__(self, stage_output: StageOutput, gallery: Gallery, frames: list[int]) -> None:
        self._out, self._gallery, self._first_frame = stage_output, gallery, frames[0]
        self._materials = MaterialBinder(stage_output.stage, f"{MATERIALS_PATH}/world", *_list_surfaces())
        self._meshes: dict[str, _MeshWriter] = {}
        self._items: dict[int, tuple[ValueSamples, ValueSamples]] = {}
        self._item_names: set[str] = set()
        self._fields: dict[str, _FieldWriter] = {}
        cameras = SceneCameras(gallery)
        self._lights = LightWriter(stage_output, gallery)
        written_names = {
            name: written if written == "camera" else stage_output.name("camera", written)
            for name, written in cameras.list_exported(frames[0]).items()
        }
        self._cameras = [
            _CameraWriter(stage_output, gallery, cameras, name, f"{ROOT_PATH}/{written}")
            for name, written in written_names.items()
        ]

    def frame(self, frame: int, picture: Picture) -> None:
        """Write the world in a frame."""
        for solid in picture.solids:
            if solid.name not in self._meshes:
                path = f"{ROOT_PATH}/{self._out.name('mesh', solid.name)}"
                self._meshes[solid.name] = _MeshWriter(self._out, path, self._gallery.manifest.up)
                self._materials.bind_material(self._out.stage.GetPrimAtPath(path), solid.kind)
            self._meshes[solid.name].frame(frame, solid)
        for number, item in enumerate(picture.items):
            self._write_item(frame, number, item)
        for trail in picture.trails:
            if trail.name not in self._fields:
                self._fields[trail.name] = _FieldWriter(self._out, trail)
                if frame > self._first_frame:
                    self._fields[trail.name].write_empty_frame(self._first_frame)
            self._fields[trail.name].frame(frame, trail)
        for removed_name in self._fields.keys() - {trail.name for trail in picture.trails}:
            self._fields[removed_name].write_empty_frame(frame)
        self._lights.frame(frame, picture)
        for camera in self._cameras:
            camera.frame(frame)

    def _write_item(self, frame: int, number: int, item: Item) -> None:
        """Write the body of an item at its position. Its size shows how much of its amount is left, as in pictures.

        `number`: the index of the item among all items."""
        if item.shape == "none" or item.radius <= 0:
            return
        geom, stage = import_pxr_module("UsdGeom"), self._out.stage
        if number not in self._items:
            if not self._items:
                geom.Xform.Define(stage, f"{ROOT_PATH}/items")
            path = f"{ROOT_PATH}/items/{make_unique(to_identifier(item.name), self._item_names)}"
            points, faces, colour = build_item_mesh(item.shape)
            geometry: tuple[Array, Array] = (points, compute_vertex_normals(points, faces))
            if self._gallery.manifest.up == "z":
                geometry = (_rotate_to_z_up(geometry[0]), _rotate_to_z_up(geometry[1]))
            place, normals = geometry
            shape = add_mesh(stage, path, place, faces, normals, _map_around_centre(points))
            ops = (shape.AddTranslateOp(), shape.AddScaleOp(geom.XformOp.PrecisionDouble))
            self._items[number] = (self._out.add_samples(ops[0], _to_usd_vector), self._out.add_samples(ops[1], _to_usd_vector))
            shape.CreateDisplayColorPrimvar("vertex").Set(to_vector_array(decode_srgb(colour)))
            self._materials.bind_material(shape.GetPrim(), "" if item.look is None else KIND_BY_LOOK[item.look])
        move, scale = self._items[number]
        move.set(frame, item.position)
        scale.set(frame, np.full(3, item.radius * max(min(item.remaining_share, 1.0), 1e-9) ** (1 / 3)))


def _list_surfaces() -> tuple[dict[str, tuple[float, float, float]], dict[str, tuple[float, float]]]:
    """Return the linear colours of the kinds of surfaces, and their roughness and metalness, by kind."""
    colours = {kind: tuple(decode_srgb(row.colour).tolist()) for kind, row in SURFACE_KINDS.items()}
    return colours, {kind: (row.roughness, row.metalness) for kind, row in SURFACE_KINDS.items()}


class _CameraWriter:
    """Writer of a camera of the scene. `name`: its name in the scene. `path`: the path of its prim."""

    def __init__(self, stage_output: StageOutput, gallery: Gallery, cameras: SceneCameras, name: str, path: str) -> None:
        self._gallery, self._cameras, self._name, self._has_clipping_range = gallery, cameras, name, False
        camera = import_pxr_module("UsdGeom").Camera.Define(stage_output.stage, path)
        self._tenths_per_mm = 10.0 / UNIT_MM[gallery.manifest.units]  # tenths of the stage's unit per millimetre
        camera.CreateHorizontalApertureAttr(SENSOR_WIDTH_MM * self._tenths_per_mm)
        camera.CreateVerticalApertureAttr(SENSOR_WIDTH_MM * 9 / 16 * self._tenths_per_mm)
        self._clipping_range = camera.CreateClippingRangeAttr()
        lens = gallery.manifest.named_cameras[name]
        if isinstance(lens, LensEntry) and lens.f_stop is not None:
            camera.CreateFStopAttr(lens.f_stop)
        self._transform = stage_output.add_samples(
            camera.AddTransformOp(), lambda rows: import_pxr_module("Gf").Matrix4d(*rows.ravel().tolist())
        )
        self._focal, self._focus_distance = (
            stage_output.add_samples(a, lambda v: float(v[0]))
            for a in (camera.CreateFocalLengthAttr(), camera.CreateFocusDistanceAttr())
        )

    def frame(self, frame: int) -> None:
        """Write the camera's transform and lens in a frame."""
        camera = self._cameras.make_camera(frame, self._name)
        assert camera is not None
        eye, axes = find_camera_axes(camera, self._gallery.manifest.up)
        rows = np.zeros((4, 4))
        rows[:3, :3], rows[3] = axes, (*eye, 1)
        far = float(np.linalg.norm(np.asarray(camera.look_at) - eye))
        self._transform.set(frame, rows)
        self._focal.set(frame, [camera.focal * self._tenths_per_mm])
        self._focus_distance.set(frame, [far if camera.focus is None else camera.focus])
        if not self._has_clipping_range:
            self._clipping_range.Set(import_pxr_module("Gf").Vec2f(far / 1000, far * 1000))
            self._has_clipping_range = True


class _MeshWriter:
    """Writer of one mesh of the world. It writes only what changed since the previous frame."""

    def __init__(self, stage_output: StageOutput, path: str, up: str = "y") -> None:
        usd_mesh = import_pxr_module("UsdGeom").Mesh.Define(stage_output.stage, path)
        usd_mesh.CreateSubdivisionSchemeAttr("none")
        usd_mesh.CreateDoubleSidedAttr(True)
        self._counts = stage_output.add_samples(usd_mesh.CreateFaceVertexCountsAttr(), to_integer_array, np.int32)
        self._corners = stage_output.add_samples(usd_mesh.CreateFaceVertexIndicesAttr(), to_integer_array, np.int32)
        self._points = stage_output.add_samples(usd_mesh.CreatePointsAttr(), to_vector_array, np.float32)
        self._normals = stage_output.add_samples(usd_mesh.CreateNormalsAttr(), to_vector_array, np.float32)
        usd_mesh.SetNormalsInterpolation("faceVarying")
        self._extent = stage_output.add_samples(usd_mesh.CreateExtentAttr(), to_vector_array, np.float32)
        kind = import_pxr_module("Sdf").ValueTypeNames.TexCoord2fArray
        uvs = import_pxr_module("UsdGeom").PrimvarsAPI(usd_mesh).CreatePrimvar("st", kind, "vertex")
        self._uvs = stage_output.add_samples(uvs, import_pxr_module("Vt").Vec2fArray.FromNumpy, np.float32)
        self._up = 1 if up == "y" else 2
        self._current_solid: Solid | None = None
        self._current_uvs = np.zeros((0, 2), np.float32)

    def frame(self, frame: int, solid: Solid) -> None:
        """Write the mesh in a frame."""
        if solid is not self._current_solid:
            if self._current_solid is None or self._current_solid.faces is not solid.faces:
                self._current_uvs = _map_from_above(solid.vertices, self._up)  # constant while the faces are the same
            self._current_normals = compute_creased_normals(solid.vertices, solid.faces)
            self._current_solid = solid
        self._counts.set(frame, np.full(len(solid.faces), 3))
        self._corners.set(frame, np.ravel(solid.faces))
        self._points.set(frame, solid.vertices)
        self._normals.set(frame, self._current_normals)
        self._uvs.set(frame, self._current_uvs)
        self._extent.set(frame, compute_box(solid.vertices))


class _FieldWriter:
    """Writer of a field as coloured points at all cells with some strength. The width of a point shows the strength."""

    def __init__(self, stage_output: StageOutput, trail: Trail) -> None:
        geom = import_pxr_module("UsdGeom")
        geom.Xform.Define(stage_output.stage, f"{ROOT_PATH}/fields")
        usd_points = geom.Points.Define(stage_output.stage, f"{ROOT_PATH}/fields/{to_identifier(trail.name)}")
        usd_points.CreatePurposeAttr("guide")
        floats = import_pxr_module("Vt").FloatArray.FromNumpy
        self._points = stage_output.add_samples(usd_points.CreatePointsAttr(), to_vector_array, np.float32)
        self._widths = stage_output.add_samples(usd_points.CreateWidthsAttr(), floats, np.float32)
        usd_points.SetWidthsInterpolation("vertex")
        kind = import_pxr_module("Sdf").ValueTypeNames.FloatArray
        self._strength = stage_output.add_samples(
            geom.PrimvarsAPI(usd_points).CreatePrimvar("strength", kind, "vertex"), floats, np.float32
        )
        self._extent = stage_output.add_samples(usd_points.CreateExtentAttr(), to_vector_array, np.float32)
        usd_points.CreateDisplayColorPrimvar("constant").Set(to_vector_array(decode_srgb(np.array([trail.colour]))))

    def write_empty_frame(self, frame: int) -> None:
        """Write a frame in which the field has no points."""
        self._points.set(frame, np.zeros((0, 3)))
        self._widths.set(frame, np.zeros(0))
        self._strength.set(frame, np.zeros(0))
        self._extent.set(frame, np.zeros((2, 3)))

    def frame(self, frame: int, trail: Trail) -> None:
        """Write the field's points and widths in a frame."""
        rows = np.flatnonzero(trail.strength > 0)
        points, strength = trail.position[rows], trail.strength[rows]
        full = trail.full_strength or float(strength.max(initial=0.0)) or 1.0
        width = trail.cell * np.sqrt(np.clip(strength / full, 0.0, 1.0))
        self._points.set(frame, points)
        self._widths.set(frame, width)
        self._strength.set(frame, strength)
        reach = trail.cell / 2
        self._extent.set(frame, compute_box(points) + np.array([[-reach], [reach]]) if len(points) else np.zeros((2, 3)))


def compute_creased_normals(points: Array, faces: Array) -> Array:
    """Return unit normals float32[3 m, 3] for the corners of m triangles. They are smooth, except where a face deviates by more
    than 40 degrees."""
    corners = np.asarray(points, np.float64)[faces]
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat = normalise_or_fallback(flat, np.array([0.0, 1.0, 0.0]))
    smooth = compute_vertex_normals(points, faces).astype(np.float64)[faces]
    near = (smooth * flat[:, None]).sum(axis=-1, keepdims=True) > _CREASE_COSINE
    normals: Array = np.where(near, smooth, flat[:, None]).reshape(-1, 3).astype(np.float32)
    return normals


def _map_from_above(points: Array, up: int) -> Array:
    """Return texture coordinates (n, 2) for points seen from above. Along the longer side, they range from 0 to 1."""
    flat = np.delete(np.asarray(points, np.float64), up, axis=1)
    if not len(flat):
        return np.zeros((0, 2), np.float32)
    low = flat.min(axis=0)
    coordinates: Array = ((flat - low) / max(float((flat.max(axis=0) - low).max()), 1e-12)).astype(np.float32)
    return coordinates


def _map_around_centre(points: Array) -> Array:
    """Return texture coordinates (n, 2) for points by their direction from the body's centre: longitude and latitude."""
    low, high = compute_box(points)
    offset = points - (low + high) / 2
    size = np.maximum(np.linalg.norm(offset, axis=1), 1e-12)
    around = np.arctan2(offset[:, 2], offset[:, 0]) / (2 * np.pi) + 0.5
    return np.stack([around, np.arccos(np.clip(offset[:, 1] / size, -1.0, 1.0)) / np.pi], axis=1).astype(np.float32)


def _rotate_to_z_up(directions: Array) -> Array:
    """Return vectors (n, 3) of a world with y up, in the axes of a world with z up."""
    return np.stack([directions[:, 0], -directions[:, 2], directions[:, 1]], axis=1)


def _to_usd_vector(values: Array) -> Any:
    """Return a point (3,) as USD's vector."""
    return import_pxr_module("Gf").Vec3d(*values.tolist())
