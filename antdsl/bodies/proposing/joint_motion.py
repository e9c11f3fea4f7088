"""Joints of a body over the samples of its clips, and its points in one pose. All are in the definition's own space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.definition import Definition
from antdsl.bodies.agents.deformers import deform_binding
from antdsl.bodies.agents.poses import REST_CLIP, Poses, build_clip_table, compute_transforms, sample_poses
from antdsl.bodies.posed_body import find_base_layer

Floats = NDArray[np.float64]
_MAX_SAMPLES = 1200  # maximum number of examined samples of a clip
_CYCLE_STEPS = 3  # times the longest step; a longer step from the last pose to the first is a jump
_CLOSED_SHARE = 1e-3  # share of the body's extent; a last pose nearer to the first repeats it


def sample_worlds(body: Definition, clip: str, times: Floats) -> NDArray[np.float32]:
    """Return world matrices of joints, float32[n, J, 3, 4], joints in the order of the rig. `clip`: "" for the rest pose."""
    table = build_clip_table(body)
    number = table.find_clip(clip) if clip else REST_CLIP
    worlds = compute_transforms(table, sample_poses(table, np.full(len(times), number), times))[1]
    ordered = np.empty_like(worlds)
    ordered[:, :, table.joint_order] = worlds
    return ordered.transpose(3, 2, 0, 1)


@dataclass(frozen=True, slots=True, eq=False)
class ClipMotion:
    """Joints over one cycle of a clip.

    `worlds` float32[F, J, 3, 4]: their world matrices. `step`: seconds between samples.
    `repeats_first_pose`: the last pose of the clip repeats the first; it is left out here.
    `is_cyclic`: the last pose leads to the first, in a step about as long as the others."""

    name: str
    worlds: NDArray[np.float32]
    step: float
    repeats_first_pose: bool
    is_cyclic: bool

    @property
    def seconds(self) -> float:
        """Return the duration of the cycle."""
        return len(self.worlds) * self.step


def clip_motion(body: Definition, name: str, extent: float) -> ClipMotion:
    """Return the motion of a clip. `extent`: the size of the body. Long clips are examined at fewer samples."""
    clip = body.clips[name]
    count = min(max(clip.sample_count, 1), _MAX_SAMPLES)
    times = np.linspace(0.0, clip.duration, count)
    worlds = sample_worlds(body, name, np.minimum(times, clip.duration * (1 - 1e-6)))
    step = clip.duration / max(count - 1, 1)
    positions = worlds[:, :, :, 3].astype(np.float64)
    closes = count > 2 and bool(np.abs(positions[-1] - positions[0]).max() < max(_CLOSED_SHARE * extent, 1e-9))
    gap = float(np.abs(positions[-1] - positions[0]).max())
    longest = float(np.abs(np.diff(positions, axis=0)).max(initial=0.0))
    return ClipMotion(name, worlds[:-1] if closes else worlds, step, closes, closes or gap <= _CYCLE_STEPS * longest)


@dataclass(frozen=True, slots=True, eq=False)
class BodyPoints:
    """The points of the drawn layer in one pose: `place` float64[P, 3].

    `joint` int[P]: the joint that each follows most, or -1."""

    place: Floats
    joint: NDArray[np.intp]


def posed_points(body: Definition, worlds: NDArray[np.float32]) -> BodyPoints:
    """Return the points of a body. `worlds`: the matrices of its joints in one pose, [J, 3, 4]."""
    poses = Poses(worlds[None], None, np.asarray(body.rig.channel_defaults, np.float32)[None])
    positions, joints = [np.zeros((0, 3))], [np.zeros(0, np.intp)]
    layer = find_base_layer(body)
    for binding in (*layer.static, *layer.deforming):
        shape = body.shapes[binding.shape]
        points = np.asarray(deform_binding(body, binding, poses).points[0], np.float64)
        if shape.capture is not None and binding.deformer not in ("", "blendshape"):
            numbers = np.array([body.rig.joint(name) for name in shape.capture.names], np.intp)
            strongest = shape.capture.weights.argmax(axis=1)
            joint = numbers[np.take_along_axis(shape.capture.joints, strongest[:, None], axis=1)[:, 0]]
        else:
            joint = np.full(len(points), body.rig.joint(binding.transform) if binding.transform else -1, np.intp)
        positions.append(points)
        joints.append(joint)
    return BodyPoints(np.concatenate(positions), np.concatenate(joints))
