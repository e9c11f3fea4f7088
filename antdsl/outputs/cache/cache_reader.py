"""Reading of a cache: its frames and their content, checkpoints and hashes. Everything is checked before use.

manifest.json                         the inputs of the cache, and how to read it
static.npz                            meshes, positions of field cells
frames/frame.1001.npz                 one per frame: agents, fields, items
checkpoints/checkpoint.1050.npz       everything needed to continue from this frame
hashes.jsonl                          by frame, hashes of the complete state, the frame file and the checkpoint file"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.outputs.cache.hashes import HASHES, Line, checkpoint_damage, damage, read_lines, static_damage
from antdsl.outputs.cache.manifest import MANIFEST, CameraEntry, Manifest, read_manifest
from antdsl.outputs.cache.npz import ArrayFileError, read_npz

MARKER = ".antdsl-cache"
STATIC = "static.npz"
NAMES = ("frames", "checkpoints", STATIC, HASHES, MANIFEST, MARKER)  # the entries of a cache's folder
SURFACE_ERROR = "surface_error"  # in a checkpoint: the greatest surface error of all frames up to it
_NUMBERED = re.compile(r"[a-z]+\.(-?[0-9]{1,10})\.npz", re.ASCII)

Arrays = Mapping[str, NDArray[Any]]


class CacheError(Exception):
    """Reason why a part of a cache cannot be used. The message is complete without context."""


def frame_path(folder: Path, frame: int) -> Path:
    """Return the path of a frame's file. Its number has at least four digits, as in the names of pictures."""
    return folder / f"frames/frame.{frame:04d}.npz"


def checkpoint_path(folder: Path, frame: int) -> Path:
    """Return the path of a frame's checkpoint file."""
    return folder / f"checkpoints/checkpoint.{frame:04d}.npz"


def numbered_files(folder: Path, path: Callable[[Path, int], Path]) -> tuple[list[int], list[Path]]:
    """Return the numbers of the frames or checkpoints in a cache's folder, ascending, and the files with invalid names.

    `path`: returns the path of a frame's or checkpoint's file from the folder and the number.
    The second list has files in the same folder with names such as `frame.12.npz`."""
    place = path(folder, 0).parent
    numbers, strays = [], []
    for each in place.iterdir() if place.is_dir() else ():
        match = _NUMBERED.fullmatch(each.name)
        if match and path(folder, int(match[1])).name == each.name:
            numbers.append(int(match[1]))
        elif each.name.endswith(".npz") and not each.name.startswith("."):
            strays.append(each)
    return sorted(numbers), sorted(strays)


