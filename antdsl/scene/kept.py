"""Keeps what was worked out about small meshes that are staged again and again, as in a preview."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, wraps
from typing import Concatenate, ParamSpec, Protocol, TypeVar

from numpy.typing import NDArray


class _Mesh(Protocol):
    @property
    def vertices(self) -> NDArray[object]: ...  # type: ignore[type-var]


M = TypeVar("M", bound=_Mesh)
P = ParamSpec("P")
T = TypeVar("T")


def once_a_mesh(work: Callable[Concatenate[M, P], T]) -> Callable[Concatenate[M, P], T]:
    """`work`, done once for a mesh and what goes with it. Only for meshes that nobody can change, which are those that are kept
    anyway; what is given back must not be changed either."""
    kept = lru_cache(maxsize=64)(work)

    @wraps(work)
    def ask(mesh: M, /, *words: P.args, **named: P.kwargs) -> T:
        if mesh.vertices.flags.writeable:
            return work(mesh, *words, **named)
        return kept(mesh, *words, **named)  # type: ignore[arg-type]

    return ask
