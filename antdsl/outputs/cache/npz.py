"""NPZ files of plain arrays, written atomically, without pickle or compression.

On reading, all sizes are compared with the size of the file. The layout is that of NumPy (NEP 1 inside an uncompressed zip), so
`numpy.load` can read these files."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Container, Iterable, Mapping
from functools import lru_cache
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.outputs.cache.zip_parts import MemberForm, StoredFile, make_member_form, make_stored_file
from antdsl.safe_read import FileTooLargeError, open_size_limited
from antdsl.scene.geometry.arrays import ALLOWED_DTYPES, NPY_MAGIC, ArrayFileError, parse_npy, read_npz_archive

__all__ = ["ArrayFileError", "encode_npz", "make_npz_file", "parse_npy", "read_npz", "write_member"]

_BYTE_TYPE = np.dtype(np.uint8)
MAX_FILE_BYTES = 64 * limits.GIB
_FIXED_DATE = (1980, 1, 1, 0, 0, 0)  # fixed, so that equal arrays give equal bytes at any time


def encode_npz(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Return the bytes of an NPZ file with these arrays, in order."""
    return b"".join(make_npz_file(arrays).parts)


def make_npz_file(arrays: Mapping[str, NDArray[Any]]) -> StoredFile:
    """Return the NPZ file with these arrays, as consecutive parts.

    The parts share memory with the arrays. The arrays must not change until the parts are written."""
    return make_stored_file(_make_member(name, array) for name, array in arrays.items())


def _make_member(name: str, array: NDArray[Any]) -> tuple[MemberForm, memoryview]:
    """Return the zip member for an array: its form, and the bytes after its header."""
    (form, kind), of = _make_member_form(name, array.dtype, array.shape), array.data
    if not kind and of.nbytes and of.c_contiguous:
        return form, of.cast("B")
    return form, np.asarray(array, order="C").astype(kind or array.dtype, copy=False).reshape(-1).view(_BYTE_TYPE).data


@lru_cache(1024)  # arrays of consecutive frames usually have equal shapes
def _make_member_form(name: str, dtype: np.dtype[Any], shape: tuple[int, ...]) -> tuple[MemberForm, str]:
    """Return the form of the zip member for an array with this name, type and shape, and the type to which to convert the array.

    The returned type is empty if no conversion is needed."""
    kind = _encode_type(name, dtype)
    as_it_is = dtype.isnative and dtype.str == kind
    return make_member_form(f"{name}.npy", _make_header(kind, shape), dtype.itemsize * prod(shape)), "" if as_it_is else kind


def write_member(
    file: zipfile.ZipFile, name: str, dtype: np.dtype[Any], shape: tuple[int, ...], parts: Iterable[NDArray[Any]]
) -> None:
    """Add an array with this type and shape to an open NPZ file. `parts`: consecutive ranges of its rows, one in memory at a
    time."""
    entry = zipfile.ZipInfo(f"{name}.npy", _FIXED_DATE)
    kind = _encode_type(name, dtype)
    with file.open(entry, "w", force_zip64=True) as member:
        member.write(_make_header(kind, shape))
        for part in parts:
            member.write(np.asarray(part, order="C").astype(kind, copy=False).tobytes())


def _encode_type(name: str, dtype: np.dtype[Any]) -> str:
    """Return the code of a type in the file format. Raises ValueError for a type that cannot be stored."""
    kind = dtype.newbyteorder("<").str
    if kind not in ALLOWED_DTYPES:
        raise ValueError(f"array `{name}` of type {dtype} cannot be stored")
    return kind


def _make_header(kind: str, shape: tuple[int, ...]) -> bytes:
    """Return the header of an array in NumPy's format. `kind`: the code of its type."""
    header = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape!r}, }}".encode("ascii")
    header += b" " * (-(len(NPY_MAGIC) + 2 + len(header) + 1) % 64) + b"\n"
    return NPY_MAGIC + len(header).to_bytes(2, "little") + header


def read_npz(path: Path, names: Container[str] | None = None) -> dict[str, NDArray[Any]]:
    """Return the arrays of a file that `encode_npz` wrote, after checking their checksums. `names`: the arrays to return; None
    for all.

    Raises ArrayFileError for any other file, and OSError for a file that cannot be opened. Links are not followed."""
    try:
        with open_size_limited(path, MAX_FILE_BYTES, follows_links=False) as file:
            return read_npz_archive(file, os.fstat(file.fileno()).st_size, names)
    except FileTooLargeError as error:
        raise ArrayFileError(f"has {error.size:,} bytes, more than the limit of {error.cap:,}") from None
