"""The joint chains of legs: the joints that move with each bone, and the positions of hip and foot in the standing pose."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.definition import Definition, Leg, Rig
from antdsl.bodies.agents.poses import REST_CLIP, build_clip_table, compute_transforms, sample_poses
from antdsl.scene.setting import GaitData, LegsData

Joints = NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class LegChain:
    """A leg, with joints given by their indices in the rig.

    `upper`, `lower`, `ankle`, `foot`: the joints of hip, knee, ankle and foot. If the leg has no ankle, `ankle` equals `foot`.
    `thigh_joints`: `upper` and its descendants that are not at or below `lower`.
    `shank_joints`: `lower` and its descendants that are not at or below `ankle`.
    `arch_joints`: `ankle` and its descendants that are not at or below `foot`; empty without an ankle.
    `sole_joints`: `foot` and all joints below it.
    `has_flat_sole`: whether the definition names the ankle, so that the sole lies flat on the ground.
    """

    upper: int
    lower: int
    ankle: int
    foot: int
    thigh_joints: Joints
    shank_joints: Joints
    arch_joints: Joints
    sole_joints: Joints
    has_flat_sole: bool


def build_leg_chain(rig: Rig, leg: Leg) -> LegChain:
    """Return the joint chain of a leg. Raises KeyError for a joint that the rig does not have."""
    upper, lower, foot = rig.find_joint(leg.upper), rig.find_joint(leg.lower), rig.find_joint(leg.foot)
    ankle = rig.find_joint(leg.ankle) if leg.ankle else foot
    below = [_build_descendant_mask(rig, joint) for joint in (upper, lower, ankle, foot)]
    thigh, shank, arch = (np.flatnonzero(a & ~b) for a, b in pairwise(below))
    return LegChain(upper, lower, ankle, foot, thigh, shank, arch, np.flatnonzero(below[-1]), bool(leg.ankle))


def _build_descendant_mask(rig: Rig, joint: int) -> NDArray[np.bool_]:
    """Return a mask of a joint and all its descendants, bool[J]."""
    is_below = np.zeros(len(rig.names), np.bool_)
    is_below[joint] = True
    for number in range(joint + 1, len(is_below)):
        is_below[number] = rig.parents[number] >= 0 and is_below[rig.parents[number]]
    return is_below


def compute_standing_joints(body: Definition) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the positions [J, 3] of joints in agent space, and their world matrices [J, 3, 3] without translation. Both are for
    the standing pose.

    The standing pose is the first sample of the idle clip, or without an idle clip the rest pose."""
    table = build_clip_table(body)
    number = table.find_clip(body.idle) if body.idle in body.clips else REST_CLIP
    world = compute_transforms(table, sample_poses(table, np.array([number]), np.zeros(1)))[1]
    matrices = np.empty((len(table.joint_order), 3, 4))
    matrices[table.joint_order] = world[..., 0].transpose(2, 0, 1)
    base, positions = body.compute_base_matrix(), matrices[:, :, 3]
    place = [(base[k, 0] * positions[:, 0] + base[k, 1] * positions[:, 1]) + base[k, 2] * positions[:, 2] for k in range(3)]
    return np.stack(place, 1), matrices[:, :, :3]


def build_legs_data(body: Definition) -> LegsData:
    """Return the leg data of a body that runs need, in body lengths."""
    positions, _ = compute_standing_joints(body)
    chains = [build_leg_chain(body.rig, leg) for leg in body.legs]
    hip, knee, ankle, foot = (positions[[getattr(each, name) for each in chains]] for name in ("upper", "lower", "ankle", "foot"))
    length = _compute_lengths(knee - hip) + _compute_lengths(ankle - knee) + _compute_lengths(foot - ankle)
    per = 1.0 / body.length
    gaits = tuple(GaitData(g.speed * per, g.stride * per, g.duty, g.lift * per, g.phases) for g in body.gaits)
    return LegsData(foot, hip, np.maximum(length, 1e-6), gaits, any(each.has_flat_sole for each in chains))


def _compute_lengths(v: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the lengths of vectors [..., 3]."""
    return np.asarray(np.sqrt((v[:, 0] * v[:, 0] + v[:, 1] * v[:, 1]) + v[:, 2] * v[:, 2]))
