"""Converts an agent definition for graphics hardware: to one mesh in which each vertex follows up to four bones.

Blend shapes become morph targets with a weight for each agent."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.affine import Floats
from antdsl.bodies.agents.blend_shapes import (
    apply_blend_shapes,
    compute_attribute_offsets,
    compute_knot_shares,
    list_blend_knots,
    match_points,
)
from antdsl.bodies.agents.definition import Binding, Clip, Definition, Rig, SkinShape, SkinWeights
from antdsl.bodies.agents.deformers import SKINNING_DEFORMERS, find_deformers
from antdsl.bodies.agents.transforms import compute_world_matrices

MAX_JOINTS_PER_VERTEX = 4  # most joints that a vertex follows
NO_JOINT_NUMBER = -1  # the joint of a bone that does not move in agent space
_EQUAL_MATRIX_TOLERANCE = 1e-4  # relative to the largest entry; matrices that differ less share a bone
_SINGULAR_DETERMINANT = 1e-9  # matrices with a smaller determinant count as singular
Matrix = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class SkinnedMesh:
    """A mesh for linear skinning, with v vertices and B bones.

    `points` and `normals`: float32[v, 3] in the rest pose, in the definition's units.
    `bones`: int32[v, 4], the bones that each vertex follows.
    `weights`: float32[v, 4], the weights of these bones, which add up to 1.
    `bone_joints`: int32[B], the number of each bone's joint in the rig.
    `inverse_matrices`: float32[B, 3, 4], from the space of the rest pose to the space of each bone."""

    points: NDArray[np.float32]
    normals: NDArray[np.float32]
    bones: NDArray[np.int32]
    weights: NDArray[np.float32]
    bone_joints: NDArray[np.int32]
    inverse_matrices: NDArray[np.float32]


def build_skinned_mesh(definition: Definition, bindings: Sequence[Binding], vertex_points: NDArray[np.integer]) -> SkinnedMesh:
    """Return the skinned mesh of the given bindings, with shapes that have normals.

    `vertex_points`: int[v], the point of each vertex, as an index into the points of all bindings in sequence.

    A static shape follows only its joint. If a point of another shape follows more than four joints, the four with the largest
    weights are used. Other deformers are replaced by linear skinning. Blend shapes have their base shape;
    `compute_blend_targets` returns the offsets from it."""
    bone_table = _BoneTable(definition)
    parts = [
        (_build_skinned_part if _is_skinned(each) else _build_static_part)(definition, each, bone_table) for each in bindings
    ]
    none = np.zeros((0, 3), np.float32)
    fours = np.zeros((0, MAX_JOINTS_PER_VERTEX), np.float32)
    return SkinnedMesh(
        np.concatenate([none, *(each.points for each in parts)]).astype(np.float32)[vertex_points],
        np.concatenate([none, *(each.normals for each in parts)]).astype(np.float32)[vertex_points],
        np.concatenate([fours.astype(np.int32), *(each.bones for each in parts)])[vertex_points],
        np.concatenate([fours, *(each.weights for each in parts)])[vertex_points],
        np.array(bone_table.joints, np.int32),
        np.array([each[:3] for each in bone_table.inverses], np.float32).reshape(-1, 3, 4),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _MeshPart:
    """The vertices of one binding: points, normals, bones and weights, as in `SkinnedMesh`."""

    points: NDArray[np.floating]
    normals: NDArray[np.floating]
    bones: NDArray[np.int32]
    weights: NDArray[np.float32]


class _BoneTable:
    """The bones that were requested so far. Each bone is stored once."""

    def __init__(self, definition: Definition) -> None:
        self.rest = compute_world_matrices(definition.rig.parents, definition.rig.rest_matrices)
        self.joints: list[int] = []
        self.inverses: list[Matrix] = []

    def get_bone_number(self, joint: int, inverse_matrix: Matrix) -> int:
        """Return the number of the bone with this joint and inverse matrix. If there is no such bone, add it."""
        for number, (other, known) in enumerate(zip(self.joints, self.inverses, strict=True)):
            if other == joint and np.abs(known - inverse_matrix).max() <= _EQUAL_MATRIX_TOLERANCE * max(
                1.0, float(np.abs(inverse_matrix[:, :3]).max())
            ):
                return number
        self.joints.append(joint)
        self.inverses.append(inverse_matrix)
        return len(self.joints) - 1


def _is_skinned(binding: Binding) -> bool:
    """Return whether a binding has a skinning deformer, so that its points follow several joints."""
    return bool(binding.deformer) and any(step in SKINNING_DEFORMERS for step in find_deformers(binding.deformer))


def _build_static_part(definition: Definition, binding: Binding, bone_table: _BoneTable) -> _MeshPart:
    """Return the vertices of a static shape, at the position of its joint in the rest pose.

    Because of this position, the shape can share a bone with shapes that are skinned to the joint."""
    shape = definition.shapes[binding.shape]
    points, normals = shape.points.astype(np.float64), _get_normals_or_zeros(shape).astype(np.float64)
    bones = np.zeros((len(points), MAX_JOINTS_PER_VERTEX), np.int32)
    weights = np.zeros((len(points), MAX_JOINTS_PER_VERTEX), np.float32)
    weights[:, 0] = 1
    joint, inverse = NO_JOINT_NUMBER, np.eye(4)
    if binding.transform:
        joint = definition.rig.find_joint(binding.transform)
        rest = bone_table.rest[joint]
        if abs(np.linalg.det(rest[:3, :3])) > _SINGULAR_DETERMINANT:
            inverse = np.linalg.inv(rest)
            points = points @ rest[:3, :3].T + rest[:3, 3]
            normals = normals @ inverse[:3, :3]
            normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20)
    bones[:] = bone_table.get_bone_number(joint, inverse)
    return _MeshPart(points, normals, bones, weights)


def _build_skinned_part(definition: Definition, binding: Binding, bone_table: _BoneTable) -> _MeshPart:
    """Return the vertices of a shape in which each point follows its own joints."""
    shape = definition.shapes[binding.shape]
    capture = shape.capture
    if capture is None:
        raise ValueError(f"shape `{shape.name}` has no capture weights, so its points cannot follow joints")
    number = np.array(
        [
            bone_table.get_bone_number(definition.rig.find_joint(name), capture.inverse_matrices[k])
            for k, name in enumerate(capture.names)
        ],
        np.int32,
    )
    joints, weights = _select_strongest_joints(capture)
    return _MeshPart(shape.points, _get_normals_or_zeros(shape), number[joints], weights)


def _select_strongest_joints(capture: SkinWeights) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Return, for each point, the joints with the largest weights, at most four, and these weights."""
    joints, weights = capture.joints, capture.weights
    if joints.shape[1] < MAX_JOINTS_PER_VERTEX:
        wide = ((0, 0), (0, MAX_JOINTS_PER_VERTEX - joints.shape[1]))
        return np.pad(joints, wide).astype(np.int32), np.pad(weights, wide).astype(np.float32)
    most = np.argsort(-weights, axis=1, kind="stable")[:, :MAX_JOINTS_PER_VERTEX]
    top_weights = np.take_along_axis(weights, most, axis=1)
    total = top_weights.sum(axis=1, keepdims=True)
    return np.take_along_axis(joints, most, axis=1).astype(np.int32), (top_weights / np.where(total > 0, total, 1)).astype(
        np.float32
    )


