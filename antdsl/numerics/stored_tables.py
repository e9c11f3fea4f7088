"""Stores tables that are computed from meshes for later runs.

They are plain arrays, identified by a hash of their inputs. The inputs are the arrays and numbers that a table is computed
from, the sources of the packages that compute it, and NumPy's version. Tables are stored like machine code (`object_cache`),
never in a scene's folder. They carry a signature of this user, because kernels trust the row numbers in them. Tables of small
meshes are not stored. Stored and recomputed tables have the same values."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from hashlib import blake2b
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import antdsl
from antdsl.limits import MIB
from antdsl.machine_code import object_cache
from antdsl.numerics import stages
from antdsl.safe_read import read_size_limited

Tables = dict[str, NDArray[Any]]

MIN_STORED_SIZE: Final = 10_000  # number of faces or cells; smaller tables are fast to compute and not stored
TABLE_STORE: Final = object_cache.StoreKind(
    "tables",
    "ANTDSL_TABLE_CACHE",
    ".tables",
    "tables of meshes",
    "are",
    "antdsl uses only tables that it has signed with your private key",
    "one mesh",
    "each run computes the tables again",
    "antdsl computes the tables again",
)
_MAX_STORE_BYTES: Final = 1024 * MIB
_MAX_TABLE_BYTES: Final = 256 * MIB
# Packages that compute tables
_HASHED_PACKAGES: Final = "machine_code", "numerics", "scene/geometry", "casting", "ground", "fields"
_ALIGNMENT_BYTES: Final = 64  # alignment of arrays, in bytes
_ALLOWED_DTYPES: Final = frozenset(["|b1", "|i1", "<i4", "<i8", "<f4", "<f8"])

_computed_tables = 0  # number of tables computed by this process


def get_or_compute(
    name: str, size: int, inputs: Sequence[NDArray[Any] | float | str], compute: Callable[[], Tables], unit: str = "faces"
) -> Tables:
    """Return the tables that `compute` makes from these inputs, or the same tables from the store. The caller may change the
    arrays.

    - `name`: the name of the computation, a part of the key
    - `size`: the number of faces of the mesh, or of another `unit`; results of small inputs are not stored. Use 0 for a result
      that no other run needs
    - `inputs`: everything that the result depends on; the other part of the key"""
    global _computed_tables
    key = _compute_key(name, inputs) if size >= MIN_STORED_SIZE else None
    tables = None if key is None else _unpack_tables(_open_store_once().get(key))
    if tables is None:
        if size >= MIN_STORED_SIZE:
            stages.begin_stage(f"{name} of {size:,} {unit}")
        tables = compute()
        _computed_tables += 1
        if key is not None and sum(array.nbytes for array in tables.values()) <= _MAX_TABLE_BYTES - MIB:
            _open_store_once().store_bytes(key, _pack_tables(tables))
    return tables


def count_computed_tables() -> int:
    """Return how many tables this process has computed because they were not stored."""
    return _computed_tables


def reset_store() -> None:
    """Close the store. The next use determines its folder again, as in a new process."""
    _open_store_once.cache_clear()


def open_store() -> object_cache.ObjectCache:
    """Open and return the store of this user."""
    return object_cache.ObjectCache(kind=TABLE_STORE, max_bytes=_MAX_STORE_BYTES, max_result_bytes=_MAX_TABLE_BYTES)


_open_store_once = cache(open_store)


def _compute_key(name: str, inputs: Sequence[NDArray[Any] | float | str]) -> str:
    """Return the key of a table. It is a hash of the table's name, its inputs and the sources."""
    hashed = blake2b(digest_size=32)
    for part in (name, antdsl.__version__, np.__version__, _hash_sources(), *inputs):
        if isinstance(part, np.ndarray):
            hashed.update(f"{part.dtype.str}{part.shape};".encode())
            hashed.update(np.ascontiguousarray(part).data)
        else:
            text = part if isinstance(part, str) else float(part).hex()
            hashed.update(f"{type(part).__name__} {len(text)} {text};".encode())
    return hashed.hexdigest()


@cache
def _hash_sources() -> str:
    """Return a hash of the source files of all modules that compute tables; empty if the installation has no sources."""
    hashed = blake2b(digest_size=16)
    try:
        for path in _list_modules():
            data = read_size_limited(path, 4 * MIB)
            hashed.update(f"{path.name} {len(data)};".encode() + data)
    except OSError:
        return ""
    return hashed.hexdigest()


def _list_modules() -> Iterator[Path]:
    """Yield the source files of all packages that compute tables."""
    package = Path(antdsl.__file__).parent
    for folder in _HASHED_PACKAGES:
        yield from sorted((package / folder).rglob("*.py"))


def _pack_tables(tables: Mapping[str, NDArray[Any]]) -> bytes:
    """Return arrays as bytes: a line of JSON with the name, type and shape of each array, then the data of all arrays."""
    arrays = {name: np.ascontiguousarray(array) for name, array in tables.items()}
    line = json.dumps([[name, array.dtype.str, array.shape] for name, array in arrays.items()]).encode() + b"\n"
    parts, offset = [line], len(line)
    for array in arrays.values():
        gap = -offset % _ALIGNMENT_BYTES
        parts += [bytes(gap), array.tobytes()]
        offset += gap + array.nbytes
    return b"".join(parts)


def _unpack_tables(data: bytes | None) -> Tables | None:
    """Return the arrays in bytes that `_pack_tables` wrote, or None if `data` is None or invalid."""
    if data is None:
        return None
    tables: Tables = {}
    try:
        offset = data.index(b"\n") + 1
        for name, kind, shape in json.loads(data[:offset]):
            if kind not in _ALLOWED_DTYPES or min(shape, default=0) < 0:
                return None
            offset += -offset % _ALIGNMENT_BYTES
            count = math.prod(shape)
            tables[name] = np.frombuffer(data, kind, count, offset).reshape(shape).copy()
            offset += tables[name].nbytes
    except (ValueError, TypeError):
        return None
    return tables if offset == len(data) else None
