"""Bends legs so that feet reach their footholds: two-bone inverse kinematics of many agents, one leg after the other.

The law of cosines opens or closes the knee in its plane in the pose. Then the complete leg rotates about the hip by the shortest
rotation to the goal, so the knee does not change its side. Joints in between keep their local transforms. The foot and all joints
below it keep their rotation, so the foot's angle to the ground is that of the clip. If the goal is out of reach, the leg
stretches towards it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.affine import Floats, Numbers, compose_matrices, normalise_quaternions
from antdsl.bodies.agents.definition import Definition
from antdsl.bodies.agents.leg_chains import Joints, LegChain, build_leg_chain, compute_standing_joints
from antdsl.bodies.agents.machine_clips import MachineClips, PlayedClip
from antdsl.bodies.agents.poses import Poses

MAX_LEG_EXTENSION = 0.9995  # share of the length of both bones; in a completely straight leg the knee would have no direction
_FOLDED_LEG_FACTOR = 1.02  # factor of the length difference of both bones
_MAX_TRUNK_SINK = 0.25  # leg lengths; maximum lowering of a trunk, so that standing feet are in reach
_MIN_KNEE_SINE = 1e-3  # sine of the knee angle; below it, the knee does not define a plane
LEG_BENDING_LIMITS = {
    "straight": MAX_LEG_EXTENSION,
    "folded": _FOLDED_LEG_FACTOR,
    "sunk": _MAX_TRUNK_SINK,
    "plane": _MIN_KNEE_SINE,
}  # for renderers that bend legs themselves


@dataclass(frozen=True, slots=True, eq=False)
class BodySpaceFeet:
    """The feet of n agents relative to their bodies, in body lengths along the axes ahead, up and aside.

    `positions`: float32[n, L, 3], the ground below each foot, or the position of a swinging foot.
    `is_on_ground`: bool[n, L], whether the foot is on the ground.
    `rise`: float32[n], height of the trunk above its rest position.
    `tilt`: float32[n, 4], rotation of the trunk from its rest orientation, x y z w."""

    positions: Floats
    is_on_ground: NDArray[np.bool_]
    rise: Floats
    tilt: Floats

    def scale_trunk(self, weights: Floats) -> BodySpaceFeet:
        """Return the same feet, with the rise and tilt of trunks scaled by `weights` [n], from 0 to 1."""
        tilt = self.tilt * weights[:, None]
        tilt[:, 3] += 1 - weights
        return replace(self, rise=self.rise * weights, tilt=tilt)


@dataclass(frozen=True, slots=True, eq=False)
class PlacedFeet:
    """The feet of n agents in a frame, as stored in caches, in scene units.

    `P`: float32[n, L, 3], positions.
    `is_on_ground`: uint8[n, L], whether the foot is on the ground.
    `phase`: float32[n], the phase of the gait.
    `rise`: float32[n], height of the trunk above its rest position.
    `tilt`: float32[n, 4], rotation of the trunk from its rest orientation, x y z w."""

    P: Floats
    is_on_ground: NDArray[np.uint8]
    phase: Floats
    rise: Floats
    tilt: Floats

    def convert_to_body_space(
        self, position: NDArray[np.floating], orient: NDArray[np.floating], scale: NDArray[np.floating]
    ) -> BodySpaceFeet:
        """Return the feet in the space of their bodies, which have `position` [n, 3], rotation `orient` [n, 4] and length `scale`
        [n].

        Numbers that are not finite count as 0."""
        with np.errstate(all="ignore"):
            away = np.asarray(self.P, np.float64) - np.asarray(position, np.float64)[:, None]
            across = _build_rotation_matrices(orient)
            size = np.where(np.asarray(scale) > 0, scale, 1.0).astype(np.float64)
            x, y, z = (away[..., k] for k in range(3))
            place = [(x * m[0, :, None] + y * m[1, :, None]) + z * m[2, :, None] for m in np.moveaxis(across, 1, 0)]
            local = np.stack(place, -1) / size[:, None, None]
            return BodySpaceFeet(
                np.nan_to_num(local, posinf=0, neginf=0).astype(np.float32), self.is_on_ground != 0,
                np.nan_to_num(self.rise / size, posinf=0, neginf=0).astype(np.float32), np.nan_to_num(self.tilt),
            )  # fmt: skip


class LegSolver:
    """The legs of a definition, prepared for inverse kinematics."""

    def __init__(self, body: Definition) -> None:
        self._chains = [build_leg_chain(body.rig, leg) for leg in body.legs]
        standing = compute_standing_joints(body)
        self.sole_heights = standing[[each.foot for each in self._chains], 1].astype(np.float32).reshape(-1)
        base = body.compute_base_matrix()[:3, :3] * body.length
        self._base_rotation, self._length = base.astype(np.float32), np.float32(body.length)
        self._up_axis = base[1].astype(np.float32)
        self._standing_positions = (standing @ base * body.length).T.astype(np.float32)  # shape (3, J), axes of the definition
        self._front_axis = base[0].astype(np.float32)
        legs = np.zeros(len(body.rig.names), np.bool_)
        for each in self._chains:
            legs[each.thigh] = legs[each.shank] = legs[each.sole] = True
        self._group_moves_legs = {
            name: any(
                legs[body.rig.find_joint(joint)] and weight > 0 for joint, weight in group.members if joint in body.rig.names
            )
            for name, group in body.groups.items()
        }
        self._clips_without_feet = {name for name, clip in body.clips.items() if not clip.feet}

    @property
    def count(self) -> int:
        """Return the number of legs."""
        return len(self._chains)

    @property
    def chains(self) -> Sequence[LegChain]:
        """Return the joint chain of each leg."""
        return self._chains

    def get_straight_axes(self) -> Floats:
        """Return the bend axes float32[L, 3] of knees that are straight in a pose, in the definition's space."""
        return np.concatenate([self._get_straight_axis(each) for each in self._chains], axis=1).T

    def compute_stance_weights(
        self, clips: Sequence[tuple[str, str] | PlayedClip], machines: Sequence[MachineClips], count: int
    ) -> Floats:
        """Return how strongly the feet of `count` agents are placed on the ground, float32[n] from 0 to 1.

        Clips that do not place feet reduce it, according to their layers and weights in the pose."""
        stands = np.ones(count, np.float32)
        played = [PlayedClip(*each) for each in clips]
        free = np.array([each.clip in self._clips_without_feet for each in played] + [False])
        moves = np.array(
            [not each.add and (not each.group or self._group_moves_legs.get(each.group, False)) for each in played] + [False]
        )
        for machine in machines:
            weight, loose = np.zeros(count, np.float32), np.zeros(count, np.float32)
            for clip, _, share in machine.iterate_clip_slots():
                row = np.where((clip >= 0) & (clip < len(clips)), clip, len(clips))
                heeded = np.maximum(np.nan_to_num(share), 0) * moves[row]
                weight += heeded
                loose += heeded * free[row]
            over = np.minimum(weight, 1)
            stands = stands * (1 - over) + over * (1 - loose / np.where(weight > 0, weight, np.float32(1)))
        return stands.astype(np.float32)

    def bend_legs(self, poses: Poses, feet: BodySpaceFeet, stance_weights: Floats) -> Poses:
        """Return poses with the feet at the positions of `feet`, weighted by `stance_weights` [n], and with trunks moved by
        `rise` and `tilt`. `local` of the poses is None."""
        world = np.array(poses.world_transforms.transpose(2, 3, 1, 0), np.float32, order="C")
        goals = self._compute_foot_goals(feet)
        self._lower_bodies(world, goals, feet.is_on_ground, stance_weights)
        for each, goal in zip(self._chains, goals, strict=True):
            self._bend_leg(world, each, goal, stance_weights)
        self._move_trunk(world, feet)
        return replace(poses, world_transforms=world.transpose(3, 2, 0, 1), local_transforms=None)

    def _compute_foot_goals(self, feet: BodySpaceFeet) -> list[Floats]:
        """Return the goal position of each foot joint, float32[3, n], in the definition's space before the trunk moves."""
        turn = _build_rotation_matrices(feet.tilt).astype(np.float32)
        goals = []
        for k in range(len(self._chains)):
            x, y, z = feet.positions[:, k, 0], feet.positions[:, k, 1] + self.sole_heights[k] - feet.rise, feet.positions[:, k, 2]
            q = [(turn[0, r] * x + turn[1, r] * y) + turn[2, r] * z for r in range(3)]
            b = self._base_rotation * self._length
            goals.append(np.stack([(b[0, r] * q[0] + b[1, r] * q[1]) + b[2, r] * q[2] for r in range(3)]))
        return goals

    def _lower_bodies(self, world: Floats, goals: list[Floats], is_on_ground: NDArray[np.bool_], stance_weights: Floats) -> None:
        """Lower bodies until the feet that are on the ground can reach it: the trunk of a clip may be too high for the stance."""
        most = np.zeros(len(stance_weights), np.float32)
        for k, (each, goal) in enumerate(zip(self._chains, goals, strict=True)):
            hip, knee, foot = (world[:, 3, joint] for joint in (each.upper, each.lower, each.foot))
            length = (_measure_lengths(knee - hip) + _measure_lengths(foot - knee)) * np.float32(MAX_LEG_EXTENSION)
            displacement = goal - hip
            high = _dot_rows(displacement, self._up_axis[:, None])
            level = np.maximum(length * length - np.maximum(_dot_rows(displacement, displacement) - high * high, 0), 0)
            short = np.clip(-np.sqrt(level) - high, 0, np.float32(_MAX_TRUNK_SINK) * length)
            most = np.maximum(most, np.where(is_on_ground[:, k], short, 0))
        world[:, 3] -= self._up_axis[:, None, None] * (most * stance_weights)

    def _bend_leg(self, world: Floats, leg: LegChain, goal: Floats, stance_weights: Floats) -> None:
        """Bend a leg in `world` so that its foot reaches `goal` [3, n], weighted by `stance_weights` [n], in place."""
        hip, knee, foot = (world[:, 3, joint].copy() for joint in (leg.upper, leg.lower, leg.foot))
        sole = world[:, :, leg.sole].copy()
        goal = foot + (goal - foot) * stance_weights
        thigh, shank = hip - knee, foot - knee
        a, b = _measure_lengths(thigh), _measure_lengths(shank)
        tiny = np.float32(1e-6) * self._length
        a, b = np.maximum(a, tiny), np.maximum(b, tiny)
        hip_to_goal = goal - hip
        far = np.clip(
            _measure_lengths(hip_to_goal), np.abs(a - b) * np.float32(_FOLDED_LEG_FACTOR), (a + b) * np.float32(MAX_LEG_EXTENSION)
        )
        old = np.clip(_dot_rows(thigh, shank) / (a * b), -1, 1)
        new = np.clip((a * a + b * b - far * far) / (2 * a * b), -1, 1)
        old_sine, new_sine = np.sqrt(1 - old * old), np.sqrt(1 - new * new)
        axis = self._compute_knee_axis(world, leg, thigh, shank, a * b)
        turn = _build_axis_rotation(axis, new * old + new_sine * old_sine, new_sine * old - new * old_sine)
        _rotate_joints(world, np.concatenate([leg.shank, leg.sole]), turn, knee)
        reached = world[:, 3, leg.foot] - hip
        turn = _build_rotation_between(_normalise_rows(reached), _normalise_rows(hip_to_goal))
        _rotate_joints(world, np.concatenate([leg.thigh, leg.shank, leg.sole]), turn, hip)
        moved = world[:, 3, leg.foot] - foot
        world[:, :, leg.sole] = sole
        world[:, 3, leg.sole] += moved[:, None, :]

    def _compute_knee_axis(self, world: Floats, leg: LegChain, thigh: Floats, shank: Floats, size: Floats) -> Floats:
        """Return the unit axis [3, n] about which the knee opens. For a straight leg, this is the axis in the standing pose."""
        axis = _cross_rows(thigh, shank)
        rest = self._get_straight_axis(leg)
        straight = _measure_lengths(axis) <= np.float32(_MIN_KNEE_SINE) * size
        axis = np.where(straight, rest - thigh * (_dot_rows(rest, thigh) / _dot_rows(thigh, thigh)), axis)
        return _normalise_rows(axis)

    def _get_straight_axis(self, leg: LegChain) -> Floats:
        """Return the bend axis [3, 1] of the standing pose; for a straight leg, the axis of a knee that bends forward."""
        hip, knee, foot = (self._standing_positions[:, joint, None] for joint in (leg.upper, leg.lower, leg.foot))
        rest = _cross_rows(hip - knee, foot - knee)
        if _measure_lengths(rest)[0] <= _MIN_KNEE_SINE * _measure_lengths(hip - knee)[0] * _measure_lengths(foot - knee)[0]:
            rest = _cross_rows(self._front_axis[:, None], hip - foot)  # a knee that bends to the front
        return rest

    def _move_trunk(self, world: Floats, feet: BodySpaceFeet) -> None:
        """Move all joints of `world` by `rise` and `tilt` of the feet, in place."""
        base, turn = self._base_rotation, _build_rotation_matrices(feet.tilt)
        half = [
            [(turn[a, 0] * base[0, s] + turn[a, 1] * base[1, s]) + turn[a, 2] * base[2, s] for s in range(3)] for a in range(3)
        ]
        own = np.array([
            [(base[0, r] * half[0][s] + base[1, r] * half[1][s]) + base[2, r] * half[2][s] for s in range(3)] for r in range(3)
        ], np.float32)  # fmt: skip
        _rotate_joints(world, np.arange(world.shape[2]), own, np.zeros((3, len(feet.rise)), np.float32))
        world[:, 3] += base[1][:, None, None] * (feet.rise * self._length)


