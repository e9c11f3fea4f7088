"""`Motion`: joints turned and moved over time, with feet that are where they are put, made into a clip of an agent definition.

Feet are reached by two bones: hip, knee and ankle stay in the plane in which the knee is bent in the rest pose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.clip import Clip
from antdsl.bodies.agents.legs import Gait
from antdsl.bodies.agents.rig import Rig
from antdsl.bodies.agents.transforms import rotation_of

Array = NDArray[np.float64]
RATE, FAST = 30.0, 90.0  # samples a second, about: of clips, and of those in which legs are quick
X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


@dataclass(frozen=True, slots=True)
class Chain:
    """A leg as clips move it: joints at hip, knee, ankle and tip. The ankle is reached for; what is beyond keeps its pitch."""

    upper: str
    lower: str
    ankle: str
    tip: str


class Motion:
    """Poses of a rig at F moments, evenly over `seconds`. `phase` float64[F]: from 0 to 1. Turns and moves come before legs."""

    def __init__(self, rig: Rig, seconds: float, rate: float = RATE) -> None:
        self.rig, self.seconds = rig, seconds
        self.samples = max(2, round(seconds * rate)) + 1
        self.phase = np.linspace(0.0, 1.0, self.samples)
        count = len(rig.names)
        self._turn = np.tile(np.eye(3), (self.samples, count, 1, 1))
        self._move = np.tile(rig.rest[:, :3, 3], (self.samples, 1, 1))
        self._scale = np.ones((self.samples, count, 3))
        self._used: set[int] = set()
        self._rest = _places(rig, self._move[:1], self._turn[:1])[0][0]

    def rest(self, joint: str) -> Array:
        """Where a joint is in the rest pose."""
        return np.asarray(self._rest[self.rig.joint(joint)])

    def wave(self, cycles: int = 1, start: float = 0.0) -> Array:
        """A sine that has gone through `cycles` whole cycles at the end: what loops, loops."""
        return np.asarray(np.sin(2 * np.pi * (cycles * self.phase + start)))

    def keys(self, *rows: tuple[float, float]) -> Array:
        """A value that goes from key to key (place from 0 to 1, value), slow at each."""
        at, value = np.array([r[0] for r in rows]), np.array([r[1] for r in rows])
        k = np.clip(np.searchsorted(at, self.phase, side="right") - 1, 0, len(at) - 2)
        t = np.clip((self.phase - at[k]) / np.maximum(at[k + 1] - at[k], 1e-9), 0.0, 1.0)
        return np.asarray(value[k] + (value[k + 1] - value[k]) * t * t * (3 - 2 * t))

    def turn(self, joint: str, axis: Sequence[float], degrees: Array | float) -> None:
        """Turns a joint about an axis of its parent, after what turned it before."""
        number = self.rig.joint(joint)
        self._used.add(number)
        self._turn[:, number] = _rotation(axis, np.broadcast_to(np.radians(degrees), self.samples)) @ self._turn[:, number]

    def move(self, joint: str, axis: Sequence[float], by: Array | float) -> None:
        """Moves a joint along an axis of its parent."""
        number = self.rig.joint(joint)
        self._used.add(number)
        self._move[:, number] += np.broadcast_to(by, self.samples)[:, None] * np.asarray(axis)

    def swell(self, joint: str, by: Array) -> None:
        """Scales what follows a joint, by factors [F] across and the root of these along x."""
        number = self.rig.joint(joint)
        self._used.add(number)
        self._scale[:, number] *= np.stack([np.sqrt(by), by, by], 1)

    def above_ground(self, joint: str) -> None:
        """Moves a joint up by as much as any joint of the rig is below the ground, along the vertical of its parent, which is not
        turned: what rolls over its legs is borne by them."""
        places, _ = _places(self.rig, self._move, self._turn)
        self.move(joint, Y, np.maximum(-places[:, :, 1].min(axis=1), 0.0))

    def reach(self, chain: Chain, tip: Array, level: float = 1.0, pitch: Array | float = 0.0) -> None:
        """Puts the tip of a leg at `tip` [F, 3]. `level`: whether what is beyond the ankle keeps its pitch (1), `pitch` degrees
        up from that of the rest pose, or goes with the shank (0)."""
        rig = self.rig
        upper, lower, ankle, end = (rig.joint(name) for name in (chain.upper, chain.lower, chain.ankle, chain.tip))
        places, turns = _places(rig, self._move, self._turn, _line(rig, upper))
        parent = turns[:, rig.parents[upper]]
        rest_hip, rest_knee, rest_ankle, rest_tip = (self._rest[j] for j in (upper, lower, ankle, end))
        hip = places[:, upper]
        # Beyond the ankle all turns about the vertical with the way from hip to tip.
        was, now = rest_tip - rest_hip, tip - hip
        yaw = np.arctan2(-now[:, 2], now[:, 0]) - np.arctan2(-was[2], was[0])
        yaw = (yaw + np.pi) % (2 * np.pi) - np.pi
        far = abs(was[2]) > 0.3 * np.linalg.norm(was)  # legs straight down do not turn with it
        turned = _rotation(Y, yaw if far else np.zeros(self.samples))
        beyond = turned @ _rotation(Z, np.broadcast_to(np.radians(pitch), self.samples))
        goal = tip - np.einsum("nij,j->ni", beyond, rest_tip - rest_ankle) if level > 0 else tip
        first, second = np.linalg.norm(rest_knee - rest_hip), np.linalg.norm(rest_ankle - rest_knee)
        if level <= 0:
            second = np.linalg.norm(rest_tip - rest_knee)
        way = goal - hip
        length = np.linalg.norm(way, axis=1)
        reach = np.clip(length, abs(first - second) * 1.02 + 1e-9, (first + second) * 0.998)
        way = way / np.maximum(length, 1e-12)[:, None]
        # The leg bends in the plane that it bends in at rest, turned as the trunk is and, of legs to the side, as the leg is.
        across = np.cross(rest_ankle - rest_hip, rest_knee - rest_hip)
        normal = np.einsum("nij,j->ni", parent, across)
        if far:
            normal = np.einsum("nij,nj->ni", turned, normal)
        pole = np.cross(normal, way)
        pole /= np.maximum(np.linalg.norm(pole, axis=1, keepdims=True), 1e-12)
        ahead = (first**2 - second**2 + reach**2) / (2 * reach)
        aside = np.sqrt(np.maximum(first**2 - ahead**2, 0.0))
        joint = hip + way * ahead[:, None] + pole * aside[:, None]
        goal = hip + way * reach[:, None]
        last = rest_ankle if level > 0 else rest_tip
        thigh = _aimed(rest_knee - rest_hip, last - rest_hip, joint - hip, goal - hip)
        shank = _aimed(last - rest_knee, last - rest_hip, goal - joint, goal - hip)
        self._set(upper, parent, thigh)
        self._set(lower, self._above(lower, upper, thigh), shank)
        if level > 0:
            self._set(ankle, self._above(ankle, lower, shank), beyond)
        self._used |= {upper, lower, ankle}

    def _above(self, joint: int, known: int, turn: Array) -> Array:
        """How the parent of a joint is turned, which lies at or below one that is turned so."""
        chain, parent = [], int(self.rig.parents[joint])
        while parent != known:
            chain.append(parent)
            parent = int(self.rig.parents[parent])
        for each in reversed(chain):
            turn = turn @ self._turn[:, each]
        return turn

    def _set(self, joint: int, parent: Array, world: Array) -> None:
        self._turn[:, joint] = np.swapaxes(parent, 1, 2) @ world

    def clip(
        self, name: str, loop: bool = True, stride: float = 0.0, marks: Mapping[str, float] | None = None, feet: bool = True
    ) -> Clip:
        """The clip of all joints that were moved. `marks`: moments by name, from 0 to 1."""
        used = sorted(self._used)
        rotation = _quaternions(self._turn[:, used])
        move, scale = self._move[:, used].astype(np.float32), self._scale[:, used].astype(np.float32)
        if loop:
            rotation[-1], move[-1], scale[-1] = rotation[0], move[0], scale[0]
        return Clip(
            name, (self.samples - 1) / self.seconds, tuple(self.rig.names[j] for j in used), move, rotation, scale, loop=loop,
            stride=stride, marks={mark: at * self.seconds for mark, at in (marks or {}).items()}, feet=feet,
        )  # fmt: skip


def footpath(gait: Gait, leg: int, phase: Array, rest: Array) -> Array:
    """Where the tip of a leg is [F, 3] in a gait, seen from the body: drawn back evenly while it stands, then ahead in an arc."""
    own = (phase + gait.phases[leg]) % 1.0
    travel = gait.stride * gait.duty
    swing = np.clip((own - gait.duty) / (1 - gait.duty), 0.0, 1.0)
    ahead = np.where(own < gait.duty, travel * (0.5 - own / gait.duty), travel * (_eased(swing) - 0.5))
    return np.asarray(rest + np.stack([ahead, gait.lift * np.sin(np.pi * swing) ** 2, np.zeros_like(own)], 1))


def steps(
    m: Motion, gait: Gait, chains: Sequence[Chain], off: float = 0.0, on: float = 0.0, heel: float = 0.0, toes: bool = False
) -> None:
    """Puts all legs where they are in a gait. The heel leaves the ground first, by `off` degrees, and comes down first, the toes
    up by `on`, where it is `heel` behind the tip. With `toes` what follows the tip stays flat as the heel leaves."""
    for leg, chain in enumerate(chains):
        own = (m.phase + gait.phases[leg]) % 1.0
        stand, swing = own / gait.duty, (own - gait.duty) / (1 - gait.duty)
        down = on * (1 - _eased(stand / 0.18)) - off * _eased((stand - 0.55) / 0.45)
        pitch = np.where(own < gait.duty, down, -off + (off + on) * _eased(swing * 1.15))
        tip = footpath(gait, leg, m.phase, m.rest(chain.tip))
        tip[:, 1] += heel * np.sin(np.radians(np.maximum(pitch, 0.0)))
        m.reach(chain, tip, pitch=pitch)
        if toes:
            m.turn(chain.tip, Z, -np.minimum(pitch, 0.0))


def _eased(share: Array) -> Array:
    share = np.clip(share, 0.0, 1.0)
    return np.asarray(share * share * (3 - 2 * share))


def _line(rig: Rig, joint: int) -> list[int]:
    """A joint and all above it, from the top."""
    found = [joint]
    while (parent := int(rig.parents[found[-1]])) >= 0:
        found.append(parent)
    return found[::-1]


def _places(rig: Rig, move: Array, turn: Array, joints: Sequence[int] | None = None) -> tuple[Array, Array]:
    """World places [F, J, 3] and turns [F, J, 3, 3] of all joints; of some `joints` alone, whose parents come before them."""
    places, turns = np.empty_like(move), np.empty_like(turn)
    for joint in range(len(rig.parents)) if joints is None else joints:
        parent = rig.parents[joint]
        if parent < 0:
            places[:, joint], turns[:, joint] = move[:, joint], turn[:, joint]
        else:
            places[:, joint] = places[:, parent] + np.einsum("nij,nj->ni", turns[:, parent], move[:, joint])
            turns[:, joint] = turns[:, parent] @ turn[:, joint]
    return places, turns


def _rotation(axis: Sequence[float], angle: Array) -> Array:
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    s, c = np.sin(angle)[:, None, None], (1 - np.cos(angle))[:, None, None]
    return np.asarray(np.eye(3) + s * cross + c * (cross @ cross))


def _frame(way: Array, beside: Array) -> Array:
    """Turns [F, 3, 3] whose first column is along `way` and whose third is across it and `beside`."""
    first = way / np.maximum(np.linalg.norm(way, axis=-1, keepdims=True), 1e-12)
    third = np.cross(first, beside)
    third /= np.maximum(np.linalg.norm(third, axis=-1, keepdims=True), 1e-12)
    return np.stack([first, np.cross(third, first), third], -1)


def _aimed(rest: Array, rest_beside: Array, way: Array, beside: Array) -> Array:
    """Turns [F, 3, 3] that take a bone of the rest pose to `way` [F, 3], and the plane of the leg to that leg's plane."""
    return _frame(way, beside) @ _frame(rest, rest_beside).T


def _quaternions(turn: Array) -> NDArray[np.float32]:
    """Quaternions x y z w of matrices [F, K, 3, 3], each with the sign that is nearer to the sample before."""
    found = rotation_of(turn)
    for k in range(1, len(found)):
        found[k] *= np.where((found[k] * found[k - 1]).sum(-1, keepdims=True) < 0, -1.0, 1.0)
    return found.astype(np.float32)
