"""Poses of many agents. The clips of a definition form one table, which is sampled at each agent's own time.

The table has one row per clip sample, so that one gather reads the samples of all agents.

Between two samples, translations, scales, shears and channels are interpolated linearly. Rotations are interpolated linearly
along the shorter path, and then normalised (nlerp). Nlerp needs no sine, so all processors give the same bits. Nlerp can also
blend any number of clips, independent of their order. Slerp works for two rotations only, but turns at a constant speed. For
samples 10 degrees apart, the two differ by at most 0.0013 degrees; for 90 degrees, by 0.92. Readers of files therefore use slerp
to sample keys that are far apart.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.affine import (
    Floats,
    compose_matrices,
    decompose_matrices,
    invert_and_transpose,
    multiply_matrices,
    normalise_quaternions,
)
from antdsl.bodies.agents.definition import Clip, Definition, Rig, TransformGroup

REST_CLIP = -1  # no clip: the rest pose and the default channel values


@dataclass(slots=True, eq=False)
class LocalPose:
    """Local poses of n agents, one array per component, with joints in the order of a `ClipTable`.

    `translation`: float32[3, J, n].
    `rotation`: float32[4, J, n], unit quaternions x y z w.
    `scale`: float32[3, J, n]; None means 1.
    `shear`: float32[3, J, n]; None means 0.
    `channels`: float32[C, n].
    """

    translation: Floats
    rotation: Floats
    scale: Floats | None
    shear: Floats | None
    channels: Floats


@dataclass(frozen=True, slots=True, eq=False)
class WorldPoses:
    """Transforms and channel values of n agents, with joints and channels in the order of the rig.

    `world_transforms` and `local_transforms`: float32[n, J, 3, 4], the upper three rows of each joint's matrix, in agent space or
        in the parent's space; the fourth row would be 0 0 0 1. `channels`: float32[n, C].

    The arrays are views of [3, 4, J, n] memory, in which each component of a joint is contiguous over agents. Computations need
    this layout. Use `numpy.ascontiguousarray` to get contiguous matrices.
    """

    world_transforms: Floats
    local_transforms: Floats | None
    channels: Floats


def sample_poses(table: ClipTable, clips: NDArray[np.integer], times: NDArray[np.floating]) -> LocalPose:
    """Return the poses of n agents. `clips`: int[n], the clip of each agent. `times`: [n], its time in the clip, in seconds.

    A looping clip is periodic, also before time 0. For other clips, the pose is the first sample before the start of the clip,
    and the last sample after its end. Clip -1 is the rest pose. A time that is not finite is replaced by 0. Raises IndexError
    for a clip number out of range.
    """
    row, next_row, share = _find_sample_rows(table, clips, times)
    if not len(table.joint_order) + len(table.rig.channels):
        return _split_rows(table, np.empty((0, len(row)), np.float32))
    samples = table.sample_rows.take(row, axis=0)
    step = table.sample_rows.take(next_row, axis=0)
    step -= samples
    step *= share[:, None]
    samples += step
    turned = np.empty(samples.shape[::-1], np.float32)
    turned[:] = samples.T
    pose = _split_rows(table, turned)
    normalise_quaternions(pose.rotation)
    return pose


def build_rest_pose(table: ClipTable, count: int) -> LocalPose:
    """Return the rest pose for `count` agents, as read-only arrays."""
    pose = _split_rows(table, np.broadcast_to(table.sample_rows[0][:, None], (table.sample_rows.shape[1], 1)).copy())
    normalise_quaternions(pose.rotation)
    wide = [None if a is None else np.broadcast_to(a, (*a.shape[:-1], count)) for a in (pose.scale, pose.shear)]
    return LocalPose(
        np.broadcast_to(pose.translation, (*pose.translation.shape[:-1], count)),
        np.broadcast_to(pose.rotation, (*pose.rotation.shape[:-1], count)),
        wide[0], wide[1], np.broadcast_to(pose.channels, (len(pose.channels), count)),
    )  # fmt: skip


def compute_transforms(table: ClipTable, pose: LocalPose) -> tuple[Floats, Floats]:
    """Return the local and the world matrices of poses, both float32[3, 4, J, n], with joints in the order of the table."""
    shape = (3, 4, *pose.rotation.shape[1:])
    local = compose_matrices(pose.translation, pose.rotation, pose.scale, pose.shear, np.empty(shape, np.float32))
    return local, _compute_world_matrices(table, local)


def to_world_transforms(table: ClipTable, local_transforms: Floats) -> Floats:
    """Return the world transforms for the given local transforms. Both are float32[n, J, 3, 4], with joints in the order of the
    rig.

    Use it for transforms that do not come from a clip, such as those of legs after inverse kinematics."""
    world = np.empty((3, 4, local_transforms.shape[1], len(local_transforms)), np.float32)
    world[:, :, table.joint_order] = _compute_world_matrices(
        table, local_transforms.transpose(2, 3, 1, 0)[:, :, table.joint_order]
    )
    return world.transpose(3, 2, 0, 1)


def to_local_transforms(table: ClipTable, world: Floats) -> Floats:
    """Return the local transforms for the given world transforms. Both are float32[n, J, 3, 4], with joints in the order of the
    rig.

    A local transform is the inverse of the parent's world transform, times the joint's world transform. It cannot be recovered
    below a parent with scale 0."""
    placed = world.transpose(2, 3, 1, 0)
    local = np.array(placed, np.float32)
    children = np.flatnonzero(np.asarray(table.rig.parents) >= 0)
    above = placed[:, :, np.asarray(table.rig.parents)[children]]
    back = np.empty(above.shape, np.float32)
    back[:, :3] = invert_and_transpose(above).transpose(1, 0, 2, 3)
    for r in range(3):
        back[r, 3] = -((back[r, 0] * above[0, 3] + back[r, 1] * above[1, 3]) + back[r, 2] * above[2, 3])
    local[:, :, children] = multiply_matrices(back, placed[:, :, children], np.empty(above.shape, np.float32))
    return local.transpose(3, 2, 0, 1)


def to_square_matrices(matrices: Floats) -> Floats:
    """Return contiguous matrices float32[…, 4, 4] for column vectors, from matrices with three rows."""
    squares = np.zeros((*matrices.shape[:-2], 4, 4), np.float32)
    squares[..., :3, :] = matrices
    squares[..., 3, 3] = 1
    return squares


def _compute_world_matrices(table: ClipTable, local_transforms: Floats) -> Floats:
    """Return the world matrices for the given local matrices. Both are [3, 4, J, n], with joints in the order of the table.

    They are computed from the roots down: the world matrix of a joint is its parent's world matrix times its local matrix."""
    world = np.empty(local_transforms.shape, np.float32)
    for begin, end, parents in table.depth_levels:
        if not len(parents):
            world[:, :, begin:end] = local_transforms[:, :, begin:end]
        else:
            multiply_matrices(world[:, :, parents], local_transforms[:, :, begin:end], world[:, :, begin:end])
    return world


