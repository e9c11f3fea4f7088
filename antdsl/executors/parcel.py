"""Input bundles: files under their original paths, as one byte string with a hash. The files of a project travel to other
machines this way, once."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePath

from antdsl.bounded import read_bounded
from antdsl.executors.tasks import TaskRefused
from antdsl.limits import BUNDLE_BYTES


@dataclass(frozen=True, slots=True)
class FileBundle:
    """`data`: the length of a table of contents in 8 bytes, the table as JSON (paths and sizes, in order), the files."""

    data: bytes
    digest: str

    def unpack(self, folder: Path) -> None:
        """Write the files below a folder, each at `inside(folder, its path)`. Raises Refused if the data does not match the
        hash."""
        if _digest(self.data) != self.digest:
            raise TaskRefused("the files of the project did not arrive as they were sent")
        start = 8 + int.from_bytes(self.data[:8], "little")
        for name, size in json.loads(self.data[8:start]):
            path = folder / name
            if not path.resolve().is_relative_to(folder.resolve()):
                raise TaskRefused(f"a file of the project would be put outside of its folder: `{name}`")
            path.parent.mkdir(parents=True, exist_ok=True)
            with open(path, "xb") as file:
                file.write(self.data[start : start + size])
            start += size


@dataclass(frozen=True, slots=True)
class VisibleFile:
    """A file that identifies machines with the same folders: its path, and a hash of its content."""

    path: str
    digest: str

    @classmethod
    def of(cls, path: Path) -> VisibleFile:
        """OSError where there is no such file."""
        absolute_path = Path(os.path.abspath(path))
        return cls(str(absolute_path), _digest(read_bounded(absolute_path, BUNDLE_BYTES)))

    def is_visible(self) -> bool:
        """Whether it is seen here."""
        try:
            return _digest(read_bounded(self.path, BUNDLE_BYTES)) == self.digest
        except OSError:
            return False


def pack(paths: Iterable[Path]) -> FileBundle:
    """Return an input bundle of regular files. Raises Refused if they are more than `BUNDLE_BYTES` together, OSError if one
    cannot be read."""
    files: dict[str, bytes] = {}
    left = BUNDLE_BYTES
    for path in sorted({Path(os.path.abspath(path)) for path in paths}):
        content = read_bounded(path, BUNDLE_BYTES)
        left -= len(content)
        if left < 0:
            raise TaskRefused(f"the files that the scenes read are more than {BUNDLE_BYTES >> 20} MiB, and more do not travel")
        files[_relative_path(path)] = content
    return _pack_files(files)


def _pack_files(files: Mapping[str, bytes]) -> FileBundle:
    table = json.dumps([[name, len(content)] for name, content in files.items()]).encode()
    data = b"".join((len(table).to_bytes(8, "little"), table, *files.values()))
    return FileBundle(data, _digest(data))


def unpacked_path(folder: Path, path: str) -> Path:
    """Return the path of a bundled file below the folder that the bundle was unpacked into."""
    return folder / _relative_path(Path(path))


def _relative_path(path: PurePath) -> str:
    """Return an absolute path as one relative to a folder: `/shots/a.yaml` as `shots/a.yaml`, `C:\\\\shots` as `C/shots`."""
    drive = path.drive.replace(":", "").replace("\\", "_")
    return "/".join([*([drive] if drive else []), *path.parts[1:]])


def _digest(data: bytes) -> str:
    return hashlib.blake2b(data, digest_size=16).hexdigest()
