"""A crowd as a point instancer. Poses of its bodies are prototypes, agents are instances.

Positions, orientations, velocities and angular velocities have a sample at every time. Readers use velocities only at the times
of positions and orientations. Other arrays have samples when they change. The signs of quaternions follow the previous
sample."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.records import match_ids
from antdsl.outputs.cache.manifest import SpeciesEntry
from antdsl.outputs.pictures.light import decode_srgb
from antdsl.outputs.usd.bank import PrototypeBank
from antdsl.outputs.usd.moments import SpeciesSample, TimeSample
from antdsl.outputs.usd.values import ROOT_PATH, StageOutput, ValueSamples, identifier, integers, name_states, vectors
from antdsl.scene.geometry.usd import pxr


class InstancerWriter:
    """Writer of one species: its agents are instances from a bank of poses."""

    notes: tuple[str, ...] = ()

    def __init__(self, out: StageOutput, species: SpeciesEntry, number: int, close: bool = False) -> None:
        self._out, self._number, stage = out, number, out.stage
        path = f"{ROOT_PATH}/{out.name('species', species.name)}"
        self.made = pxr("UsdGeom").PointInstancer.Define(stage, path)
        pxr("UsdGeom").Scope.Define(stage, f"{path}/prototypes")
        name_states(self.made.GetPrim(), species)
        self._bank = PrototypeBank(out, species, close)
        self._targets = 0
        self._samples: dict[str, ValueSamples] = {}
        self._signs = (np.zeros(0, np.int64), np.zeros((0, 4)))
        self._api = pxr("UsdGeom").PrimvarsAPI(self.made)
        self._names = [state.name for state in species.machines[0].states] if species.machines else []
        vt = pxr("Vt")
        self._kinds: dict[str, tuple[Callable[[Any], Any], Any]] = {
            "orientations": (vt.QuathArray.FromNumpy, np.float16),
            "orientationsf": (vt.QuatfArray.FromNumpy, np.float32),
            "ids": (vt.Int64Array.FromNumpy, np.int64),
            "invisibleIds": (vt.Int64Array.FromNumpy, np.int64),
            "protoIndices": (integers, np.int32),
        }

    def sample(self, time_sample: TimeSample) -> None:
        """Write the agents at a time, by their ids."""
        agents, time = time_sample.agents(self._number), time_sample.time
        prototypes = self._prototypes(agents, time_sample.shutter_agents[self._number])
        self._set(time, "positions", agents.position)
        turn = self._align_signs(agents)
        # USD's arrays of quaternions lie in memory with the real part last, as ours do
        self._set(time, "orientations", turn)
        self._set(time, "orientationsf", turn)
        self._set(time, "velocities", agents.velocity)
        self._set(time, "angularVelocities", agents.turning)
        self._set(time, "scales", np.repeat(agents.scale[:, None], 3, axis=1))
        self._set(time, "ids", agents.ids)
        self._set(time, "invisibleIds", agents.ids[~agents.is_visible])
        self._set(time, "protoIndices", prototypes)
        self._set(time, "extent", self._extent(agents))
        self._primvar(time, "displayColor", decode_srgb(agents.colour))
        if agents.state is not None and self._names:
            self._primvar(time, "state", np.clip(agents.state, 0, len(self._names) - 1))
        for name, values in agents.numbers.items():
            self._primvar(time, name, values)
        if len(self._bank.paths) > self._targets:
            self.made.CreatePrototypesRel().SetTargets(self._bank.paths)
            self._targets = len(self._bank.paths)

    def _prototypes(self, agents: SpeciesSample, shutter_agents: SpeciesSample) -> NDArray[np.int32]:
        """Return the prototype of each agent. It does not change while the shutter is open, since motion blur needs one
        mesh."""
        prototypes = self._bank.prototype_numbers(agents)
        if agents.ids is not shutter_agents.ids:
            at, is_matched = match_ids(agents.ids, shutter_agents.ids)
            prototypes[is_matched] = self._bank.prototype_numbers(shutter_agents)[at[is_matched]]
        return prototypes

    def _align_signs(self, agents: SpeciesSample) -> NDArray[np.float64]:
        """Return orientations as quaternions, with the signs of the previous sample."""
        turn = agents.orient.copy()
        at, is_matched = match_ids(agents.ids, self._signs[0])
        if is_matched.any():
            products = (turn[is_matched] * self._signs[1][at[is_matched]]).sum(axis=1)
            turn[is_matched] *= np.where(products < 0, -1.0, 1.0)[:, None]
        self._signs = (agents.ids, turn)
        return turn

    def _extent(self, agents: SpeciesSample) -> NDArray[np.float64]:
        place, size = agents.position[agents.is_visible], agents.scale[agents.is_visible]
        if not len(place):
            return np.zeros((2, 3))
        reach = self._bank.reach * size[:, None]
        return np.stack([(place - reach).min(axis=0), (place + reach).max(axis=0)])

    def _set(self, time: float, name: str, values: Any) -> None:
        if name not in self._samples:
            convert, kind = self._kinds.get(name, (vectors, np.float32))
            attribute = getattr(self.made, f"Create{name[0].upper()}{name[1:]}Attr")()
            always = name in ("positions", "orientations", "orientationsf", "velocities", "angularVelocities")
            self._samples[name] = self._out.samples(attribute, convert, kind, always=always)
        self._samples[name].set(time, values)

    def _primvar(self, time: float, name: str, values: Any) -> None:
        """Write one value per agent as a primvar. States are written as indices of their names."""
        if name not in self._samples:
            types, vt = pxr("Sdf").ValueTypeNames, pxr("Vt")
            is_integer = np.asarray(values).dtype.kind in "iu"
            if name == "state":
                primvar = self._api.CreatePrimvar("state", types.TokenArray, "vertex")
                primvar.Set(vt.TokenArray(self._names))
                self._samples[name] = self._out.samples(primvar.CreateIndicesAttr(), integers, np.int32)
            elif name == "displayColor":
                self._samples[name] = self._out.samples(
                    self._api.CreatePrimvar(name, types.Color3fArray, "vertex"), vectors, np.float32
                )
            elif is_integer:
                self._samples[name] = self._out.samples(
                    self._api.CreatePrimvar(identifier(name), types.IntArray, "vertex"), integers, np.int32
                )
            else:
                primvar = self._api.CreatePrimvar(identifier(name), types.FloatArray, "vertex")
                self._samples[name] = self._out.samples(primvar, vt.FloatArray.FromNumpy, np.float32)
        self._samples[name].set(time, values)
