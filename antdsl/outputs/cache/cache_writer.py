"""Writes a cache from which a run can continue after a crash at any time.

A thread writes frames atomically while the simulation continues. A checkpoint is written only after all earlier frames are safely
on disk. Hashes are written line by line."""

from __future__ import annotations

import math
import os
import stat
import time
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.atomic_write import PART_SUFFIX, create_folder_durably, is_link, write_atomically
from antdsl.numerics.records import select_by_prefix
from antdsl.outputs.cache.cache_reader import (
    MARKER_FILE_NAME,
    STATIC_FILE_NAME,
    STORED_MEASURES_KEY,
    SURFACE_ERROR_KEY,
    Cache,
    list_numbered_files,
    make_checkpoint_path,
    make_frame_path,
    open_cache,
)
from antdsl.outputs.cache.frame_maker import FrameMaker
from antdsl.outputs.cache.frame_writer import BackgroundWorker, CacheFileWriter
from antdsl.outputs.cache.hashes import HASHES_FILE_NAME, HashLine, hash_static_file, make_line, read_lines
from antdsl.outputs.cache.lock import LOCK_FILE_NAME, FolderLock, FolderLocked
from antdsl.outputs.cache.manifest import (
    EDIT_ARRAYS_PATTERN,
    MANIFEST_FILE_NAME,
    Manifest,
    ManifestError,
    Provenance,
    write_manifest,
)
from antdsl.outputs.cache.npz import make_npz_file
from antdsl.outputs.surface_error import measure_surface_error
from antdsl.runtime import World, feet_hash, state_hash, take_checkpoint
from antdsl.runtime.checkpoints import STATE_HASH_VERSION

Arrays = Mapping[str, NDArray[Any]]


class ForeignFolder(Exception):
    """Error for a folder with a file that antdsl has not written. The message names the file."""


class PathBlocked(Exception):
    """Error if a folder, a link or another object is at the path of a cache file. The message names the path."""


class DifferentInputs(Exception):
    """Error for an existing cache that was made from other inputs.

    `names`: the inputs that differ. `choices`: descriptions of the options that differ."""

    def __init__(self, manifest: Manifest, names: list[str], choices: Sequence[str] = ()) -> None:
        problems = [f"the cache was made {' and '.join(choices)}"] if choices else []
        problems += [f"the cache was made from other inputs: {', '.join(f'`{name}`' for name in names)}"] if names else []
        super().__init__("; ".join(problems))
        self.manifest, self.names = manifest, names


def prepare_folder(folder: Path, *, force: bool) -> None:
    """Create a folder, or check that antdsl may write to it. An error leaves the folder unchanged.

    Raises ForeignFolder if the folder contains other files. Raises PathBlocked if a folder or link is at the path of a cache
    file."""
    if folder.exists() and not folder.is_dir():
        raise ForeignFolder(f"`{folder}` is a file")
    create_folder_durably(folder)
    for name in ("frames", "checkpoints"):
        if is_link(folder / name):
            raise PathBlocked(f"`{folder / name}` is a link, but must be a folder")
        if (folder / name).exists() and not (folder / name).is_dir():
            raise PathBlocked(f"`{folder / name}` is a file, but must be a folder")
    for path in _list_cache_files(folder):
        if path.is_dir() and not path.is_symlink():
            raise PathBlocked(f"`{path}` is a folder, but a file of the cache is needed there")
    lock = folder / LOCK_FILE_NAME
    if os.path.lexists(lock) and not stat.S_ISREG(os.lstat(lock).st_mode):
        raise PathBlocked(f"`{lock}` is a link or a device, but a file of the cache is needed there")
    marker = folder / MARKER_FILE_NAME
    if not marker.exists():
        # a run that was killed at its start leaves a lock or an unfinished marker
        others = sorted(
            name.name
            for name in folder.iterdir()
            if name.name != LOCK_FILE_NAME and not name.match(f".{MARKER_FILE_NAME}.*{PART_SUFFIX}")
        )
        if others and not force:
            raise ForeignFolder(f"`{folder}` has files that do not belong to a cache, such as `{others[0]}`")
        write_atomically(marker, b"This folder is written by antdsl; what is in it may be replaced by the next run.\n")
    for name in ("frames", "checkpoints"):
        create_folder_durably(folder / name)


def _list_cache_files(folder: Path) -> Iterator[Path]:
    """Yield the existing files of a folder that a run would remove or replace."""
    yield from (
        folder / name for name in (MARKER_FILE_NAME, LOCK_FILE_NAME, STATIC_FILE_NAME, MANIFEST_FILE_NAME, HASHES_FILE_NAME)
    )
    for path in (make_frame_path, make_checkpoint_path):
        yield from (path(folder, number) for number in list_numbered_files(folder, path)[0])
    yield from _find_unfinished_files(folder)