@dataclass(frozen=True, slots=True, eq=False)
class Cache:
    """A cache on disk. Use `open_cache` to get one."""

    folder: Path
    manifest: Manifest

    def frames(self) -> list[int]:
        """Return the numbers of the existing frames, ascending."""
        return numbered_files(self.folder, frame_path)[0]

    def checkpoints(self) -> list[int]:
        """Return the numbers of the frames that have a checkpoint, ascending."""
        return numbered_files(self.folder, checkpoint_path)[0]

    def strays(self) -> list[str]:
        """Return a message for each ignored file in the folders of frames and checkpoints. Each message is complete without
        context."""
        return [
            f"`{stray}` is not a {what} of this cache: {what}s have names such as `{path(self.folder, 12).name}`"
            for what, path in (("frame", frame_path), ("checkpoint", checkpoint_path))
            for stray in numbered_files(self.folder, path)[1]
        ]

    def frame(self, number: int, only: frozenset[str] | None = None) -> Arrays:
        """Return the arrays of a frame in the documented format. Raises CacheError if the frame is missing or damaged.

        `only`: the names of the arrays to return; None for all."""
        return _read(frame_path(self.folder, number), number, only)

    def checkpoint(self, number: int) -> Arrays:
        """Return all arrays needed to continue from a frame. Raises CacheError if the checkpoint is missing or damaged."""
        return _read(checkpoint_path(self.folder, number), number)

    def static(self) -> Arrays:
        """Return the arrays of `static.npz`, in scene units. Raises CacheError if the file is damaged or lacks an array that
        the manifest needs.

        Among them are meshes (`mesh.NAME.vertices`, `.faces`) and positions of field cells (`field.NAME.P`)."""
        arrays = _read(self.folder / STATIC, None)
        for name in _static_names(self.manifest, arrays):
            if name not in arrays:
                raise CacheError(f"`{self.folder / STATIC}` has no `{name}`, and the manifest names it")
        return arrays

    def source_files(self) -> list[Path]:
        """Return the files that the scene was made from, without those that no longer exist. Empty if the manifest names no
        scene."""
        if self.manifest.scene_path is None:
            return []
        scene = Path(os.path.normpath(self.folder.resolve() / self.manifest.scene_path))
        return [each for each in (scene, *(scene.parent / name for name in self.manifest.inputs)) if each.is_file()]

    def hashes(self) -> dict[int, str]:
        """Return the state hash of each frame. An incomplete last line, left by a crash, is ignored."""
        return {frame: line.hash for frame, line in self.lines().items()}

    def lines(self) -> dict[int, Line]:
        """Return the complete lines of `hashes.jsonl`, by frame."""
        return read_lines(self.folder / HASHES)

    def damage(self, frame: int, line: Line | None) -> str | None:
        """Return a message on damage to a frame's file, or None if its bytes are those that were written. `line`: the line of the
        frame."""
        return damage(frame_path(self.folder, frame), frame, line)

    def checkpoint_damage(self, frame: int, line: Line | None) -> str | None:
        """Return a message on damage to a checkpoint, or None. An unreadable checkpoint is damaged too.

        `line`: the line of the frame. If it has no hash of the checkpoint, changed bytes are not detected."""
        return checkpoint_damage(checkpoint_path(self.folder, frame), frame, line) or _read_problem(
            lambda: self.checkpoint(frame)
        )

    def static_damage(self) -> str | None:
        """Return a message on damage to `static.npz`, or None."""
        expected = self.manifest.static
        return (static_damage(self.folder / STATIC, expected) if expected else None) or _read_problem(self.static)


def open_cache(folder: Path) -> Cache:
    """Return the cache in a folder. Raises ManifestError with the reason if there is none."""
    return Cache(folder, read_manifest(folder))


def _read_problem(read: Callable[[], object]) -> str | None:
    """Return the message of the CacheError that `read` raises, or None."""
    try:
        read()
    except CacheError as why:
        return str(why)
    return None


def _static_names(manifest: Manifest, arrays: Arrays) -> Iterator[str]:
    """Yield the names of the arrays that must exist: those that the manifest's entries need, and the vectors of each stored
    flow."""
    for mesh in manifest.meshes:
        if not mesh.row.is_dug:
            yield from (f"mesh.{mesh.name}.vertices", f"mesh.{mesh.name}.faces")
    if isinstance(manifest.camera, CameraEntry) and manifest.camera.moves:
        yield from (f"camera.{name}" for name in ("at", "look_at", "up", "focal"))
    yield from (f"field.{field.name}.P" for field in manifest.fields)
    yield from (f"{name.removesuffix('P')}V" for name in arrays if name.startswith("flow.") and name.endswith(".P"))


def _read(path: Path, number: int | None, only: frozenset[str] | None = None) -> Arrays:
    try:
        arrays = read_npz(path, None if only is None else only | {"frame"})
    except FileNotFoundError:
        raise CacheError(f"`{path}` is not there") from None
    except OSError as why:
        raise CacheError(f"`{path}` cannot be read: {(why.strerror or str(why)).lower()}") from None
    except ArrayFileError as why:
        raise CacheError(f"`{path}` {why}") from None
    if number is not None:
        said = arrays.get("frame")
        if said is None or said.shape != () or said.dtype.kind not in "iu" or int(said) != number:
            raise CacheError(f"`{path}` does not hold frame {number}")
    return arrays


def scalar(value: int) -> NDArray[np.int64]:
    """Return an integer as an int64 array without dimensions."""
    return np.array(value, np.int64)
