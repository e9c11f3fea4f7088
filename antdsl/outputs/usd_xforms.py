"""A crowd as one Xform an agent, with sampled translation, angles and scale: keyframes for programs that animate objects."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.catalogue import body
from antdsl.outputs.cache.cache_reader import Arrays
from antdsl.outputs.euler_angles import Angles
from antdsl.outputs.gallery import Gallery
from antdsl.outputs.pictures.light import decoded
from antdsl.outputs.pictures.model import Crowd
from antdsl.outputs.usd_parts import ROOT, Samples, identifier, name_states, still_mesh
from antdsl.scene.geometry.usd import pxr


class XformWriter:
    """One species: an Xform for each agent, below it the body as an instance of one that all share."""

    def __init__(self, stage: Any, gallery: Gallery, species: str, shape: str) -> None:
        entry = next(entry for entry in gallery.manifest.species if entry.name == species)
        self._stage, self._path, self._body = stage, f"{ROOT}/{identifier(species)}", f"/bodies/{identifier(species)}"
        name_states(pxr("UsdGeom").Scope.Define(stage, self._path).GetPrim(), entry)
        for path in ("/bodies", self._body):  # classes are drawn only where they are instanced
            stage.CreateClassPrim(path)
        drawn = body(shape)
        still_mesh(stage, f"{self._body}/shape", drawn.poses[0], drawn.faces)
        stage.GetPrimAtPath(self._body).SetTypeName("Xform")
        self._angles, self._agents, self._there = Angles(), dict[int, _Agent](), np.empty(0, np.int64)
        self._first: int | None = None

    def frame(self, frame: int, crowd: Crowd, arrays: Arrays, rows: NDArray[np.intp]) -> None:
        """The agents of a frame. Who is not in it is hidden."""
        self._first = frame if self._first is None else self._first
        ids = np.asarray(arrays["id"], np.int64)[rows] if "id" in arrays else np.arange(len(rows))
        order = np.argsort(ids, kind="stable")
        ids, rows = ids[order], rows[order]
        turn = self._angles.of(ids, np.asarray(crowd.orient)[order])
        place, size, colour = crowd.position[order], crowd.scale[order], decoded(crowd.colour[order])
        state = np.asarray(arrays["state"], np.int64)[rows] if "state" in arrays else np.full(len(rows), -1)
        for gone in np.setdiff1d(self._there, ids).tolist():
            self._agents[gone].hide(frame)
        for row, name in enumerate(ids.tolist()):
            if name not in self._agents:
                self._agents[name] = _Agent(self._stage, f"{self._path}/agent_{name}", self._body, name, self._first, frame)
            self._agents[name].set(frame, place[row], turn[row], size[row], colour[row], int(state[row]))
        self._there = ids


class _Agent:
    """The Xform of one agent."""

    def __init__(self, stage: Any, path: str, shape: str, name: int, first: int, frame: int) -> None:
        geom, types, gf, vt = pxr("UsdGeom"), pxr("Sdf").ValueTypeNames, pxr("Gf"), pxr("Vt")
        made = geom.Xform.Define(stage, path)
        double = geom.XformOp.PrecisionDouble
        ops = (made.AddTranslateOp(double), made.AddRotateXYZOp(double), made.AddScaleOp(double))
        self._ops = tuple(Samples(op, lambda v: gf.Vec3d(*v.tolist())) for op in ops)
        prim = made.GetPrim()
        prim.CreateAttribute("userProperties:id", types.Int64).Set(name)
        state = prim.CreateAttribute("userProperties:state", types.Int)
        self._state = Samples(state, lambda v: int(v[0]), np.int32)
        colour = geom.PrimvarsAPI(made).CreatePrimvar("displayColor", types.Color3fArray, "constant")
        self._colour = Samples(colour, lambda v: vt.Vec3fArray.FromNumpy(v[None]), np.float32)
        self._seen = made.CreateVisibilityAttr()
        if frame > first:
            self._seen.Set("invisible", first)
        self._seen.Set("inherited", frame)
        self._hidden = False
        instance = stage.DefinePrim(f"{path}/body", "Xform")
        instance.GetReferences().AddInternalReference(shape)
        instance.SetInstanceable(True)

    def set(self, frame: int, place: Any, turn: Any, size: float, colour: Any, state: int) -> None:
        for samples, value in zip(self._ops, (place, turn, np.full(3, size)), strict=True):
            samples.set(frame, value)
        self._colour.set(frame, colour)
        if state >= 0:
            self._state.set(frame, state)
        if self._hidden:
            self._seen.Set("inherited", frame)
            self._hidden = False

    def hide(self, frame: int) -> None:
        self._seen.Set("invisible", frame)
        self._hidden = True
