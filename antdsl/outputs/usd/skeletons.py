"""A crowd as UsdSkel. Each agent is an instance of the definition of its body, with a separate SkelAnimation."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.affine import decompose_matrices, normalise_quaternions
from antdsl.bodies.agents.poses import WorldPoses
from antdsl.bodies.posed_body import PosedBody
from antdsl.numerics.records import match_ids
from antdsl.outputs.cache.manifest import SpeciesEntry
from antdsl.outputs.pictures.light import decode_srgb
from antdsl.outputs.usd.definitions import SkelDefinition, write_definition
from antdsl.outputs.usd.materials import MaterialBinder
from antdsl.outputs.usd.time_samples import SpeciesSample, TimeSample
from antdsl.outputs.usd.values import (
    BODIES_PATH,
    MATERIALS_PATH,
    ROOT_PATH,
    StageOutput,
    ValueSamples,
    Visibility,
    make_unique,
    to_identifier,
    write_state_names,
)
from antdsl.scene.geometry.usd import import_pxr_module

_MAX_IGNORED_SHEAR = 1e-4  # shear of a joint; larger values are reported, because UsdSkel omits shear


class SkeletonWriter:
    """Writer of the agents of one species. The animation of an agent is a sibling of the agent.

    With `has_instances`, agents are instances of their body. Otherwise they are copies, with meshes in the colours of agents.
    These are for programs that do not pose instances, or do not inherit primvars."""

    def __init__(
        self, stage_output: StageOutput, species: SpeciesEntry, number: int, has_instances: bool = True, close: bool = False
    ) -> None:
        self._out, self._species, self._number, stage = stage_output, species, number, stage_output.stage
        self._path = f"{ROOT_PATH}/{stage_output.name('species', species.name)}"
        write_state_names(import_pxr_module("UsdGeom").Scope.Define(stage, self._path).GetPrim(), species)
        import_pxr_module("UsdGeom").Scope.Define(stage, f"{self._path}/motion")
        self._bodies: dict[int, tuple[PosedBody, SkelDefinition]] = {}
        self._agents = dict[tuple[int, int], _AgentPrim]()  # by agent id and body
        self._hideable_agents: set[tuple[int, int]] = set()
        self._named_agents, self._file_number = set[int](), stage_output.file_number
        self._first: float | None = None
        self._has_shear, self._has_instances, self._uses_close_bodies = False, has_instances, close

    @property
    def notes(self) -> list[str]:
        """Return messages about features of the bodies that UsdSkel cannot represent."""
        messages = [note for _, definition in self._bodies.values() for note in definition.notes]
        if self._has_shear:
            messages.append(f"joints of `{self._species.name}` are sheared: UsdSkel has no shear, so it is left out")
        return messages

    def sample(self, time_sample: TimeSample) -> None:
        """Write the agents at a time. Agents that do not exist at this time are hidden."""
        agents = time_sample.agents(self._number)
        self._first = time_sample.time if self._first is None else self._first
        visible_keys = set[tuple[int, int]]()
        colour = decode_srgb(agents.colour)
        for part, (crowd, rows) in enumerate(agents.parts):
            if crowd.body is None:
                continue
            body, definition = self._find_or_write_body(crowd.body, crowd.body_key)
            joints = _sample_joints(time_sample, self._number, part, body)
            self._has_shear = self._has_shear or joints.has_shear
            channels = [body.definition.rig.find_channel(name) for name in definition.channels]
            for k, row in enumerate(rows.tolist()):
                if not agents.is_visible[row]:
                    continue
                agent = self._find_or_add_agent(int(agents.ids[row]), definition, time_sample.time)
                visible_keys.add((int(agents.ids[row]), definition.number))
                agent.write_placement(time_sample.time, agents, row, colour[row])
                agent.write_pose(time_sample.time, [each[k] for each in joints.values], joints.channels[k, channels])
        if self._file_number != self._out.file_number:  # a new file of values first hides all agents that may appear in it later
            self._file_number, self._hideable_agents = self._out.file_number, set(self._agents)
        for hidden_key in sorted(self._hideable_agents - visible_keys):
            self._agents[hidden_key].write_hidden(time_sample.time)
        self._hideable_agents = visible_keys

    def _find_or_add_agent(self, name: int, body: SkelDefinition, time: float) -> _AgentPrim:
        """Return the prims of an agent with a body. If the agent's layers change later, it gets another instance."""
        if (name, body.number) not in self._agents:
            assert self._first is not None
            path = f"agent_{name}" if name not in self._named_agents else f"agent_{name}_{body.number}"
            self._named_agents.add(name)
            agent = _AgentPrim(self._out, self._path, path, name, body, self._species, self._first, time, self._has_instances)
            self._agents[name, body.number] = agent
        return self._agents[name, body.number]

    def _find_or_write_body(self, body: PosedBody, key: str) -> tuple[PosedBody, SkelDefinition]:
        """Return a body together with its written definition. Write it if this is its first use. `key`: the key of the body."""
        if id(body) not in self._bodies:
            number = len(self._bodies) + 1
            name = self._out.name_body(self._species.name, body, key)
            looks = MaterialBinder(self._out.stage, f"{MATERIALS_PATH}/{name}", body.definition.materials)
            definition = write_definition(self._out.stage, f"{BODIES_PATH}/{name}", body, looks, self._uses_close_bodies)
            definition.number = number
            self._bodies[id(body)] = body, definition
        return self._bodies[id(body)]


