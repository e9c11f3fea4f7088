"""A bank of poses: for each species, the prototypes of its agents' instances, created at first use.

A pose consists of the topmost clip on the complete body and the clip on each transform group. Each clip is at the nearest of a
few moments. A clip counts if it has most of its machine's weight. An agent that walks on its feet but plays no walking clip gets
one. This clip is chosen by the agent's speed, at the phase of its gait. A prototype is a pose in the colour of a state."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.definition import Clip
from antdsl.bodies.agents.machine_clips import PlayedClip
from antdsl.bodies.agents.poses import Poses
from antdsl.bodies.posed_body import PosedBody
from antdsl.outputs.cache.manifest import SpeciesEntry
from antdsl.outputs.pictures.light import decode_srgb
from antdsl.outputs.pictures.model import Crowd
from antdsl.outputs.usd.materials import DrawnBody, MaterialBinder, single_clip
from antdsl.outputs.usd.moments import SpeciesSample
from antdsl.outputs.usd.values import BODIES_PATH, MATERIALS_PATH, ROOT_PATH, Array, StageOutput, identifier, mesh, vectors
from antdsl.scene.geometry.usd import pxr

POSES_PER_CLIP = 16  # of a clip on the whole body
_POSES_PER_GROUP_CLIP = 4  # of a clip on a transform group
_MAX_PROTOTYPES = 2048  # prototypes of a species, beyond which clips on groups are left out
_STANDING_SPEED = 0.02  # body lengths a second below which an agent stands
_MAX_FINE_TRIANGLES = 1500  # triangles above which the coarse body is taken


class PrototypeBank:
    """The poses of one species (as class prims), and its prototypes below the path of its instancer."""

    def __init__(self, out: StageOutput, species: SpeciesEntry, close: bool = False) -> None:
        self._stage, self._name, self._close = out.stage, out.name("species", species.name), close
        self._bodies: list[tuple[PosedBody, _PoseBody]] = []
        self._numbers: dict[tuple[int, ...], int] = {}
        self._poses: dict[tuple[int, ...], str] = {}
        self.paths: list[str] = []
        self.reach = 0.0
        states = species.machines[0].states if species.machines else ()
        self._colours = decode_srgb(np.array([state.colour for state in states] or [(0.35, 0.35, 0.35)]))
        self._states = [identifier(state.name) for state in states]

    def prototype_numbers(self, agents: SpeciesSample) -> NDArray[np.int32]:
        """Return the prototype of each agent as an index of `paths`, int32[n]."""
        found = np.zeros(len(agents.ids), np.int32)
        for rows, keys, which in self._keys(agents):
            found[rows] = np.array([self._prototype(*key) for key in keys], np.int32)[which]
        return found

    def poses_of(self, agents: SpeciesSample) -> list[str]:
        """Return the path of each agent's pose."""
        pose_paths = [""] * len(agents.ids)
        for rows, keys, which in self._keys(agents):
            paths = [self._pose(body, *played) for body, _, *played in keys]
            for row, kind in zip(rows.tolist(), which.tolist(), strict=True):
                pose_paths[row] = paths[kind]
        return pose_paths

    def _keys(self, agents: SpeciesSample) -> Iterator[tuple[NDArray[np.intp], list[tuple[int, ...]], NDArray[np.intp]]]:
        """Yield, for each worn body: the rows of its agents, the distinct keys, and the index of each agent's key.

        A key consists of the body, the state, and the codes of the played clips."""
        state = np.full(len(agents.ids), -1) if agents.state is None else agents.state
        for crowd, rows in agents.parts:
            if crowd.worn is None:
                continue
            speed = np.linalg.norm(agents.own_velocity[rows], axis=1) / np.maximum(agents.scale[rows], 1e-12)
            body_codes, *on_parts = played_codes(crowd.worn, crowd, speed)
            columns = [state[rows], body_codes, *(on_parts if len(self.paths) < _MAX_PROTOTYPES else ())]
            kinds, which = _unique_rows(np.stack(columns, axis=1).astype(np.int64))
            body = self._body(crowd.worn)
            yield rows, [(body, *kind) for kind in kinds.tolist()], which

    def _body(self, worn: PosedBody) -> int:
        for number, (known, _) in enumerate(self._bodies):
            if known is worn:
                return number
        name = self._name + (f"_{len(self._bodies) + 1}" if self._bodies else "")
        self._bodies.append((worn, _PoseBody(self._stage, name, worn, self._close)))
        return len(self._bodies) - 1

    def _pose(self, body: int, *played: int) -> str:
        """Return the path of the mesh for a body with these clip codes. It is written at its first use."""
        key = (body, *played)
        if key not in self._poses:
            self._poses[key], reach = self._bodies[body][1].write(len(self._poses), list(played))
            self.reach = max(self.reach, reach)
        return self._poses[key]

    def _prototype(self, body: int, state: int, *played: int) -> int:
        """Return the index of the prototype of a pose in the colour of a state. It is written at its first use."""
        key = (body, state, *played)
        if key not in self._numbers:
            self._numbers[key] = len(self.paths)
            named = self._states[state] if 0 <= state < len(self._states) else "none"
            path = f"{ROOT_PATH}/{self._name}/prototypes/p{len(self.paths):04d}_{named}"
            colour = self._colours[state if 0 <= state < len(self._colours) else 0]
            add_coloured_mesh(self._stage, path, self._pose(body, *played)).Set(vectors(colour[None]))
            self.paths.append(path)
        return self._numbers[key]


