"""Shapes that are modelled when they are first asked for: a check or a run needs a body's clips and none of its triangles."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from antdsl.bodies.agents.layer import Binding, Layer
from antdsl.bodies.agents.shape import Shape
from antdsl.bodies.library.modelling import Model
from antdsl.bodies.library.surfaces import Point


class LazyShapes(Mapping[str, Shape]):
    """Shapes by name, each made once by a function of its name."""

    def __init__(self, makers: Mapping[str, Callable[[str], Shape]]) -> None:
        self._makers, self._made = dict(makers), dict[str, Shape]()

    def __getitem__(self, name: str) -> Shape:
        if name not in self._made:
            self._made[name] = self._makers[name](name)
        return self._made[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._makers)

    def __len__(self) -> int:
        return len(self._makers)


def layered(
    name: str, joints: Mapping[str, tuple[str, Point]], fill: Callable[[Model, bool], None]
) -> tuple[LazyShapes, dict[str, Layer]]:
    """Shapes and layers of a body: `body`, which `fill(model, False)` models, and `close`, which `fill(model, True)` does."""

    def modelled(shape: str) -> Shape:
        model = Model(joints)
        fill(model, shape != name)
        return model.shape(shape)

    shapes = {"body": name, "close": f"{name}_close"}
    layers = {layer: Layer(layer, deforming=(Binding("", shape, deformer="linearskinning"),)) for layer, shape in shapes.items()}
    return LazyShapes(dict.fromkeys(shapes.values(), modelled)), layers