def _get_normals_or_zeros(shape: SkinShape) -> NDArray[np.float32]:
    """Return the normals of a shape, or zeros if it has none."""
    return np.zeros_like(shape.points) if shape.normals is None else shape.normals


@dataclass(frozen=True, slots=True)
class BlendTarget:
    """One shape of a blend-shape input: its primary shape or an in-between.

    `channel`: the channel that weights the input.
    `knots`: the weights at which the input's shapes apply in full.
    `knot_index`: the index of this shape in `knots`.
    """

    channel: str
    knots: tuple[float, ...]
    knot_index: int


def compute_blend_targets(
    definition: Definition, bindings: Sequence[Binding], vertex_points: NDArray[np.integer]
) -> dict[BlendTarget, NDArray[np.float32]]:
    """Return, for each target, the offsets that it adds to the rest pose of a skinned mesh at the weight 1.

    The offsets are float32[v, 6]: three numbers for the point and three for the normal. Only shapes with blending as their first
    deformer have targets. `vertex_points`: int[v], the point of each vertex, as an index into the points of all bindings in
    sequence."""
    sizes = [len(definition.shapes[each.shape].points) for each in bindings]
    starts = np.cumsum([0, *sizes])
    offsets_by_target: dict[BlendTarget, NDArray[np.float32]] = {}
    rest = compute_world_matrices(definition.rig.parents, definition.rig.rest_matrices)
    for start, binding in zip(starts, bindings, strict=False):
        shape, chain = definition.shapes[binding.shape], find_deformers(binding.deformer) if binding.deformer else ()
        if shape.blend is None or chain[:1] != (apply_blend_shapes,):
            continue
        carried = binding.transform and not any(step in SKINNING_DEFORMERS for step in chain)
        turn = rest[definition.rig.find_joint(binding.transform)][:3, :3] if carried else np.eye(3)
        for target, rows, offsets in _compute_target_offsets(definition, shape, turn):
            target_offsets = offsets_by_target.setdefault(target, np.zeros((int(starts[-1]), 6), np.float32))
            target_offsets[start + rows] += offsets
    return {target: offsets[vertex_points] for target, offsets in offsets_by_target.items()}


