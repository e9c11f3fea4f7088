"""Converts an agent definition to other axes and another unit of length, without changing the body."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.definition import Clip, Definition, Layer, SkinShape
from antdsl.bodies.agents.transforms import compose_matrix, compose_transforms, decompose_matrix

AxisVector = tuple[float, float, float]
Floats = NDArray[np.float64]


def convert_definition_axes(body: Definition, front: AxisVector, up: AxisVector, unit: float) -> Definition:
    """Return the definition converted to other forward and upward axes, and to `unit` millimetres per unit of length. Both must
    be coordinate axes, such as +x.

    All local spaces are transformed in the same way. Joint names do not change. Posed points have the same positions in a scene,
    up to rounding in float32."""
    turn = _build_axis_frame(front, up) @ _build_axis_frame(body.front, body.up).T
    size = body.unit / unit
    if size == 1.0 and (turn == np.eye(3)).all():
        return replace(body, front=front, up=up)
    change = np.eye(4)
    change[:3, :3] = turn * size
    back: Floats = np.linalg.inv(change).astype(np.float64)
    clips = {name: _convert_clip(each, change, back) for name, each in body.clips.items()}
    rest = compose_transforms(
        compose_transforms(np.broadcast_to(change, body.rig.rest_matrices.shape), body.rig.rest_matrices), back
    )
    return replace(
        body, rig=replace(body.rig, rest_matrices=rest),
        clips={name: replace(each, stride=each.stride * size) for name, each in clips.items()},
        shapes={name: _convert_shape(each, change, back) for name, each in body.shapes.items()},
        layers={name: _convert_layer(each, np.abs(turn)) for name, each in body.layers.items()},
        gaits=tuple(replace(g, speed=g.speed * size, stride=g.stride * size, lift=g.lift * size) for g in body.gaits),
        front=front, up=up, length=body.length * size, unit=unit, capsule=_scale_capsule(body.capsule, size),
    )  # fmt: skip


def _scale_capsule(capsule: tuple[float, float, float, float] | None, size: float) -> tuple[float, float, float, float] | None:
    """Return a collision shape with its lengths multiplied by `size`."""
    if capsule is None:
        return None
    length, width, height, ahead = capsule
    return length * size, width * size, height * size, ahead * size


def _build_axis_frame(front: AxisVector, up: AxisVector) -> Floats:
    """Return the matrix [3, 3] with the columns front, up and side (front × up)."""
    ahead, above = np.array(front, np.float64), np.array(up, np.float64)
    return np.stack([ahead, above, np.cross(ahead, above)], axis=1)


def _convert_clip(clip: Clip, rotation: Floats, inverse_rotation: Floats) -> Clip:
    """Return a clip converted to other axes. `rotation` [3, 3] converts vectors; `inverse_rotation` is its inverse."""
    if not clip.joints:
        return clip
    move, turn, scale = (each.astype(np.float64) for each in (clip.translation, clip.rotation, clip.scale))
    matrices = compose_matrix(move, turn, scale, None if clip.shear is None else clip.shear.astype(np.float64))
    new_matrices = compose_transforms(
        compose_transforms(np.broadcast_to(rotation, matrices.shape), matrices), np.broadcast_to(inverse_rotation, matrices.shape)
    )
    move, _, scale, shear = decompose_matrix(new_matrices)
    axis = rotation[:3, :3] / np.abs(np.linalg.det(rotation[:3, :3])) ** (1 / 3)
    # only the axis of a rotation changes, not its angle, so that signs stay continuous over samples
    turn = np.concatenate([clip.rotation[..., :3] @ axis.T, clip.rotation[..., 3:]], axis=-1)
    return replace(
        clip, translation=move.astype(np.float32), rotation=turn.astype(np.float32), scale=scale.astype(np.float32),
        shear=shear.astype(np.float32) if clip.shear is not None or np.abs(shear).max(initial=0.0) > 1e-6 else None,
    )  # fmt: skip


def _convert_shape(shape: SkinShape, rotation: Floats, inverse_rotation: Floats) -> SkinShape:
    """Return a shape converted to other axes. `rotation` [3, 3] converts vectors; `inverse_rotation` is its inverse."""
    axis = rotation[:3, :3] / np.abs(np.linalg.det(rotation[:3, :3])) ** (1 / 3)
    capture = shape.capture
    if capture is not None:
        inverse = compose_transforms(np.broadcast_to(rotation, capture.inverse_matrices.shape), capture.inverse_matrices)
        capture = replace(capture, inverse_matrices=compose_transforms(inverse, np.broadcast_to(inverse_rotation, inverse.shape)))
    return replace(
        shape, points=(shape.points @ rotation[:3, :3].T).astype(np.float32), capture=capture,
        normals=None if shape.normals is None else (shape.normals @ axis.T).astype(np.float32),
    )  # fmt: skip


def _convert_layer(layer: Layer, axis_map: Floats) -> Layer:
    """Return a layer converted to other axes: the bounds scales of its bindings are reordered. `axis_map` [3, 3]: converts
    vectors to the new axes."""

    def convert_scale(scale: tuple[float, float, float]) -> tuple[float, float, float]:
        x, y, z = (axis_map @ np.array(scale)).tolist()
        return x, y, z

    static, deforming = (
        tuple(replace(each, bounds_scale=convert_scale(each.bounds_scale)) for each in part)
        for part in (layer.static, layer.deforming)
    )
    return replace(layer, static=static, deforming=deforming)
