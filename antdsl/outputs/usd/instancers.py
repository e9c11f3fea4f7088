"""A crowd as a point instancer. Prototypes are the poses of its bodies; instances are its agents.

Positions, orientations, velocities and angular velocities have a sample at every time, because readers use velocities only at
times that have positions and orientations. Other arrays have samples only when they change. The sign of a quaternion is that
nearest to the previous sample."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.records import match_ids
from antdsl.outputs.cache.manifest import SpeciesEntry
from antdsl.outputs.pictures.light import decode_srgb
from antdsl.outputs.usd.pose_bank import PrototypeBank
from antdsl.outputs.usd.time_samples import SpeciesSample, TimeSample
from antdsl.outputs.usd.values import (
    ROOT_PATH,
    StageOutput,
    ValueSamples,
    to_identifier,
    to_integer_array,
    to_vector_array,
    write_state_names,
)
from antdsl.scene.geometry.usd import import_pxr_module


class InstancerWriter:
    """Writer of one species as instances of poses."""

    notes: tuple[str, ...] = ()

    def __init__(self, stage_output: StageOutput, species: SpeciesEntry, number: int, close: bool = False) -> None:
        self._out, self._number, stage = stage_output, number, stage_output.stage
        path = f"{ROOT_PATH}/{stage_output.name('species', species.name)}"
        self.instancer = import_pxr_module("UsdGeom").PointInstancer.Define(stage, path)
        import_pxr_module("UsdGeom").Scope.Define(stage, f"{path}/prototypes")
        write_state_names(self.instancer.GetPrim(), species)
        self._bank = PrototypeBank(stage_output, species, close)
        self._prototype_count = 0
        self._samples: dict[str, ValueSamples] = {}
        self._previous_quaternions = (np.zeros(0, np.int64), np.zeros((0, 4)))
        self._primvars_api = import_pxr_module("UsdGeom").PrimvarsAPI(self.instancer)
        self._state_names = [state.name for state in species.machines[0].states] if species.machines else []
        vt = import_pxr_module("Vt")
        self._conversion_by_attribute: dict[str, tuple[Callable[[Any], Any], Any]] = {
            "orientations": (vt.QuathArray.FromNumpy, np.float16),
            "orientationsf": (vt.QuatfArray.FromNumpy, np.float32),
            "ids": (vt.Int64Array.FromNumpy, np.int64),
            "invisibleIds": (vt.Int64Array.FromNumpy, np.int64),
            "protoIndices": (to_integer_array, np.int32),
        }

    def sample(self, time_sample: TimeSample) -> None:
        """Write the agents at a time, with their ids."""
        agents, time = time_sample.agents(self._number), time_sample.time
        prototypes = self._choose_prototypes(agents, time_sample.shutter_agents[self._number])
        self._write_attribute(time, "positions", agents.position)
        turn = self._align_signs(agents)
        # USD's arrays of quaternions lie in memory with the real part last, as ours do
        self._write_attribute(time, "orientations", turn)
        self._write_attribute(time, "orientationsf", turn)
        self._write_attribute(time, "velocities", agents.velocity)
        self._write_attribute(time, "angularVelocities", agents.angular_velocity)
        self._write_attribute(time, "scales", np.repeat(agents.scale[:, None], 3, axis=1))
        self._write_attribute(time, "ids", agents.ids)
        self._write_attribute(time, "invisibleIds", agents.ids[~agents.is_visible])
        self._write_attribute(time, "protoIndices", prototypes)
        self._write_attribute(time, "extent", self._compute_extent(agents))
        self._write_primvar(time, "displayColor", decode_srgb(agents.colour))
        if agents.state is not None and self._state_names:
            self._write_primvar(time, "state", np.clip(agents.state, 0, len(self._state_names) - 1))
        for name, values in agents.numbers.items():
            self._write_primvar(time, name, values)
        if len(self._bank.paths) > self._prototype_count:
            self.instancer.CreatePrototypesRel().SetTargets(self._bank.paths)
            self._prototype_count = len(self._bank.paths)

    def _choose_prototypes(self, agents: SpeciesSample, shutter_agents: SpeciesSample) -> NDArray[np.int32]:
        """Return the prototype of each agent. While the shutter is open, it does not change, because motion blur needs a single
        mesh."""
        prototypes = self._bank.find_prototypes(agents)
        if agents.ids is not shutter_agents.ids:
            at, is_matched = match_ids(agents.ids, shutter_agents.ids)
            prototypes[is_matched] = self._bank.find_prototypes(shutter_agents)[at[is_matched]]
        return prototypes

    def _align_signs(self, agents: SpeciesSample) -> NDArray[np.float64]:
        """Return orientations as quaternions with the signs that are nearest to each agent's previous sample."""
        turn = agents.orient.copy()
        at, is_matched = match_ids(agents.ids, self._previous_quaternions[0])
        if is_matched.any():
            products = (turn[is_matched] * self._previous_quaternions[1][at[is_matched]]).sum(axis=1)
            turn[is_matched] *= np.where(products < 0, -1.0, 1.0)[:, None]
        self._previous_quaternions = (agents.ids, turn)
        return turn

    def _compute_extent(self, agents: SpeciesSample) -> NDArray[np.float64]:
        """Return the lowest and the highest corner (2, 3) of a box around all agents."""
        place, size = agents.position[agents.is_visible], agents.scale[agents.is_visible]
        if not len(place):
            return np.zeros((2, 3))
        reach = self._bank.max_reach * size[:, None]
        return np.stack([(place - reach).min(axis=0), (place + reach).max(axis=0)])

    def _write_attribute(self, time: float, name: str, values: Any) -> None:
        """Write the values of an attribute of the instancer at a time."""
        if name not in self._samples:
            convert, kind = self._conversion_by_attribute.get(name, (to_vector_array, np.float32))
            attribute = getattr(self.instancer, f"Create{name[0].upper()}{name[1:]}Attr")()
            always = name in ("positions", "orientations", "orientationsf", "velocities", "angularVelocities")
            self._samples[name] = self._out.add_samples(attribute, convert, kind, always=always)
        self._samples[name].set(time, values)

    def _write_primvar(self, time: float, name: str, values: Any) -> None:
        """Write one value per agent as a primvar. States are written as indices in the list of state names."""
        if name not in self._samples:
            types, vt = import_pxr_module("Sdf").ValueTypeNames, import_pxr_module("Vt")
            is_integer = np.asarray(values).dtype.kind in "iu"
            if name == "state":
                primvar = self._primvars_api.CreatePrimvar("state", types.TokenArray, "vertex")
                primvar.Set(vt.TokenArray(self._state_names))
                self._samples[name] = self._out.add_samples(primvar.CreateIndicesAttr(), to_integer_array, np.int32)
            elif name == "displayColor":
                self._samples[name] = self._out.add_samples(
                    self._primvars_api.CreatePrimvar(name, types.Color3fArray, "vertex"), to_vector_array, np.float32
                )
            elif is_integer:
                self._samples[name] = self._out.add_samples(
                    self._primvars_api.CreatePrimvar(to_identifier(name), types.IntArray, "vertex"), to_integer_array, np.int32
                )
            else:
                primvar = self._primvars_api.CreatePrimvar(to_identifier(name), types.FloatArray, "vertex")
                self._samples[name] = self._out.add_samples(primvar, vt.FloatArray.FromNumpy, np.float32)
        self._samples[name].set(time, values)
