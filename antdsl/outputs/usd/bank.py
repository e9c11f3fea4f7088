"""A bank of poses: for each species the prototypes that its agents are instances of, made when an agent is first in one.

A pose is what each machine of an agent plays at the nearest of some moments of the clip: the clip that has more than half of the
weight, the one before it while that still has. A prototype is such a pose in the colour of a state."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.machine_clips import MachineClips
from antdsl.bodies.agents.poses import Poses
from antdsl.bodies.body import Body
from antdsl.bodies.catalogue import body as catalogue_body
from antdsl.bodies.posed_body import PosedBody
from antdsl.outputs.cache.manifest import SpeciesEntry
from antdsl.outputs.pictures.light import decoded
from antdsl.outputs.pictures.model import Crowd
from antdsl.outputs.usd.drawn import DrawnBody, alone
from antdsl.outputs.usd.materials import Looks
from antdsl.outputs.usd.moments import Agents
from antdsl.outputs.usd.values import BODIES, LOOKS, ROOT, identifier, mesh, vectors
from antdsl.scene.geometry.usd import pxr

SAMPLES = 16  # of a clip on the whole body
_SAMPLES_OF_PARTS = 4  # of a clip on a transform group
_MOST = 2048  # prototypes of a species, beyond which clips on groups are left out
_FINE = 1500  # triangles above which the coarse body is taken


class Bank:
    """The poses of one species, as classes, and its prototypes, below the path of its instancer."""

    def __init__(self, stage: Any, species: SpeciesEntry) -> None:
        self._stage, self._name = stage, identifier(species.name)
        self._bodies: list[tuple[PosedBody | Body, _Drawn | _Plain]] = []
        self._numbers: dict[tuple[int, ...], int] = {}
        self._poses: dict[tuple[int, ...], str] = {}
        self.paths: list[str] = []
        self.reach = 0.0
        states = species.machines[0].states if species.machines else ()
        self._colours = decoded(np.array([state.colour for state in states] or [(0.35, 0.35, 0.35)]))
        self._states = [identifier(state.name) for state in states]

    def numbers(self, agents: Agents) -> NDArray[np.int32]:
        """The prototype of each agent, int32[n]: a place in `paths`."""
        found = np.zeros(len(agents.ids), np.int32)
        for rows, keys, which in self._keys(agents):
            found[rows] = np.array([self._prototype(*key) for key in keys], np.int32)[which]
        return found

    def poses_of(self, agents: Agents) -> list[str]:
        """The paths of the poses that agents are in."""
        found = [""] * len(agents.ids)
        for rows, keys, which in self._keys(agents):
            paths = [self._pose(body, *played) for body, _, *played in keys]
            for row, kind in zip(rows.tolist(), which.tolist(), strict=True):
                found[row] = paths[kind]
        return found

    def _keys(self, agents: Agents) -> Iterator[tuple[NDArray[np.intp], list[tuple[int, ...]], NDArray[np.intp]]]:
        """For those who wear a body: their rows, the keys that there are (body, state, what each machine plays), and which of
        them each has."""
        state = np.full(len(agents.ids), -1) if agents.state is None else agents.state
        for crowd, rows in agents.parts:
            worn = crowd.worn or plain(crowd.body)
            body = self._body(worn)
            played = [walked(worn, crowd)] if isinstance(worn, Body) else moments_played(worn, crowd.plays)
            columns = [state[rows], *played]
            if len(self.paths) > _MOST and isinstance(worn, PosedBody):
                columns[1:] = [np.where(_on_part(worn, column), 0, column) for column in played]
            kinds, which = _kinds(np.stack(columns, axis=1).astype(np.int64))
            yield rows, [(body, *kind) for kind in kinds.tolist()], which

    def _body(self, worn: PosedBody | Body) -> int:
        for number, (known, _) in enumerate(self._bodies):
            if known is worn:
                return number
        kind = _Plain if isinstance(worn, Body) else _Drawn
        name = self._name + (f"_{len(self._bodies) + 1}" if self._bodies else "")
        self._bodies.append((worn, kind(self._stage, name, worn)))  # type: ignore[arg-type]
        return len(self._bodies) - 1

    def _pose(self, body: int, *played: int) -> str:
        """The mesh of what machines play."""
        key = (body, *played)
        if key not in self._poses:
            self._poses[key], reach = self._bodies[body][1].write(len(self._poses), list(played))
            self.reach = max(self.reach, reach)
        return self._poses[key]

    def _prototype(self, body: int, state: int, *played: int) -> int:
        """The pose in the colour of a state."""
        key = (body, state, *played)
        if key not in self._numbers:
            self._numbers[key] = len(self.paths)
            named = self._states[state] if 0 <= state < len(self._states) else "none"
            path = f"{ROOT}/{self._name}/prototypes/p{len(self.paths):04d}_{named}"
            colour = self._colours[state if 0 <= state < len(self._colours) else 0]
            coloured(self._stage, path, self._pose(body, *played)).Set(vectors(colour[None]))
            self.paths.append(path)
        return self._numbers[key]


def coloured(stage: Any, path: str, pose: str) -> Any:
    """A mesh that is a pose, loaded where it is drawn; its primvar displayColor, which materials of states take."""
    prim = stage.DefinePrim(path, "Mesh")
    prim.GetPayloads().AddInternalPayload(pose)
    return pxr("UsdGeom").PrimvarsAPI(prim).CreatePrimvar("displayColor", pxr("Sdf").ValueTypeNames.Color3fArray, "constant")


def _on_part(worn: PosedBody, played: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which of what is played is on a transform group."""
    groups = np.array([bool(group) for _, group in worn.clips] + [False])
    found: NDArray[np.bool_] = groups[played // (SAMPLES + 1) - 1]
    return found


class _Drawn:
    """A body that poses are written of."""

    def __init__(self, stage: Any, name: str, worn: PosedBody) -> None:
        self._stage, self._path = stage, f"{BODIES}/{name}"
        body = worn.coarse if len(worn.faces) > _FINE else worn
        self._drawn = DrawnBody(body)
        stage.CreateClassPrim(self._path)
        self._looks = Looks(stage, f"{LOOKS}/{name}", worn.definition.materials)

    def write(self, number: int, played: list[int]) -> tuple[str, float]:
        """The mesh of a pose, and how far it reaches, in body lengths."""
        machines = [alone(np.array([p // (SAMPLES + 1) - 1]), np.array([p % (SAMPLES + 1) / SAMPLES])) for p in played]
        poses: Poses = self._drawn.body.poses(machines, 1)
        points, normals = (each[0] for each in self._drawn.posed(poses))
        path = f"{self._path}/pose_{number:04d}"
        made = mesh(self._stage, path, points, self._drawn.faces, normals, self._drawn.uvs)
        self._looks.bind_faces(made, self._drawn.names, self._drawn.material)
        return path, float(np.linalg.norm(points, axis=1).max(initial=0.0))


class _Plain:
    """A plain body that poses are written of."""

    def __init__(self, stage: Any, name: str, worn: Body) -> None:
        self._stage, self._worn, self._path = stage, worn, f"{BODIES}/{name}"
        stage.CreateClassPrim(self._path)
        self._looks = Looks(stage, f"{LOOKS}/{name}", {"dark": (0.02, 0.016, 0.012)})

    def write(self, number: int, played: list[int]) -> tuple[str, float]:
        """The mesh of a pose, and how far it reaches, in body lengths."""
        points, faces = self._worn.poses[played[0]], self._worn.faces
        path = f"{self._path}/pose_{number:04d}"
        made = mesh(self._stage, path, points, faces, self._worn.normals)
        dark = (self._worn.tint[faces].mean(axis=1) < 0.5).astype(np.int64)
        self._looks.bind_faces(made, ("", "dark"), dark)
        return path, float(np.linalg.norm(points, axis=1).max(initial=0.0))


@cache
def plain(name: str) -> Body:
    return catalogue_body(name)


def walked(worn: Body, crowd: Crowd) -> NDArray[np.int64]:
    """The moment of its walk that each agent is in, by the way that it has gone."""
    count = len(worn.poses)
    way = np.zeros(len(crowd.position)) if crowd.walked is None else crowd.walked / np.maximum(crowd.scale, 1e-12) / worn.stride
    return ((way % 1.0) * count).astype(np.int64) % count


def moments_played(worn: PosedBody, machines: tuple[MachineClips, ...]) -> list[NDArray[np.int64]]:
    """For each machine what its agents play, int64[n]: 0 for nothing, else (clip + 1) · (SAMPLES + 1) + the nearest of so many
    moments."""
    durations = [worn.definition.clips.get(name) for name, _ in worn.clips]
    loops = np.array([clip is not None and clip.loop for clip in durations] + [False])
    steps = np.array([_SAMPLES_OF_PARTS if group else SAMPLES for _, group in worn.clips] + [1])
    found = []
    for machine in machines:
        fade = np.clip(machine.fade, 0.0, 1.0)
        here, before = machine.weight * (1 - fade), machine.before_weight * fade
        clip = np.where(here >= before, machine.clip, machine.before).astype(np.int64)
        turns = np.where(here >= before, machine.turns, machine.before_turns).astype(np.float64)
        clip = np.where((here + before >= 0.5) & (clip < len(worn.clips)), clip, -1)
        part = np.where(loops[clip], turns - np.floor(turns), np.clip(turns, 0.0, 1.0))
        step = np.rint(part * steps[clip]).astype(np.int64)
        step = np.where(loops[clip], step % steps[clip], step) * (SAMPLES // np.maximum(steps[clip], 1))
        found.append(np.where(clip >= 0, (clip + 1) * (SAMPLES + 1) + step, 0))
    return found


def _kinds(table: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.intp]]:
    """The rows of a table that differ, and which of them each row is."""
    packed = np.zeros(len(table), np.int64)
    for column in table.T:
        low = int(column.min(initial=0))
        packed = packed * (int(column.max(initial=0)) - low + 1) + (column - low)
    _, first, which = np.unique(packed, return_index=True, return_inverse=True)
    return table[first], which.reshape(-1)
