"""A cache as a USD stage: a point instancer a species or an Xform an agent, the world's meshes, items and camera, all over
time, in the scene's units and axes. USD has its own ways: quaternions real part first, colours linear, focal lengths in tenths
of a unit."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl import __version__
from antdsl.bodies.catalogue import body
from antdsl.bodies.placed import placed
from antdsl.numerics.vector_rows import unit_or
from antdsl.outputs.cache.cache_reader import Arrays
from antdsl.outputs.gallery import Gallery
from antdsl.outputs.pictures.light import decoded
from antdsl.outputs.pictures.model import Crowd, Item, Solid
from antdsl.outputs.usd_parts import ROOT, Samples, box, identifier, name_states, still_mesh, vectors
from antdsl.outputs.usd_xforms import XformWriter
from antdsl.scene.geometry.usd import pxr
from antdsl.scene.model import UNIT_MM
from antdsl.whole import whole

_APERTURE = 36.0  # mm
_SAVE_EVERY = 50  # frames that wait in memory for their place in the file
_OWN = frozenset(["frame", "P", "v", "orient", "id", "pscale", "Cd", "species", "v_ground"])


def export_instances(gallery: Gallery, frames: Iterable[int], path: Path) -> None:
    """Write these frames into a USD file with one point instancer a species. It is in its place whole or not at all.

    UsdError without usd-core, CacheError for a frame that is damaged, OSError where nothing can be written."""
    _export(gallery, frames, path, _CrowdWriter)


def export_xforms(gallery: Gallery, frames: Iterable[int], path: Path) -> None:
    """The same with one Xform an agent, as programs read them that animate objects one by one."""
    _export(gallery, frames, path, XformWriter)


def _export(gallery: Gallery, frames: Iterable[int], path: Path, crowds: type[_CrowdWriter] | type[XformWriter]) -> None:
    frames = list(frames)
    with whole(path, path.suffix) as part:
        try:
            stage = pxr("Usd").Stage.CreateNew(str(part))
        except pxr("Tf").ErrorException as problem:
            raise OSError(None, "cannot be written", str(path)) from problem
        writer = _Writer(stage, gallery, frames, crowds)
        for number, frame in enumerate(frames):
            writer.frame(frame)
            if number % _SAVE_EVERY == _SAVE_EVERY - 1:
                stage.Save()
        stage.Save()
        del writer, stage  # the file is closed before it is moved


class _Writer:
    """A stage that is filled frame by frame."""

    def __init__(self, stage: Any, gallery: Gallery, frames: list[int], crowds: type[_CrowdWriter] | type[XformWriter]) -> None:
        self.stage, self.gallery, self.frames, self._kind = stage, gallery, frames, crowds
        self._crowds: dict[str, _CrowdWriter | XformWriter] = {}
        self._meshes: dict[str, _MeshWriter] = {}
        self._items: dict[str, tuple[Samples, ...]] = {}
        geom, manifest = pxr("UsdGeom"), gallery.manifest
        self.unit_mm = UNIT_MM[manifest.units]
        geom.SetStageMetersPerUnit(stage, self.unit_mm / 1000)
        geom.SetStageUpAxis(stage, manifest.up.upper())
        stage.SetTimeCodesPerSecond(1 / gallery.dt)
        stage.SetFramesPerSecond(1 / gallery.dt)
        stage.SetStartTimeCode(frames[0])
        stage.SetEndTimeCode(frames[-1])
        stage.SetMetadata("comment", f"antdsl {__version__}: {manifest.scene}, seed {manifest.seed}")
        world = geom.Xform.Define(stage, ROOT)
        pxr("Usd").ModelAPI(world).SetKind("assembly")
        stage.SetDefaultPrim(world.GetPrim())
        self._camera()

    def frame(self, frame: int) -> None:
        """Add one frame."""
        picture, arrays = self.gallery.picture(frame), self.gallery.cache.frame(frame)
        whole = {crowd.species: crowd for crowd in picture.crowds}
        for number, species in enumerate(self.gallery.manifest.species):
            if species.name not in self._crowds:
                self._crowds[species.name] = self._kind(self.stage, self.gallery, species.name, "ant")
            rows = np.flatnonzero(arrays["species"] == number) if "species" in arrays else np.arange(len(arrays["P"]))
            self._crowds[species.name].frame(frame, whole[species.name], arrays, rows)
        for solid in picture.solids:
            if solid.name not in self._meshes:
                self._meshes[solid.name] = _MeshWriter(self.stage, f"{ROOT}/{identifier(solid.name)}")
            self._meshes[solid.name].frame(frame, solid)
        for item in picture.items:
            self._item(frame, item)

    def _camera(self) -> None:
        camera = self.gallery.camera(self.frames[0])
        if camera is None:
            return
        made = pxr("UsdGeom").Camera.Define(self.stage, f"{ROOT}/camera")
        tenths = 10.0 / self.unit_mm  # of a millimetre in the stage's unit
        made.CreateHorizontalApertureAttr(_APERTURE * tenths)
        made.CreateVerticalApertureAttr(_APERTURE * 9 / 16 * tenths)
        move = Samples(made.AddTransformOp(), lambda rows: pxr("Gf").Matrix4d(*rows.ravel().tolist()))
        focal, focus = (Samples(a, lambda v: float(v[0])) for a in (made.GetFocalLengthAttr(), made.GetFocusDistanceAttr()))
        for frame in self.frames if self.gallery.camera_moves else self.frames[:1]:
            camera = self.gallery.camera(frame)
            assert camera is not None
            eye, aim = np.asarray(camera.at), np.asarray(camera.look_at)
            upward = camera.up or ((0.0, 1.0, 0.0) if self.gallery.manifest.up == "y" else (0.0, 0.0, 1.0))
            back, up = unit_or(eye - aim, np.array([0.0, 0.0, 1.0])), np.asarray(upward, np.float64)
            if np.linalg.norm(np.cross(up, back)) < 1e-6:
                up = np.roll(up, 1)
            side = unit_or(np.cross(up, back), np.array([0.0, 0.0, 1.0]))
            rows = np.zeros((4, 4))
            rows[0, :3], rows[1, :3], rows[2, :3], rows[3] = side, np.cross(back, side), back, (*eye, 1)
            move.set(frame, rows)
            focal.set(frame, camera.focal * tenths)
            focus.set(frame, np.linalg.norm(aim - eye))

    def _item(self, frame: int, item: Item) -> None:
        """An item's body where it is; what is left of it is its size, as in pictures."""
        if item.shape == "none" or item.radius <= 0:
            return
        if item.name not in self._items:
            path = f"{ROOT}/items/{identifier(item.name)}"
            made = pxr("UsdGeom").Xform.Define(self.stage, path)
            move, size = made.AddTranslateOp(), made.AddScaleOp(pxr("UsdGeom").XformOp.PrecisionDouble)
            self._items[item.name] = tuple(Samples(op, lambda v: pxr("Gf").Vec3d(*v.tolist())) for op in (move, size))
            points, faces, colour = placed(item.shape)
            if self.gallery.manifest.up == "z":
                points = np.stack([points[:, 0], -points[:, 2], points[:, 1]], axis=1)
            mesh = still_mesh(self.stage, f"{path}/shape", points, faces)
            mesh.CreateDisplayColorPrimvar("vertex").Set(vectors(decoded(colour)))
        place, scale = self._items[item.name]
        place.set(frame, item.position)
        scale.set(frame, np.full(3, item.radius * max(min(item.left, 1.0), 1e-9) ** (1 / 3)))