class _JointSamples:
    """The local transforms of the joints of n agents.

    `values`: translations, rotations (x y z w) and scales, each float32[n, J, 3 or 4]. `channels`: float32[n, C]."""

    def __init__(self, poses: WorldPoses) -> None:
        assert poses.local_transforms is not None
        n, count = poses.local_transforms.shape[:2]
        square = np.zeros((n * count, 4, 4))
        square[:, :3] = poses.local_transforms.reshape(n * count, 3, 4)
        place, turn, scale, shear = decompose_matrices(square)
        self.has_shear = bool((np.abs(shear) > _MAX_IGNORED_SHEAR).any())
        parts = (np.moveaxis(each, 0, -1).reshape(n, count, len(each)) for each in (place, turn, scale))
        self.values = tuple(np.ascontiguousarray(each, np.float32) for each in parts)
        self.channels = np.asarray(poses.channels, np.float32)

    def interpolate_rows(self, rows: NDArray[np.bool_], other: _JointSamples, other_rows: NDArray[np.intp], share: float) -> None:
        """Interpolate or extrapolate the joints in `rows` linearly towards those of `other`, by the fraction `share`.

        `other_rows`: the row of each agent in `other`. Rotations follow the smaller angle."""
        for k, (mine, theirs) in enumerate(zip(self.values, other.values, strict=True)):
            towards = theirs[other_rows[rows]]
            if k == 1:
                towards = np.where((towards * mine[rows]).sum(axis=-1, keepdims=True) < 0, -towards, towards)
            mine[rows] += (towards - mine[rows]) * np.float32(share)
        self.channels[rows] += (other.channels[other_rows[rows]] - self.channels[rows]) * np.float32(share)
        turn = np.ascontiguousarray(np.moveaxis(self.values[1], -1, 0))
        self.values = (self.values[0], np.ascontiguousarray(np.moveaxis(normalise_quaternions(turn), 0, -1)), self.values[2])


def _sample_joints(time_sample: TimeSample, number: int, part: int, body: PosedBody) -> _JointSamples:
    """Return the joints of the agents with one body at a time. After the last frame, the last motion continues.

    `number`: the species. `part`: the index of the crowd in the species' `parts`."""
    agents = time_sample.species[number]
    crowd, rows = agents.parts[part]
    joints = _JointSamples(crowd.compute_poses(needs_local=True))
    others, share = time_sample.next_agents, time_sample.share
    if not others:
        others, share = time_sample.previous_agents, -share
    if not share or others is None:
        return joints
    for other, other_rows in others[number].parts:
        if other.body is body:
            at, same = match_ids(agents.ids[rows], others[number].ids[other_rows])
            joints.interpolate_rows(same, _JointSamples(other.compute_poses(needs_local=True)), at, share)
    return joints


