"""Blend shapes: a shape moves towards other shapes of the library, by the weights in each agent's channels.

Each input adds its difference from the base shape, times its weight. Weights are not normalised and may be below 0 or above 1. An
input may have in-betweens: corrective shapes that apply in full at a given weight. It is then piecewise linear between the base
(weight 0), the in-betweens, and the primary shape (weight 1). The outermost pieces are extrapolated. An in-between that lacks an
attribute is skipped for that attribute. Points are matched by an attribute (`id`, unless the base names another one) if both
shapes have it, else by index. Points without a match stay as in the base.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.affine import Floats
from antdsl.bodies.agents.definition import Definition, SkinShape
from antdsl.bodies.agents.poses import WorldPoses
from antdsl.bodies.agents.skinning import DeformedShape, normalise_in_place

_SHAPE_FIELD_BY_ATTRIBUTE = {"P": "points", "N": "normals"}  # attributes that are separate fields of a shape
_MIN_KNOT_SPACING = 1e-6  # in-betweens with weights nearer to each other than this count as one


def apply_blend_shapes(
    deformed_shape: DeformedShape, shape: SkinShape, definition: Definition, poses: WorldPoses
) -> DeformedShape:
    """Return the deformed shape after adding its blend-shape inputs, weighted by the channels of each agent.

    Only the attributes that `shape` lists for blending change (default: P and N). Primitives have no attributes in antdsl, so
    `BlendTargets.primitive_id` is unused. Raises ValueError for a shape without blend shapes, for different numbers of inputs and
    channels, and for in-betweens at weight 0 or 1. Raises KeyError for shapes that the library lacks, and for channels that the
    rig lacks."""
    blend = shape.blend
    if blend is None:
        raise ValueError(f"shape `{shape.name}` needs the names of its blend shapes, in `blendshape_shapenames`")
    if len(blend.shapes) != len(blend.channels):
        raise ValueError(
            f"shape `{shape.name}` has {len(blend.shapes)} blend shapes, but {len(blend.channels)} channels; use one channel "
            "for each blend shape"
        )
    n = max(len(poses.channels), len(deformed_shape.points))
    names = [
        name
        for name in blend.attributes
        if _read_attribute(deformed_shape, name) is not None and get_point_attribute(shape, name) is not None
    ]
    values = {name: _split_components(_read_attribute(deformed_shape, name), n) for name in names}
    for name, channel in zip(blend.shapes, blend.channels, strict=True):
        weights = poses.channels[:, definition.rig.find_channel(channel)]
        targets, knots = list_blend_knots(definition, name)
        for each in names:
            if get_point_attribute(definition.shapes[name], each) is None:
                continue
            has = [k for k, target in enumerate(targets) if get_point_attribute(target, each) is not None]
            for k, share in zip(has, compute_knot_shares(weights, knots[has]), strict=True):
                base_points, target_points = match_points(shape, targets[k], blend.point_id)
                values[each][:, base_points] += (
                    compute_attribute_offsets(shape, targets[k], each, base_points, target_points)[..., None] * share
                )
    rest = {name: array.transpose(2, 1, 0) for name, array in values.items() if name not in _SHAPE_FIELD_BY_ATTRIBUTE}
    points = values["P"].transpose(2, 1, 0) if "P" in values else deformed_shape.points
    normals = normalise_in_place(values["N"]).transpose(2, 1, 0) if "N" in values else deformed_shape.normals
    return DeformedShape(points, normals, {**deformed_shape.attributes, **rest})


def _read_attribute(deformed_shape: DeformedShape, name: str) -> Floats | None:
    """Return the values [n, P, …] of an attribute of the shape, after the deformers applied so far; None if it has no such
    attribute."""
    return (
        {"P": deformed_shape.points, "N": deformed_shape.normals}[name]
        if name in _SHAPE_FIELD_BY_ATTRIBUTE
        else deformed_shape.attributes.get(name)
    )


def _split_components(values: Floats | None, n: int) -> Floats:
    """Return an attribute [n, P, …] as a new array [components, P, n]."""
    assert values is not None
    wide = values.reshape(*values.shape[:2], -1).transpose(2, 1, 0)
    return np.ascontiguousarray(np.broadcast_to(wide, (*wide.shape[:2], n)).astype(np.float32))


def list_blend_knots(definition: Definition, name: str) -> tuple[list[SkinShape], NDArray[np.float64]]:
    """Return the shapes of the input `name`, which are its primary shape and the in-betweens. Also return the weights at which
    these shapes apply in full.

    Both results are in ascending order of weight."""
    primary = definition.shapes[name]
    between = primary.in_betweens
    pairs = [(1.0, primary)]
    if between is not None:
        if len(between.shapes) != len(between.weights):
            raise ValueError(
                f"shape `{name}` has {len(between.shapes)} in-betweens, but {len(between.weights)} weights; use one weight for "
                "each in-between"
            )
        for each, weight in zip(between.shapes, between.weights, strict=True):
            if any(abs(weight - other) < _MIN_KNOT_SPACING for other in (0.0, *(known for known, _ in pairs))):
                raise ValueError(
                    f"in-between `{each}` of shape `{name}` has weight {weight:g}; use each weight once, and neither 0 nor 1"
                )
            pairs.append((weight, definition.shapes[each]))
    pairs.sort(key=lambda pair: pair[0])
    return [target for _, target in pairs], np.array([weight for weight, _ in pairs])


def compute_knot_shares(weights: Floats, knots: NDArray[np.float64]) -> Floats:
    """Return the factors of the K shapes of an input, float32[K, n], for the input's weights [n].

    The offset of each shape from the base is multiplied by its factor. `knots`: [K], the weight at which each shape applies in
    full. Between two knots, factors change linearly. The base counts as a knot at weight 0."""
    all_knots = np.sort(np.append(knots, 0.0))
    weight = weights.astype(np.float64)
    piece = np.clip(np.searchsorted(all_knots, weight, side="right") - 1, 0, len(all_knots) - 2)
    near = (weight - all_knots[piece]) / (all_knots[piece + 1] - all_knots[piece])
    all_shares = np.zeros((len(all_knots), len(weight)))
    agents = np.arange(len(weight))
    all_shares[piece, agents] = 1 - near
    all_shares[piece + 1, agents] = near
    shares: Floats = all_shares[all_knots != 0].astype(np.float32)
    return shares


def match_points(base: SkinShape, target: SkinShape, point_id: str) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return two arrays of indices: the matched points in the base shape, and the corresponding points in the target shape."""
    own, other = base.attributes.get(point_id), target.attributes.get(point_id)
    if own is None or other is None:
        both = np.arange(min(len(base.points), len(target.points)))
        return both, both
    order = np.argsort(other, kind="stable")
    place = np.minimum(np.searchsorted(other[order], own), max(len(other) - 1, 0))
    base_points = np.flatnonzero(other[order][place] == own) if len(other) else np.zeros(0, np.intp)
    return base_points, order[place[base_points]] if len(other) else base_points


def get_point_attribute(shape: SkinShape, name: str) -> NDArray[np.generic] | None:
    """Return an attribute [P, …] of the points of a shape."""
    values: NDArray[np.generic] | None = (
        getattr(shape, _SHAPE_FIELD_BY_ATTRIBUTE[name]) if name in _SHAPE_FIELD_BY_ATTRIBUTE else shape.attributes.get(name)
    )
    return values


def compute_attribute_offsets(
    base: SkinShape, target: SkinShape, name: str, base_points: NDArray[np.intp], target_points: NDArray[np.intp]
) -> Floats:
    """Return the differences (target minus base) of an attribute at matched points, float32[components, matched]."""
    mine, others = get_point_attribute(base, name), get_point_attribute(target, name)
    assert mine is not None and others is not None
    delta = others[target_points].astype(np.float32) - mine[base_points].astype(np.float32)
    # `int(np.prod())` works even if no point is matched
    return np.ascontiguousarray(delta.reshape(len(base_points), int(np.prod(delta.shape[1:]))).T)
