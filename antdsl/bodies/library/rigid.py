"""Bodies without moving parts: an arrow and a ball, each all in the colour of the agent's state but for the ball's nose."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from antdsl.bodies.agents.definition import Definition
from antdsl.bodies.agents.layer import Binding, Layer
from antdsl.bodies.agents.shape import Shape
from antdsl.bodies.library.lazy_shapes import LazyShapes
from antdsl.bodies.library.modelling import Model, rig_of
from antdsl.bodies.library.surfaces import Surface, ellipsoid

_ROOT = {"root": ("", (0.0, 0.0, 0.0))}


def arrow() -> Definition:
    """A dart that points where it goes: for birds, fish, anything seen as a flock."""
    return _rigid("arrow", {"body": _dart}, {})


def ball() -> Definition:
    """A ball of diameter 1 with a small nose that shows where it heads."""
    return _rigid(
        "ball", {"body": lambda model: _ball(model, 2), "close": lambda model: _ball(model, 4)}, {"nose": (0.03, 0.02, 0.02)}
    )


def _dart(model: Model) -> None:
    corners = np.array([(0.5, 0.14, 0.0), (-0.5, 0.10, 0.30), (-0.5, 0.10, -0.30), (-0.30, 0.30, 0.0), (-0.32, 0.04, 0.0)])
    faces = np.array([(0, 3, 1), (0, 2, 3), (0, 1, 4), (0, 4, 2), (1, 3, 4), (2, 4, 3)])
    flat = np.stack([corners[:, 0] + 0.5, corners[:, 2] + 0.5], 1)
    for number, face in enumerate(faces):  # a part for each, so that edges stay sharp
        one = Surface(corners[face], np.array([[0, 1, 2]], np.int32), flat[face], np.zeros(3))
        model.add(one, "root", "state", f"side {number}")


def _ball(model: Model, detail: int) -> None:
    model.add(ellipsoid((0.0, 0.5, 0.0), (0.5, 0.5, 0.5), detail), "root", "state", "ball")
    model.add(ellipsoid((0.47, 0.5, 0.0), (0.10, 0.10, 0.10), detail - 1), "root", "nose", "nose")


def _rigid(name: str, layers: dict[str, Callable[[Model], None]], materials: dict[str, tuple[float, float, float]]) -> Definition:
    def modelled(shape: str) -> Shape:
        model = Model(_ROOT)
        layers["body" if shape == name else "close"](model)
        return model.shape(shape)

    names = {layer: name if layer == "body" else f"{name}_{layer}" for layer in layers}
    return Definition(
        name, rig_of(_ROOT), LazyShapes(dict.fromkeys(names.values(), modelled)),
        {layer: Layer(layer, static=(Binding("root", shape),)) for layer, shape in names.items()}, materials=materials,
    )  # fmt: skip
