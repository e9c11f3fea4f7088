"""Deformers by name: functions that make a shape of the library follow the transforms and channel values of n agents.

`DEFORMER_BY_NAME` has those of Houdini's documentation: `linearskinning`, `dualquatskinning`, `dualquatblendskinning` and
`blendshape`. Any names can be joined by `+` (`blendshape+linearskinning`); the deformers are then applied in sequence.
`register_deformer` adds a deformer. A binding without a deformer is a static shape that moves rigidly with its joint.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from antdsl.bodies.agents.affine import invert_and_transpose
from antdsl.bodies.agents.blend_shapes import apply_blend_shapes
from antdsl.bodies.agents.definition import Binding, Definition, SkinShape
from antdsl.bodies.agents.poses import WorldPoses
from antdsl.bodies.agents.skinning import (
    DeformedShape,
    apply_dual_quaternion_skinning,
    apply_linear_skinning,
    blend_skinning_methods,
    normalise_in_place,
    transform_points,
)
from antdsl.numerics.processor.float_environment import use_standard_floats

_POINTS_PER_CHUNK = 1 << 15  # points per chunk, over all agents


class Deformer(Protocol):
    """A function that deforms a shape.

    Its arguments are the current shape, the library shape, the definition, and the poses of n agents. It returns the shape for
    each agent, and does not modify its arguments. For the first deformer, the current shape is the library shape, shared by all
    agents (n is 1). Deformers are called for subsets of agents, so the result for one agent must not depend on the others.
    """

    def __call__(
        self, deformed_shape: DeformedShape, shape: SkinShape, definition: Definition, poses: WorldPoses
    ) -> DeformedShape: ...


DEFORMER_BY_NAME: dict[str, Deformer] = {
    "linearskinning": apply_linear_skinning,
    "dualquatskinning": apply_dual_quaternion_skinning,
    "dualquatblendskinning": blend_skinning_methods,
    "blendshape": apply_blend_shapes,
}


# deformers that move a shape by the joints that its points follow
SKINNING_DEFORMERS = (apply_linear_skinning, apply_dual_quaternion_skinning, blend_skinning_methods)


def register_deformer(name: str, deformer: Deformer) -> None:
    """Add a deformer that bindings can use by its name. Raises ValueError if the name exists, is empty, or contains `+`."""
    if not name or "+" in name or name in DEFORMER_BY_NAME:
        raise ValueError(
            f"`{name}` cannot be the name of a deformer: it is empty, has a `+`, or is one of {', '.join(DEFORMER_BY_NAME)}"
        )
    DEFORMER_BY_NAME[name] = deformer


def find_deformers(name: str) -> tuple[Deformer, ...]:
    """Return the deformers of a name such as `blendshape+linearskinning`, in the order of application. Raises KeyError for an
    unknown deformer; the message lists the existing names."""
    missing = [part for part in name.split("+") if part not in DEFORMER_BY_NAME]
    if missing:
        raise KeyError(
            f"there is no deformer `{missing[0]}`; use one of {', '.join(DEFORMER_BY_NAME)}, or several of them joined by `+`"
        )
    return tuple(DEFORMER_BY_NAME[part] for part in name.split("+"))


def deform_binding(definition: Definition, binding: Binding, poses: WorldPoses) -> DeformedShape:
    """Return the shape of a binding, deformed for each of n agents.

    A shape that no skinning deformer moves follows the binding's joint rigidly. Raises KeyError for a missing shape, joint or
    deformer, and the errors of the deformers."""
    shape = definition.shapes[binding.shape]
    n = len(poses.world_transforms)
    named = shape.blend.attributes if shape.blend else ()
    further = {name: values[None].astype(np.float32) for name, values in shape.attributes.items() if name in named}
    rest = DeformedShape(shape.points[None], None if shape.normals is None else shape.normals[None], further)
    chain = find_deformers(binding.deformer) if binding.deformer else ()
    if binding.transform and not any(step in SKINNING_DEFORMERS for step in chain):
        chain = (*chain, _build_rigid_deformer(binding))
    points = np.empty((n, *shape.points.shape), np.float32)
    normals = None if shape.normals is None else np.empty(points.shape, np.float32)
    others = {name: np.empty((n, *values.shape[1:]), np.float32) for name, values in rest.attributes.items()}
    part = max(16, _POINTS_PER_CHUNK // max(1, len(shape.points)))
    for a in range(0, n, part):
        rows = slice(a, min(a + part, n))
        local = None if poses.local_transforms is None else poses.local_transforms[rows]
        part_poses, deformed = WorldPoses(poses.world_transforms[rows], local, poses.channels[rows]), rest
        with use_standard_floats():
            for step in chain:
                deformed = step(deformed, shape, definition, part_poses)
        points[rows] = deformed.points
        if normals is not None and deformed.normals is not None:
            normals[rows] = deformed.normals
        for name, into in others.items():
            into[rows] = deformed.attributes[name].reshape(-1, *into.shape[1:])
    return DeformedShape(points, normals, others)


def _build_rigid_deformer(binding: Binding) -> Deformer:
    """Return a deformer that moves a shape rigidly with the binding's joint."""

    def carry_shape(deformed_shape: DeformedShape, shape: SkinShape, definition: Definition, poses: WorldPoses) -> DeformedShape:
        joint = definition.rig.find_joint(binding.transform)
        matrices = poses.world_transforms[:, joint].transpose(1, 2, 0)[:, :, None]
        points = transform_points(matrices, deformed_shape.points).transpose(2, 1, 0)
        if deformed_shape.normals is None:
            return DeformedShape(points, None, deformed_shape.attributes)
        across = transform_points(invert_and_transpose(matrices), deformed_shape.normals)
        return DeformedShape(points, normalise_in_place(across).transpose(2, 1, 0), deformed_shape.attributes)

    return carry_shape
