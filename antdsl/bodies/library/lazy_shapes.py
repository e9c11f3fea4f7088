"""Shapes that are modelled when they are first asked for: a check or a run needs a body's clips and none of its triangles."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from antdsl.bodies.agents.shape import Shape


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