def _build_rotation_matrices(quaternions: NDArray[np.floating]) -> Numbers:
    """Return matrices float64[3, 3, n] of quaternions [n, 4]. A zero quaternion becomes the identity."""
    q = normalise_quaternions(np.array(np.asarray(quaternions, np.float64).T, order="C"))
    return compose_matrices(np.zeros((3, q.shape[1])), q, None, None, np.empty((3, 4, q.shape[1])))[:, :3]


def _rotate_joints(world: Floats, joints: Joints, turn: Floats, pivots: Floats) -> None:
    """Rotate `joints` of world matrices by the matrices `turn` [3, 3, n] about the points `pivots` [3, n], in place."""
    old = world[:, :, joints]
    old[:, 3] -= pivots[:, None]
    for r in range(3):
        new = (turn[r, 0] * old[0] + turn[r, 1] * old[1]) + turn[r, 2] * old[2]
        new[3] += pivots[r]
        world[r][:, joints] = new


def _build_axis_rotation(axis: Floats, cosine: Floats, sine: Floats) -> Floats:
    """Return matrices [3, 3, n] of rotations about unit axes [3, n], from the cosine and sine of their angles (Rodrigues'
    formula)."""
    x, y, z = axis
    left = 1 - cosine
    return np.stack([
        np.stack([cosine + x * x * left, x * y * left - z * sine, x * z * left + y * sine]),
        np.stack([x * y * left + z * sine, cosine + y * y * left, y * z * left - x * sine]),
        np.stack([x * z * left - y * sine, y * z * left + x * sine, cosine + z * z * left]),
    ])  # fmt: skip


def _build_rotation_between(a: Floats, b: Floats) -> Floats:
    """Return matrices [3, 3, n] of the shortest rotations from unit vectors `a` to unit vectors `b`, [3, n] each."""
    axis, cosine = _cross_rows(a, b), _dot_rows(a, b)
    x, y, z = axis
    by = 1 / np.maximum(1 + cosine, np.float32(1e-6))
    return np.stack([
        np.stack([cosine + x * x * by, x * y * by - z, x * z * by + y]),
        np.stack([x * y * by + z, cosine + y * y * by, y * z * by - x]),
        np.stack([x * z * by - y, y * z * by + x, cosine + z * z * by]),
    ])  # fmt: skip


def _dot_rows(a: Floats, b: Floats) -> Floats:
    product: Floats = (a[0] * b[0] + a[1] * b[1]) + a[2] * b[2]
    return product


def _cross_rows(a: Floats, b: Floats) -> Floats:
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _measure_lengths(v: Floats) -> Floats:
    return np.asarray(np.sqrt(_dot_rows(v, v)))


def _normalise_rows(v: Floats) -> Floats:
    return np.asarray(v / np.maximum(_measure_lengths(v), np.float32(1e-12)))
