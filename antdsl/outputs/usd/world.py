"""The world of a shot in USD: static, moving and dug meshes, items, fields, and the camera."""

from __future__ import annotations

from typing import Any

import numpy as np

from antdsl.bodies.body import vertex_normals
from antdsl.bodies.shapes import placed
from antdsl.numerics.vector_rows import unit_or
from antdsl.outputs.gallery import Gallery
from antdsl.outputs.pictures.light import decode_srgb
from antdsl.outputs.pictures.model import Item, Picture, Solid, Trail
from antdsl.outputs.usd.materials import MaterialBinder
from antdsl.outputs.usd.values import (
    MATERIALS_PATH,
    ROOT_PATH,
    Array,
    StageOutput,
    ValueSamples,
    box,
    identifier,
    integers,
    make_unique,
    mesh,
    vectors,
)
from antdsl.scene.geometry.usd import pxr
from antdsl.scene.model import UNIT_MM

_APERTURE_MM = 36.0  # mm
_CREASE_COSINE = np.cos(np.radians(40.0))  # edges that are sharper stay sharp
_COLOUR_BY_KIND = {
    "ground": (0.27, 0.19, 0.12), "stone": (0.30, 0.29, 0.27), "boulder": (0.33, 0.31, 0.28), "hill": (0.32, 0.20, 0.11),
}  # fmt: skip


class WorldWriter:
    """Writer of everything in the world except agents."""

    def __init__(self, out: StageOutput, gallery: Gallery, frames: list[int]) -> None:
        self._out, self._gallery, self._first = out, gallery, frames[0]
        self._looks = MaterialBinder(out.stage, f"{MATERIALS_PATH}/world", _COLOUR_BY_KIND)
        self._meshes: dict[str, _MeshWriter] = {}
        self._items: dict[int, tuple[ValueSamples, ValueSamples]] = {}
        self._items_named: set[str] = set()
        self._fields: dict[str, _FieldWriter] = {}
        self._camera = _CameraWriter(out, gallery) if gallery.camera(frames[0]) else None

    def frame(self, frame: int, picture: Picture) -> None:
        """Write the world in a frame."""
        for solid in picture.solids:
            if solid.name not in self._meshes:
                path = f"{ROOT_PATH}/{self._out.name('mesh', solid.name)}"
                self._meshes[solid.name] = _MeshWriter(self._out, path, self._gallery.manifest.up)
                self._looks.bind(self._out.stage.GetPrimAtPath(path), solid.kind)
            self._meshes[solid.name].frame(frame, solid)
        for number, item in enumerate(picture.items):
            self._item(frame, number, item)
        for trail in picture.trails:
            if trail.name not in self._fields:
                self._fields[trail.name] = _FieldWriter(self._out, trail)
                if frame > self._first:
                    self._fields[trail.name].nothing(self._first)
            self._fields[trail.name].frame(frame, trail)
        for removed_name in self._fields.keys() - {trail.name for trail in picture.trails}:
            self._fields[removed_name].nothing(frame)
        if self._camera is not None:
            self._camera.frame(frame)

    def _item(self, frame: int, number: int, item: Item) -> None:
        """Write the body of an item at its position. Its size shows the remaining amount, as in pictures.

        `number`: the index of the item among all items."""
        if item.shape == "none" or item.radius <= 0:
            return
        geom, stage = pxr("UsdGeom"), self._out.stage
        if number not in self._items:
            if not self._items:
                geom.Xform.Define(stage, f"{ROOT_PATH}/items")
            path = f"{ROOT_PATH}/items/{make_unique(identifier(item.name), self._items_named)}"
            points, faces, colour = placed(item.shape)
            geometry: tuple[Array, Array] = (points, vertex_normals(points, faces))
            if self._gallery.manifest.up == "z":
                geometry = (_to_z_up(geometry[0]), _to_z_up(geometry[1]))
            place, normals = geometry
            shape = mesh(stage, path, place, faces, normals, _uv_around(points))
            ops = (shape.AddTranslateOp(), shape.AddScaleOp(geom.XformOp.PrecisionDouble))
            self._items[number] = (self._out.samples(ops[0], _vector), self._out.samples(ops[1], _vector))
            shape.CreateDisplayColorPrimvar("vertex").Set(vectors(decode_srgb(colour)))
            self._looks.bind(shape.GetPrim(), "")
        move, scale = self._items[number]
        move.set(frame, item.position)
        scale.set(frame, np.full(3, item.radius * max(min(item.left, 1.0), 1e-9) ** (1 / 3)))


