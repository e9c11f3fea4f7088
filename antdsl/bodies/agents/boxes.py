"""Bounding boxes of agents, computed from the shapes of their collision layers, or without these from their current layers.

A static shape's box is scaled by its binding's bounds scale and then transformed by its joint. A deforming shape's box is the
scaled bounding box of the positions of the joints that it follows (Houdini 20.5, Agent Primitives, Bounding Box). A deforming
shape that follows a single joint moves like a static shape. Boxes are scaled about their centre, so the result does not depend on
their position.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.definition import Binding, Definition, SkinShape
from antdsl.bodies.agents.transforms import compose_transforms, compute_world_matrices
from antdsl.scene.geometry.matrices import apply_transforms

Floats = NDArray[Any]  # float32 or float64


def compute_layer_boxes(definition: Definition, worlds: Floats, layers: Sequence[str]) -> tuple[Floats, Floats]:
    """Return one box for each of n agents, around the given layers: its lowest and its highest corner, both [n, 3].

    `worlds` [n, J, 4, 4]: the world matrices of the joints. The corners have the dtype of `worlds`. They are NaN for layers
    without a shape. Raises KeyError for a layer or a shape that the definition lacks."""
    count = len(worlds)
    least = np.full((count, 3), np.inf, worlds.dtype)
    most = np.full((count, 3), -np.inf, worlds.dtype)
    for name in layers:
        layer = definition.layers[name]
        for binding in (*layer.static, *layer.deforming):
            low, high = _compute_binding_box(definition, binding, worlds)
            np.minimum(least, low, out=least)
            np.maximum(most, high, out=most)
    empty = least[:, 0] > most[:, 0]
    least[empty], most[empty] = np.nan, np.nan
    return least, most


def compute_agent_boxes(
    definition: Definition, worlds: Floats, worn_layers: Sequence[tuple[str, ...]], collision_layers: Sequence[tuple[str, ...]],
    worn_indices: NDArray[np.integer], collision_indices: NDArray[np.integer],
) -> tuple[Floats, Floats]:  # fmt: skip
    """Return the boxes of agents that have different layers. The result is as in `compute_layer_boxes`.

    Agent i wears `worn_layers[worn_indices[i]]` and collides with `collision_layers[collision_indices[i]]`. The box is that of
    the collision layers if there are any, else that of the worn layers."""
    least = np.full((len(worlds), 3), np.nan, worlds.dtype)
    most = least.copy()
    for a, b in sorted(set(zip(worn_indices.tolist(), collision_indices.tolist(), strict=True))):
        rows = np.flatnonzero((worn_indices == a) & (collision_indices == b))
        least[rows], most[rows] = compute_layer_boxes(definition, worlds[rows], collision_layers[b] or worn_layers[a])
    return least, most


def _compute_binding_box(definition: Definition, binding: Binding, worlds: Floats) -> tuple[Floats, Floats]:
    """Return the lowest and highest corners [n, 3] of the box of a binding's shape."""
    shape = definition.shapes[binding.shape]
    scale = np.array(binding.bounds_scale, worlds.dtype)
    if shape.capture is not None and binding.deformer not in ("", "blendshape"):
        followed = _list_capture_joints(shape)
        chosen = [definition.rig.find_joint(shape.capture.names[number]) for number in followed]
        if len(chosen) == 1:  # a shape with one joint moves like a static shape
            return _transform_box(
                _compute_shape_extent(definition, shape), scale, worlds[:, chosen[0]], shape.capture.inverse_matrices[followed[0]]
            )
        low, high = _compute_joint_box(worlds, chosen)
        middle, half = (low + high) / 2, (high - low) / 2 * scale
        return middle - half, middle + half
    extent = _compute_shape_extent(definition, shape)
    if binding.transform:
        return _transform_box(extent, scale, worlds[:, definition.rig.find_joint(binding.transform)], np.eye(4))
    middle, half = _scale_box(extent, scale)
    return np.broadcast_to(middle - half, (len(worlds), 3)), np.broadcast_to(middle + half, (len(worlds), 3))


def _scale_box(extent: tuple[Floats, Floats], scale: Floats) -> tuple[Floats, Floats]:
    """Return the centre [3] and half widths [3] of a box that is scaled about its centre, in the dtype of `scale`."""
    low, high = extent
    return ((low + high) / 2).astype(scale.dtype), ((high - low) / 2).astype(scale.dtype) * scale


