"""Writes a cache so that a crash at any instant leaves one that can be continued: frames are put in place whole by a thread
behind the simulation,
checkpoints only after all frames before them are on the disk, hashes line by line."""

from __future__ import annotations

import json
import os
import queue
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.outputs.cache import (
    HASHES,
    MARKER,
    STATIC,
    Cache,
    CacheError,
    checkpoint_path,
    frame_path,
    numbered,
    open_cache,
    read_hashes,
)
from antdsl.outputs.lock import LOCK, FolderLock
from antdsl.outputs.manifest import Manifest, ManifestError, write_manifest
from antdsl.outputs.npz import sync_file, sync_folder, to_bytes, write_whole

Arrays = Mapping[str, NDArray[Any]]
_BEHIND = 2  # frames that may wait to be written


class ForeignFolder(Exception):
    """The folder has files that antdsl did not write; the message names one."""


class DifferentInputs(Exception):
    """The cache was made from other inputs; `names` says which differ."""

    def __init__(self, names: list[str]) -> None:
        super().__init__("the cache belongs to different inputs: " + ", ".join(f"`{name}`" for name in names))
        self.names = names


def prepare_folder(folder: Path, *, force: bool) -> None:
    """Make the folder, or see that it is ours to write to; ForeignFolder when it holds somebody else's files."""
    if folder.exists() and not folder.is_dir():
        raise ForeignFolder(f"`{folder}` is a file")
    folder.mkdir(parents=True, exist_ok=True)
    marker = folder / MARKER
    if not marker.exists():
        # a lock or a half-written marker is what a run leaves that was killed as it began
        others = sorted(name.name for name in folder.iterdir() if name.name not in (LOCK, f".{MARKER}.part"))
        if others and not force:
            raise ForeignFolder(f"`{folder}` has files that are not a cache's, such as `{others[0]}`")
        write_whole(marker, b"This folder is written by antdsl; what is in it may be replaced by the next run.\n", sync=True)
    for name in ("frames", "checkpoints"):
        if (folder / name).is_symlink():
            raise ForeignFolder(f"`{folder / name}` is a link")
        (folder / name).mkdir(exist_ok=True)


def clear(folder: Path, above: int | None = None) -> None:
    """Remove the frames and checkpoints (above a frame, if given) of an earlier run, and its hashes of them; nothing else."""
    for number in numbered(folder / "frames"):
        if above is None or number > above:
            frame_path(folder, number).unlink(missing_ok=True)
    for number in numbered(folder / "checkpoints"):
        if above is None or number > above:
            checkpoint_path(folder, number).unlink(missing_ok=True)
    for part in (part for place in (folder, folder / "frames", folder / "checkpoints") for part in list(place.glob(".*.part"))):
        part.unlink(missing_ok=True)
    kept = {} if above is None else {f: h for f, h in read_hashes(folder / HASHES).items() if f <= above}
    write_whole(folder / HASHES, b"".join(_line(frame, value) for frame, value in kept.items()), sync=True)


def _line(frame: int, value: str) -> bytes:
    return json.dumps({"frame": frame, "hash": value}).encode() + b"\n"


def resume_points(folder: Path, inputs: Mapping[str, str], first: int, last: int) -> tuple[Cache, list[int]] | None:
    """The cache to continue and the frames one may continue from, the latest first; None where there is nothing to continue.

    A checkpoint counts only when every frame up to it is there with its hash. DifferentInputs when the cache is of other
    inputs."""
    try:
        cache = open_cache(folder)
    except ManifestError:
        return None
    then = cache.manifest.inputs
    different = [name for name in {**then, **inputs} if then.get(name) != inputs.get(name)]
    if different:
        raise DifferentInputs(sorted(different))
    there, hashes = set(cache.frames()), cache.hashes()
    unbroken = first - 1
    while unbroken + 1 in there and unbroken + 1 in hashes:
        unbroken += 1
    return cache, [number for number in reversed(cache.checkpoints()) if first <= number <= min(unbroken, last)]


def read_checkpoint(cache: Cache, frame: int) -> Arrays | None:
    """A checkpoint's arrays less the bookkeeping, or None when it is damaged."""
    try:
        arrays = cache.checkpoint(frame)
    except CacheError:
        return None
    return {name.removeprefix("world."): array for name, array in arrays.items() if name.startswith("world.")}


class CacheWriter:
    """Between `__enter__` and `__exit__` the folder is locked and frames can be put in. After an error nothing more is
    written."""

    def __init__(self, folder: Path, manifest: Manifest) -> None:
        self.folder, self.manifest = folder, manifest
        self._lock = FolderLock(folder)
        self._queue: queue.Queue[tuple[int, Callable[[], tuple[Arrays, str]]] | None] = queue.Queue(maxsize=_BEHIND)
        self._unsynced: list[Path] = []
        self.seconds = 0.0  # spent on writing frames behind the caller's back
        self._problem: BaseException | None = None
        self._thread = threading.Thread(target=self._write_behind, name="cache writer", daemon=True)

    def __enter__(self) -> CacheWriter:
        self._lock.__enter__()
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None) -> None:
        try:
            if self._thread.is_alive():
                self._queue.put(None)
                self._thread.join()
            if kind is None:
                self._raise()
                self._sync()
        finally:
            self._lock.__exit__(kind, value, trace)

    def begin(self, static: Arrays | None, kept_up_to: int | None) -> None:
        """Write what stands for the whole run. Frames above `kept_up_to` (all if None) of an earlier run are removed first."""
        clear(self.folder, kept_up_to)
        if static is not None:
            write_whole(self.folder / STATIC, to_bytes(static), sync=True)
        write_manifest(self.folder, self.manifest)
        self._thread.start()

    def put(self, frame: int, make: Callable[[], tuple[Arrays, str]]) -> None:
        """Hand over a frame; behind the caller's back it is made (its arrays and the state's hash) and written, in order.

        An error of `make` or of the disk is raised by what is called next."""
        self._raise()
        self._queue.put((frame, make))

    def checkpoint(self, frame: int, arrays: Arrays) -> None:
        """Write a checkpoint, durably, after everything before it."""
        self._queue.join()
        self._raise()
        self._sync()
        whole = {"frame": np.array(frame, np.int64), **{f"world.{name}": array for name, array in arrays.items()}}
        write_whole(checkpoint_path(self.folder, frame), to_bytes(whole), sync=True)

    def _sync(self) -> None:
        for path in self._unsynced:
            sync_file(path)
        self._unsynced.clear()
        sync_folder(self.folder / "frames")
        sync_file(self.folder / HASHES)

    def _raise(self) -> None:
        if self._problem is not None:
            raise self._problem

    def _write_behind(self) -> None:
        with open(self.folder / HASHES, "ab") as hashes:
            while (entry := self._queue.get()) is not None:
                try:
                    if self._problem is None:
                        frame, make = entry
                        arrays, state_hash = make()
                        began = time.perf_counter()
                        path = frame_path(self.folder, frame)
                        write_whole(path, to_bytes(arrays), sync=False)
                        self._unsynced.append(path)
                        hashes.write(_line(frame, state_hash))
                        hashes.flush()
                        self.seconds += time.perf_counter() - began
                except BaseException as problem:  # handed to the caller of the next `put`
                    self._problem = problem
                finally:
                    self._queue.task_done()
            self._queue.task_done()


def free_bytes(folder: Path) -> int:
    """What the disk of a folder has left."""
    about = os.statvfs(folder) if hasattr(os, "statvfs") else None
    return 2**62 if about is None else about.f_bavail * about.f_frsize
