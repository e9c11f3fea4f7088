"""Stores edits: in the manifest of their cache, which does not change otherwise, or as a new cache with the edited frames."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from antdsl.atomic_write import sync_files, write_atomically
from antdsl.outputs.cache.cache_reader import STATIC_FILE_NAME, Cache, make_frame_path
from antdsl.outputs.cache.cache_writer import clear_folder, prepare_folder
from antdsl.outputs.cache.hashes import HASHES_FILE_NAME, hash_static_file, make_line
from antdsl.outputs.cache.lock import FolderLock
from antdsl.outputs.cache.manifest import EDIT_ARRAYS_PATTERN, EditsEntry, find_relative_path, read_manifest, write_manifest
from antdsl.outputs.cache.npz import make_npz_file
from antdsl.outputs.edits.edit_files import encode_edit_arrays


def store_edits(folder: Path, entry: EditsEntry | None, arrays: Mapping[str, NDArray[Any]] | None = None) -> bool:
    """Write edits to the manifest of a cache, or remove them if `entry` is None. Return whether the cache had edits before.

    `arrays`: the meshes and bodies that the edits name. They are written first, to a file next to the manifest. Raises
    ManifestError if the folder contains no cache, and FolderLocked while a run writes to it."""
    with FolderLock(folder):
        manifest = read_manifest(folder)
        if entry is not None and entry.arrays is not None:
            write_atomically(folder / entry.arrays, encode_edit_arrays(dict(arrays or {}))[1])
        write_manifest(folder, manifest.model_copy(update={"edits": entry}))
        for path in folder.glob("edits.*.npz"):
            if EDIT_ARRAYS_PATTERN.fullmatch(path.name) and (entry is None or path.name != entry.arrays):
                path.unlink(missing_ok=True)
    return manifest.edits is not None


def write_cache(cache: Cache, folder: Path, *, force: bool = False) -> Iterator[int]:
    """Write the frames of a cache with edits as a new cache. Yield the number of each frame that was written.

    The new cache has no checkpoints. Raises CacheError if a frame is damaged. Raises ForeignFolder, PathBlocked and FolderLocked
    in the same cases as a run."""
    prepare_folder(folder, force=force)
    with FolderLock(folder):
        clear_folder(folder)
        (folder / "manifest.json").unlink(missing_ok=True)  # the folder is not a cache until it is complete
        static = make_npz_file(cache.read_static())
        write_atomically(folder / STATIC_FILE_NAME, static.parts)
        yield from _write_frames(cache, folder)
        sync_files(make_frame_path(folder, number) for number in cache.frames())
        change = {"static": hash_static_file(static), "scene_path": _find_scene_path(cache, folder)}
        write_manifest(folder, cache.manifest.model_copy(update=change))


def _write_frames(cache: Cache, folder: Path) -> Iterator[int]:
    """Write the frames in order. Yield the number of each."""
    states, lines = cache.read_state_hashes(), []
    for number in cache.frames():
        file = make_npz_file(cache.frame(number))
        write_atomically(make_frame_path(folder, number), file.parts, sync=False)
        lines.append(make_line(number, states.get(number, ""), file).text(number))
        yield number
    write_atomically(folder / HASHES_FILE_NAME, b"".join(lines))


def _find_scene_path(cache: Cache, folder: Path) -> str | None:
    """Return the path of the scene file relative to `folder`. None if the scene file is unknown."""
    if cache.manifest.scene_path is None:
        return None
    return find_relative_path(Path(os.path.normpath(cache.folder.resolve() / cache.manifest.scene_path)), folder)