def _transform_box(extent: tuple[Floats, Floats], scale: Floats, worlds: Floats, local_matrix: Floats) -> tuple[Floats, Floats]:
    """Return the bounding boxes of a box after scaling about its centre, then `local_matrix` [4, 4], then each of `worlds` [n,
    4, 4]."""
    matrices = worlds
    if (local_matrix != np.eye(4)).any():
        local_matrix = local_matrix.astype(worlds.dtype)
        columns = [
            ((worlds[:, :, 0] * c[0] + worlds[:, :, 1] * c[1]) + worlds[:, :, 2] * c[2]) + worlds[:, :, 3] * c[3]
            for c in local_matrix.T
        ]
        matrices = np.stack(columns, axis=-1)
    middle, half = _scale_box(extent, scale)
    # box of a rotated box: rotated centre, and half widths times the absolute values of the matrix's entries
    turned = matrices[:, :3, 0] * middle[0] + matrices[:, :3, 1] * middle[1] + matrices[:, :3, 2] * middle[2] + matrices[:, :3, 3]
    size = np.abs(matrices[:, :3, :3])
    wide = size[:, :, 0] * half[0] + size[:, :, 1] * half[1] + size[:, :, 2] * half[2]
    return turned - wide, turned + wide


def _compute_joint_box(worlds: Floats, joints: list[int]) -> tuple[Floats, Floats]:
    """Return the lowest and highest corners [n, 3] of the boxes around the positions of `joints`."""
    low = worlds[:, joints[0], :3, 3].copy()
    high = low.copy()
    for joint in joints[1:]:
        np.minimum(low, worlds[:, joint, :3, 3], out=low)
        np.maximum(high, worlds[:, joint, :3, 3], out=high)
    return low, high


def _list_capture_joints(shape: SkinShape) -> list[int]:
    """Return the joints that move at least one point of a shape, as indices into `capture.names`."""
    assert shape.capture is not None
    return [int(number) for number in np.unique(shape.capture.joints[shape.capture.weights > 0])]


def _compute_shape_extent(definition: Definition, shape: SkinShape) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the lowest and the highest corner of the box around a shape and all of its blend-shape targets."""
    inputs = [definition.shapes[name] for name in (shape.blend.shapes if shape.blend else ())]
    shapes = [shape, *inputs]
    shapes += [definition.shapes[name] for each in inputs if each.in_betweens for name in each.in_betweens.shapes]
    points = [each.points for each in shapes if len(each.points)]
    if not points:
        return np.full(3, np.inf), np.full(3, -np.inf)
    return (
        np.min([each.min(axis=0) for each in points], axis=0).astype(np.float64),
        np.max([each.max(axis=0) for each in points], axis=0).astype(np.float64),
    )


def compute_rest_box(definition: Definition) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the lowest and the highest corner of the box around all shapes of all layers in the rest pose.

    The length of a body is measured from this box. Without shapes, it is the box around the joints."""
    return compute_posed_box(definition, compute_world_matrices(definition.rig.parents, definition.rig.rest_matrices))


def compute_posed_box(definition: Definition, world: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the lowest and the highest corner of the box around all shapes of all layers in a pose.

    `world`: [J, 4, 4], the world matrices of the joints. Without shapes, the box is that of the joints."""
    point_sets = [world[:, :3, 3]]
    for layer in definition.layers.values():
        for binding in (*layer.static, *layer.deforming):
            shape = definition.shapes.get(binding.shape)
            if shape is not None and len(shape.points):
                point_sets.append(_compute_rest_points(definition, binding, shape, world))
    points = np.concatenate(point_sets[1:] or point_sets)
    return points.min(axis=0), points.max(axis=0)


def _compute_rest_points(
    definition: Definition, binding: Binding, shape: SkinShape, world: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the points [P, 3] of a binding's shape in a pose. `world`: [J, 4, 4], the world matrices of the joints."""
    points = shape.points.astype(np.float64)
    if shape.capture is None or binding.deformer in ("", "blendshape"):
        return _transform_points(world[definition.rig.find_joint(binding.transform)], points) if binding.transform else points
    chosen = [definition.rig.find_joint(name) for name in shape.capture.names]
    matrices = compose_transforms(world[chosen], shape.capture.inverse_matrices)
    skinned_points = np.zeros_like(points)
    for column in range(shape.capture.joints.shape[1]):
        skinned_points += (
            _transform_points(matrices[shape.capture.joints[:, column]], points) * shape.capture.weights[:, column, None]
        )
    return skinned_points


def _transform_points(matrix: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return transformed points [P, 3]. `matrix`: one matrix [4, 4] for all points, or one for each point [P, 4, 4]."""
    return apply_transforms(matrix[..., :3, :], points)
