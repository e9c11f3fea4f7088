"""Keeps what was worked out about small meshes that are staged again and again, as in a preview."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import lru_cache, wraps
from typing import Concatenate, ParamSpec, Protocol, TypeVar

from numpy.typing import NDArray

_MESHES, _ANSWERS = 16, 4096  # kept at most: meshes for each kind of work, and what was worked out about each


class _Mesh(Protocol):
    @property
    def vertices(self) -> NDArray[object]: ...  # type: ignore[type-var]


M = TypeVar("M", bound=_Mesh)
P = ParamSpec("P")
T = TypeVar("T")


def once_a_mesh(work: Callable[Concatenate[M, P], T]) -> Callable[Concatenate[M, P], T]:
    """`work`, done once for a mesh and what goes with it. Only for meshes that nobody can change, which are those that are kept
    anyway; what is given back must not be changed either."""

    @lru_cache(maxsize=_MESHES)
    def kept(mesh: M) -> dict[Hashable, T]:
        return {}

    @wraps(work)
    def ask(mesh: M, /, *words: P.args, **named: P.kwargs) -> T:
        if mesh.vertices.flags.writeable:
            return work(mesh, *words, **named)
        known, key = kept(mesh), (words, tuple(sorted(named.items())))  # type: ignore[arg-type]
        if key not in known:
            if len(known) >= _ANSWERS:
                known.clear()
            known[key] = work(mesh, *words, **named)
        return known[key]

    return ask
