"""Reads a cache: its frames and their content, checkpoints and hashes. Everything is checked before use.

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
from itertools import islice
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from antdsl.outputs.cache.hashes import (
    HASHES_FILE_NAME,
    HashLine,
    find_checkpoint_damage,
    find_frame_damage,
    find_static_damage,
    read_lines,
)
from antdsl.outputs.cache.manifest import CAMERA_PARTS, MANIFEST_FILE_NAME, Manifest, make_camera_array_name, read_manifest
from antdsl.outputs.cache.manifest_parts import CameraEntry
from antdsl.outputs.cache.npz import ArrayFileError, read_npz
from antdsl.scene.setting import CameraData
from antdsl.scene.thing_models import UNIT_MM, UP_VECTORS

MARKER_FILE_NAME = ".antdsl-cache"
STATIC_FILE_NAME = "static.npz"
MEASURES_FILE_NAME, MEASURES_PARQUET_NAME = "measures.csv", "measures.parquet"
CACHE_ENTRY_NAMES = (
    "frames",
    "checkpoints",
    STATIC_FILE_NAME,
    HASHES_FILE_NAME,
    MANIFEST_FILE_NAME,
    MARKER_FILE_NAME,
    MEASURES_FILE_NAME,
    MEASURES_PARQUET_NAME,
)  # the entries of a cache's folder
STORED_MEASURES_KEY = "measures"  # key in a checkpoint: values of earlier frames that measures need
SURFACE_ERROR_KEY = "surface_error"  # key in a checkpoint: the greatest surface error of all frames up to it
_NUMBERED_FILE_PATTERN = re.compile(r"[a-z]+\.(-?[0-9]{1,10})\.npz", re.ASCII)

_MAX_LISTED_FOLDERS = 300
Arrays = Mapping[str, NDArray[Any]]


class CacheError(Exception):
    """Error for a part of a cache that cannot be used. The message is a complete explanation."""


def make_frame_path(folder: Path, frame: int) -> Path:
    """Return the path of a frame's file. The frame number has at least four digits, as in the names of pictures."""
    return folder / f"frames/frame.{frame:04d}.npz"


def make_checkpoint_path(folder: Path, frame: int) -> Path:
    """Return the path of a frame's checkpoint file."""
    return folder / f"checkpoints/checkpoint.{frame:04d}.npz"


def list_numbered_files(folder: Path, path: Callable[[Path, int], Path]) -> tuple[list[int], list[Path]]:
    """Return the numbers of the frames or checkpoints in a cache's folder, ascending, and the files with invalid names.

    `path`: returns the path of the file for a folder and a number. A name is invalid if it has a number in another form, such as
    `frame.12.npz`."""
    place = path(folder, 0).parent
    numbers, strays = [], []
    for each in place.iterdir() if place.is_dir() else ():
        match = _NUMBERED_FILE_PATTERN.fullmatch(each.name)
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
        """Return the numbers of all existing frames, ascending."""
        return list_numbered_files(self.folder, make_frame_path)[0]

    def checkpoints(self) -> list[int]:
        """Return the numbers of the frames that have a checkpoint, ascending."""
        return list_numbered_files(self.folder, make_checkpoint_path)[0]

    def describe_stray_files(self) -> list[str]:
        """Return a complete message for each file that is ignored in the folders of frames and checkpoints."""
        return [
            f"`{stray}` is not a {what} of this cache: {what}s have names such as `{path(self.folder, 12).name}`"
            for what, path in (("frame", make_frame_path), ("checkpoint", make_checkpoint_path))
            for stray in list_numbered_files(self.folder, path)[1]
        ]

    def frame(self, number: int, names: frozenset[str] | None = None) -> Arrays:
        """Return the arrays of a frame in the documented format. Raises CacheError if the frame is missing or damaged.

        `names`: the names of the arrays to return; None for all arrays."""
        return _read_arrays(make_frame_path(self.folder, number), number, names)

    def read_checkpoint(self, number: int) -> Arrays:
        """Return all arrays that a run needs to continue from a frame. Raises CacheError if the checkpoint is missing or
        damaged."""
        return _read_arrays(make_checkpoint_path(self.folder, number), number)

    def read_static(self) -> Arrays:
        """Return the arrays of `static.npz`, in scene units, such as meshes and the positions of field cells.

        Meshes are `mesh.NAME.vertices` and `.faces`; positions of field cells are `field.NAME.P`. Raises CacheError if the file
        is damaged, or lacks an array that the manifest needs."""
        arrays = _read_arrays(self.folder / STATIC_FILE_NAME, None)
        for name in _list_required_arrays(self.manifest, arrays):
            if name not in arrays:
                raise CacheError(f"`{self.folder / STATIC_FILE_NAME}` has no `{name}`, although the manifest names it")
        return arrays

    def find_source_files(self) -> list[Path]:
        """Return the existing files from which the cache was made. Empty if the manifest names no scene."""
        if self.manifest.scene_path is None:
            return []
        scene = Path(os.path.normpath(self.folder.resolve() / self.manifest.scene_path))
        return [each for each in (scene, *(scene.parent / name for name in self.manifest.inputs)) if each.is_file()]

    def read_state_hashes(self) -> dict[int, str]:
        """Return the state hash of each frame. An incomplete last line, as a crash may leave it, is ignored."""
        return {frame: line.hash for frame, line in self.lines().items()}

    def lines(self) -> dict[int, HashLine]:
        """Return the complete lines of `hashes.jsonl`, by frame. A line contains all hashes of the frame."""
        return read_lines(self.folder / HASHES_FILE_NAME)

    def find_frame_damage(self, frame: int, line: HashLine | None) -> str | None:
        """Return a message about damage to a frame's file. None if the file has the bytes that were written.

        `line`: the hashes of the frame."""
        return find_frame_damage(make_frame_path(self.folder, frame), frame, line)

    def find_checkpoint_damage(self, frame: int, line: HashLine | None) -> str | None:
        """Return a message about damage to a checkpoint, or that it cannot be read. None if it is intact.

        `line`: the hashes of the frame. Without a hash of the checkpoint, changed bytes are not detected."""
        return find_checkpoint_damage(make_checkpoint_path(self.folder, frame), frame, line) or _find_read_problem(
            lambda: self.read_checkpoint(frame)
        )

    def find_static_damage(self) -> str | None:
        """Return a message about damage to `static.npz`. None if it is intact."""
        expected = self.manifest.static
        return (find_static_damage(self.folder / STATIC_FILE_NAME, expected) if expected else None) or _find_read_problem(
            self.read_static
        )


