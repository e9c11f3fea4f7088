"""Deformers by name: what makes a shape of the library follow the transforms and channel values of n agents.

`DEFORMERS` has the document's: `linearskinning`, `dualquatskinning`, `dualquatblendskinning` and `blendshape`. Names joined by
`+` are applied one after the other (`blendshape+linearskinning`), any that there are. `register` adds one's own. A binding
without a deformer is a static shape, which the joint it is bound to carries about as it is.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from antdsl.bodies.agents.affine import inverse_transposed
from antdsl.bodies.agents.blend_shapes import blend_shapes
from antdsl.bodies.agents.definition import Binding, Definition, Shape
from antdsl.bodies.agents.poses import Poses
from antdsl.bodies.agents.skinning import Deformed, apply, dual_quaternion, dual_quaternion_blend, linear, unit
from antdsl.numerics.float_environment import standard

_PART = 1 << 15  # points of agents worked on at once


class Deformer(Protocol):
    """A function of a shape as it is so far (the shape of the library at first, for all agents alike: n is 1), the shape of the
    library, the definition that it belongs to, and the poses of n agents. It gives the shape for each of these agents, and
    changes nothing of what it is given. It is called with some of the agents at a time; what it gives for one must not depend on
    who else is there."""

    def __call__(self, given: Deformed, shape: Shape, definition: Definition, poses: Poses) -> Deformed: ...


DEFORMERS: dict[str, Deformer] = {
    "linearskinning": linear,
    "dualquatskinning": dual_quaternion,
    "dualquatblendskinning": dual_quaternion_blend,
    "blendshape": blend_shapes,
}


SKINNING = (linear, dual_quaternion, dual_quaternion_blend)  # what moves a shape by the joints of its own points


def register(name: str, deformer: Deformer) -> None:
    """Add a deformer by a name that bindings then use. Raises ValueError for a name that is taken, empty, or has a `+`."""
    if not name or "+" in name or name in DEFORMERS:
        raise ValueError(f"`{name}` is no name for a deformer: it is empty, has a `+`, or is one of {', '.join(DEFORMERS)}")
    DEFORMERS[name] = deformer


def steps(name: str) -> tuple[Deformer, ...]:
    """The deformers of a name, in the order in which they are applied. Raises KeyError with those that there are."""
    missing = [part for part in name.split("+") if part not in DEFORMERS]
    if missing:
        raise KeyError(f"there is no deformer `{missing[0]}`; there are {', '.join(DEFORMERS)}, and these joined by `+`")
    return tuple(DEFORMERS[part] for part in name.split("+"))


def bound(definition: Definition, binding: Binding, poses: Poses) -> Deformed:
    """The shape of a binding for each of n agents, in the space of the agent: deformed, and carried by its joint unless it
    follows joints by its own points.

    Raises KeyError for a shape, joint or deformer that there is not, and what its deformers raise."""
    shape = definition.shapes[binding.shape]
    n = len(poses.world)
    named = shape.blend.attributes if shape.blend else ()
    further = {name: values[None].astype(np.float32) for name, values in shape.attributes.items() if name in named}
    rest = Deformed(shape.points[None], None if shape.normals is None else shape.normals[None], further)
    chain = steps(binding.deformer) if binding.deformer else ()
    if binding.transform and not any(step in SKINNING for step in chain):
        chain = (*chain, _carried(binding))
    points = np.empty((n, *shape.points.shape), np.float32)
    normals = None if shape.normals is None else np.empty(points.shape, np.float32)
    others = {name: np.empty((n, *values.shape[1:]), np.float32) for name, values in rest.attributes.items()}
    part = max(16, _PART // max(1, len(shape.points)))
    for a in range(0, n, part):
        some = slice(a, min(a + part, n))
        local = None if poses.local is None else poses.local[some]
        here, found = Poses(poses.world[some], local, poses.channels[some]), rest
        with standard():
            for step in chain:
                found = step(found, shape, definition, here)
        points[some] = found.points
        if normals is not None and found.normals is not None:
            normals[some] = found.normals
        for name, into in others.items():
            into[some] = found.attributes[name].reshape(-1, *into.shape[1:])
    return Deformed(points, normals, others)


def _carried(binding: Binding) -> Deformer:
    """The step that moves a shape by its joint alone."""

    def carried(given: Deformed, shape: Shape, definition: Definition, poses: Poses) -> Deformed:
        joint = definition.rig.joint(binding.transform)
        matrices = poses.world[:, joint].transpose(1, 2, 0)[:, :, None]
        points = apply(matrices, given.points).transpose(2, 1, 0)
        if given.normals is None:
            return Deformed(points, None, given.attributes)
        across = apply(inverse_transposed(matrices), given.normals)
        return Deformed(points, unit(across).transpose(2, 1, 0), given.attributes)

    return carried
