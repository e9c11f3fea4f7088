"""A .usdz package: unpacked here, never by USD, and written again as USD expects it.

USD's own reader of packages thus sees packages of ours alone: stored members with plain names, each once, and layers only. Two
readers of one zip file could otherwise see different members in it."""

from __future__ import annotations

import io
import posixpath
import re
import struct
import zipfile

from antdsl import limits
from antdsl.reader.refusal import shown

LAYERS = (".usd", ".usda", ".usdc")
_ALIGNMENT = 64  # of the data of each member (USDZ specification)
_PADDING = 0x1986  # the extra field by which USD pads
_END = struct.Struct("<4s4H2LH")
_NAME = re.compile(r"[^\x00-\x1f\x7f\\:\[\]<>|*?\"@`]{1,255}")


class PackageError(Exception):
    """Why a package is not read, in words that fit after its name."""


def layers_of(data: bytes) -> dict[str, bytes]:
    """The layers of a package by name, the first being the one that stands for the package. PackageError where the file is no
    package, or has a member that a package must not have. Other members, such as textures, are left out."""
    _check_end(data)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return _layers(archive, len(data))
    except (zipfile.BadZipFile, EOFError, NotImplementedError, RuntimeError, ValueError, OverflowError, struct.error):
        raise PackageError("is damaged, or no zip file") from None


def _check_end(data: bytes) -> None:
    """Compare the number of members and the size of the directory with the limits before a member is looked at."""
    place = data.rfind(b"PK\5\6", max(0, len(data) - _END.size - 0xFFFF))
    if place < 0 or place + _END.size > len(data):
        raise PackageError("is damaged, or no zip file")
    _, _, _, _, count, size, _, _ = _END.unpack_from(data, place)
    if count > limits.PACKAGE_PARTS or size > 512 * limits.PACKAGE_PARTS:
        raise PackageError(f"has {count:,} members, and more than {limits.PACKAGE_PARTS:,} are not read")


def _layers(archive: zipfile.ZipFile, size: int) -> dict[str, bytes]:
    entries = archive.infolist()
    if len(entries) > limits.PACKAGE_PARTS:
        raise PackageError(f"has {len(entries):,} members, and more than {limits.PACKAGE_PARTS:,} are not read")
    if sum(entry.file_size for entry in entries) > size:
        raise PackageError("says that it holds more than its own size")
    seen: set[str] = set()
    for entry in entries:
        _check_member(entry, seen)
    layers = [entry for entry in entries if entry.filename.lower().endswith(LAYERS)]
    if not layers or layers[0] is not entries[0]:
        raise PackageError("does not begin with a layer")
    return {entry.filename: archive.read(entry) for entry in layers}  # reading compares the checksum


def _check_member(entry: zipfile.ZipInfo, seen: set[str]) -> None:
    name = entry.orig_filename
    told = f"`{shown(name[:60])}`"
    parts = name.removesuffix("/").split("/")
    if not all(_NAME.fullmatch(part) and part not in (".", "..") for part in parts) or len(name) > 4096:
        raise PackageError(f"has a member {told} with a name that is absolute, leaves the package or is no plain name")
    if posixpath.normcase(name) in seen:
        raise PackageError(f"has two members {told}")
    seen.add(name)
    if entry.flag_bits & 0x41:
        raise PackageError(f"has an encrypted member {told}")
    if entry.compress_type != zipfile.ZIP_STORED or entry.compress_size != entry.file_size:
        raise PackageError(f"has a compressed member {told}, and those of a .usdz are stored")
    kind = entry.external_attr >> 28
    if kind not in (0, 4, 8):  # file types of Unix: none given, a folder, a regular file
        raise PackageError(f"has a member {told} that is a link or a device")


def packed(layers: dict[str, bytes]) -> bytes:
    """A package of these layers."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
        for name, data in layers.items():
            entry = zipfile.ZipInfo(name)
            begin = file.tell() + 30 + len(name.encode()) + 4
            padding = -begin % _ALIGNMENT
            entry.extra = struct.pack("<HH", _PADDING, padding) + bytes(padding)
            archive.writestr(entry, data)
    return file.getvalue()
