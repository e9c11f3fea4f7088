"""Computes a key from all sources that determine a kernel's LLVM IR. The key identifies cached code, so that the LLVM IR need
not be written again. The key covers the source files of the kernel's functions, the values of the names in these functions,
and all files of `machine_code`. A kernel that uses a value without a representation that is equal in all runs has no key. Its
LLVM IR identifies it instead."""

from __future__ import annotations

import os
from collections.abc import Iterator
from functools import cache
from hashlib import blake2b
from pathlib import Path
from types import CodeType, FunctionType, GenericAlias, ModuleType
from typing import Any

import numpy as np

from antdsl import machine_code
from antdsl.limits import MIB
from antdsl.machine_code.kernels.checks import CHECKS_ENABLED
from antdsl.machine_code.kernels.records import get_field_types, is_record, resolve_annotation
from antdsl.machine_code.kernels.types import ArrayType, ScalarType
from antdsl.safe_read import read_size_limited

_MAX_SOURCE_BYTES = 4 * MIB  # of a file


class _UnknownSource(Exception):
    """Error for a value that cannot be compared between runs."""


def compute_source_key(part: Any, types: list[Any]) -> str | None:
    """Return a key that identifies the LLVM IR of a kernel with arguments of these types, or None if it has no key. LLVM IR
    never begins like a key."""
    parts: list[str] = [_hash_compiler_sources(), f"checked {CHECKS_ENABLED}", *map(_describe_type, types)]
    known: dict[int, int] = {}
    try:
        _describe_function(part, parts, known)
    except (_UnknownSource, OSError, ValueError):
        return None
    hashed = blake2b(digest_size=32)
    for each in parts:
        data = each.encode("utf-8", "surrogatepass")
        hashed.update(len(data).to_bytes(8, "little") + data)
    return "sources " + hashed.hexdigest()


def _describe_type(type: Any) -> str:
    if isinstance(type, tuple):
        names = getattr(type, "_fields", ())
        return f"{type.__class__.__qualname__}{names}({','.join(map(_describe_type, type))})"
    return _get_cached_repr(type)


@cache
def _get_cached_repr(type: Any) -> str:
    return repr(type)


@cache
def _hash_compiler_sources() -> str:
    """Return a hash of all source files of `machine_code`."""
    folder = Path(machine_code.__file__).parent
    return "".join(_hash_file(str(each)) for each in sorted([*folder.rglob("*.py"), *folder.rglob("*.ll")]))


def _hash_file(path: str) -> str:
    """Return the hash of a file. It is computed again if the file's time or size has changed."""
    file_stat = os.stat(path)
    return _cached_file_hash(path, file_stat.st_mtime_ns, file_stat.st_size)


@cache
def _cached_file_hash(path: str, modified_ns: int, size: int) -> str:
    return blake2b(read_size_limited(path, _MAX_SOURCE_BYTES), digest_size=16).hexdigest()


def _describe_function(part: Any, parts: list[str], literal_value: dict[int, int]) -> None:
    """Append a description of a function, and of the values that its names refer to, to `parts`. `literal_value`: numbers for
    the functions described before, by object identity. The number then stands for the description."""
    function: FunctionType = part.function
    if id(function) in literal_value:
        parts.append(f"function {literal_value[id(function)]}")
        return
    literal_value[id(function)] = len(literal_value)
    code, world = function.__code__, function.__globals__
    place = f"{function.__module__} {function.__qualname__} {code.co_firstlineno} {part.attribute}"
    parts.append(f"{place} {_hash_file(code.co_filename)}")
    names = sorted(set(_list_code_names(code)))
    for name in names:
        if name in world:
            parts.append(name)
            _describe_value(world[name], names, parts, literal_value)


def _list_code_names(code: CodeType) -> Iterator[str]:
    """Yield all names in the code of a function that the translation may look up in the function's module."""
    for names in (code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars):
        yield from names
    for each in code.co_consts:
        if isinstance(each, CodeType):
            yield from _list_code_names(each)


def _describe_value(value: Any, names: list[str], parts: list[str], literal_value: dict[int, int]) -> None:
    """Append the description of a value that a kernel uses to `parts`. `names`: the attributes of the value that may be used.
    Raises _UnknownSource if it has no description."""
    part = None if is_record(value) else getattr(value, "part", None)
    if part is not None:
        _describe_function(part, parts, literal_value)
    elif isinstance(value, ModuleType):
        parts.append(f"module {value.__name__}")
        has = vars(value)  # NumPy takes long to say that it has not
        for name in names:
            inner = has.get(name)
            if inner is not None and not isinstance(inner, ModuleType):
                parts.append(name)
                _describe_value(inner, [], parts, literal_value)
    elif is_record(value):
        parts.append(f"record {value.__module__} {_describe_type(get_field_types(value))}")
    elif isinstance(value, tuple):
        parts.append(f"{type(value).__qualname__} {len(value)}")
        for each in value:
            _describe_value(each, names, parts, literal_value)
    elif value is None or isinstance(value, bool | int | float | str | np.generic | ScalarType | ArrayType):
        parts.append(f"{type(value).__name__} {value!r}")
    elif isinstance(value, GenericAlias):
        parts.append(_describe_type(resolve_annotation(value, {})))
    elif callable(value) and isinstance(getattr(value, "__qualname__", None), str):
        parts.append(f"{value.__module__} {value.__qualname__}")
    else:
        raise _UnknownSource
