"""The code of a text: from memory, from the installation (`shipped`), from an earlier run (`object_cache`), or compiled now."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from functools import cache
from threading import Lock

from antdsl.machine_code import machine, object_cache, shipped

_MOST_FUNCTIONS = 256  # functions with code in memory
_known: OrderedDict[str, machine.Code] = OrderedDict()
_guard = Lock()


def code(named: str, write: Callable[[], str] | None = None) -> machine.Code:
    """Return the functions of a text, ready to run on this processor. With `write`, the text is the result of `write`, and
    `named` is its unique name. Raises RuntimeError for an invalid text."""
    target = machine.host()
    key = object_cache.key(named, target, versions=object_cache.versions())
    with _guard:
        if key in _known:
            _known.move_to_end(key)
            return _known[key]
    stored = _find_stored_code(named, target, key)
    object_file = machine.object_code(named if write is None else write(), target) if stored is None else stored
    loaded_code = machine.load(object_file)
    if stored is None:
        _objects().put(key, object_file)
    with _guard:
        _known[key] = loaded_code
        while len(_known) > _MOST_FUNCTIONS:
            _known.popitem(last=False)
    return loaded_code


def is_available(named: str) -> bool:
    """Return whether the code of a text, or of its name, is in memory or stored."""
    target = machine.host()
    key = object_cache.key(named, target, versions=object_cache.versions())
    with _guard:
        if key in _known:
            return True
    return _find_stored_code(named, target, key) is not None


def _find_stored_code(named: str, target: machine.Target, key: str) -> bytes | None:
    """Return the object file of a text: from the installation, or else from an earlier run, where it is stored under a key."""
    shipped_object = shipped.find_object(named, target)
    return _objects().get(key) if shipped_object is None else shipped_object


def stored(key: str) -> bytes | None:
    """What `store` stored under a key, in this run or an earlier one."""
    return _objects().get(key)


def store(key: str, data: bytes) -> None:
    """Store what belongs to code, as code is stored: signed."""
    _objects().put(key, data)


def messages() -> list[str]:
    """Return messages for the user on why stored code was not used, or why new code is not stored."""
    return shipped.messages() + (list(_objects().messages) if _objects.cache_info().currsize else [])


def forget() -> None:
    """Release all code in memory that is not in use, as in a process that begins; the contents of folders stay."""
    with _guard:
        _known.clear()
    _objects.cache_clear()
    shipped.forget()


@cache
def _objects() -> object_cache.ObjectCache:
    return object_cache.ObjectCache()