class _AgentPrim:
    """The prims of one agent: a placed instance, and its animation."""

    def __init__(
        self,
        stage_output: StageOutput,
        parent_path: str,
        path: str,
        name: int,
        body: SkelDefinition,
        species: SpeciesEntry,
        first: float,
        time: float,
        has_instances: bool,
    ) -> None:
        geom, skel, types, vt, gf = (
            import_pxr_module("UsdGeom"),
            import_pxr_module("UsdSkel"),
            import_pxr_module("Sdf").ValueTypeNames,
            import_pxr_module("Vt"),
            import_pxr_module("Gf"),
        )
        stage, self._out = stage_output.stage, stage_output
        moves = skel.Animation.Define(stage, f"{parent_path}/motion/{path}")
        moves.CreateJointsAttr(vt.TokenArray(list(body.joints)))
        array = vt.Vec3fArray.FromNumpy
        self._joints = (
            stage_output.add_samples(moves.CreateTranslationsAttr(), array, np.float32),
            stage_output.add_samples(moves.CreateRotationsAttr(), vt.QuatfArray.FromNumpy, np.float32),
            stage_output.add_samples(moves.CreateScalesAttr(), vt.Vec3hArray.FromNumpy, np.float16),
        )
        self._weights = None
        if body.channels:
            moves.CreateBlendShapesAttr(vt.TokenArray([to_identifier(channel) for channel in body.channels]))
            self._weights = stage_output.add_samples(moves.CreateBlendShapeWeightsAttr(), vt.FloatArray.FromNumpy, np.float32)
        root = skel.Root.Define(stage, f"{parent_path}/{path}")
        prim = root.GetPrim()
        single, double = geom.XformOp.PrecisionFloat, geom.XformOp.PrecisionDouble
        self._translations = stage_output.add_samples(root.AddTranslateOp(double), lambda v: gf.Vec3d(*v.tolist()))
        self._rotations = stage_output.add_samples(
            root.AddOrientOp(single), lambda v: gf.Quatf(float(v[3]), *v[:3].tolist()), np.float32
        )
        self._scales = stage_output.add_samples(root.AddScaleOp(single), lambda v: gf.Vec3f(*v.tolist()), np.float32)
        prim.GetPayloads().AddInternalPayload(body.path)
        prim.SetInstanceable(has_instances)
        skel.BindingAPI.Apply(prim).CreateAnimationSourceRel().SetTargets([moves.GetPath()])
        prim.CreateAttribute("userProperties:id", types.Int64).Set(name)
        self._api = geom.PrimvarsAPI(root)
        colour = self._api.CreatePrimvar("displayColor", types.Color3fArray, "constant")
        tinted = (stage.OverridePrim(f"{parent_path}/{path}/{below}") for below in body.tinted_meshes if not has_instances)
        tints = [geom.PrimvarsAPI(each).CreatePrimvar("displayColor", types.Color3fArray, "constant") for each in tinted]
        self._colour = [
            stage_output.add_samples(each, lambda v: vt.Vec3fArray.FromNumpy(v[None]), np.float32) for each in (colour, *tints)
        ]
        self._velocities = [
            stage_output.add_samples(
                self._api.CreatePrimvar(name, types.Vector3f, "constant"),
                lambda v: gf.Vec3f(*v.tolist()),
                np.float32,
                always=True,
            )
            for name in ("velocity", "angularVelocity")
        ]
        self._used_names = {"displayColor", "state", "velocity", "angularVelocity"}
        self._names = [state.name for state in species.machines[0].states] if species.machines else []
        self._numbers: dict[str, ValueSamples] = {}
        self._previous_values = (np.zeros(4), None)
        self._visibility = Visibility(stage_output, root, first, time)

    def write_placement(self, time: float, agents: SpeciesSample, row: int, colour: NDArray[np.floating]) -> None:
        """Write position, orientation, scale, velocities, colour, state and other numbers at a time."""
        self._translations.set(time, agents.position[row])
        turn = agents.orient[row] * (-1.0 if agents.orient[row] @ self._previous_values[0] < 0 else 1.0)
        self._previous_values = (turn, self._previous_values[1])
        self._rotations.set(time, turn)
        self._scales.set(time, np.full(3, agents.scale[row]))
        for samples, values in zip(self._velocities, (agents.velocity[row], agents.angular_velocity[row]), strict=True):
            samples.set(time, values)
        for samples in self._colour:
            samples.set(time, colour)
        if agents.state is not None and 0 <= agents.state[row] < len(self._names):
            self._write_number("state", agents.state[row], time)
        for name, values in agents.numbers.items():
            self._write_number(name, values[row], time)
        self._visibility.set(time, True)

    def write_pose(self, time: float, joints: list[Any], weights: Any) -> None:
        """Write the transforms of the joints and the weights of blend shapes at a time."""
        positions, turns, scales = joints
        previous = self._previous_values[1]
        if previous is not None:
            turns = np.where((turns * previous).sum(axis=-1, keepdims=True) < 0, -turns, turns)
        self._previous_values = (self._previous_values[0], turns)
        for samples, values in zip(self._joints, (positions, turns, scales), strict=True):
            samples.set(time, values)
        if self._weights is not None:
            self._weights.set(time, weights)

    def _write_number(self, name: str, value: Any, time: float) -> None:
        """Write the value of a numeric attribute at a time."""
        if name not in self._numbers:
            types, names = import_pxr_module("Sdf").ValueTypeNames, self._names
            is_integer = np.asarray(value).dtype.kind in "iu"
            if name == "state":
                primvar = self._api.CreatePrimvar("state", types.Token, "constant")
                self._numbers[name] = self._out.add_samples(primvar, lambda v: names[int(v[0])], np.int64)
            else:
                written = make_unique(to_identifier(name), self._used_names)
                primvar = self._api.CreatePrimvar(written, types.Int if is_integer else types.Float, "constant")
                self._numbers[name] = self._out.add_samples(
                    primvar, (lambda v: int(v[0])) if is_integer else (lambda v: float(v[0]))
                )
        self._numbers[name].set(time, np.reshape(value, 1))

    def write_hidden(self, time: float) -> None:
        """Hide the agent from this time on."""
        self._visibility.set(time, False)