class _CameraWriter:
    """Writer of the scene's own camera."""

    def __init__(self, out: StageOutput, gallery: Gallery) -> None:
        self._gallery, self._reaches = gallery, False
        camera = pxr("UsdGeom").Camera.Define(out.stage, f"{ROOT_PATH}/camera")
        self._tenths = 10.0 / UNIT_MM[gallery.manifest.units]  # of a millimetre in the stage's unit
        camera.CreateHorizontalApertureAttr(_APERTURE_MM * self._tenths)
        camera.CreateVerticalApertureAttr(_APERTURE_MM * 9 / 16 * self._tenths)
        self._clipping = camera.CreateClippingRangeAttr()
        self._move = out.samples(camera.AddTransformOp(), lambda rows: pxr("Gf").Matrix4d(*rows.ravel().tolist()))
        self._focal, self._focus = (
            out.samples(a, lambda v: float(v[0])) for a in (camera.CreateFocalLengthAttr(), camera.CreateFocusDistanceAttr())
        )

    def frame(self, frame: int) -> None:
        """Write the camera's transform and lens in a frame."""
        camera = self._gallery.camera(frame)
        assert camera is not None
        eye, aim = np.asarray(camera.at), np.asarray(camera.look_at)
        upward = camera.up or ((0.0, 1.0, 0.0) if self._gallery.manifest.up == "y" else (0.0, 0.0, 1.0))
        back, up = unit_or(eye - aim, np.array([0.0, 0.0, 1.0])), np.asarray(upward, np.float64)
        if np.linalg.norm(np.cross(up, back)) < 1e-6:
            up = np.roll(up, 1)
        side = unit_or(np.cross(up, back), np.array([0.0, 0.0, 1.0]))
        rows = np.zeros((4, 4))
        rows[0, :3], rows[1, :3], rows[2, :3], rows[3] = side, np.cross(back, side), back, (*eye, 1)
        far = float(np.linalg.norm(aim - eye))
        self._move.set(frame, rows)
        self._focal.set(frame, [camera.focal * self._tenths])
        self._focus.set(frame, [far])
        if not self._reaches:
            self._clipping.Set(pxr("Gf").Vec2f(far / 1000, far * 1000))
            self._reaches = True


class _MeshWriter:
    """Writer of one mesh of the world. It writes only what changed since the previous frame."""

    def __init__(self, out: StageOutput, path: str, up: str = "y") -> None:
        usd_mesh = pxr("UsdGeom").Mesh.Define(out.stage, path)
        usd_mesh.CreateSubdivisionSchemeAttr("none")
        usd_mesh.CreateDoubleSidedAttr(True)
        self._counts = out.samples(usd_mesh.CreateFaceVertexCountsAttr(), integers, np.int32)
        self._corners = out.samples(usd_mesh.CreateFaceVertexIndicesAttr(), integers, np.int32)
        self._points = out.samples(usd_mesh.CreatePointsAttr(), vectors, np.float32)
        self._normals = out.samples(usd_mesh.CreateNormalsAttr(), vectors, np.float32)
        usd_mesh.SetNormalsInterpolation("faceVarying")
        self._extent = out.samples(usd_mesh.CreateExtentAttr(), vectors, np.float32)
        kind = pxr("Sdf").ValueTypeNames.TexCoord2fArray
        uvs = pxr("UsdGeom").PrimvarsAPI(usd_mesh).CreatePrimvar("st", kind, "vertex")
        self._uvs = out.samples(uvs, pxr("Vt").Vec2fArray.FromNumpy, np.float32)
        self._up = 1 if up == "y" else 2
        self._drawn: Solid | None = None
        self._mapped = np.zeros((0, 2), np.float32)

    def frame(self, frame: int, solid: Solid) -> None:
        """Write the mesh in a frame."""
        if solid is not self._drawn:
            if self._drawn is None or self._drawn.faces is not solid.faces:
                self._mapped = _uv_from_above(solid.vertices, self._up)  # constant while the faces are the same
            self._shaded = creased_normals(solid.vertices, solid.faces)
            self._drawn = solid
        self._counts.set(frame, np.full(len(solid.faces), 3))
        self._corners.set(frame, np.ravel(solid.faces))
        self._points.set(frame, solid.vertices)
        self._normals.set(frame, self._shaded)
        self._uvs.set(frame, self._mapped)
        self._extent.set(frame, box(solid.vertices))


