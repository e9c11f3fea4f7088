"""The code of a text: that in memory, that which another run has kept, or new code."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from functools import cache
from threading import Lock

from antdsl.machine_code import machine, object_cache

_KEPT = 256  # functions whose code stays in memory
_known: OrderedDict[str, machine.Code] = OrderedDict()
_guard = Lock()


def code(named: str, write: Callable[[], str] | None = None) -> machine.Code:
    """The functions of a text, ready to run on this processor; with `write`, of the text that this gives and that `named` alone
    stands for. Raises RuntimeError where the text is wrong."""
    target = machine.host()
    key = object_cache.key(named, target, versions=object_cache.versions())
    with _guard:
        if key in _known:
            _known.move_to_end(key)
            return _known[key]
    kept = _objects().get(key)
    made = machine.object_code(named if write is None else write(), target) if kept is None else kept
    found = machine.load(made)
    if kept is None:
        _objects().put(key, made)
    with _guard:
        _known[key] = found
        while len(_known) > _KEPT:
            _known.popitem(last=False)
    return found


def kept(named: str) -> bool:
    """Whether the code of a text, or of what stands for it, is there, in memory or from another run."""
    key = object_cache.key(named, machine.host(), versions=object_cache.versions())
    with _guard:
        if key in _known:
            return True
    return _objects().get(key) is not None


def told() -> list[str]:
    """Sentences for the user on why compiled code of other runs was not used, or that of this one is not kept."""
    return list(_objects().messages) if _objects.cache_info().currsize else []


def forget() -> None:
    """Let go of all code in memory that nobody has in use, as in a process that begins; what a folder keeps stays there."""
    with _guard:
        _known.clear()
    _objects.cache_clear()


@cache
def _objects() -> object_cache.ObjectCache:
    return object_cache.ObjectCache()
