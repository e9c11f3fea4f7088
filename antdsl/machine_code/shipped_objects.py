"""Reads the object files of the package's own kernels and LLVM IR texts. `build_objects` compiled them when the package was
installed. The folder `objects` of this package has one file per target. It consists of an index (key → position, size, hash)
and the object files. Object code is executed, so these files are read from the installation only. No variable, option or
working directory can name another folder. Each object file is compared with its hash before use. Object files for other
versions of LLVM or of the sources have other keys, so they are never used. No file system error is raised."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from functools import cache
from hashlib import blake2b
from pathlib import Path
from typing import IO, Final

from antdsl.diagnostics.model import replace_unprintable
from antdsl.limits import MIB
from antdsl.machine_code import object_cache
from antdsl.machine_code.llvm_compiler import Target
from antdsl.safe_read import open_size_limited

OBJECTS_FOLDER: Final = Path(__file__).resolve().parent / "objects"
_MAX_FILE_BYTES: Final = 64 * MIB  # of one file
_FILE_MAGIC: Final = b"antdsl objects 1"
_HEADER_STRUCT: Final = struct.Struct(f"<{len(_FILE_MAGIC)}s32sQ")  # magic, hash of the index, number of entries
_ENTRY_STRUCT: Final = struct.Struct("<32sQQ32s")  # key, position behind the index, size, hash
# Features that code for these levels of x86-64 may use (x86-64 psABI, section 3.1.1), without `fma`. Carry-less products are
# added, which all processors of these levels have. `llvm_compiler` explains why 512-bit registers require `avx512vbmi2`.
_X86_V3_FEATURES: Final = (
    "64bit", "cmov", "cx8", "fxsr", "mmx", "sse", "sse2", "cx16", "popcnt", "sahf", "sse3", "sse4.1", "sse4.2", "ssse3", "crc32",
    "avx", "avx2", "bmi", "bmi2", "f16c", "lzcnt", "movbe", "xsave", "pclmul",
)  # fmt: skip
_X86_V4_FEATURES: Final = (
    *_X86_V3_FEATURES,
    "avx512f",
    "avx512bw",
    "avx512cd",
    "avx512dq",
    "avx512vl",
    "avx512vbmi2",
    "vpclmulqdq",
)


def _format_feature_text(present_features: tuple[str, ...], absent_features: tuple[str, ...]) -> str:
    """Return processor features as a text in LLVM's format: `+` before present features, `-` before absent ones."""
    return ",".join([*(f"+{name}" for name in present_features), *(f"-{name}" for name in absent_features)])


# By name, the widest registers first. Fused operations are disabled, as in `llvm_compiler.format_features`.
TARGET_BY_NAME: Final[Mapping[str, Target]] = {
    "x86-64-v4": Target("x86_64-unknown-linux-gnu", "x86-64-v4", _format_feature_text(_X86_V4_FEATURES, ("fma4",))),
    "x86-64-v3": Target(
        "x86_64-unknown-linux-gnu", "x86-64-v3", _format_feature_text(_X86_V3_FEATURES, ("fma", "fma4", "avx512f"))
    ),
    "aarch64": Target("aarch64-unknown-linux-gnu", "generic", "+neon"),
}


@cache
def find_target_name(host: Target) -> str | None:
    """Return the name of a shipped target with code that `host` can run with equal results; None if there is none."""
    if "linux" not in host.triple:
        return None
    present = _list_present_features(host)
    for name, target in TARGET_BY_NAME.items():
        levels = target.is_x86 and host.is_x86 and _list_present_features(target) <= present
        if levels or (target.is_arm and host.is_arm):
            return name
    return None


def _list_present_features(target: Target) -> set[str]:
    """Return the names of the enabled features of a target."""
    return {word[1:] for word in target.features.split(",") if word.startswith("+")}


def compute_shipped_key(text_or_name: str, target: Target) -> str:
    """Return the key of an object file. `text_or_name`: the LLVM IR or its unique name. `target`: the target it is compiled
    for."""
    return object_cache.compute_object_key(text_or_name, target, versions=object_cache.list_code_versions())


def find_object(text_or_name: str, host: Target) -> bytes | None:
    """Return the installed object file of an LLVM IR text for the processor `host`; None if the installation has none.
    `text_or_name`: the text or its unique name."""
    name = find_target_name(host)
    return (
        None if name is None else _open_objects(OBJECTS_FOLDER, name).get(compute_shipped_key(text_or_name, TARGET_BY_NAME[name]))
    )


def make_objects_path(folder: Path, name: str) -> Path:
    """Return the path of the file with the compiled objects of the target `name`."""
    return folder / f"{name}.objects"


def take_messages() -> list[str]:
    """Return sentences that tell the user why object files of the installation are not used. None is repeated."""
    return (
        []
        if _damaged_file is None
        else [f"compiled code in `{replace_unprintable(str(_damaged_file))}` is damaged: install antdsl again"]
    )


def close_files() -> None:
    """Close the object files of the installation. They are opened again when needed."""
    global _damaged_file
    _damaged_file = None
    _open_objects.cache_clear()


@cache
def _open_objects(folder: Path, name: str) -> ObjectFile:
    return ObjectFile(make_objects_path(folder, name))


class ObjectFile:
    """One file of the installation with many object files, by key. Its index is read once. A missing or invalid file is
    treated as empty."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._index: dict[bytes, tuple[int, int, bytes]] = {}
        try:
            with open_size_limited(path, _MAX_FILE_BYTES) as file:
                self._read_index(file)
        except FileNotFoundError:
            pass
        except OSError:
            _report_damaged_file(path)

    def _read_index(self, file: IO[bytes]) -> None:
        head = file.read(_HEADER_STRUCT.size)
        magic, checked, count = _HEADER_STRUCT.unpack(head) if len(head) == _HEADER_STRUCT.size else (b"", b"", 0)
        index = file.read(min(_MAX_FILE_BYTES, count * _ENTRY_STRUCT.size))
        if magic != _FILE_MAGIC or _hash_data(index) != checked:
            _report_damaged_file(self._path)
            return
        for key, position, size, content in _ENTRY_STRUCT.iter_unpack(index):
            self._index[key] = (_HEADER_STRUCT.size + len(index) + position, size, content)

    def __len__(self) -> int:
        return len(self._index)

    def get(self, key: str) -> bytes | None:
        """Return the object file stored under `key`, or None if it is missing or damaged."""
        entry = self._index.get(bytes.fromhex(key))
        if entry is None:
            return None
        position, size, content = entry
        try:
            with open_size_limited(self._path, _MAX_FILE_BYTES) as file:
                file.seek(position)
                code = file.read(size)
        except OSError:
            code = b""
        if _hash_data(code) != content:
            _report_damaged_file(self._path)
            return None
        return code


def pack_objects(codes: Mapping[str, bytes]) -> bytes:
    """Return the content of a file that stores these object files by key. The content depends on nothing else."""
    index, position = [], 0
    for key, code in sorted(codes.items()):
        index.append(_ENTRY_STRUCT.pack(bytes.fromhex(key), position, len(code), _hash_data(code)))
        position += len(code)
    entries = b"".join(index)
    return (
        _HEADER_STRUCT.pack(_FILE_MAGIC, _hash_data(entries), len(index))
        + entries
        + b"".join(code for _, code in sorted(codes.items()))
    )


_damaged_file: Path | None = None


def _report_damaged_file(path: Path) -> None:
    global _damaged_file
    _damaged_file = path


def _hash_data(data: bytes) -> bytes:
    return blake2b(data, digest_size=32).digest()