class _FieldWriter:
    """Writer of a field as points in its colour, at the cells with some strength. The width of a point shows the strength."""

    def __init__(self, out: StageOutput, trail: Trail) -> None:
        geom = pxr("UsdGeom")
        geom.Xform.Define(out.stage, f"{ROOT_PATH}/fields")
        usd_points = geom.Points.Define(out.stage, f"{ROOT_PATH}/fields/{identifier(trail.name)}")
        usd_points.CreatePurposeAttr("guide")
        floats = pxr("Vt").FloatArray.FromNumpy
        self._points = out.samples(usd_points.CreatePointsAttr(), vectors, np.float32)
        self._widths = out.samples(usd_points.CreateWidthsAttr(), floats, np.float32)
        usd_points.SetWidthsInterpolation("vertex")
        kind = pxr("Sdf").ValueTypeNames.FloatArray
        self._strength = out.samples(geom.PrimvarsAPI(usd_points).CreatePrimvar("strength", kind, "vertex"), floats, np.float32)
        self._extent = out.samples(usd_points.CreateExtentAttr(), vectors, np.float32)
        usd_points.CreateDisplayColorPrimvar("constant").Set(vectors(decode_srgb(np.array([trail.colour]))))

    def nothing(self, frame: int) -> None:
        """Write that the field has no points in a frame."""
        self._points.set(frame, np.zeros((0, 3)))
        self._widths.set(frame, np.zeros(0))
        self._strength.set(frame, np.zeros(0))
        self._extent.set(frame, np.zeros((2, 3)))

    def frame(self, frame: int, trail: Trail) -> None:
        """Write the field's points and widths in a frame."""
        rows = np.flatnonzero(trail.strength > 0)
        points, strength = trail.position[rows], trail.strength[rows]
        full = trail.full or float(strength.max(initial=0.0)) or 1.0
        width = trail.cell * np.sqrt(np.clip(strength / full, 0.0, 1.0))
        self._points.set(frame, points)
        self._widths.set(frame, width)
        self._strength.set(frame, strength)
        reach = trail.cell / 2
        self._extent.set(frame, box(points) + np.array([[-reach], [reach]]) if len(points) else np.zeros((2, 3)))


def creased_normals(points: Array, faces: Array) -> Array:
    """Return unit normals float32[3 m, 3] of the corners of triangles. They are smooth, except where a face deviates by over 40
    degrees."""
    corners = np.asarray(points, np.float64)[faces]
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat = unit_or(flat, np.array([0.0, 1.0, 0.0]))
    smooth = vertex_normals(points, faces).astype(np.float64)[faces]
    near = (smooth * flat[:, None]).sum(axis=-1, keepdims=True) > _CREASE_COSINE
    normals: Array = np.where(near, smooth, flat[:, None]).reshape(-1, 3).astype(np.float32)
    return normals


def _uv_from_above(points: Array, up: int) -> Array:
    """Return texture coordinates (n, 2) as seen from above. The longer side has the range 0 to 1."""
    flat = np.delete(np.asarray(points, np.float64), up, axis=1)
    if not len(flat):
        return np.zeros((0, 2), np.float32)
    low = flat.min(axis=0)
    coordinates: Array = ((flat - low) / max(float((flat.max(axis=0) - low).max()), 1e-12)).astype(np.float32)
    return coordinates


def _uv_around(points: Array) -> Array:
    """Return texture coordinates (n, 2) by direction from the centre of a body: longitude and latitude."""
    low, high = box(points)
    offset = points - (low + high) / 2
    size = np.maximum(np.linalg.norm(offset, axis=1), 1e-12)
    around = np.arctan2(offset[:, 2], offset[:, 0]) / (2 * np.pi) + 0.5
    return np.stack([around, np.arccos(np.clip(offset[:, 1] / size, -1.0, 1.0)) / np.pi], axis=1).astype(np.float32)


def _to_z_up(directions: Array) -> Array:
    """Convert vectors (n, 3) from a world with y up to one with z up."""
    return np.stack([directions[:, 0], -directions[:, 2], directions[:, 1]], axis=1)


def _vector(values: Array) -> Any:
    return pxr("Gf").Vec3d(*values.tolist())
