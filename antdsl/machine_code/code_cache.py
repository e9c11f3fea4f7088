"""Returns compiled code for LLVM IR. It comes from memory, the installation (`shipped_objects`) or an earlier run
(`object_cache`); otherwise LLVM compiles it now."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from functools import cache
from threading import Lock

from antdsl.machine_code import llvm_compiler, object_cache, shipped_objects

_MAX_CACHED_FUNCTIONS = 256  # maximum number of functions with code in memory
_code_by_key: OrderedDict[str, llvm_compiler.LoadedCode] = OrderedDict()
_code_lock = Lock()


def load_code(text_or_name: str, build_text: Callable[[], str] | None = None) -> llvm_compiler.LoadedCode:
    """Return the compiled functions of a text in LLVM IR, ready to run on this processor. Raises RuntimeError if the text is
    invalid. `text_or_name`: the text, or its unique name if `build_text` is set. `build_text`: a function that returns the
    text; only called if the text must be compiled."""
    target = llvm_compiler.find_host_target()
    key = object_cache.compute_object_key(text_or_name, target, versions=object_cache.list_environment_versions())
    with _code_lock:
        if key in _code_by_key:
            _code_by_key.move_to_end(key)
            return _code_by_key[key]
    stored = _find_stored_code(text_or_name, target, key)
    object_file = (
        llvm_compiler.compile_object(text_or_name if build_text is None else build_text(), target) if stored is None else stored
    )
    loaded_code = llvm_compiler.load_object(object_file)
    if stored is None:
        _get_object_cache().store_bytes(key, object_file)
    with _code_lock:
        _code_by_key[key] = loaded_code
        while len(_code_by_key) > _MAX_CACHED_FUNCTIONS:
            _code_by_key.popitem(last=False)
    return loaded_code


def is_code_available(text_or_name: str) -> bool:
    """Return whether the compiled code of a text is in memory or stored in a file. `text_or_name`: the text in LLVM IR, or its
    unique name."""
    target = llvm_compiler.find_host_target()
    key = object_cache.compute_object_key(text_or_name, target, versions=object_cache.list_environment_versions())
    with _code_lock:
        if key in _code_by_key:
            return True
    return _find_stored_code(text_or_name, target, key) is not None


def _find_stored_code(text_or_name: str, target: llvm_compiler.Target, key: str) -> bytes | None:
    """Return the stored object file of a text, from the installation or from the cache under `key`; None if neither has it."""
    shipped_object = shipped_objects.find_object(text_or_name, target)
    return _get_object_cache().get(key) if shipped_object is None else shipped_object


def load_stored_data(key: str) -> bytes | None:
    """Return the bytes stored under a key with `store_data`, in this run or an earlier one; None if nothing is stored."""
    return _get_object_cache().get(key)


def store_data(key: str, data: bytes) -> None:
    """Store data that belongs to compiled code under `key`, signed in the same way as the code."""
    _get_object_cache().store_bytes(key, data)


def take_messages() -> list[str]:
    """Return messages that tell the user why stored code was not used or new code could not be stored."""
    return shipped_objects.take_messages() + (
        list(_get_object_cache().messages) if _get_object_cache.cache_info().currsize else []
    )


def release_unused_code() -> None:
    """Remove unused code from memory, so that it is loaded as in a new process. Stored files are unchanged."""
    with _code_lock:
        _code_by_key.clear()
    _get_object_cache.cache_clear()
    shipped_objects.close_files()


@cache
def _get_object_cache() -> object_cache.ObjectCache:
    return object_cache.ObjectCache()
