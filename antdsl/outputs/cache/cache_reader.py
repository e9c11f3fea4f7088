"""A cache read: which frames there are, what is in one, which checkpoints and hashes. Nothing in it is trusted before it is
checked.

manifest.json                   what it was made from and how to read it
static.npz                      meshes, places of field cells
frames/frame.1001.npz           one a frame: agents, fields, items
checkpoints/checkpoint.1050.npz all that is needed to go on from there
hashes.jsonl                    a hash of the whole state, of the frame's file and of its checkpoint's, by frame
"""

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
NAMES = ("frames", "checkpoints", STATIC, HASHES, MANIFEST, MARKER)  # what lies in a cache's folder
SURFACE_ERROR = "surface_error"  # of a checkpoint: the greatest of all frames up to it
_NUMBERED = re.compile(r"[a-z]+\.(-?[0-9]{1,10})\.npz", re.ASCII)

Arrays = Mapping[str, NDArray[Any]]


class CacheError(Exception):
    """Why a part of a cache cannot be used, in words that stand alone."""


def frame_path(folder: Path, frame: int) -> Path:
    """Where a frame is kept; numbers have at least four digits, as frames in pictures do."""
    return folder / f"frames/frame.{frame:04d}.npz"


def checkpoint_path(folder: Path, frame: int) -> Path:
    return folder / f"checkpoints/checkpoint.{frame:04d}.npz"


def numbered(folder: Path, path: Callable[[Path, int], Path]) -> tuple[list[int], list[Path]]:
    """The numbers of the frames or checkpoints (as `path` writes their names) of a cache's folder, in order; and what lies among
    them under a name that none is written by, `frame.12.npz` for one."""
    place = path(folder, 0).parent
    found, strays = [], []
    for each in place.iterdir() if place.is_dir() else ():
        match = _NUMBERED.fullmatch(each.name)
        if match and path(folder, int(match[1])).name == each.name:
            found.append(int(match[1]))
        elif each.name.endswith(".npz") and not each.name.startswith("."):
            strays.append(each)
    return sorted(found), sorted(strays)


@dataclass(frozen=True, slots=True, eq=False)
class Cache:
    """A cache on disk. `open_cache` makes one."""

    folder: Path
    manifest: Manifest

    def frames(self) -> list[int]:
        """The frames that are there, in order."""
        return numbered(self.folder, frame_path)[0]

    def checkpoints(self) -> list[int]:
        """The frames that have a checkpoint, in order."""
        return numbered(self.folder, checkpoint_path)[0]

    def strays(self) -> list[str]:
        """Why files beside frames and checkpoints count for nothing, in words that stand alone."""
        return [
            f"`{stray}` is no {what} of this cache: {what}s have names such as `{path(self.folder, 12).name}`"
            for what, path in (("frame", frame_path), ("checkpoint", checkpoint_path))
            for stray in numbered(self.folder, path)[1]
        ]

    def frame(self, number: int, only: frozenset[str] | None = None) -> Arrays:
        """The arrays of a frame, or `only` those of some names, as the format says; CacheError when it is missing or damaged."""
        return _read(frame_path(self.folder, number), number, only)

    def checkpoint(self, number: int) -> Arrays:
        """All that is needed to go on from a frame; CacheError when it is missing or damaged."""
        return _read(checkpoint_path(self.folder, number), number)

    def static(self) -> Arrays:
        """Meshes (`mesh.NAME.vertices`, `.faces`) and places of field cells (`field.NAME.P`), in scene units. CacheError also
        where there is none of something that the manifest names."""
        arrays = _read(self.folder / STATIC, None)
        for name in _static_names(self.manifest, arrays):
            if name not in arrays:
                raise CacheError(f"`{self.folder / STATIC}` has no `{name}`, and the manifest names it")
        return arrays

    def made_from(self) -> list[Path]:
        """The files of the scene that it was made from, as far as they can be told and are where they were."""
        if self.manifest.scene_path is None:
            return []
        scene = Path(os.path.normpath(self.folder.resolve() / self.manifest.scene_path))
        return [each for each in (scene, *(scene.parent / name for name in self.manifest.inputs)) if each.is_file()]

    def hashes(self) -> dict[int, str]:
        """The hash of the state at each frame; a last line that was cut off by a crash is left out."""
        return {frame: line.hash for frame, line in self.lines().items()}

    def lines(self) -> dict[int, Line]:
        """What is known of each frame and its file, as far as it is whole."""
        return read_lines(self.folder / HASHES)

    def damage(self, frame: int, line: Line | None) -> str | None:
        """What is wrong with the file of a frame, None where it has the bytes that were written. `line`: what is known of it."""
        return damage(frame_path(self.folder, frame), frame, line)

    def checkpoint_damage(self, frame: int, line: Line | None) -> str | None:
        """The same for a checkpoint, which must hold together besides. One from before its hash was kept may have other bytes."""
        return checkpoint_damage(checkpoint_path(self.folder, frame), frame, line) or _unread(lambda: self.checkpoint(frame))

    def static_damage(self) -> str | None:
        """The same for `static.npz`."""
        kept = self.manifest.static
        return (static_damage(self.folder / STATIC, kept) if kept else None) or _unread(self.static)


def open_cache(folder: Path) -> Cache:
    """The cache in a folder; ManifestError says why there is none."""
    return Cache(folder, read_manifest(folder))


def _unread(read: Callable[[], object]) -> str | None:
    try:
        read()
    except CacheError as why:
        return str(why)
    return None


def _static_names(manifest: Manifest, arrays: Arrays) -> Iterator[str]:
    """The arrays that go with what a manifest names, and with each other."""
    for mesh in manifest.meshes:
        if mesh.kind != "solid":
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
    """A number as an array without dimensions."""
    return np.array(value, np.int64)
