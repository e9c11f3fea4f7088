"""Edits a cache after the run and writes the result as a separate cache. The original is not changed.

Orientations are smoothed over the frames before and after. A run cannot do this, because it does not know the next frame."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from antdsl.atomic_write import sync_files, write_atomically
from antdsl.outputs.cache.cache_reader import STATIC_FILE_NAME, Arrays, Cache, CacheError, make_frame_path
from antdsl.outputs.cache.cache_writer import clear_folder, prepare_folder
from antdsl.outputs.cache.frame_agents import IDENTITY_ARRAYS, get_species_numbers, make_agent_keys
from antdsl.outputs.cache.hashes import HASHES_FILE_NAME, hash_static_file, make_line
from antdsl.outputs.cache.lock import FolderLock
from antdsl.outputs.cache.manifest import find_relative_path, write_manifest
from antdsl.outputs.cache.npz import make_npz_file

MIN_SMOOTHING_FRAMES, MAX_SMOOTHING_FRAMES = 3, 99  # frames
_REQUIRED_ARRAYS = ("id", "orient")


class NotEditable(Exception):
    """Error for a cache that cannot be edited. The message is the reason, complete without context."""


def smooth_orientations(cache: Cache, folder: Path, width: int, *, force: bool = False) -> Iterator[int]:
    """Write a copy of a cache with orientations smoothed over `width` frames. Yield the number of each written frame.

    The copy has no checkpoints. Raises CacheError if a frame is damaged; ForeignFolder, PathBlocked and FolderLocked as for a
    run."""
    lacking = [name for name in _REQUIRED_ARRAYS if name not in cache.manifest.attributes]
    if lacking:
        raise NotEditable(f"the cache has no attribute `{lacking[0]}`, which smoothing needs")
    prepare_folder(folder, force=force)
    with FolderLock(folder):
        clear_folder(folder)
        (folder / "manifest.json").unlink(missing_ok=True)  # the folder is not a cache until it is complete
        static = make_npz_file(cache.read_static())
        write_atomically(folder / STATIC_FILE_NAME, static.parts)
        yield from _write_frames(cache, folder, width)
        sync_files(make_frame_path(folder, number) for number in cache.frames())
        edits = sum(name.startswith("edit ") for name in cache.manifest.inputs)
        inputs = {**cache.manifest.inputs, f"edit {edits + 1}": f"smooth orient:{width}"}
        change = {"static": hash_static_file(static), "inputs": inputs, "scene_path": _find_scene_path(cache, folder)}
        write_manifest(folder, cache.manifest.model_copy(update=change))


def _write_frames(cache: Cache, folder: Path, width: int) -> Iterator[int]:
    """Write the frames in order, and yield the number of each. Memory holds the orientations of `width` frames at a time."""
    numbers, states, lines = cache.frames(), cache.read_state_hashes(), []
    existing_frames, near = set(numbers), {}
    for number in numbers:
        for each in range(number - width // 2, number + width // 2 + 1):
            if each in existing_frames and each not in near:
                near[each] = _read_orientations(cache, each)
        for past in [each for each in near if each < number - width // 2]:
            del near[past]
        arrays = {**cache.frame(number), "orient": smooth_frame(near, number, width)}
        file = make_npz_file(arrays)
        write_atomically(make_frame_path(folder, number), file.parts, sync=False)
        lines.append(make_line(number, states.get(number, ""), file).text(number))
        yield number
    write_atomically(folder / HASHES_FILE_NAME, b"".join(lines))


def _read_orientations(cache: Cache, number: int) -> FrameOrientations:
    arrays: Arrays = cache.frame(number, IDENTITY_ARRAYS | {"orient"})
    orient, ids = arrays.get("orient"), arrays.get("id")
    if orient is None or ids is None or ids.ndim != 1 or orient.shape != (len(ids), 4):
        raise CacheError(f"`{make_frame_path(cache.folder, number)}` has no matching ids and orientations")
    if get_species_numbers(arrays).shape != ids.shape:
        raise CacheError(f"`{make_frame_path(cache.folder, number)}` does not have a species for each agent")
    return FrameOrientations(make_agent_keys(arrays), orient.astype(np.float64))


def _find_scene_path(cache: Cache, folder: Path) -> str | None:
    """Return the path from another folder to the scene file, or None if it is unknown."""
    if cache.manifest.scene_path is None:
        return None
    return find_relative_path(Path(os.path.normpath(cache.folder.resolve() / cache.manifest.scene_path)), folder)


@dataclass(frozen=True, slots=True, eq=False)
class FrameOrientations:
    """The agents of a frame: `key` int64[n], unique in the cache, and `orient` float64[n, 4], unit quaternions."""

    key: NDArray[np.int64]
    orient: NDArray[np.float64]


def smooth_frame(frames: Mapping[int, FrameOrientations], frame: int, width: int) -> NDArray[np.float32]:
    """Return the orientations [n, 4] of a frame as weighted means over `width` frames, half before the frame and half after it.

    Weights fall off as a raised cosine (J. von Hann's window). For each agent, the same number of frames is used on both sides:
    those in which it exists without a gap. So the orientation of an agent in its first or last frame is unchanged, and no agent
    lags.

    Each quaternion is added with the sign nearer to its neighbour on the side of `frame`, and the sum is normalised. For small
    angles this is the mean of F. L. Markley et al., Averaging Quaternions, J. Guidance, Control, and Dynamics 30 (2007)."""
    current, half = frames[frame], width // 2
    sides = [_collect_side_orientations(frames, frame, direction, half) for direction in (-1, 1)]
    reach = np.minimum(sides[0][1], sides[1][1])
    total = current.orient.copy()
    for k in range(half):
        angle = np.minimum((k + 1) / (reach + 1), 1.0) * np.pi  # beyond its reach, an agent has weight 0
        total += (0.5 + 0.5 * np.cos(angle))[:, None] * (sides[0][0][k] + sides[1][0][k])
    size = np.sqrt((total * total).sum(axis=1))
    good = np.isfinite(size) & (size > 1e-6)
    return np.where(good[:, None], total / np.where(good, size, 1.0)[:, None], current.orient).astype(np.float32)


def _collect_side_orientations(
    frames: Mapping[int, FrameOrientations], frame: int, direction: int, frame_count: int
) -> tuple[list[NDArray[np.float64]], NDArray[np.int64]]:
    """Return the orientations of a frame's agents in `frame_count` frames on one side, the nearest first.

    `direction`: -1 for the frames before, 1 for the frames after.
    The second result is the number of these frames in which each agent exists without a gap."""
    current = frames[frame]
    last, is_present, count = current.orient, np.ones(len(current.key), np.bool_), np.zeros(len(current.key), np.int64)
    orientations = []
    for k in range(1, frame_count + 1):
        other = frames.get(frame + direction * k)
        if other is None or not len(other.key):
            is_present[:] = False
        else:
            order = np.argsort(other.key, kind="stable")
            at = order[np.minimum(np.searchsorted(other.key[order], current.key), len(order) - 1)]
            is_present &= other.key[at] == current.key
            orient = np.where(is_present[:, None], other.orient[at], last)
            last = np.where((orient * last).sum(axis=1)[:, None] < 0, -orient, orient)
        count[is_present] = k
        orientations.append(last)
    return orientations, count
