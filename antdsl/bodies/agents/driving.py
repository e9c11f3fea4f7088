"""Pose controls other than clips: channel values, look directions of parts of a body, and joint offsets."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.affine import Floats, normalise_quaternions
from antdsl.bodies.agents.definition import Rig, TransformGroup, map_language_names
from antdsl.bodies.agents.poses import ClipTable, WorldPoses
from antdsl.bodies.agents.varied_bodies import VariationDraws


@dataclass(frozen=True, slots=True, eq=False)
class PoseAdjustments:
    """Values that determine the poses of n agents, together with the clips.

    `channels`: float32[n] by display name. A value replaces that of the clips; NaN means that the clips decide.
    `look_directions`: float32[n, 3] by transform group, unit vectors in the agent's space (+x ahead, +y up); (1, 0, 0) is
    straight ahead.
    `variation_draws`: the sources of random differences between the bodies.
    `lean`: float32[n, 2], how much each agent turns (-1 right to 1 left) and climbs (-1 down to 1 up); None if no clip depends
    on it.
    `joint_offsets`: float32[n, 7] by joint: a translation in body lengths and a rotation x y z w, both in the agent's space."""

    channels: Mapping[str, Floats] = field(default_factory=dict)
    look_directions: Mapping[str, Floats] = field(default_factory=dict)
    variation_draws: VariationDraws | None = None
    lean: Floats | None = None
    joint_offsets: Mapping[str, Floats] = field(default_factory=dict)


def set_pose_channels(table: ClipTable, poses: WorldPoses, channels: Mapping[str, Floats]) -> WorldPoses:
    """Return the poses in which channels have the values in `channels`, where these are finite. Channels that the rig lacks are
    ignored."""
    names = {
        language_name: k for k, language_name in enumerate(map_language_names(each.name for each in table.rig.channels).values())
    }
    known = {names[name]: value for name, value in channels.items() if name in names}
    if not known:
        return poses
    values = np.array(poses.channels, np.float32)
    for k, value in known.items():
        said = np.isfinite(value)
        values[said, k] = value[said]
    return replace(poses, channels=values)


def rotate_joints_to_look_directions(
    table: ClipTable,
    poses: WorldPoses,
    looks: Mapping[str, Floats],
    groups: Mapping[str, TransformGroup],
    base: NDArray[np.float64],
) -> WorldPoses:
    """Return the poses with transform groups rotated towards their look directions.

    Each joint of a group rotates about its own position, together with all joints below it. Its weight says what fraction of the
    shortest rotation from straight ahead to the look direction it makes. The joints of a chain together make at most the full
    rotation. `base` [3, 3] transforms from the definition's space to agent space. Groups that the body does not have are
    ignored. If a joint was rotated, `local_transforms` is None."""
    known_looks = {name: look for name, look in looks.items() if name in groups and len(look)}
    if not known_looks:
        return poses
    world = np.array(poses.world_transforms, np.float32)
    x, y, z = base[0]
    axes = (base / np.sqrt((x * x + y * y) + z * z)).astype(np.float32)
    for name, look in known_looks.items():
        direction = [(look[:, 0] * axes[0, k] + look[:, 1] * axes[1, k]) + look[:, 2] * axes[2, k] for k in range(3)]
        turn = _compute_shortest_rotation(direction, axes[0])
        for joint, share in iterate_look_shares(table.rig, groups[name]):
            _rotate_joints(world, joint, table.rig.find_descendants(joint), _scale_rotation_angle(turn, share))
    return WorldPoses(world, None, poses.channels)


def offset_joints(table: ClipTable, poses: WorldPoses, offsets: Mapping[str, Floats], base: NDArray[np.float64]) -> WorldPoses:
    """Return the poses in which some joints are translated, and rotated about their own positions. All joints below them move
    with them.

    `base` [3, 3] transforms from the definition's space to agent space. Joints that the rig does not have are ignored. If a
    joint was moved, `local_transforms` is None."""
    known = {table.rig.names.index(name): offset for name, offset in offsets.items() if name in table.rig.names and len(offset)}
    if not known:
        return poses
    world = np.array(poses.world_transforms, np.float32)
    x, y, z = base[0]
    scale = np.sqrt((x * x + y * y) + z * z)
    axes = base / scale
    for joint, offset in sorted(known.items(), key=lambda entry: entry[0]):
        wide = np.asarray(offset, np.float64)
        shift, turn = (
            (wide[:, k : k + 1] * axes[0] + wide[:, k + 1 : k + 2] * axes[1]) + wide[:, k + 2 : k + 3] * axes[2] for k in (0, 3)
        )
        below = table.rig.find_descendants(joint)
        _rotate_joints(world, joint, below, np.concatenate([turn, wide[:, 6:]], axis=1).astype(np.float32))
        world[:, below, :, 3] += (shift / scale).astype(np.float32)  # indexed so, joints come before agents
    return WorldPoses(world, None, poses.channels)


def iterate_look_shares(rig: Rig, group: TransformGroup) -> Iterator[tuple[int, float]]:
    """Yield each joint of a group, with the fraction of the rotation towards a look direction that it makes.

    The fraction is the joint's weight. It is limited so that the joints of a chain together make at most the full rotation."""
    left = np.ones(len(rig.names))
    for joint, weight in sorted((rig.find_joint(member), weight) for member, weight in group.members):
        share = min(weight, float(left[joint]))
        if share > 0:
            left[rig.find_descendants(joint)] -= share
            yield joint, share


def _compute_shortest_rotation(direction: Sequence[Floats], ahead: Floats) -> Floats:
    """Return the shortest rotations from `ahead` [3] to each direction, as quaternions float32[n, 4].

    `direction`: three arrays [n], the x, y and z of unit vectors. `ahead`: a unit vector."""
    x, y, z = ahead
    quaternions = np.stack([
        y * direction[2] - z * direction[1], z * direction[0] - x * direction[2], x * direction[1] - y * direction[0],
        1 + ((direction[0] * x + direction[1] * y) + direction[2] * z),
    ]).astype(np.float32)  # fmt: skip
    # opposite directions have no unique rotation
    quaternions[:, quaternions[3] < 1e-6] = np.array([[0], [0], [0], [1]], np.float32)
    return np.ascontiguousarray(normalise_quaternions(quaternions).T)


def _scale_rotation_angle(turn: Floats, weight: float) -> Floats:
    """Return rotations [n, 4] reduced to the fraction `weight`, by nlerp (normalised linear interpolation) from the identity."""
    part = turn * np.float32(weight)
    part[:, 3] += np.float32(1 - weight)
    return np.ascontiguousarray(normalise_quaternions(np.ascontiguousarray(part.T)).T)


def _rotate_joints(world: Floats, joint: int, moved_joints: NDArray[np.intp], rotation: Floats) -> None:
    """Rotate `moved_joints` in the world matrices `world` [n, J, 3, 4] about the position of `joint`, in place."""
    x, y, z, w = rotation.T
    matrix = np.empty((len(rotation), 3, 3), np.float32)
    matrix[:, 0] = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], axis=1)
    matrix[:, 1] = np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], axis=1)
    matrix[:, 2] = np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=1)
    pivot = world[:, joint, :, 3].copy()
    part: Any = world[:, moved_joints]
    part[..., 3] -= pivot[:, None]
    for row in range(3):
        a, b, c = (matrix[:, row, k, None, None] for k in range(3))
        turned = (a * part[:, :, 0] + b * part[:, :, 1]) + c * part[:, :, 2]
        turned[..., 3] += pivot[:, None, row]
        world[:, moved_joints, row] = turned
