"""Poses of many agents: clips sampled at a time of each agent's own, and the local and world transforms that follow.

Between two samples translations, scales, shears and channels go linearly. Rotations do too, by the shorter way, and are made unit
again (nlerp): it needs no sine, so that all processors give the same bits, and it is the one way that also blends many clips
without an order among them. Slerp, which two rotations only have, turns at a constant speed; for samples 10 degrees apart the two
differ by 0.0013 degrees at most, for 90 degrees apart by 0.92, so a reader of keys that lie far apart samples them by slerp.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.affine import Floats, composed, inverse_transposed, normalised, times
from antdsl.bodies.agents.clip_table import ClipTable


@dataclass(slots=True, eq=False)
class Pose:
    """Local poses of n agents, one array a component: `translation` float32[3, J, n], `rotation` [4, J, n] (unit, x y z w),
    `scale` and `shear` [3, J, n] or None for 1 and 0, joints in the order of a `ClipTable`; `channels` float32[C, n]."""

    translation: Floats
    rotation: Floats
    scale: Floats | None
    shear: Floats | None
    channels: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """Transforms and channel values of n agents, joints and channels in the order of the rig.

    `world` and `local` float32[n, J, 3, 4]: the upper three rows of the matrix of each joint, in the space of its agent and in
    that of its parent; the fourth is 0 0 0 1. `channels` float32[n, C]. The arrays are views of memory in which a component of a
    joint lies agent by agent ([3, 4, J, n]), which is how they are worked on; `numpy.ascontiguousarray` puts agents apart."""

    world: Floats
    local: Floats | None
    channels: Floats


def sampled(table: ClipTable, clips: NDArray[np.integer], times: NDArray[np.floating]) -> Pose:
    """The pose of each of n agents in a clip of its own, int[n], at a time of its own in seconds, [n].

    A clip that loops begins again when it is over, before time 0 too; any other holds its first and its last sample. Clip -1 is
    the rest pose. A time that is not finite is 0. Raises IndexError for the number of no clip."""
    row, after, share = _places(table, clips, times)
    if not len(table.order) + len(table.rig.channels):
        return _pose(table, np.empty((0, len(row)), np.float32))
    found = table.samples.take(row, axis=0)
    step = table.samples.take(after, axis=0)
    step -= found
    step *= share[:, None]
    found += step
    turned = np.empty(found.shape[::-1], np.float32)
    turned[:] = found.T
    pose = _pose(table, turned)
    normalised(pose.rotation)
    return pose


def rest_pose(table: ClipTable, count: int) -> Pose:
    """The rest pose for so many agents, as arrays that are not to be written to."""
    pose = _pose(table, np.broadcast_to(table.samples[0][:, None], (table.samples.shape[1], 1)).copy())
    normalised(pose.rotation)
    wide = [None if a is None else np.broadcast_to(a, (*a.shape[:-1], count)) for a in (pose.scale, pose.shear)]
    return Pose(
        np.broadcast_to(pose.translation, (*pose.translation.shape[:-1], count)),
        np.broadcast_to(pose.rotation, (*pose.rotation.shape[:-1], count)),
        wide[0], wide[1], np.broadcast_to(pose.channels, (len(pose.channels), count)),
    )  # fmt: skip


def transforms(table: ClipTable, pose: Pose) -> tuple[Floats, Floats]:
    """Local and world matrices of poses, float32[3, 4, J, n] each, joints in the order of the table."""
    shape = (3, 4, *pose.rotation.shape[1:])
    local = composed(pose.translation, pose.rotation, pose.scale, pose.shear, np.empty(shape, np.float32))
    return local, _placed(table, local)


def world_transforms(table: ClipTable, local: Floats) -> Floats:
    """World transforms float32[n, J, 3, 4] that follow from local ones, joints in the order of the rig: for transforms that are
    not a clip's, such as those of legs that were bent to reach the ground, or of a head that looks at something."""
    found = np.empty((3, 4, local.shape[1], len(local)), np.float32)
    found[:, :, table.order] = _placed(table, local.transpose(2, 3, 1, 0)[:, :, table.order])
    return found.transpose(3, 2, 0, 1)


def local_transforms(table: ClipTable, world: Floats) -> Floats:
    """Local transforms float32[n, J, 3, 4] that world ones stand for, joints in the order of the rig: the inverse of each
    parent's times the joint's own. What a parent that is scaled to nothing had for its children cannot be told."""
    placed = world.transpose(2, 3, 1, 0)
    found = np.array(placed, np.float32)
    children = np.flatnonzero(np.asarray(table.rig.parents) >= 0)
    above = placed[:, :, np.asarray(table.rig.parents)[children]]
    back = np.empty(above.shape, np.float32)
    back[:, :3] = inverse_transposed(above).transpose(1, 0, 2, 3)
    for r in range(3):
        back[r, 3] = -((back[r, 0] * above[0, 3] + back[r, 1] * above[1, 3]) + back[r, 2] * above[2, 3])
    found[:, :, children] = times(back, placed[:, :, children], np.empty(above.shape, np.float32))
    return found.transpose(3, 2, 0, 1)


def square(matrices: Floats) -> Floats:
    """Matrices float32[…, 4, 4] of such of three rows, agents apart in memory: for column vectors, as everywhere here."""
    found = np.zeros((*matrices.shape[:-2], 4, 4), np.float32)
    found[..., :3, :] = matrices
    found[..., 3, 3] = 1
    return found


def _placed(table: ClipTable, local: Floats) -> Floats:
    """World matrices [3, 4, J, n] of local ones, joints in the order of the table: depth by depth of the rig, each joint's is
    its parent's times its own."""
    world = np.empty(local.shape, np.float32)
    for begin, end, parents in table.levels:
        if not len(parents):
            world[:, :, begin:end] = local[:, :, begin:end]
        else:
            times(world[:, :, parents], local[:, :, begin:end], world[:, :, begin:end])
    return world


def _places(
    table: ClipTable, clips: NDArray[np.integer], times: NDArray[np.floating]
) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats]:
    """The rows of the samples before and after each agent's time, and how far it is from the one to the other."""
    clip = np.asarray(clips, np.int64) + 1
    if ((clip < 0) | (clip >= len(table.counts))).any():
        raise IndexError(f"clips are numbered from 0 to {len(table.names) - 1}, and -1 for none")
    last = table.counts[clip] - 1
    at = np.asarray(times, np.float64) * table.rates[clip]
    at = np.where(np.isfinite(at), at, 0.0)
    turn = np.where(last > 0, last, 1).astype(np.float64)
    at = np.where(table.loops[clip], at - np.floor(at / turn) * turn, at)
    at = np.minimum(np.maximum(at, 0.0), last)
    before = np.minimum(np.floor(at), np.maximum(last - 1, 0))
    row = table.first[clip] + before.astype(np.int64)
    return row, np.minimum(row + 1, table.first[clip] + last), (at - before).astype(np.float32)


def _pose(table: ClipTable, rows: Floats) -> Pose:
    """The parts of rows [W, n] of a table."""
    joints, n = len(table.order), rows.shape[1]
    at, parts = 0, []
    for width in (3, 4, *([3] if table.scaled else []), *([3] if table.sheared else [])):
        parts.append(rows[at : at + width * joints].reshape(width, joints, n))
        at += width * joints
    scale = parts[2] if table.scaled else None
    shear = parts[-1] if table.sheared else None
    return Pose(parts[0], parts[1], scale, shear, rows[at:])