@dataclass(frozen=True, eq=False)
class CacheView(Cache):
    """A view of another cache, `source`. Subclasses replace some parts of it; all other parts come from `source`."""

    source: Cache

    @classmethod
    def of(cls, source: Cache, *values: Any) -> Self:
        """Return a view of the cache `source`. `values`: the values of the additional fields of the class, in order."""
        return cls(source.folder, source.manifest, source, *values)

    def frames(self) -> list[int]:
        """Return the numbers of the existing frames, ascending."""
        return self.source.frames()

    def checkpoints(self) -> list[int]:
        """Return the numbers of the frames that have a checkpoint, ascending."""
        return self.source.checkpoints()

    def frame(self, number: int, names: frozenset[str] | None = None) -> Arrays:
        """Return the arrays of a frame. `names`: the names of the arrays to return; None for all arrays."""
        return self.source.frame(number, names)

    def read_static(self) -> Arrays:
        """Return the arrays that apply to all frames, such as meshes."""
        return self.source.read_static()

    def find_source_files(self) -> list[Path]:
        """Return the existing files from which the cache was made."""
        return self.source.find_source_files()


def select_arrays(arrays: Arrays, names: frozenset[str] | None) -> Arrays:
    """Return only the arrays in `names`, and the frame number. If `names` is None, return all arrays."""
    return arrays if names is None else {name: array for name, array in arrays.items() if name in names or name == "frame"}


def list_caches_below(folder: Path) -> list[str]:
    """Return the relative paths of all caches in a folder and its subfolders, sorted. Links are not followed.

    At most 300 folders are examined."""
    caches, examined = [], 0
    for depth in ("*/", "*/*/"):
        for each in sorted(islice(folder.glob(depth), _MAX_LISTED_FOLDERS - examined)):
            examined += 1
            parts = (each.parent, each) if depth.count("*") > 1 else (each,)
            is_plain = not any(part.is_symlink() or part.name.startswith(".") for part in parts)
            if is_plain and (each / MANIFEST_FILE_NAME).is_file():
                caches.append(each.relative_to(folder).as_posix())
    return sorted(caches)


def open_cache(folder: Path) -> Cache:
    """Return the cache in a folder. Raises ManifestError with the reason if the folder contains no cache."""
    return Cache(folder, read_manifest(folder))


def read_camera(cache: Cache, name: str) -> CameraData:
    """Return a camera that does not depend on agents, in mm from the scene's origin. Raises CacheError if `static.npz` is
    damaged."""
    manifest, entry = cache.manifest, cache.manifest.named_cameras[name]
    assert isinstance(entry, CameraEntry)
    if entry.moves:
        static = cache.read_static()
        at, look_at, up, focal = (np.asarray(static[make_camera_array_name(name, part)], np.float64) for part in CAMERA_PARTS)
    else:
        points = (entry.at, entry.look_at, entry.up or UP_VECTORS[manifest.up])
        at, look_at, up = (np.array([point], np.float64) for point in points)
        focal = np.array([entry.focal or 0.0])
    at, look_at = ((rows + manifest.origin) * UNIT_MM[manifest.units] for rows in (at, look_at))
    return CameraData(at, look_at, up, focal, manifest.first)


def _find_read_problem(read: Callable[[], object]) -> str | None:
    """Return the message of the CacheError that `read` raises. None if it raises none."""
    try:
        read()
    except CacheError as error:
        return str(error)
    return None


def _list_required_arrays(manifest: Manifest, arrays: Arrays) -> Iterator[str]:
    """Yield the names of the arrays that `static.npz` must contain."""
    for mesh in manifest.meshes:
        if not mesh.row.is_dug:
            yield from (f"mesh.{mesh.name}.vertices", f"mesh.{mesh.name}.faces")
    for name, camera in manifest.named_cameras.items():
        if isinstance(camera, CameraEntry) and camera.moves:
            yield from (make_camera_array_name(name, part) for part in CAMERA_PARTS)
    yield from (f"field.{field.name}.P" for field in manifest.fields)
    yield from (f"{name.removesuffix('P')}V" for name in arrays if name.startswith("flow.") and name.endswith(".P"))


def _read_arrays(path: Path, number: int | None, names: frozenset[str] | None = None) -> Arrays:
    """Return the arrays of a file. Raises CacheError if the file is missing or damaged, or is not for frame `number`."""
    try:
        arrays = read_npz(path, None if names is None else names | {"frame"})
    except FileNotFoundError:
        raise CacheError(f"`{path}` does not exist") from None
    except OSError as error:
        raise CacheError(f"`{path}` cannot be read: {(error.strerror or str(error)).lower()}") from None
    except ArrayFileError as error:
        raise CacheError(f"`{path}` {error}") from None
    if number is not None:
        said = arrays.get("frame")
        if said is None or said.shape != () or said.dtype.kind not in "iu" or int(said) != number:
            raise CacheError(f"`{path}` does not hold frame {number}")
    return arrays
