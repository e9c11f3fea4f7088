"""Bends legs so that feet reach their footholds: two-bone inverse kinematics of many agents, one leg after the other.

First, the knee opens or closes by the law of cosines, in the plane in which it bends in the pose. Then the complete leg rotates
about the hip by the shortest rotation to the goal, so the knee still points to the same side. Joints between these do not change
their local transforms. The foot and all joints below it do not rotate, so the foot's angle to the ground is that of the clip. A
leg that cannot reach the goal is extended towards it.

A leg with an ankle has a flat sole. The parts at and below the ankle get the rotation of the standing pose, tilted so that its up
direction is the ground's normal. The two bones then reach for the ankle. If they are too short, the heel rises about the foot
joint.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.affine import Floats, invert_and_transpose
from antdsl.bodies.agents.definition import Definition
from antdsl.bodies.agents.joint_rotations import (
    build_axis_rotation,
    build_rotation_between,
    build_rotation_matrices,
    compute_heel_rotation,
    cross,
    dot,
    measure_lengths,
    normalise,
    rotate_joints,
    rotate_vectors,
    rotate_vectors_by_inverse,
)
from antdsl.bodies.agents.leg_chains import LegChain, build_leg_chain, compute_standing_joints
from antdsl.bodies.agents.machine_clips import MachineClips, PlayedClip
from antdsl.bodies.agents.poses import WorldPoses

MAX_LEG_EXTENSION = 0.9995  # share of the length of both bones; in a completely straight leg the knee would have no direction
_MIN_FOLDED_LEG_FACTOR = 1.02  # factor of the length difference of both bones
_MAX_TRUNK_SINK_SHARE = 0.25  # leg lengths; maximum lowering of a trunk, so that standing feet are in reach
_HEEL_SINK_SHARE = 0.05  # bone lengths; maximum lowering of a body on level ground, so that heels stay down
_MIN_KNEE_SINE = 1e-3  # sine of the knee angle; below it, the knee does not define a plane
LEG_BENDING_LIMITS = {
    "straight": MAX_LEG_EXTENSION,
    "folded": _MIN_FOLDED_LEG_FACTOR,
    "sunk": _MAX_TRUNK_SINK_SHARE,
    "plane": _MIN_KNEE_SINE,
    "heel": _HEEL_SINK_SHARE,
}  # for renderers that bend legs themselves


@dataclass(frozen=True, slots=True, eq=False)
class BodySpaceFeet:
    """The feet of n agents relative to their bodies, in body lengths. Axes are x ahead, y up, and z to the side.

    `positions`: float32[n, L, 3], the point on the ground below each foot; for a swinging foot, its position in the air.
    `is_on_ground`: bool[n, L], whether the foot is on the ground.
    `trunk_rise`: float32[n], height of the trunk above its rest position.
    `trunk_tilt`: float32[n, 4], rotation of the trunk from its rest orientation, x y z w.
    `normals`: float32[n, L, 3], unit normals of the ground below each foot. A zero vector, or None for all feet, means level
    ground."""

    positions: Floats
    is_on_ground: NDArray[np.bool_]
    trunk_rise: Floats
    trunk_tilt: Floats
    normals: Floats | None = None

    def scale_trunk_motion(self, weights: Floats) -> BodySpaceFeet:
        """Return the same feet with a weaker motion of the trunks: rise and tilt are multiplied by `weights` [n], from 0 to 1."""
        tilt = self.trunk_tilt * weights[:, None]
        tilt[:, 3] += 1 - weights
        return replace(self, trunk_rise=self.trunk_rise * weights, trunk_tilt=tilt)


@dataclass(frozen=True, slots=True, eq=False)
class PlacedFeet:
    """The feet of n agents in a frame, as stored in caches, in scene units.

    `P`: float32[n, L, 3], positions.
    `is_on_ground`: uint8[n, L], whether the foot is on the ground.
    `phase`: float32[n], the phase of the gait.
    `rise`: float32[n], height of the trunk above its rest position.
    `tilt`: float32[n, 4], rotation of the trunk from its rest orientation, x y z w.
    `normals`: float32[n, L, 3], normals of the ground below each foot, in the axes of the body; None without flat soles."""

    P: Floats
    is_on_ground: NDArray[np.uint8]
    phase: Floats
    rise: Floats
    tilt: Floats
    normals: Floats | None = None

    def convert_to_body_space(
        self, position: NDArray[np.floating], orient: NDArray[np.floating], scale: NDArray[np.floating]
    ) -> BodySpaceFeet:
        """Return the feet in the space of their bodies. Of the bodies, `position` is [n, 3], `orient` quaternions [n, 4], and
        `scale` the lengths [n].

        Values that are not finite are replaced by 0."""
        with np.errstate(all="ignore"):
            away = np.asarray(self.P, np.float64) - np.asarray(position, np.float64)[:, None]
            across = build_rotation_matrices(orient)
            size = np.where(np.asarray(scale) > 0, scale, 1.0).astype(np.float64)
            x, y, z = (away[..., k] for k in range(3))
            place = [(x * m[0, :, None] + y * m[1, :, None]) + z * m[2, :, None] for m in np.moveaxis(across, 1, 0)]
            local = np.stack(place, -1) / size[:, None, None]
            return BodySpaceFeet(
                np.nan_to_num(local, posinf=0, neginf=0).astype(np.float32), self.is_on_ground != 0,
                np.nan_to_num(self.rise / size, posinf=0, neginf=0).astype(np.float32), np.nan_to_num(self.tilt),
                None if self.normals is None else np.nan_to_num(self.normals),
            )  # fmt: skip


class LegIkSolver:
    """The legs of a definition, prepared for inverse kinematics."""

    def __init__(self, body: Definition) -> None:
        self._chains = [build_leg_chain(body.rig, leg) for leg in body.legs]
        standing, axes = compute_standing_joints(body)
        self.sole_heights = standing[[each.foot for each in self._chains], 1].astype(np.float32).reshape(-1)
        base = body.compute_base_matrix()[:3, :3] * body.length
        self._base_rotation, self._length = base.astype(np.float32), np.float32(body.length)
        self._up_axis = base[1].astype(np.float32)
        self._standing_positions = (standing @ base * body.length).T.astype(np.float32)  # shape (3, J), axes of the definition
        self._front_axis = base[0].astype(np.float32)
        local_up = rotate_vectors(invert_and_transpose(axes.transpose(1, 2, 0)).swapaxes(0, 1), base[1])
        self._local_up_axes = normalise(local_up).astype(np.float32)  # [3, J]: the body's up in the space of each joint
        legs = np.zeros(len(body.rig.names), np.bool_)
        for each in self._chains:
            legs[each.thigh_joints] = legs[each.shank_joints] = legs[each.arch_joints] = legs[each.sole_joints] = True
        self._group_moves_legs = {
            name: any(
                legs[body.rig.find_joint(joint)] and weight > 0 for joint, weight in group.members if joint in body.rig.names
            )
            for name, group in body.groups.items()
        }
        self._clips_without_feet = {name for name, clip in body.clips.items() if not clip.feet}

    @property
    def leg_count(self) -> int:
        """Return the number of legs."""
        return len(self._chains)

    @property
    def chains(self) -> Sequence[LegChain]:
        """Return the joint chain of each leg."""
        return self._chains

    @property
    def has_flat_soles(self) -> bool:
        """Return whether at least one leg has an ankle, and thus a flat sole."""
        return any(each.has_flat_sole for each in self._chains)

    def get_local_up_axes(self, joint: int) -> Floats:
        """Return the standing body's up direction in the space of a joint, as a unit vector float32[3]."""
        return np.asarray(self._local_up_axes[:, joint])

    def get_arch(self, leg: LegChain) -> Floats:
        """Return the vector float32[3] from the foot joint to the ankle of the standing body, in the definition's space."""
        return np.asarray(self._standing_positions[:, leg.ankle] - self._standing_positions[:, leg.foot])

    def get_straight_axes(self) -> Floats:
        """Return the axes float32[L, 3] about which knees bend, in the definition's space. They are for legs that are straight
        in a pose."""
        return np.concatenate([self._get_straight_axis(each) for each in self._chains], axis=1).T

    def compute_stance_weights(
        self, clips: Sequence[tuple[str, str] | PlayedClip], machines: Sequence[MachineClips], count: int
    ) -> Floats:
        """Return how strongly the feet of `count` agents are held at their footholds, float32[n] from 0 (as in the clips) to 1.

        Clips that do not place feet reduce this strength, in proportion to their weight in the pose."""
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

    def bend_legs(self, poses: WorldPoses, feet: BodySpaceFeet, stance_weights: Floats) -> WorldPoses:
        """Return poses in which legs bend towards the positions of `feet`, as strongly as `stance_weights` [n] says. Trunks are
        moved by the rise and tilt of `feet`. `local_transforms` of the result is None."""
        world = np.array(poses.world_transforms.transpose(2, 3, 1, 0), np.float32, order="C")
        goals, normals = self._compute_foot_goals(feet), self._compute_sole_normals(feet)
        self._lower_bodies(world, goals, normals, feet.is_on_ground, stance_weights)
        for each, goal, normal in zip(self._chains, goals, normals, strict=True):
            self._bend_leg(world, each, goal, normal, stance_weights)
        self._move_trunk(world, feet)
        return replace(poses, world_transforms=world.transpose(3, 2, 0, 1), local_transforms=None)

    def _compute_foot_goals(self, feet: BodySpaceFeet) -> list[Floats]:
        """Return the goal positions of each foot joint, float32[3, n]. They are in the definition's space, before the trunk
        rises and tilts."""
        turn = build_rotation_matrices(feet.trunk_tilt).astype(np.float32)
        goals = []
        for k in range(len(self._chains)):
            height = feet.positions[:, k, 1] + self.sole_heights[k] - feet.trunk_rise
            place = np.stack([feet.positions[:, k, 0], height, feet.positions[:, k, 2]])
            goals.append(rotate_vectors_by_inverse(self._base_rotation * self._length, rotate_vectors_by_inverse(turn, place)))
        return goals

    def _compute_sole_normals(self, feet: BodySpaceFeet) -> list[Floats | None]:
        """Return the ground normals below the flat sole of each leg, float32[3, n]. They are in the definition's space, before
        the trunk rises and tilts.

        The entry of a leg without a flat sole is None."""
        turn = build_rotation_matrices(feet.trunk_tilt).astype(np.float32)
        level = np.broadcast_to(np.array([[0], [1], [0]], np.float32), (3, len(feet.trunk_rise)))
        normals = [level if feet.normals is None else feet.normals[:, k].T for k in range(len(self._chains))]
        return [
            rotate_vectors_by_inverse(
                self._base_rotation, rotate_vectors_by_inverse(turn, np.where(measure_lengths(normal) > 0, normal, level))
            )
            if leg.has_flat_sole
            else None
            for leg, normal in zip(self._chains, normals, strict=True)
        ]

    def _lower_bodies(
        self,
        world: Floats,
        goals: list[Floats],
        normals: list[Floats | None],
        is_on_ground: NDArray[np.bool_],
        stance_weights: Floats,
    ) -> None:
        """Lower the bodies in `world`, in place, until all feet that are on the ground can reach it. This is needed because the
        trunk in a clip may be too high.

        Bodies also sink a little so that heels stay down, and by the amount by which a slope lowers the ankle of a flat sole.
        Therefore heels rise only in long steps."""
        most = np.zeros(len(stance_weights), np.float32)
        for k, (each, goal, normal) in enumerate(zip(self._chains, goals, normals, strict=True)):
            hip, knee, ankle, foot = (world[:, 3, joint] for joint in (each.upper, each.lower, each.ankle, each.foot))
            bones = measure_lengths(knee - hip) + measure_lengths(ankle - knee)
            length = (bones + measure_lengths(foot - ankle)) * np.float32(MAX_LEG_EXTENSION)
            short = np.clip(self._measure_unreachable_distance(goal - hip, length), 0, np.float32(_MAX_TRUNK_SINK_SHARE) * length)
            if normal is not None:
                level = self.get_arch(each)[:, None]
                arch = rotate_vectors(build_rotation_between(self._up_axis[:, None], normal), level)
                gap = self._measure_unreachable_distance(goal + arch - hip, bones * np.float32(MAX_LEG_EXTENSION))
                drop = dot(level - arch, self._up_axis[:, None])
                most_for_heel = np.maximum(drop, 0) + np.float32(_HEEL_SINK_SHARE) * bones
                short = np.maximum(short, np.minimum(gap, most_for_heel))
            most = np.maximum(most, np.where(is_on_ground[:, k], short, 0))
        world[:, 3] -= self._up_axis[:, None, None] * (most * stance_weights)

    def _measure_unreachable_distance(self, displacement: Floats, length: Floats) -> Floats:
        """Return how far hips must sink so that legs of `length` [n] reach goals at `displacement` [3, n] from the hips. The
        result is negative for hips that are already low enough."""
        high = dot(displacement, self._up_axis[:, None])
        level = np.maximum(length * length - np.maximum(dot(displacement, displacement) - high * high, 0), 0)
        return np.asarray(-np.sqrt(level) - high)

    def _bend_leg(self, world: Floats, leg: LegChain, goal: Floats, normal: Floats | None, stance_weights: Floats) -> None:
        """Bend a leg in `world` in place, so that its foot reaches `goal` [3, n]. `stance_weights` [n]: how much to bend the
        leg, from 0 (no change) to 1.

        `normal` [3, n]: the normal of the ground below a flat sole; None if the rotation of the foot does not change."""
        hip, knee, foot = (world[:, 3, joint].copy() for joint in (leg.upper, leg.lower, leg.foot))
        goal = foot + (goal - foot) * stance_weights
        if normal is not None:
            goal = self._rotate_sole_to_ground(world, leg, goal, normal, stance_weights)
        foot, below = world[:, 3, leg.ankle].copy(), np.concatenate([leg.arch_joints, leg.sole_joints])
        sole = world[:, :, below].copy()
        thigh, shank = hip - knee, foot - knee
        a, b = measure_lengths(thigh), measure_lengths(shank)
        tiny = np.float32(1e-6) * self._length
        a, b = np.maximum(a, tiny), np.maximum(b, tiny)
        hip_to_goal = goal - hip
        far = np.clip(
            measure_lengths(hip_to_goal),
            np.abs(a - b) * np.float32(_MIN_FOLDED_LEG_FACTOR),
            (a + b) * np.float32(MAX_LEG_EXTENSION),
        )
        old = np.clip(dot(thigh, shank) / (a * b), -1, 1)
        new = np.clip((a * a + b * b - far * far) / (2 * a * b), -1, 1)
        old_sine, new_sine = np.sqrt(1 - old * old), np.sqrt(1 - new * new)
        axis = self._compute_knee_axis(world, leg, thigh, shank, a * b)
        turn = build_axis_rotation(axis, new * old + new_sine * old_sine, new_sine * old - new * old_sine)
        rotate_joints(world, np.concatenate([leg.shank_joints, below]), turn, knee)
        reached = world[:, 3, leg.ankle] - hip
        turn = build_rotation_between(normalise(reached), normalise(hip_to_goal))
        rotate_joints(world, np.concatenate([leg.thigh_joints, leg.shank_joints, below]), turn, hip)
        moved = world[:, 3, leg.ankle] - foot
        world[:, :, below] = sole
        world[:, 3, below] += moved[:, None, :]

    def _rotate_sole_to_ground(
        self, world: Floats, leg: LegChain, goal: Floats, normal: Floats, stance_weights: Floats
    ) -> Floats:
        """Rotate the joints at and below an ankle in `world`, in place, so that the sole lies flat on the ground. Return the
        goal position of the ankle [3, n].

        `goal` [3, n]: the goal of the foot joint. If the bones cannot reach the ankle's goal, the heel rises about the foot
        joint as far as necessary."""
        hip, knee, ankle, foot = (world[:, 3, joint].copy() for joint in (leg.upper, leg.lower, leg.ankle, leg.foot))
        turns = []
        for joint, part, pivot in ((leg.ankle, leg.arch_joints, ankle), (leg.foot, leg.sole_joints, foot)):
            up = normalise(rotate_vectors(world[:, :3, joint], self._local_up_axes[:, joint, None]))
            turns.append(build_rotation_between(up, normalise(up + (normal - up) * stance_weights)))
            rotate_joints(world, part, turns[-1], pivot)
        arch = rotate_vectors(turns[0], ankle - foot)
        reach = (measure_lengths(knee - hip) + measure_lengths(ankle - knee)) * np.float32(MAX_LEG_EXTENSION)
        raised = compute_heel_rotation(arch, hip - goal, reach)
        rotate_joints(world, leg.arch_joints, build_rotation_between(normalise(arch), normalise(raised)), ankle)
        world[:, 3, leg.sole_joints] += ((ankle - raised) - foot)[:, None, :]
        return goal + raised

    def _compute_knee_axis(self, world: Floats, leg: LegChain, thigh: Floats, shank: Floats, size: Floats) -> Floats:
        """Return the unit axes [3, n] about which the knees open. If a leg is straight in the pose, its axis is that of the
        standing pose."""
        axis = cross(thigh, shank)
        rest = self._get_straight_axis(leg)
        straight = measure_lengths(axis) <= np.float32(_MIN_KNEE_SINE) * size
        axis = np.where(straight, rest - thigh * (dot(rest, thigh) / dot(thigh, thigh)), axis)
        return normalise(axis)

    def _get_straight_axis(self, leg: LegChain) -> Floats:
        """Return the axis [3, 1] about which the leg bends in the standing pose. For a straight leg, it is the axis of a knee
        that bends forward."""
        hip, knee, foot = (self._standing_positions[:, joint, None] for joint in (leg.upper, leg.lower, leg.foot))
        rest = cross(hip - knee, foot - knee)
        if measure_lengths(rest)[0] <= _MIN_KNEE_SINE * measure_lengths(hip - knee)[0] * measure_lengths(foot - knee)[0]:
            rest = cross(self._front_axis[:, None], hip - foot)  # a knee that bends to the front
        return rest

    def _move_trunk(self, world: Floats, feet: BodySpaceFeet) -> None:
        """Move all joints of `world` by the trunk rise and tilt of `feet`, in place."""
        base, turn = self._base_rotation, build_rotation_matrices(feet.trunk_tilt)
        half = [
            [(turn[a, 0] * base[0, s] + turn[a, 1] * base[1, s]) + turn[a, 2] * base[2, s] for s in range(3)] for a in range(3)
        ]
        own = np.array([
            [(base[0, r] * half[0][s] + base[1, r] * half[1][s]) + base[2, r] * half[2][s] for s in range(3)] for r in range(3)
        ], np.float32)  # fmt: skip
        rotate_joints(world, np.arange(world.shape[2]), own, np.zeros((3, len(feet.trunk_rise)), np.float32))
        world[:, 3] += base[1][:, None, None] * (feet.trunk_rise * self._length)
