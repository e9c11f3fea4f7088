"""Reads arrays from files: NPZ files from bytes or from an open archive. Also converts values to float64.

The content of a file is never trusted: pickle and compression are errors, and all sizes are compared with the size of the file.
The layout is NumPy's own (NEP 1 inside an uncompressed zip), so files of `numpy.savez` can be read."""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Container
from math import prod
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

MAX_ARCHIVE_MEMBERS = 4096
NPY_MAGIC = b"\x93NUMPY\x01\x00"
ALLOWED_DTYPES = ("<f4", "<f8", "<i4", "<i8", "<i2", "|i1", "|u1", "<u2", "<u4", "<u8", "|b1")
_HEADER_PATTERN = re.compile(
    r"\{'descr': '([<|][fiub][1248])', 'fortran_order': (False), 'shape': (\((?:[0-9]{1,18}, ?)*(?:[0-9]{1,18})?,?\)), *\} *\n?",
    re.ASCII,
)
_MEMBER_NAME_PATTERN = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.\-#>|~/]*", re.ASCII)


class ArrayFileError(Exception):
    """Error for a file that is incomplete or not in the expected format. The message is a reason that fits after the file's
    name."""


def read_arrays(data: bytes) -> dict[str, NDArray[Any]]:
    """Return all arrays in the bytes of an NPZ file, after a check of the checksums. Raises ArrayFileError with the reason."""
    return read_npz_archive(io.BytesIO(data), len(data))


def read_npz_archive(file: IO[bytes], size: int, names: Container[str] | None = None) -> dict[str, NDArray[Any]]:
    """Return the arrays of an open file of `size` bytes, like `read_arrays`. `names`: the names to read; None for all."""
    try:
        with zipfile.ZipFile(file) as archive:
            return _read_members(archive, size, names)
    # NotImplementedError: raised by zipfile for an unknown compression
    except (zipfile.BadZipFile, EOFError, NotImplementedError, RuntimeError, ValueError, OverflowError) as problem:
        raise ArrayFileError(f"is damaged or not an array file ({problem})") from None


def _read_members(archive: zipfile.ZipFile, size: int, names: Container[str] | None) -> dict[str, NDArray[Any]]:
    """Return the arrays of an open archive of `size` bytes. `names`: the names to read; None for all. Raises ArrayFileError, or
    an error of `zipfile`."""
    entries = archive.infolist()
    if len(entries) > MAX_ARCHIVE_MEMBERS:
        raise ArrayFileError(f"has {len(entries):,} arrays, more than {MAX_ARCHIVE_MEMBERS:,}")
    if sum(entry.file_size for entry in entries) > size:
        raise ArrayFileError("declares more data than its size")
    arrays: dict[str, NDArray[Any]] = {}
    for entry in entries:
        name = entry.filename.removesuffix(".npy")
        if not entry.filename.endswith(".npy") or not _MEMBER_NAME_PATTERN.fullmatch(name) or ".." in name or "//" in name:
            raise ArrayFileError(f"has a member with an invalid name `{entry.filename[:40]!r}`")
        if name in arrays:
            raise ArrayFileError(f"has two arrays `{name}`")
        if entry.compress_type != zipfile.ZIP_STORED or entry.flag_bits & 0x1 or entry.compress_size != entry.file_size:
            raise ArrayFileError(f"has a compressed or locked array `{name}`")
        if names is None or name in names:
            arrays[name] = parse_npy(archive.read(entry), name)  # read compares the checksum
    return arrays


def parse_npy(data: bytes, name: str) -> NDArray[Any]:
    """Return the array in the bytes of an .npy file of version 1. Before the array is read, its shape is compared with the
    number of bytes."""
    if not data.startswith(NPY_MAGIC) or len(data) < 10:
        raise ArrayFileError(f"has an array `{name}` of an unknown kind")
    length = int.from_bytes(data[8:10], "little")
    header = _HEADER_PATTERN.fullmatch(data[10 : 10 + length].decode("latin-1"))
    if header is None or header[1] not in ALLOWED_DTYPES:
        raise ArrayFileError(f"has an array `{name}` with an unknown header")
    shape = tuple(int(part) for part in re.findall("[0-9]+", header[3]))
    dtype = np.dtype(header[1])
    if len(shape) > 8 or prod(shape) * dtype.itemsize != len(data) - 10 - length:
        raise ArrayFileError(f"has an array `{name}` with a shape that does not fit its size")
    return np.frombuffer(data, dtype, offset=10 + length).reshape(shape)


def convert_to_float64(values: NDArray[Any]) -> NDArray[np.float64]:
    """Return a copy as float64. Values may be infinite or nan; NumPy's warning about signalling nans is suppressed."""
    with np.errstate(invalid="ignore"):
        return values.astype(np.float64)
