"""Input bundles: the files of a project, packed with their paths and a hash to be sent to other machines."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePath

from antdsl.executors.tasks import TaskRejectedError
from antdsl.limits import MAX_BUNDLE_BYTES
from antdsl.safe_read import read_size_limited


@dataclass(frozen=True, slots=True)
class FileBundle:
    """A bundle of files to send to other machines.

    `files`: contents by path, relative to the folder into which they are unpacked. `digest`: a hash of paths and contents."""

    files: Mapping[str, bytes]
    digest: str

    def unpack(self, folder: Path) -> None:
        """Write the files below a folder. Raises TaskRejectedError if the hash is wrong, or if a path leads out of the folder."""
        if hash_files(self.files) != self.digest:
            raise TaskRejectedError("the project's files were changed during the transfer")
        for name, content in self.files.items():
            path = folder / name
            if not path.resolve().is_relative_to(folder.resolve()):
                raise TaskRejectedError(f"the path of a project file leads out of the project's folder: `{name}`")
            path.parent.mkdir(parents=True, exist_ok=True)
            with open(path, "xb") as file:
                file.write(content)


@dataclass(frozen=True, slots=True)
class VisibleFile:
    """A file that shows whether a machine shares the requester's folders: the machine does if it has the same file. `path`: its
    path. `digest`: a hash of its content."""

    path: str
    digest: str

    @classmethod
    def from_path(cls, path: Path) -> VisibleFile:
        """Return an object for the file at `path`. Raises OSError if there is no such file."""
        absolute_path = os.path.abspath(path)
        return cls(absolute_path, hash_files({"": read_size_limited(absolute_path, MAX_BUNDLE_BYTES)}))

    def is_visible(self) -> bool:
        """Return whether this machine has a file with this path and content."""
        try:
            return VisibleFile.from_path(Path(self.path)) == self
        except OSError:
            return False


def pack_files(paths: Iterable[Path]) -> FileBundle:
    """Return a bundle of regular files. Raises TaskRejectedError if their total size exceeds `MAX_BUNDLE_BYTES`, and OSError if
    one cannot be read."""
    files: dict[str, bytes] = {}
    left = MAX_BUNDLE_BYTES
    for path in sorted({Path(os.path.abspath(path)) for path in paths}):
        content = read_size_limited(path, MAX_BUNDLE_BYTES)
        left -= len(content)
        if left < 0:
            raise TaskRejectedError(f"the files of the scenes exceed {MAX_BUNDLE_BYTES >> 20} MiB, the limit for a transfer")
        files[_make_relative_path(path)] = content
    return FileBundle(files, hash_files(files))


def find_unpacked_path(folder: Path, path: str) -> Path:
    """Return the path of a bundled file on this machine. `folder`: the folder into which the bundle was unpacked."""
    return folder / _make_relative_path(Path(path))


def _make_relative_path(path: PurePath) -> str:
    """Return an absolute path as one relative to a folder: `/shots/a.yaml` as `shots/a.yaml`, `C:\\\\shots` as `C/shots`."""
    drive = path.drive.replace(":", "").replace("\\", "_")
    return "/".join([*([drive] if drive else []), *path.parts[1:]])


def hash_files(files: Mapping[str, bytes]) -> str:
    """Return a hash of paths and contents."""
    hashed = hashlib.blake2b(digest_size=16)
    for name, content in files.items():
        hashed.update(f"{name}\0{len(content)}\0".encode())
        hashed.update(content)
    return hashed.hexdigest()
