"""Caches results about small meshes that are staged repeatedly, for example in a preview."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import lru_cache, wraps
from typing import Concatenate, ParamSpec, Protocol, TypeVar

from numpy.typing import NDArray

_MAX_CACHED_MESHES, _MAX_CACHED_ANSWERS = 16, 4096  # maximum cache sizes: meshes for each kind of work, and results for each mesh


class _HasVertices(Protocol):
    @property
    def vertices(self) -> NDArray[object]: ...  # type: ignore[type-var]


M = TypeVar("M", bound=_HasVertices)
P = ParamSpec("P")
T = TypeVar("T")


def cache_per_mesh(work: Callable[Concatenate[M, P], T]) -> Callable[Concatenate[M, P], T]:
    """Decorate `work`, a function of a mesh and further arguments, with a cache of its results. Callers must not change the
    results.

    Only results for read-only meshes are stored. The cache also holds a reference to each such mesh."""

    @lru_cache(maxsize=_MAX_CACHED_MESHES)
    def get_answers(mesh: M) -> dict[Hashable, T]:
        return {}

    @wraps(work)
    def get_or_compute(mesh: M, /, *words: P.args, **named: P.kwargs) -> T:
        if mesh.vertices.flags.writeable:
            return work(mesh, *words, **named)
        known, key = get_answers(mesh), (words, tuple(sorted(named.items())))  # type: ignore[arg-type]
        if key not in known:
            if len(known) >= _MAX_CACHED_ANSWERS:
                known.clear()
            known[key] = work(mesh, *words, **named)
        return known[key]

    return get_or_compute
