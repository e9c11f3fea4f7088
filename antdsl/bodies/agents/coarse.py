"""Coarse shapes for agents that are small in a picture: points of a grid's cell become one (vertex clustering; J. Rossignac and
P. Borrel, Multi-resolution 3D approximations for rendering complex scenes, 1993)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from antdsl.bodies.agents.definition import Binding, Capture, Definition, Layer, Shape

CELLS = 14  # to the length of a body, and at least
_WIDER = 2.0  # a shape is made again at most
ACROSS = 3  # to the longest side of a shape


def coarse(definition: Definition) -> Definition:
    """The definition with fewer points. Shapes still follow joints by its deformers, and are blended no more."""
    cell = definition.length / CELLS
    shapes = {name: coarse_shape(shape, cell) for name, shape in definition.shapes.items()}
    layers = {
        name: Layer(name, layer.static, tuple(_unblended(each) for each in layer.deforming))
        for name, layer in definition.layers.items()
    }
    return replace(definition, shapes=shapes, layers=layers)


def coarse_shape(shape: Shape, cell: float) -> Shape:
    """A shape whose points in one cell are their mean, and follow the joints of the first of them; triangles that have two
    corners in one cell are left out. Its box stays as large, so that it is not thinner."""
    if not len(shape.points):
        return shape
    size = min(cell, float(np.ptp(shape.points, axis=0).max()) / ACROSS) or cell
    cells = np.floor(shape.points.astype(np.float64) / size).astype(np.int64)
    _, first, of, counts = np.unique(cells, axis=0, return_index=True, return_inverse=True, return_counts=True)
    of = of.reshape(-1)

    def mean(values: np.ndarray) -> np.ndarray:
        sums = [np.bincount(of, values[:, axis], len(first)) for axis in range(3)]
        return np.stack(sums, 1) / counts[:, None]

    points, before = mean(shape.points), shape.points.astype(np.float64)
    low, high, width = before.min(axis=0), before.max(axis=0), np.ptp(points, axis=0)
    wider = np.where(width > 0, (high - low) / np.where(width > 0, width, 1), 1)
    points = low + (points - points.min(axis=0)) * np.minimum(wider, _WIDER)
    normals = None
    if shape.normals is not None:
        turned = mean(shape.normals)
        length = np.linalg.norm(turned, axis=1, keepdims=True)
        normals = np.where(length > 1e-6, turned / np.maximum(length, 1e-6), shape.normals[first]).astype(np.float32)
    faces = of[shape.faces].astype(np.int32)
    whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    follows = shape.capture
    capture = None if follows is None else Capture(follows.names, follows.joints[first], follows.weights[first], follows.inverse)
    return Shape(
        shape.name, points.astype(np.float32), faces[whole], normals, None, shape.materials,
        None if shape.material is None else shape.material[whole],
        {name: values[first] for name, values in shape.attributes.items()}, capture,
        dual_quaternion_blend=shape.dual_quaternion_blend,
    )  # fmt: skip


def _unblended(binding: Binding) -> Binding:
    steps = [step for step in binding.deformer.split("+") if step != "blendshape"]
    return replace(binding, deformer="+".join(steps))