def _find_sample_rows(
    table: ClipTable, clips: NDArray[np.integer], times: NDArray[np.floating]
) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats]:
    """Return two table rows per agent, the samples before and after its time, and the fraction of the time between them. All are
    [n]."""
    clip = np.asarray(clips, np.int64) + 1
    if ((clip < 0) | (clip >= len(table.sample_counts))).any():
        raise IndexError(f"clips are numbered from 0 to {len(table.names) - 1}; -1 stands for no clip")
    last = table.sample_counts[clip] - 1
    at = np.asarray(times, np.float64) * table.rates[clip]
    at = np.where(np.isfinite(at), at, 0.0)
    turn = np.where(last > 0, last, 1).astype(np.float64)
    at = np.where(table.is_looping[clip], at - np.floor(at / turn) * turn, at)
    at = np.minimum(np.maximum(at, 0.0), last)
    lower_sample = np.minimum(np.floor(at), np.maximum(last - 1, 0))
    row = table.first_sample_rows[clip] + lower_sample.astype(np.int64)
    return row, np.minimum(row + 1, table.first_sample_rows[clip] + last), (at - lower_sample).astype(np.float32)


def _split_rows(table: ClipTable, rows: Floats) -> LocalPose:
    """Split table rows [W, n] into the components of local poses."""
    joints, n = len(table.joint_order), rows.shape[1]
    at, parts = 0, []
    for width in (3, 4, *([3] if table.has_scale else []), *([3] if table.has_shear else [])):
        parts.append(rows[at : at + width * joints].reshape(width, joints, n))
        at += width * joints
    scale = parts[2] if table.has_scale else None
    shear = parts[-1] if table.has_shear else None
    return LocalPose(parts[0], parts[1], scale, shear, rows[at:])


