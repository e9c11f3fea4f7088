"""Finds or compiles the code of a text: from memory, the installation (`shipped`), an earlier run (`object_cache`), or LLVM."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from functools import cache
from threading import Lock

from antdsl.machine_code import machine, object_cache, shipped

_MOST_FUNCTIONS = 256  # maximum number of functions with code in memory
_code_by_key: OrderedDict[str, machine.LoadedCode] = OrderedDict()
_code_lock = Lock()


def code(named: str, write: Callable[[], str] | None = None) -> machine.LoadedCode:
    """Return the functions of a text, ready to run on this processor. Raises RuntimeError for an invalid text.

    Without `write`, `named` is the text. With `write`, `named` is a unique name of the text, and `write()` returns the text."""
    target = machine.host()
    key = object_cache.key(named, target, versions=object_cache.versions())
    with _code_lock:
        if key in _code_by_key:
            _code_by_key.move_to_end(key)
            return _code_by_key[key]
    stored = _find_stored_code(named, target, key)
    object_file = machine.object_code(named if write is None else write(), target) if stored is None else stored
    loaded_code = machine.load(object_file)
    if stored is None:
        _objects().put(key, object_file)
    with _code_lock:
        _code_by_key[key] = loaded_code
        while len(_code_by_key) > _MOST_FUNCTIONS:
            _code_by_key.popitem(last=False)
    return loaded_code


def is_available(named: str) -> bool:
    """Return whether the code of a text, given by the text or its name, is in memory or stored."""
    target = machine.host()
    key = object_cache.key(named, target, versions=object_cache.versions())
    with _code_lock:
        if key in _code_by_key:
            return True
    return _find_stored_code(named, target, key) is not None


def _find_stored_code(named: str, target: machine.Target, key: str) -> bytes | None:
    """Return the object file of a text from the installation, or else the one that an earlier run stored under `key`; None if
    neither has it."""
    shipped_object = shipped.find_object(named, target)
    return _objects().get(key) if shipped_object is None else shipped_object


def stored(key: str) -> bytes | None:
    """Return the bytes stored under a key with `store`, in this run or an earlier one; None if there are none."""
    return _objects().get(key)


def store(key: str, data: bytes) -> None:
    """Store data that belongs to code. The data is signed, as stored code is."""
    _objects().put(key, data)


def messages() -> list[str]:
    """Return messages for the user on why stored code was not used, or why new code is not stored."""
    return shipped.messages() + (list(_objects().messages) if _objects.cache_info().currsize else [])


def forget() -> None:
    """Release all unused code in memory, as at the start of a process. Stored files are unchanged."""
    with _code_lock:
        _code_by_key.clear()
    _objects.cache_clear()
    shipped.forget()


@cache
def _objects() -> object_cache.ObjectCache:
    return object_cache.ObjectCache()