def add_coloured_mesh(stage: Any, path: str, pose: str) -> Any:
    """Add a mesh that shows a pose, and return its primvar displayColor, which the materials of states use.

    The mesh is a payload, so it is loaded only where it is drawn."""
    prim = stage.DefinePrim(path, "Mesh")
    prim.GetPayloads().AddInternalPayload(pose)
    return pxr("UsdGeom").PrimvarsAPI(prim).CreatePrimvar("displayColor", pxr("Sdf").ValueTypeNames.Color3fArray, "constant")


class _PoseBody:
    """A body from which poses are written."""

    def __init__(self, stage: Any, name: str, worn: PosedBody, close: bool) -> None:
        self._stage, self._path = stage, f"{BODIES_PATH}/{name}"
        body = worn.fine if close else worn.coarse if len(worn.faces) > _MAX_FINE_TRIANGLES else worn
        self._drawn = DrawnBody(body.with_clips(bank_clips(worn)))
        stage.CreateClassPrim(self._path)
        self._looks = MaterialBinder(stage, f"{MATERIALS_PATH}/{name}", worn.definition.materials)

    def write(self, number: int, played: list[int]) -> tuple[str, float]:
        """Write the mesh of a pose. Return its path and its reach in body lengths."""
        machines = [
            single_clip(np.array([p // (POSES_PER_CLIP + 1) - 1]), np.array([p % (POSES_PER_CLIP + 1) / POSES_PER_CLIP]))
            for p in played
        ]
        poses: Poses = self._drawn.body.poses(machines, 1)
        points, normals = (each[0] for each in self._drawn.body.shape_points(poses))
        path = f"{self._path}/pose_{number:04d}"
        usd_mesh = mesh(self._stage, path, points, self._drawn.faces, normals, self._drawn.uvs)
        self._looks.bind_faces(usd_mesh, self._drawn.names, self._drawn.material)
        return path, float(np.linalg.norm(points, axis=1).max(initial=0.0))


def bank_clips(worn: PosedBody) -> list[PlayedClip]:
    """Return the clips for the poses of a bank: the clips that the species plays, the idle clip, and the walking clips."""
    clips = worn.definition.clips
    strides = [PlayedClip(name) for name, clip in clips.items() if clip.loop and clip.stride > 0 and clip.duration > 0]
    return [*(PlayedClip(*each) for each in worn.clips), PlayedClip(worn.definition.idle), *strides]


def played_codes(worn: PosedBody, crowd: Crowd, speed: NDArray[np.float64] | None) -> list[NDArray[np.int64]]:
    """Return codes int64[n] of the clips that the bodies of a crowd play.

    The first array is the topmost clip on the complete body. The others are, by machine, the clip on a transform group.
    A code is 0 for no clip, else (clip + 1) · (POSES_PER_CLIP + 1) + the nearest moment. `clip` is an index of `bank_clips`.

    `speed` [n]: body lengths per second, or None. An agent that moves, but plays no walking clip, gets the walking clip nearest
    to its speed. The phase is that of its feet."""
    clips = [worn.definition.clips.get(each.clip) for each in bank_clips(worn)]
    loops = np.array([clip is not None and clip.loop for clip in clips] + [False])
    groups = np.array([bool(each.on) for each in bank_clips(worn)] + [False])
    added = np.array([each.add for each in bank_clips(worn)] + [False])  # over all others: left out
    steps = np.where(groups, _POSES_PER_GROUP_CLIP, POSES_PER_CLIP)
    count = len(crowd.position)
    body_codes, on_parts = np.full(count, 0, np.int64), []
    for machine in crowd.plays:
        fade = np.clip(machine.fade, 0.0, 1.0)
        weight, previous_weight = machine.weight * (1 - fade), machine.before_weight * fade
        clip = np.where(weight >= previous_weight, machine.clip, machine.before).astype(np.int64)
        turns = np.where(weight >= previous_weight, machine.turns, machine.before_turns).astype(np.float64)
        clip = np.where((weight + previous_weight >= 0.5) & (clip >= 0) & (clip <= len(worn.clips)), clip, -1)
        clip = np.where(added[clip], -1, clip)
        code = np.where(clip >= 0, _code(clip, turns, loops, steps), 0)
        body_codes = np.where((clip >= 0) & ~groups[clip], code, body_codes)
        part = np.where(groups[clip], code, 0)
        if part.any():
            on_parts.append(part)
    if crowd.feet is not None and speed is not None and len(clips) > len(worn.clips) + 1:
        body_codes = _with_walking_clips(worn, clips, body_codes, crowd.feet.phase.astype(np.float64), speed)
    return [body_codes, *on_parts]


def _code(clip: NDArray[np.int64], turns: NDArray[np.float64], loops: Array, steps: Array) -> NDArray[np.int64]:
    """Return one number for each clip and the nearest of its moments."""
    part = np.where(loops[clip], turns - np.floor(turns), np.clip(turns, 0.0, 1.0))
    step = np.rint(part * steps[clip]).astype(np.int64)
    step = np.where(loops[clip], step % steps[clip], step) * (POSES_PER_CLIP // steps[clip])
    codes: NDArray[np.int64] = (clip + 1) * (POSES_PER_CLIP + 1) + step
    return codes


def _with_walking_clips(
    worn: PosedBody,
    clips: list[Clip | None],
    body_codes: NDArray[np.int64],
    phase: NDArray[np.float64],
    speed: NDArray[np.float64],
) -> NDArray[np.int64]:
    """Return the codes of the bodies, with a walking clip for bodies that move but play none."""
    first = len(worn.clips) + 1
    speeds = np.array([clip.stride / clip.duration / worn.definition.length for clip in clips[first:] if clip is not None])
    clip = body_codes // (POSES_PER_CLIP + 1) - 1
    free = np.array([each is None or (each.stride == 0 and each.feet) for each in clips] + [True])
    goes = free[clip] & (speed > _STANDING_SPEED) & np.isfinite(phase)
    nearest = np.abs(speeds - speed[:, None]).argmin(axis=1) + first
    step = np.rint((np.nan_to_num(phase) % 1.0) * POSES_PER_CLIP).astype(np.int64) % POSES_PER_CLIP
    moving_codes: NDArray[np.int64] = np.where(goes, (nearest + 1) * (POSES_PER_CLIP + 1) + step, body_codes)
    return moving_codes


def _unique_rows(table: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.intp]]:
    """Return the distinct rows of a table, and the index of each row among them."""
    packed = np.zeros(len(table), np.int64)
    for column in table.T:
        low = int(column.min(initial=0))
        packed = packed * (int(column.max(initial=0)) - low + 1) + (column - low)
    _, first, which = np.unique(packed, return_index=True, return_inverse=True)
    return table[first], which.reshape(-1)