@dataclass(frozen=True, slots=True, eq=False)
class ClipTable:
    """The samples of all clips of one rig, which has J joints and C channels.

    `names`: the clips; the index of a clip is its number.
    `sample_rows`: float32[R, W]. Row 0 is the rest pose with the default values of channels. A row contains translations (3 J
        numbers: all x, all y, all z), rotations (4 J), scales (3 J, if `has_scale`), shears (3 J, if `has_shear`) and channels
        (C). Values that a clip does not set are those of the rest pose.
    `first_sample_rows`: `first_sample_rows[clip + 1]` is the first row of a clip.
    `joint_order`: int[J], for each joint of the table its index in the rig. Joints are ordered by depth in the rig's tree.
    `depth_levels`: for each depth, the range of its joints in the table and the indices of their parents: (begin, end, parents).

    Within a clip, the signs of quaternions are chosen so that interpolation takes the shorter path.
    """

    rig: Rig
    names: tuple[str, ...]
    sample_rows: Floats
    first_sample_rows: NDArray[np.int64]
    sample_counts: NDArray[np.int64]
    rates: NDArray[np.float64]
    is_looping: NDArray[np.bool_]
    joint_order: NDArray[np.intp]
    depth_levels: tuple[tuple[int, int, NDArray[np.intp]], ...]
    has_scale: bool
    has_shear: bool

    def find_clip(self, name: str) -> int:
        """Return the number of the clip called `name`. Raises KeyError if there is none."""
        try:
            return self.names.index(name)
        except ValueError:
            raise KeyError(name) from None

    def get_duration(self, number: int) -> float:
        """Return the seconds from the first sample of a clip to its last."""
        return float(self.sample_counts[number + 1] - 1) / float(self.rates[number + 1])

    def compute_group_weights(self, group: TransformGroup) -> tuple[Floats, Floats]:
        """Return the weights of a transform group: float32[J] for joints, in the order of the table, and float32[C] for
        channels. A channel in the group has the weight 1, any other channel 0. Raises KeyError for a name that the rig does
        not have."""
        joints, channels = np.zeros(len(self.joint_order), np.float32), np.zeros(len(self.rig.channels), np.float32)
        for name, weight in group.members:
            joints[self.rig.find_joint(name)] = weight
        for name in group.channels:
            channels[self.rig.find_channel(name)] = 1
        return joints[self.joint_order], channels


def build_clip_table(definition: Definition) -> ClipTable:
    """Return the table of a definition's clips.

    Joints and channels of a clip that the rig lacks are omitted, because different rigs may share a clip. Raises ValueError if
    the arrays of a clip do not match each other, or if the joints of the rig form a cycle."""
    rig = definition.rig
    order, levels = _order_by_depth(rig)
    clips = tuple(definition.clips.values())
    rest = decompose_matrices(rig.rest_matrices)
    rest[3][np.abs(rest[3]) < 1e-7] = 0  # rounding errors do not count as shear
    scaled = bool((np.abs(rest[2] - 1) > 1e-6).any()) or any((clip.scale != 1).any() for clip in clips)
    sheared = bool(rest[3].any()) or any(clip.shear is not None and clip.shear.any() for clip in clips)
    rest_parts = [*rest[:2], *([rest[2]] if scaled else []), *([rest[3]] if sheared else [])]
    blocks = [_build_rest_row(rig, rest_parts, order)]
    for clip in clips:
        blocks.append(_build_clip_rows(clip, rig, rest_parts, order, scaled, sheared))
    counts = np.array([len(block) for block in blocks], np.int64)
    return ClipTable(
        rig, tuple(definition.clips), np.concatenate(blocks), np.concatenate([[0], np.cumsum(counts)[:-1]]), counts,
        np.array([1.0, *(clip.rate for clip in clips)]), np.array([False, *(clip.loop for clip in clips)]),
        order, levels, scaled, sheared,
    )  # fmt: skip


