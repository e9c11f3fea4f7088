"""NPZ files of plain arrays, written whole and read with suspicion: no pickle, no compression, sizes held against the file.

The layout is NumPy's own (NEP 1 inside an uncompressed zip), so that `numpy.load` of any other program reads what is written
here."""

from __future__ import annotations

import io
import os
import re
import zipfile
from collections.abc import Mapping
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl import limits

MEMBERS = 4096
FILE_BYTES = 64 * limits.GIB
_MAGIC = b"\x93NUMPY\x01\x00"
_DTYPES = ("<f4", "<f8", "<i4", "<i8", "<i2", "|i1", "|u1", "<u2", "<u4", "<u8", "|b1")
_HEADER = re.compile(
    r"\{'descr': '([<|][fiub][1248])', 'fortran_order': (False), 'shape': (\((?:[0-9]{1,18}, ?)*(?:[0-9]{1,18})?,?\)), *\} *\n?",
    re.ASCII,
)
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.\-#>|/]*", re.ASCII)
_STAMP = (1980, 1, 1, 0, 0, 0)  # the same arrays give the same bytes, whenever they are written


class ArrayFileError(Exception):
    """Why a file is not one of ours, or not whole, in words that fit after its name."""


def to_bytes(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """The bytes of an NPZ file with these arrays, in order."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED, allowZip64=True) as file:
        for name, array in arrays.items():
            file.writestr(zipfile.ZipInfo(f"{name}.npy", _STAMP), _npy(name, array))
    return buffer.getvalue()


def _npy(name: str, array: NDArray[Any]) -> bytes:
    array = np.asarray(array, order="C")
    kind = array.dtype.newbyteorder("<").str
    if kind not in _DTYPES:
        raise ValueError(f"array `{name}` of type {array.dtype} cannot be kept")
    header = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {array.shape!r}, }}".encode("ascii")
    padding = -(len(_MAGIC) + 2 + len(header) + 1) % 64
    header += b" " * padding + b"\n"
    return b"".join((_MAGIC, len(header).to_bytes(2, "little"), header, array.astype(kind, copy=False).tobytes()))


def write_whole(path: Path, data: bytes, *, sync: bool) -> None:
    """Put a file in place in one go: a reader, or a later run after a crash, sees all of it or nothing."""
    temporary = path.with_name(f".{path.name}.part")
    with open(temporary, "wb") as file:
        file.write(data)
        if sync:
            file.flush()
            os.fsync(file.fileno())
    _replace(temporary, path)
    if sync:
        sync_folder(path.parent)


def _replace(temporary: Path, path: Path) -> None:
    """`os.replace`; where a reader may hold the old file open (Windows) a few more times."""
    for attempt in range(5):
        try:
            os.replace(temporary, path)
            return
        except PermissionError:
            if attempt == 4:
                raise
            import time

            time.sleep(0.02 * 2**attempt)


def sync_file(path: Path) -> None:
    """Make sure that a file written before is on the disk."""
    handle = os.open(path, os.O_RDWR)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def sync_folder(folder: Path) -> None:
    """Make the names in a folder durable, where the system can."""
    if os.name == "nt":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def read_npz(path: Path) -> dict[str, NDArray[Any]]:
    """All arrays of a file that `to_bytes` wrote, checksums compared; ArrayFileError says what is wrong with any other."""
    try:
        with open(path, "rb") as file:
            size = os.fstat(file.fileno()).st_size
            if size > FILE_BYTES:
                raise ArrayFileError(f"has {size:,} bytes, more than {FILE_BYTES:,}")
            with zipfile.ZipFile(file) as archive:
                return _members(archive, size)
    except (zipfile.BadZipFile, EOFError, NotImplementedError, RuntimeError, ValueError, OverflowError) as problem:
        raise ArrayFileError(f"is damaged or no array file ({problem})") from None


def _members(archive: zipfile.ZipFile, size: int) -> dict[str, NDArray[Any]]:
    entries = archive.infolist()
    if len(entries) > MEMBERS:
        raise ArrayFileError(f"has {len(entries):,} arrays, more than {MEMBERS:,}")
    if sum(entry.file_size for entry in entries) > size:
        raise ArrayFileError("says it holds more than its own size")
    found: dict[str, NDArray[Any]] = {}
    for entry in entries:
        name = entry.filename.removesuffix(".npy")
        if not entry.filename.endswith(".npy") or not _NAME.fullmatch(name) or ".." in name or "//" in name:
            raise ArrayFileError(f"has a member of a strange name `{entry.filename[:40]!r}`")
        if name in found:
            raise ArrayFileError(f"has two arrays `{name}`")
        if entry.compress_type != zipfile.ZIP_STORED or entry.flag_bits & 0x1 or entry.compress_size != entry.file_size:
            raise ArrayFileError(f"has a compressed or locked array `{name}`")
        found[name] = parse_npy(archive.read(entry), name)  # read compares the checksum
    return found


def parse_npy(data: bytes, name: str) -> NDArray[Any]:
    """One array from the bytes of an .npy file, version 1; the shape is held against the number of bytes before use."""
    if not data.startswith(_MAGIC) or len(data) < 10:
        raise ArrayFileError(f"has an array `{name}` of an unknown kind")
    length = int.from_bytes(data[8:10], "little")
    header = _HEADER.fullmatch(data[10 : 10 + length].decode("latin-1"))
    if header is None or header[1] not in _DTYPES:
        raise ArrayFileError(f"has an array `{name}` whose header is not understood")
    shape = tuple(int(part) for part in re.findall("[0-9]+", header[3]))
    dtype = np.dtype(header[1])
    if len(shape) > 8 or prod(shape) * dtype.itemsize != len(data) - 10 - length:
        raise ArrayFileError(f"has an array `{name}` whose shape does not fit its size")
    return np.frombuffer(data, dtype, offset=10 + length).reshape(shape)