class _CrowdWriter:
    """One species: its body's poses as prototypes, its agents as instances."""

    def __init__(self, stage: Any, gallery: Gallery, species: str, shape: str) -> None:
        entry = next(entry for entry in gallery.manifest.species if entry.name == species)
        self.body = body(shape)
        path = f"{ROOT}/{identifier(species)}"
        self.made = pxr("UsdGeom").PointInstancer.Define(stage, path)
        prim = self.made.GetPrim()
        pxr("UsdGeom").Scope.Define(stage, f"{path}/poses")
        targets = []
        for number, points in enumerate(self.body.poses):
            mesh = still_mesh(stage, f"{path}/poses/pose_{number:02d}", points, self.body.faces)
            targets.append(mesh.GetPath())
        self.made.CreatePrototypesRel().SetTargets(targets)
        name_states(prim, entry)
        self._reach = float(np.linalg.norm(self.body.poses.reshape(-1, 3), axis=1).max())
        self._samples: dict[str, Samples] = {}

    def frame(self, frame: int, crowd: Crowd, arrays: Arrays, rows: NDArray[np.intp]) -> None:
        """The agents of a frame, in the cache's order, which is that of their ids."""
        orient = np.asarray(crowd.orient, np.float64)
        size = np.linalg.norm(orient, axis=1, keepdims=True)
        real_first = np.where(size > 0, orient / np.where(size > 0, size, 1.0), (0, 0, 0, 1))[:, [3, 0, 1, 2]]
        self._set(frame, "positions", crowd.position)
        # USD's arrays of quaternions lie in memory with the real part last
        self._set(frame, "orientations", real_first[:, [1, 2, 3, 0]])
        self._set(frame, "scales", np.repeat(crowd.scale[:, None], 3, axis=1))
        if "id" in arrays:
            self._set(frame, "ids", arrays["id"][rows])
        if crowd.velocity is not None:
            self._set(frame, "velocities", crowd.velocity + (arrays["v_ground"][rows] if "v_ground" in arrays else 0.0))
        self._set(frame, "protoIndices", self._poses(crowd))
        self._set(frame, "extent", self._extent(crowd))
        self._primvar(frame, "displayColor", "Color3fArray", decoded(crowd.colour))
        for name, values in arrays.items():
            if (
                name not in _OWN
                and "." not in name.removesuffix(".state")
                and values.ndim == 1
                and len(values) == len(arrays["P"])
            ):
                self._primvar(frame, name, "IntArray" if values.dtype.kind in "iu" else "FloatArray", values[rows])

    def _poses(self, crowd: Crowd) -> NDArray[np.int32]:
        """The moment of its walk that each agent is in."""
        return np.zeros(len(crowd.position), np.int32)

    def _extent(self, crowd: Crowd) -> NDArray[np.float64]:
        if not len(crowd.position):
            return np.zeros((2, 3))
        reach = self._reach * np.asarray(crowd.scale)[:, None]
        return np.stack([(crowd.position - reach).min(axis=0), (crowd.position + reach).max(axis=0)])

    def _set(self, frame: int, name: str, values: Any) -> None:
        if name not in self._samples:
            vt = pxr("Vt")
            kinds = {
                "orientations": (vt.QuathArray, np.float16),
                "ids": (vt.Int64Array, np.int64),
                "protoIndices": (vt.IntArray, np.int32),
            }
            array, kind = kinds.get(name, (vt.Vec3fArray, np.float32))
            create = getattr(self.made, f"Create{name[0].upper()}{name[1:]}Attr")
            self._samples[name] = Samples(create(), array.FromNumpy, kind)
        self._samples[name].set(frame, values)

    def _primvar(self, frame: int, name: str, kind: str, values: Any) -> None:
        key = f"primvars:{name}"
        if key not in self._samples:
            vt, types = pxr("Vt"), pxr("Sdf").ValueTypeNames
            kinds = {"Color3fArray": (vt.Vec3fArray, np.float32), "IntArray": (vt.IntArray, np.int32)}
            array, dtype = kinds.get(kind, (vt.FloatArray, np.float32))
            api = pxr("UsdGeom").PrimvarsAPI(self.made)
            self._samples[key] = Samples(
                api.CreatePrimvar(identifier(name), getattr(types, kind), "vertex"), array.FromNumpy, dtype
            )
        self._samples[key].set(frame, values)


class _MeshWriter:
    """A mesh of the world; what has changed since the frame before is written."""

    def __init__(self, stage: Any, path: str) -> None:
        made = pxr("UsdGeom").Mesh.Define(stage, path)
        made.CreateSubdivisionSchemeAttr("none")
        made.CreateDoubleSidedAttr(True)
        whole = pxr("Vt").IntArray.FromNumpy
        self._counts = Samples(made.CreateFaceVertexCountsAttr(), whole, np.int32)
        self._corners = Samples(made.CreateFaceVertexIndicesAttr(), whole, np.int32)
        self._points = Samples(made.CreatePointsAttr(), vectors, np.float32)
        self._extent = Samples(made.CreateExtentAttr(), vectors, np.float32)

    def frame(self, frame: int, solid: Solid) -> None:
        self._counts.set(frame, np.full(len(solid.faces), 3))
        self._corners.set(frame, np.ravel(solid.faces))
        self._points.set(frame, solid.vertices)
        self._extent.set(frame, box(solid.vertices))
