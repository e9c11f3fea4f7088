"""A crowd as one Xform per agent, with samples of translation, angles and scale.

Programs that animate single objects read these samples as keyframes."""

from __future__ import annotations

from typing import Any

import numpy as np

from antdsl.outputs.cache.manifest import SpeciesEntry
from antdsl.outputs.euler_angles import EulerAngles
from antdsl.outputs.pictures.light import decode_srgb
from antdsl.outputs.usd.pose_bank import PrototypeBank, add_coloured_mesh
from antdsl.outputs.usd.time_samples import TimeSample
from antdsl.outputs.usd.values import ROOT_PATH, StageOutput, Visibility, write_state_names
from antdsl.scene.geometry.usd import import_pxr_module


class XformWriter:
    """Writer of the agents of one species. Each is an Xform with the body in the agent's first pose below it.

    Agents with the same first pose share this body."""

    notes: tuple[str, ...] = ()

    def __init__(self, stage_output: StageOutput, species: SpeciesEntry, number: int, close: bool = False) -> None:
        self._out, self._number, self._path = stage_output, number, f"{ROOT_PATH}/{stage_output.name('species', species.name)}"
        write_state_names(import_pxr_module("UsdGeom").Scope.Define(stage_output.stage, self._path).GetPrim(), species)
        self._bank = PrototypeBank(stage_output, species, close)
        self._euler_angles, self._agents, self._hideable_agents = EulerAngles(), dict[int, _AgentPrim](), np.empty(0, np.int64)
        self._first_time: float | None = None
        self._file_number = stage_output.file_number

    def sample(self, time_sample: TimeSample) -> None:
        """Write the agents at a time. Agents that do not exist at this time are hidden."""
        agents, time = time_sample.agents(self._number), time_sample.time
        self._first_time = time if self._first_time is None else self._first_time
        turn = self._euler_angles.compute_angles(agents.ids, agents.orient)
        colour = decode_srgb(agents.colour)
        visible_ids = agents.ids[agents.is_visible]
        if self._file_number != self._out.file_number:  # a new file of values first hides all agents that may appear in it later
            self._file_number, self._hideable_agents = self._out.file_number, np.array(sorted(self._agents), np.int64)
        for hidden_id in np.setdiff1d(self._hideable_agents, visible_ids).tolist():
            self._agents[hidden_id].write_hidden(time)
        for row, name in enumerate(agents.ids.tolist()):
            if not agents.is_visible[row]:
                continue
            if name not in self._agents:
                pose = self._bank.find_pose_paths(agents)[row]
                self._agents[name] = _AgentPrim(self._out, f"{self._path}/agent_{name}", pose, name, self._first_time, time)
            state = -1 if agents.state is None else int(agents.state[row])
            self._agents[name].set(time, agents.position[row], turn[row], agents.scale[row], colour[row], state)
        self._hideable_agents = visible_ids


class _AgentPrim:
    """Writer of the Xform of one agent."""

    def __init__(self, stage_output: StageOutput, path: str, shape: str, name: int, first: float, time: float) -> None:
        geom, types, gf, vt = (
            import_pxr_module("UsdGeom"),
            import_pxr_module("Sdf").ValueTypeNames,
            import_pxr_module("Gf"),
            import_pxr_module("Vt"),
        )
        xform = geom.Xform.Define(stage_output.stage, path)
        double = geom.XformOp.PrecisionDouble
        ops = (xform.AddTranslateOp(double), xform.AddRotateXYZOp(double), xform.AddScaleOp(double))
        self._transform_samples = tuple(stage_output.add_samples(op, lambda v: gf.Vec3d(*v.tolist())) for op in ops)
        prim = xform.GetPrim()
        prim.CreateAttribute("userProperties:id", types.Int64).Set(name)
        state = prim.CreateAttribute("userProperties:state", types.Int)
        self._state = stage_output.add_samples(state, lambda v: int(v[0]), np.int32)
        colour = add_coloured_mesh(stage_output.stage, f"{path}/body", shape)
        self._colour = stage_output.add_samples(colour, lambda v: vt.Vec3fArray.FromNumpy(v[None]), np.float32)
        self._visibility = Visibility(stage_output, xform, first, time)

    def set(self, time: float, translation: Any, angles: Any, size: float, colour: Any, state: int) -> None:
        """Write translation, angles (degrees), scale, colour and state at a time."""
        for samples, value in zip(self._transform_samples, (translation, angles, np.full(3, size)), strict=True):
            samples.set(time, value)
        self._colour.set(time, colour)
        if state >= 0:
            self._state.set(time, state)
        self._visibility.set(time, True)

    def write_hidden(self, time: float) -> None:
        """Hide the agent from this time on."""
        self._visibility.set(time, False)