def _find_unfinished_files(folder: Path) -> list[Path]:
    """Return the incomplete files in the folder that killed runs have left."""
    return [part for place in (folder, folder / "frames", folder / "checkpoints") for part in place.glob(f".*{PART_SUFFIX}")]


def clear_folder(folder: Path, last_retained: int | None = None, damaged_frames: Container[int] = ()) -> None:
    """Remove the frames, checkpoints and hashes of an earlier run, and no other files.

    `last_retained`: only files of later frames are removed; None removes all. `damaged_frames`: frames of which the checkpoint is
    removed in any case.

    Hashes are removed first. So if the removal is interrupted, the files that remain have no hash and are ignored."""
    remaining_lines = (
        {}
        if last_retained is None
        else {f: line for f, line in read_lines(folder / HASHES_FILE_NAME).items() if f <= last_retained}
    )
    write_atomically(folder / HASHES_FILE_NAME, b"".join(line.text(frame) for frame, line in remaining_lines.items()))
    for number in list_numbered_files(folder, make_frame_path)[0]:
        if last_retained is None or number > last_retained:
            make_frame_path(folder, number).unlink(missing_ok=True)
    for number in list_numbered_files(folder, make_checkpoint_path)[0]:
        if last_retained is None or number > last_retained or number in damaged_frames:
            make_checkpoint_path(folder, number).unlink(missing_ok=True)
    edit_arrays = [path for path in folder.glob("edits.*.npz") if EDIT_ARRAYS_PATTERN.fullmatch(path.name)]
    for part in (*_find_unfinished_files(folder), *(edit_arrays if last_retained is None else ())):
        part.unlink(missing_ok=True)


class DifferentHashes(Exception):
    """Error for a cache with state hashes of another method, which cannot be compared."""

    def __init__(self, folder: Path) -> None:
        super().__init__(f"`{folder}` was written by a version of antdsl that computes state hashes in another way")


@dataclass(frozen=True, slots=True)
class IntactPart:
    """The undamaged part of a cache, from which a run can continue.

    `checkpoints`: the frames of usable checkpoints, latest first. `last_frame`: the last frame in the cache. `damage`: a message
    about the first damaged frame; None if all frames are intact."""

    cache: Cache
    checkpoints: list[int]
    last_frame: int | None = None
    damage: str | None = None


def find_intact_part(folder: Path, inputs: Mapping[str, str], first: int, last: int) -> IntactPart | None:
    """Return the part of the cache from which a run can continue. None if there is no such part.

    A checkpoint is usable only if the files of all frames up to it have the bytes that were written. Raises DifferentInputs if
    the cache has other inputs, and DifferentHashes if its state hashes cannot be compared."""
    try:
        cache = open_cache(folder)
    except ManifestError:
        return None
    then = cache.manifest.inputs
    different = [name for name in {**then, **inputs} if then.get(name) != inputs.get(name)]
    if different:
        raise DifferentInputs(cache.manifest, sorted(different))
    if cache.manifest.state_hash != STATE_HASH_VERSION:
        raise DifferentHashes(folder)
    lines, last_frame = cache.lines(), max(cache.frames(), default=None)
    unbroken, broken = first - 1, None
    while unbroken < last and (broken := cache.find_frame_damage(unbroken + 1, lines.get(unbroken + 1))) is None:
        unbroken += 1
    if last_frame is None or last_frame <= unbroken or (last_frame == unbroken + 1 and last_frame not in lines):
        broken = None  # the intact part ends here, or the run was killed between a frame and its line
    points = [number for number in reversed(cache.checkpoints()) if first <= number <= unbroken]
    return IntactPart(cache, points, last_frame, broken)


def read_checkpoint(cache: Cache, frame: int) -> tuple[Arrays, float | None, NDArray[np.float64] | None]:
    """Return the world's arrays of a checkpoint, the surface error, and the stored values of measures.

    The surface error is the greatest of all frames up to this one. Both are None if they were not stored. Raises CacheError if
    the checkpoint is damaged."""
    arrays = cache.read_checkpoint(frame)
    stored_error = arrays.get(SURFACE_ERROR_KEY)
    known = (
        stored_error is not None
        and stored_error.shape == ()
        and stored_error.dtype.kind == "f"
        and 0 <= float(stored_error) < math.inf
    )
    worst = float(stored_error) if stored_error is not None and known else None
    measures = arrays.get(STORED_MEASURES_KEY)
    return select_by_prefix(arrays, "world."), worst, None if measures is None else measures.astype(np.float64)


