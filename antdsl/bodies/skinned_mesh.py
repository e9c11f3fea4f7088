"""The shapes of an agent definition as one mesh whose vertices follow up to four bones each: what graphics hardware draws."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.definition import Binding, Capture, Definition, Shape
from antdsl.bodies.agents.deformers import SKINNING, steps
from antdsl.bodies.agents.transforms import world_matrices

MOST_JOINTS = 4  # that a vertex follows
NO_JOINT = -1  # of a bone that stays where it is in the space of the agent
_ALIKE = 1e-4  # matrices that differ by no more of their largest entry are one bone
_FLAT = 1e-9  # the determinant of what cannot be inverted
Matrix = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class SkinnedMesh:
    """Linear skinning alone: `points` float32[v, 3] and `normals` float32[v, 3] in the rest pose, in the definition's units;
    `bones` int32[v, 4] and `weights` float32[v, 4], which add up to 1. A bone is a joint (`joint` int32[B], by number in the rig)
    and what takes a point of the rest pose into its space (`inverse` float32[B, 3, 4])."""

    points: NDArray[np.float32]
    normals: NDArray[np.float32]
    bones: NDArray[np.int32]
    weights: NDArray[np.float32]
    joint: NDArray[np.int32]
    inverse: NDArray[np.float32]


def skinned_mesh(definition: Definition, bindings: Sequence[Binding], taken: NDArray[np.integer]) -> SkinnedMesh:
    """The mesh of some bindings, whose shapes have normals; `taken` int[v]: which vertices, counted through all of them.

    A static shape follows its joint alone. Of a point that follows more than four joints the four of most weight are kept. Other
    deformers than linear skinning are not applied: dual quaternions become linear, and blend shapes stay as their base is:
    `blend_targets` has what is added to that."""
    found = _Bones(definition)
    parts = [(_captured if _skins(each) else _static)(definition, each, found) for each in bindings]
    none = np.zeros((0, 3), np.float32)
    fours = np.zeros((0, MOST_JOINTS), np.float32)
    return SkinnedMesh(
        np.concatenate([none, *(each.points for each in parts)]).astype(np.float32)[taken],
        np.concatenate([none, *(each.normals for each in parts)]).astype(np.float32)[taken],
        np.concatenate([fours.astype(np.int32), *(each.bones for each in parts)])[taken],
        np.concatenate([fours, *(each.weights for each in parts)])[taken],
        np.array(found.joints, np.int32),
        np.array([each[:3] for each in found.inverses], np.float32).reshape(-1, 3, 4),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    points: NDArray[np.floating]
    normals: NDArray[np.floating]
    bones: NDArray[np.int32]
    weights: NDArray[np.float32]


class _Bones:
    """The bones that were asked for so far, each once."""

    def __init__(self, definition: Definition) -> None:
        self.rest = world_matrices(definition.rig.parents, definition.rig.rest)
        self.joints: list[int] = []
        self.inverses: list[Matrix] = []

    def number(self, joint: int, inverse: Matrix) -> int:
        for number, (other, known) in enumerate(zip(self.joints, self.inverses, strict=True)):
            if other == joint and np.abs(known - inverse).max() <= _ALIKE * max(1.0, float(np.abs(inverse[:, :3]).max())):
                return number
        self.joints.append(joint)
        self.inverses.append(inverse)
        return len(self.joints) - 1


def _skins(binding: Binding) -> bool:
    return bool(binding.deformer) and any(step in SKINNING for step in steps(binding.deformer))


def _static(definition: Definition, binding: Binding, found: _Bones) -> _Part:
    """A shape that a joint carries, moved to where it is in the rest pose, so that it shares the bone of those skinned there."""
    shape = definition.shapes[binding.shape]
    points, normals = shape.points.astype(np.float64), _normals(shape).astype(np.float64)
    bones = np.zeros((len(points), MOST_JOINTS), np.int32)
    weights = np.zeros((len(points), MOST_JOINTS), np.float32)
    weights[:, 0] = 1
    joint, inverse = NO_JOINT, np.eye(4)
    if binding.transform:
        joint = definition.rig.joint(binding.transform)
        rest = found.rest[joint]
        if abs(np.linalg.det(rest[:3, :3])) > _FLAT:
            inverse = np.linalg.inv(rest)
            points = points @ rest[:3, :3].T + rest[:3, 3]
            normals = normals @ inverse[:3, :3]
            normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20)
    bones[:] = found.number(joint, inverse)
    return _Part(points, normals, bones, weights)


def _captured(definition: Definition, binding: Binding, found: _Bones) -> _Part:
    """A shape whose points follow joints of their own."""
    shape = definition.shapes[binding.shape]
    capture = shape.capture
    if capture is None:
        raise ValueError(f"shape `{shape.name}` says for none of its points which joints they follow (capture)")
    number = np.array(
        [found.number(definition.rig.joint(name), capture.inverse[k]) for k, name in enumerate(capture.names)], np.int32
    )
    joints, weights = _four(capture)
    return _Part(shape.points, _normals(shape), number[joints], weights)


def _four(capture: Capture) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """The joints of most weight of each point, and their weights."""
    joints, weights = capture.joints, capture.weights
    if joints.shape[1] < MOST_JOINTS:
        wide = ((0, 0), (0, MOST_JOINTS - joints.shape[1]))
        return np.pad(joints, wide).astype(np.int32), np.pad(weights, wide).astype(np.float32)
    most = np.argsort(-weights, axis=1, kind="stable")[:, :MOST_JOINTS]
    kept = np.take_along_axis(weights, most, axis=1)
    whole = kept.sum(axis=1, keepdims=True)
    return np.take_along_axis(joints, most, axis=1).astype(np.int32), (kept / np.where(whole > 0, whole, 1)).astype(np.float32)


def _normals(shape: Shape) -> NDArray[np.float32]:
    return np.zeros_like(shape.points) if shape.normals is None else shape.normals
