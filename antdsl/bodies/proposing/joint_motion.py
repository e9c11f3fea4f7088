"""Measures the joints of a body over the samples of its clips, and its points in one pose, all in the definition's own space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.definition import Definition
from antdsl.bodies.agents.deformers import deform_binding
from antdsl.bodies.agents.poses import REST_CLIP, WorldPoses, build_clip_table, compute_transforms, sample_poses
from antdsl.bodies.posed_body import find_base_layer

Floats = NDArray[np.float64]
_MAX_SAMPLES = 1200  # maximum number of examined samples of a clip
_MAX_CLOSING_STEP_RATIO = 3  # times the longest step; a longer step from the last pose to the first is a jump
_MAX_CLOSED_GAP_SHARE = 1e-3  # share of the body's extent; a last pose nearer to the first repeats it


def sample_world_transforms(body: Definition, clip: str, times: Floats) -> NDArray[np.float32]:
    """Return the world matrices of joints at n times of a clip, float32[n, J, 3, 4], with joints in the order of the rig.

    `clip`: "" for the rest pose. `times`: seconds."""
    table = build_clip_table(body)
    number = table.find_clip(clip) if clip else REST_CLIP
    worlds = compute_transforms(table, sample_poses(table, np.full(len(times), number), times))[1]
    ordered = np.empty_like(worlds)
    ordered[:, :, table.joint_order] = worlds
    return ordered.transpose(3, 2, 0, 1)


@dataclass(frozen=True, slots=True, eq=False)
class ClipMotion:
    """The motion of joints over one cycle of a clip.

    `worlds`: float32[F, J, 3, 4], the world matrices of joints.
    `sample_interval`: seconds between samples.
    `repeats_first_pose`: whether the clip's last pose repeats its first pose. If so, `worlds` does not contain the last pose.
    `is_cyclic`: whether the step from the last pose to the first is about as long as the other steps."""

    name: str
    worlds: NDArray[np.float32]
    sample_interval: float
    repeats_first_pose: bool
    is_cyclic: bool

    @property
    def seconds(self) -> float:
        """Return the duration of the cycle."""
        return len(self.worlds) * self.sample_interval


def measure_clip_motion(body: Definition, name: str, extent: float) -> ClipMotion:
    """Return the motion of the clip `name`. A long clip is sampled at a limited number of times.

    `extent`: the size of the body, in the definition's units."""
    clip = body.clips[name]
    count = min(max(clip.sample_count, 1), _MAX_SAMPLES)
    times = np.linspace(0.0, clip.duration, count)
    worlds = sample_world_transforms(body, name, np.minimum(times, clip.duration * (1 - 1e-6)))
    step = clip.duration / max(count - 1, 1)
    positions = worlds[:, :, :, 3].astype(np.float64)
    closes = count > 2 and bool(np.abs(positions[-1] - positions[0]).max() < max(_MAX_CLOSED_GAP_SHARE * extent, 1e-9))
    gap = float(np.abs(positions[-1] - positions[0]).max())
    longest = float(np.abs(np.diff(positions, axis=0)).max(initial=0.0))
    return ClipMotion(name, worlds[:-1] if closes else worlds, step, closes, closes or gap <= _MAX_CLOSING_STEP_RATIO * longest)


@dataclass(frozen=True, slots=True, eq=False)
class BodyPoints:
    """The points of the drawn layer in one pose.

    `positions`: float64[P, 3], their positions.
    `joint_indices`: int[P], the joint that each point follows most, or -1."""

    positions: Floats
    joint_indices: NDArray[np.intp]


def find_posed_points(body: Definition, worlds: NDArray[np.float32]) -> BodyPoints:
    """Return the points of a body's drawn layer in one pose. `worlds`: the joints' world matrices in this pose, [J, 3, 4]."""
    poses = WorldPoses(worlds[None], None, np.asarray(body.rig.channel_defaults, np.float32)[None])
    positions, joints = [np.zeros((0, 3))], [np.zeros(0, np.intp)]
    layer = find_base_layer(body)
    for binding in (*layer.static, *layer.deforming):
        shape = body.shapes[binding.shape]
        points = np.asarray(deform_binding(body, binding, poses).points[0], np.float64)
        if shape.capture is not None and binding.deformer not in ("", "blendshape"):
            numbers = np.array([body.rig.find_joint(name) for name in shape.capture.names], np.intp)
            strongest = shape.capture.weights.argmax(axis=1)
            joint = numbers[np.take_along_axis(shape.capture.joints, strongest[:, None], axis=1)[:, 0]]
        else:
            joint = np.full(len(points), body.rig.find_joint(binding.transform) if binding.transform else -1, np.intp)
        positions.append(points)
        joints.append(joint)
    return BodyPoints(np.concatenate(positions), np.concatenate(joints))