def _order_by_depth(rig: Rig) -> tuple[NDArray[np.intp], tuple[tuple[int, int, NDArray[np.intp]], ...]]:
    """Return the joints sorted by depth, and for each depth (begin, end, indices of the parents)."""
    parents = np.asarray(rig.parents, np.intp)
    depth, above = np.zeros(len(parents), np.intp), parents.copy()
    while (above >= 0).any():
        depth += above >= 0
        above = np.where(above >= 0, parents[above], -1)
        if depth.max(initial=0) > len(parents):
            raise ValueError("some joints of the rig are above themselves: their parents form a circle")
    order = np.argsort(depth, kind="stable")
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    bounds = np.searchsorted(depth[order], np.arange(depth.max(initial=-1) + 2))
    levels = tuple(
        (int(a), int(b), place[parents[order[a:b]]] if parents[order[a]] >= 0 else np.zeros(0, np.intp))
        for a, b in pairwise(bounds)
    )
    return order, levels


def _build_rest_row(rig: Rig, rest: list[NDArray[np.float64]], order: NDArray[np.intp]) -> Floats:
    """Return the table row with the rest pose and the default values of channels, float32[1, W]."""
    return np.concatenate([*(part[:, order].reshape(-1) for part in rest), rig.channel_defaults]).astype(np.float32)[None]


def _build_clip_rows(
    clip: Clip, rig: Rig, rest: list[NDArray[np.float64]], order: NDArray[np.intp], has_scale: bool, has_shear: bool
) -> Floats:
    """Return the table rows of a clip, float32[F, W]. Joints that the clip does not animate have the rest pose."""
    count = clip.sample_count
    if count < 1 or not clip.rate > 0:
        raise ValueError(f"clip `{clip.name}` must have at least one sample, and a rate above 0")
    clip_parts = [clip.translation, clip.rotation, *([clip.scale] if has_scale else []), *([clip.shear] if has_shear else [])]
    expected_shapes = [(count, len(clip.joints), width) for width in (3, 4, 3, 3)]
    rig_parts = [np.repeat(part[None], count, 0) for part in rest]
    numbers = {name: number for number, name in enumerate(rig.names)}
    known = [(place, numbers[name]) for place, name in enumerate(clip.joints) if name in numbers]
    clip_joints, rig_joints = (
        (np.array(side, np.intp) for side in zip(*known, strict=True)) if known else (np.zeros(0, np.intp),) * 2
    )
    for place, part in enumerate(clip_parts):
        if part is None:
            rig_parts[place][:, :, rig_joints] = 0  # a clip without shear has shear 0
            continue
        if clip.joints and part.shape != expected_shapes[place]:
            raise ValueError(f"clip `{clip.name}` has an array {part.shape}, but needs {expected_shapes[place]}")
        if known:
            rig_parts[place][:, :, rig_joints] = np.moveaxis(part.astype(np.float64)[:, clip_joints], 2, 1)
    rig_parts[1] = _align_signs(normalise_quaternions(np.moveaxis(rig_parts[1], 1, 0)), rest[1])
    values = np.repeat(rig.channel_defaults[None], count, 0)
    names = {each.name: number for number, each in enumerate(rig.channels)}
    for place, name in enumerate(clip.channels):
        if name in names:
            values[:, names[name]] = clip.values[:, place]
    rows = [part[:, :, order].reshape(count, -1) for part in rig_parts]
    return np.concatenate([*rows, values], axis=1).astype(np.float32)


def _align_signs(rotation: NDArray[np.float64], rest: NDArray[np.float64]) -> NDArray[np.float64]:
    """Choose the signs of quaternions [4, F, J] so that they change continuously from sample to sample. Return them as [F, 4,
    J].

    Each sample gets the sign that is closer to the previous sample. The first sample gets the sign that is closer to `rest` [4,
    J]. So interpolation takes the shorter path without a test, and signs rarely differ between clips."""
    previous_rotation = np.concatenate([rest[:, None], rotation[:, :-1]], 1)
    near = previous_rotation * rotation
    dots = ((near[0] + near[1]) + near[2]) + near[3]
    sign = np.cumprod(np.where(dots < 0, -1.0, 1.0), axis=0)
    return np.moveaxis(rotation * sign, 0, 1)
