"""A bank of poses: for each species, the prototypes of its agents' instances, created at first use.

A pose consists of the topmost clip on the complete body, and the clip on each transform group. A clip is included if it has most
of its machine's weight. Its time is the nearest of a few steps in its cycle. An agent that walks on its feet but plays no walking
clip gets one, chosen by its speed, at the phase of its gait. A prototype is a pose in the colour of a state."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.definition import Clip
from antdsl.bodies.agents.machine_clips import PlayedClip
from antdsl.bodies.agents.poses import WorldPoses
from antdsl.bodies.posed_body import NO_DRIVEN_POSE, PosedBody
from antdsl.outputs.cache.manifest import SpeciesEntry
from antdsl.outputs.pictures.light import decode_srgb
from antdsl.outputs.pictures.model import Crowd
from antdsl.outputs.usd.materials import MaterialBinder, MaterialBodyMesh, make_single_clips
from antdsl.outputs.usd.time_samples import SpeciesSample
from antdsl.outputs.usd.values import (
    BODIES_PATH,
    MATERIALS_PATH,
    ROOT_PATH,
    Array,
    StageOutput,
    add_mesh,
    make_unique,
    to_identifier,
    to_vector_array,
)
from antdsl.scene.geometry.usd import import_pxr_module

POSES_PER_CLIP = 16  # poses per clip on the complete body
_POSES_PER_GROUP_CLIP = 4  # poses per clip on a transform group
_MAX_PROTOTYPES = 2048  # maximum number of prototypes of a species; beyond it, clips on groups are omitted
_STANDING_SPEED = 0.02  # body lengths per second; slower agents stand
_MAX_FINE_TRIANGLES = 1500  # the coarse body is used if the fine one has more triangles


class PrototypeBank:
    """The poses of one species as class prims, and the prototypes below the path of its instancer."""

    def __init__(self, stage_output: StageOutput, species: SpeciesEntry, close: bool = False) -> None:
        self._out, self._stage, self._species, self._uses_close_bodies = stage_output, stage_output.stage, species.name, close
        self._bodies: list[tuple[PosedBody, _PoseBody]] = []
        self._prototype_by_key: dict[tuple[int, ...], int] = {}
        self._path_by_pose: dict[tuple[int, ...], str] = {}
        self._prototype_names = set[str]()
        self.paths: list[str] = []
        self.max_reach = 0.0
        states = species.machines[0].states if species.machines else ()
        self._colours = (
            decode_srgb(np.array([state.colour for state in states])) if stage_output.shows_states and states else None
        )
        self._states = [to_identifier(state.name) for state in states]

    def find_prototypes(self, agents: SpeciesSample) -> NDArray[np.int32]:
        """Return the prototype of each agent as an index in `paths`, int32[n]."""
        found = np.zeros(len(agents.ids), np.int32)
        for rows, keys, which in self._make_pose_keys(agents):
            found[rows] = np.array([self._find_or_write_prototype(*key) for key in keys], np.int32)[which]
        return found

    def find_pose_paths(self, agents: SpeciesSample) -> list[str]:
        """Return the path of the pose of each agent."""
        pose_paths = [""] * len(agents.ids)
        for rows, keys, which in self._make_pose_keys(agents):
            paths = [self._find_or_write_pose(body, *played) for body, _, *played in keys]
            for row, kind in zip(rows.tolist(), which.tolist(), strict=True):
                pose_paths[row] = paths[kind]
        return pose_paths

    def _make_pose_keys(
        self, agents: SpeciesSample
    ) -> Iterator[tuple[NDArray[np.intp], list[tuple[int, ...]], NDArray[np.intp]]]:
        """Yield, for each worn body: the rows of its agents, the distinct keys of poses, and the index of each agent's key.

        A key consists of the body, the state, and the codes of the clips played."""
        state = np.full(len(agents.ids), -1) if agents.state is None or self._colours is None else agents.state
        for crowd, rows in agents.parts:
            if crowd.body is None:
                continue
            speed = np.linalg.norm(agents.own_velocity[rows], axis=1) / np.maximum(agents.scale[rows], 1e-12)
            body_codes, *on_parts = compute_clip_codes(crowd.body, crowd, speed)
            columns = [state[rows], body_codes, *(on_parts if len(self.paths) < _MAX_PROTOTYPES else ())]
            kinds, which = _find_unique_rows(np.stack(columns, axis=1).astype(np.int64))
            body = self._find_or_add_body(crowd.body, crowd.body_key)
            yield rows, [(body, *kind) for kind in kinds.tolist()], which

    def _find_or_add_body(self, body: PosedBody, key: str) -> int:
        """Return the number of a body in the bank. Add it if it is new. `key`: the key of the body."""
        for number, (known, _) in enumerate(self._bodies):
            if known is body:
                return number
        name = self._out.name_body(self._species, body, key)
        self._bodies.append((body, _PoseBody(self._stage, name, body, self._uses_close_bodies)))
        return len(self._bodies) - 1

    def _find_or_write_pose(self, body: int, *played: int) -> str:
        """Return the path of the mesh for a body that plays the given clip codes. Write the mesh if it does not exist."""
        key = (body, *played)
        if key not in self._path_by_pose:
            self._path_by_pose[key], reach = self._bodies[body][1].write_pose(list(played))
            self.max_reach = max(self.max_reach, reach)
        return self._path_by_pose[key]

    def _find_or_write_prototype(self, body: int, state: int, *played: int) -> int:
        """Return the index of the prototype for a pose in the colour of `state` (-1 for none). Write it if it does not exist."""
        key = (body, state, *played)
        if key not in self._prototype_by_key:
            self._prototype_by_key[key] = len(self.paths)
            pose = self._find_or_write_pose(body, *played)
            words = pose.split("/")[2:] + ([self._states[state]] if 0 <= state < len(self._states) else [])
            folder = f"{ROOT_PATH}/{self._out.name('species', self._species)}/prototypes"
            path = f"{folder}/{make_unique('_'.join(words), self._prototype_names)}"
            colour = self._bodies[body][0].compute_natural_colours(NO_DRIVEN_POSE, 1)
            if self._colours is not None:
                colour = self._colours[[state if 0 <= state < len(self._colours) else 0]]
            add_coloured_mesh(self._stage, path, pose).Set(to_vector_array(colour))
            self.paths.append(path)
        return self._prototype_by_key[key]


def add_coloured_mesh(stage: Any, path: str, pose: str) -> Any:
    """Add a mesh for a pose. Return its display colour, which the materials of states use.

    The mesh is a payload, so that it is loaded only where it is drawn."""
    prim = stage.DefinePrim(path, "Mesh")
    prim.GetPayloads().AddInternalPayload(pose)
    return (
        import_pxr_module("UsdGeom")
        .PrimvarsAPI(prim)
        .CreatePrimvar("displayColor", import_pxr_module("Sdf").ValueTypeNames.Color3fArray, "constant")
    )


class _PoseBody:
    """A body of which poses are written."""

    def __init__(self, stage: Any, name: str, posed_body: PosedBody, close: bool) -> None:
        self._stage, self._path = stage, f"{BODIES_PATH}/{name}"
        body = (
            posed_body.fine_body
            if close
            else posed_body.coarse_body
            if len(posed_body.faces) > _MAX_FINE_TRIANGLES
            else posed_body
        )
        self._body_mesh = MaterialBodyMesh(body.with_clips(list_bank_clips(posed_body)))
        stage.CreateClassPrim(self._path)
        self._materials = MaterialBinder(stage, f"{MATERIALS_PATH}/{name}", posed_body.definition.materials)
        self._clips, self._pose_names = [each.clip for each in list_bank_clips(posed_body)], set[str]()

    def write_pose(self, clip_codes: list[int]) -> tuple[str, float]:
        """Write the mesh of a pose. Return its path, and the distance of its farthest point from the origin in body lengths."""
        machines = [
            make_single_clips(np.array([p // (POSES_PER_CLIP + 1) - 1]), np.array([p % (POSES_PER_CLIP + 1) / POSES_PER_CLIP]))
            for p in clip_codes
        ]
        poses: WorldPoses = self._body_mesh.body.compute_poses(machines, 1)
        points, normals = (each[0] for each in self._body_mesh.body.compute_shape_points(poses))
        path = f"{self._path}/{self._name_pose(clip_codes)}"
        usd_mesh = add_mesh(self._stage, path, points, self._body_mesh.faces, normals, self._body_mesh.uvs)
        self._materials.bind_faces(usd_mesh, self._body_mesh.names, self._body_mesh.material)
        return path, float(np.linalg.norm(points, axis=1).max(initial=0.0))

    def _name_pose(self, clip_codes: list[int]) -> str:
        """Return a name from the clips of a pose and the steps in their cycles, such as `walk_05`."""
        played = (divmod(code, POSES_PER_CLIP + 1) for code in clip_codes if code)
        words = [f"{self._clips[number - 1]}_{step:02d}" for number, step in played]
        return make_unique(to_identifier("_".join(words) or "rest"), self._pose_names)


def list_bank_clips(body: PosedBody) -> list[PlayedClip]:
    """Return the clips for the poses of a bank: those that the species plays, the idle clip, and the walking clips."""
    clips = body.definition.clips
    strides = [PlayedClip(name) for name, clip in clips.items() if clip.loop and clip.stride > 0 and clip.duration > 0]
    return [*(PlayedClip(*each) for each in body.clips), PlayedClip(body.definition.idle), *strides]


def compute_clip_codes(body: PosedBody, crowd: Crowd, speed: NDArray[np.float64] | None) -> list[NDArray[np.int64]]:
    """Return codes int64[n] of the clips that the bodies of a crowd play, as a list of arrays.

    The first array is for the topmost clip on the complete body. The others are for the clips on transform groups, one array per
    machine. A code is 0 for no clip, else (clip + 1) · (POSES_PER_CLIP + 1) + the nearest step of the cycle. `clip` is an index
    in `list_bank_clips`.

    `speed` [n]: body lengths per second, or None. An agent that moves but plays no walking clip gets the walking clip nearest to
    its speed, at the phase of its feet."""
    clips = [body.definition.clips.get(each.clip) for each in list_bank_clips(body)]
    loops = np.array([clip is not None and clip.loop for clip in clips] + [False])
    groups = np.array([bool(each.group) for each in list_bank_clips(body)] + [False])
    added = np.array([each.add for each in list_bank_clips(body)] + [False])  # clips added to others are omitted
    steps = np.where(groups, _POSES_PER_GROUP_CLIP, POSES_PER_CLIP)
    count = len(crowd.position)
    body_codes, on_parts = np.full(count, 0, np.int64), []
    for machine in crowd.machine_clips:
        fade = np.clip(machine.fade, 0.0, 1.0)
        weight, previous_weight = machine.weight * (1 - fade), machine.before_weight * fade
        clip = np.where(weight >= previous_weight, machine.clip, machine.before).astype(np.int64)
        turns = np.where(weight >= previous_weight, machine.turns, machine.before_turns).astype(np.float64)
        clip = np.where((weight + previous_weight >= 0.5) & (clip >= 0) & (clip <= len(body.clips)), clip, -1)
        clip = np.where(added[clip], -1, clip)
        code = np.where(clip >= 0, _encode_clip(clip, turns, loops, steps), 0)
        body_codes = np.where((clip >= 0) & ~groups[clip], code, body_codes)
        part = np.where(groups[clip], code, 0)
        if part.any():
            on_parts.append(part)
    if crowd.feet is not None and speed is not None and len(clips) > len(body.clips) + 1:
        body_codes = _add_walking_clips(body, clips, body_codes, crowd.feet.phase.astype(np.float64), speed)
    return [body_codes, *on_parts]


def _encode_clip(clip: NDArray[np.int64], turns: NDArray[np.float64], loops: Array, steps: Array) -> NDArray[np.int64]:
    """Return one number for each clip together with the nearest step of its cycle.

    `turns`: played cycles. `loops`: whether the clip loops. `steps`: the number of steps in its cycle."""
    part = np.where(loops[clip], turns - np.floor(turns), np.clip(turns, 0.0, 1.0))
    step = np.rint(part * steps[clip]).astype(np.int64)
    step = np.where(loops[clip], step % steps[clip], step) * (POSES_PER_CLIP // steps[clip])
    codes: NDArray[np.int64] = (clip + 1) * (POSES_PER_CLIP + 1) + step
    return codes


def _add_walking_clips(
    body: PosedBody,
    clips: list[Clip | None],
    body_codes: NDArray[np.int64],
    phase: NDArray[np.float64],
    speed: NDArray[np.float64],
) -> NDArray[np.int64]:
    """Return the clip codes `body_codes`, with a walking clip added for bodies that move but play none."""
    first = len(body.clips) + 1
    speeds = np.array([clip.stride / clip.duration / body.definition.length for clip in clips[first:] if clip is not None])
    clip = body_codes // (POSES_PER_CLIP + 1) - 1
    free = np.array([each is None or (each.stride == 0 and each.feet) for each in clips] + [True])
    goes = free[clip] & (speed > _STANDING_SPEED) & np.isfinite(phase)
    nearest = np.abs(speeds - speed[:, None]).argmin(axis=1) + first
    step = np.rint((np.nan_to_num(phase) % 1.0) * POSES_PER_CLIP).astype(np.int64) % POSES_PER_CLIP
    moving_codes: NDArray[np.int64] = np.where(goes, (nearest + 1) * (POSES_PER_CLIP + 1) + step, body_codes)
    return moving_codes


def _find_unique_rows(table: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.intp]]:
    """Return the distinct rows of a table, and for each row its index among them."""
    packed = np.zeros(len(table), np.int64)
    for column in table.T:
        low = int(column.min(initial=0))
        packed = packed * (int(column.max(initial=0)) - low + 1) + (column - low)
    _, first, which = np.unique(packed, return_index=True, return_inverse=True)
    return table[first], which.reshape(-1)