class CacheWriter:
    """Writer of a cache. It accepts frames between `__enter__` and `__exit__`, and locks the folder for this time.

    After an error, nothing more is written.

    `get_provenance`: returns the provenance for the manifest. It reads all of antdsl's files, so the writing thread calls it.
    `report`: a callback that receives the measurements of each written frame. It is called some frames later, but before
    `__exit__` returns.

    The measurements are `hash`, `surface_error` and `seconds`. `surface_error`: the greatest of all frames so far, in body
    lengths; None if that of earlier frames is unknown. `seconds`: the time spent on each kind of work, by name."""

    def __init__(
        self,
        folder: Path,
        manifest: Manifest,
        get_provenance: Callable[[], Provenance],
        report: Callable[[Mapping[str, Any]], None],
    ) -> None:
        self.folder, self.manifest, self._get_provenance = folder, manifest, get_provenance
        self._report = report
        self._lock = FolderLock(folder)
        self._worker: BackgroundWorker | None = None

    def __enter__(self) -> CacheWriter:
        self._lock.__enter__()
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None) -> None:
        try:
            if self._worker is not None:
                self._finish_writing(self._worker, is_complete=kind is None)
        except Exception:
            self._lock.__exit__(kind, value, trace)
            raise
        # If a second Ctrl-C interrupted the wait, the folder stays locked: a thread still writes to it.
        self._lock.__exit__(kind, value, trace)

    def _finish_writing(self, worker: BackgroundWorker, *, is_complete: bool) -> None:
        """Stop the writing thread. If the run is complete, first flush all files to disk, and raise the error of a failed job."""
        try:
            if is_complete:
                worker.submit(self._file_writer.sync_files)
        finally:
            worker.wait_until_finished()
            self._file_writer.close()
        if is_complete:
            worker.raise_job_error()

    def begin(
        self,
        world: World,
        static: Arrays,
        frame_maker: FrameMaker,
        retained_lines: Mapping[int, HashLine],
        damaged_frames: Container[int] = (),
        greatest_error: float | None = 0.0,
    ) -> None:
        """Write the files that belong to the complete run, and remove frames of an earlier run.

        `retained_lines`: the hashes of the frames to retain; later frames and checkpoints are removed. `damaged_frames`: frames
        of which the checkpoint is removed in any case. `greatest_error`: the greatest surface error of the retained frames; None
        if unknown. Raises FolderLocked if another run has written to the folder since these lines were read."""
        last = max(retained_lines, default=None)
        lines = {} if last is None else read_lines(self.folder / HASHES_FILE_NAME)
        if retained_lines != {frame: line for frame, line in lines.items() if last is not None and frame <= last}:
            raise FolderLocked(f"another run has written to `{self.folder}` since this one read it")
        clear_folder(self.folder, last, damaged_frames)
        file = make_npz_file(static)
        write_atomically(self.folder / STATIC_FILE_NAME, file.parts)
        world.dug_balls = {}
        world.emissions = [] if "emit" in frame_maker.events else None
        self._maker, self._greatest_error = frame_maker, greatest_error
        self._file_writer, self._worker = CacheFileWriter(self.folder), BackgroundWorker(self._report)
        self._worker.submit(partial(self._write_manifest, hash_static_file(file)))

    def _write_manifest(self, static: str) -> Mapping[str, Any]:
        """Write the manifest with `static`, the hash of `static.npz`. Return an empty measurement."""
        write_manifest(self.folder, self.manifest.model_copy(update={"static": static, "made_with": self._get_provenance()}))
        return {}

    def submit_frame(self, world: World) -> None:
        """Measure and hash the world's current frame, and pass it to the writing thread. Raises an error that occurred with an
        earlier frame."""
        assert self._worker is not None, "begin comes first"
        times = [time.perf_counter()]
        self._greatest_error = None if self._greatest_error is None else max(self._greatest_error, measure_surface_error(world))
        times.append(time.perf_counter())
        state, feet = state_hash(world), feet_hash(world.feet, world.options.threads)
        times.append(time.perf_counter())
        file = make_npz_file(self._maker.frame(world))
        line = make_line(world.frame, state, file, feet)
        times.append(time.perf_counter())
        spent = dict(zip(("measure", "hash", "frame"), (end - start for start, end in pairwise(times)), strict=True))
        measures = {"hash": state, "surface_error": self._greatest_error}
        scribe, frame = self._file_writer, world.frame

        def write_frame() -> Mapping[str, Any]:
            return {**measures, "made": spent, **scribe.frame(frame, file, line)}

        self._worker.submit(write_frame)

    def submit_checkpoint(self, world: World, stored_measures: NDArray[np.float64]) -> None:
        """Pass a checkpoint of the last frame to the writing thread. `stored_measures`: the result of
        `RunMeasures.save_stored_values`."""
        assert self._worker is not None, "begin comes first"
        state_arrays = take_checkpoint(world)
        arrays = {"frame": state_arrays["frame"], **{f"world.{name}": array for name, array in state_arrays.items()}}
        arrays |= {STORED_MEASURES_KEY: stored_measures} if len(stored_measures) else {}
        arrays |= {} if self._greatest_error is None else {SURFACE_ERROR_KEY: np.array(self._greatest_error)}
        self._worker.submit(partial(self._file_writer.write_checkpoint, world.frame, arrays))