def _compute_target_offsets(
    definition: Definition, shape: SkinShape, rotation: NDArray[np.float64]
) -> list[tuple[BlendTarget, NDArray[np.intp], NDArray[np.float64]]]:
    """Return the targets of a shape, each with the indices of the points that it moves and their offsets, rotated by
    `rotation`."""
    blend = shape.blend
    assert blend is not None
    target_offsets = []
    for name, channel in zip(blend.shapes, blend.channels, strict=True):
        targets, knots = list_blend_knots(definition, name)
        for place, target in enumerate(targets):
            base_points, target_points = match_points(shape, target, blend.point_id)
            offsets = np.zeros((len(base_points), 6))
            for first, attribute, values in ((0, "P", target.points), (3, "N", target.normals)):
                if attribute in blend.attributes and values is not None:
                    offsets[:, first : first + 3] = (
                        compute_attribute_offsets(shape, target, attribute, base_points, target_points).T @ rotation.T
                    )
            target_offsets.append((BlendTarget(channel, tuple(knots), place), base_points, offsets))
    return target_offsets


def compute_target_weights(targets: Sequence[BlendTarget], rig: Rig, channels: Floats) -> Floats:
    """Return the weights float32[n, K] of K targets for n agents. `channels`: float32[n, C]."""
    weights = np.zeros((len(channels), len(targets)), np.float32)
    for k, target in enumerate(targets):
        weights[:, k] = compute_knot_shares(channels[:, rig.find_channel(target.channel)], np.array(target.knots))[
            target.knot_index
        ]
    return weights


def reduce_to_channels(definition: Definition) -> Definition:
    """Return the definition reduced to its channels: one static joint, and clips with channel values only. Its poses have the
    same channel values as the poses of the complete definition."""

    def reduce_clip(clip: Clip) -> Clip:
        empty = np.zeros((clip.sample_count, 0, 3), np.float32)
        return replace(
            clip, joints=(), translation=empty, rotation=np.zeros((clip.sample_count, 0, 4), np.float32), scale=empty, shear=None
        )

    channels = tuple(replace(each, transform="") for each in definition.rig.channels)
    rig = Rig(("still",), np.array([-1], np.int32), np.eye(4)[None], channels)
    groups = {name: replace(group, members=()) for name, group in definition.groups.items()}
    return replace(definition, rig=rig, clips={name: reduce_clip(clip) for name, clip in definition.clips.items()}, groups=groups)
