"""What is done with a state behind the simulation: measured, hashed, made into a frame and written; kept as a checkpoint."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.outputs.cache.cache_reader import SURFACE_ERROR, checkpoint_path, frame_path
from antdsl.outputs.cache.frames import FrameMaker
from antdsl.outputs.cache.hashes import HASHES, Line, line_of, read_lines, with_checkpoint
from antdsl.outputs.cache.npz import sync_file, sync_folder, to_bytes, write_whole
from antdsl.runtime import World, dig_again, emit_again, feet_hash, show, solid_state, state_hash

Arrays = Mapping[str, NDArray[Any]]


class Scribe:
    """Writes states into a cache's folder, in order: frames whole, a line with the hash after each, checkpoints only when all
    frames before them are on the disk. `still` is a snapshot of the world that is simulated,
    `worst` the greatest `surface_error` of the frames before, None where that is not known."""

    def __init__(self, folder: Path, still: World, maker: FrameMaker, worst: float | None = 0.0) -> None:
        self.folder, self.still, self.maker, self.worst = folder, still, maker, worst
        self._unsynced: list[Path] = []
        self._last: dict[int, Line] = {}  # the line of the frame that was written last

    def work(self, jobs: Sequence[str], arrays: Arrays) -> dict[str, Any]:
        """Do these of JOBS with a state's arrays; gives `seconds` by name and what else they found out."""
        found: dict[str, Any] = {"seconds": {}}
        for job in jobs:
            JOBS[job](self, arrays, found)
        return found

    def frame(self, arrays: Arrays, found: dict[str, Any]) -> None:
        """Write the frame and its line; finds `hash` and, of all frames so far, `surface_error`."""
        began = time.perf_counter()
        show(self.still, arrays)
        dig_again(self.still, arrays)
        emit_again(self.still, arrays)
        self.worst = None if self.worst is None else max(self.worst, surface_error(self.still))
        found["surface_error"] = self.worst
        began = _spend(found, "measure", began)
        found["hash"] = state_hash(self.still)
        began = _spend(found, "hash", began)
        made = self.maker.frame(self.still)
        began = _spend(found, "frame", began)
        path = frame_path(self.folder, self.still.frame)
        data = to_bytes(made)
        write_whole(path, data, sync=False)
        self._unsynced.append(path)
        self._line(self.still.frame, line_of(self.still.frame, found["hash"], data, feet_hash(self.still.feet)))
        _spend(found, "write", began)

    def _line(self, frame: int, line: Line) -> None:
        self._last = {frame: line}
        with open(self.folder / HASHES, "ab") as hashes:
            hashes.write(line.text(frame))

    def checkpoint(self, arrays: Arrays, found: dict[str, Any]) -> None:
        """Write a checkpoint, durably, after everything before it, its hash included: one without is from before there were
        any."""
        began = time.perf_counter()
        dig_again(self.still, arrays)
        kept = {name: array for name, array in arrays.items() if not name.endswith((".carved", ".emitted"))} | solid_state(
            self.still
        )
        whole = {"frame": arrays["frame"], **{f"world.{name}": array for name, array in kept.items()}}
        whole |= {} if self.worst is None else {SURFACE_ERROR: np.array(self.worst)}
        frame, data = int(arrays["frame"]), to_bytes(whole)
        lines = self._last or read_lines(self.folder / HASHES)
        self._line(frame, with_checkpoint(frame, lines[frame], data))
        began = _spend(found, "checkpoint", began)
        self.sync(arrays, found)
        began = time.perf_counter()
        write_whole(checkpoint_path(self.folder, frame), data, sync=True)
        _spend(found, "checkpoint", began)

    def sync(self, arrays: Arrays, found: dict[str, Any]) -> None:
        """See that all that was written is on the disk."""
        began = time.perf_counter()
        for path in self._unsynced:
            sync_file(path)
        self._unsynced.clear()
        sync_folder(self.folder / "frames")
        sync_file(self.folder / HASHES)
        _spend(found, "sync", began)


JOBS: Mapping[str, Callable[[Scribe, Arrays, dict[str, Any]], None]] = {
    "frame": Scribe.frame,
    "checkpoint": Scribe.checkpoint,
    "sync": Scribe.sync,
}


def surface_error(world: World) -> float:
    """The greatest distance of an agent, as it is written (float32), from the triangle or the solid that it stands on, in body
    lengths."""
    worst = 0.0
    for population in world.populations.values():
        if len(population):
            away = population.position.astype(np.float32) - world.ground.position(population.footing)
            x, y, z = away.T
            distance = np.sqrt((x * x + y * y) + z * z)
            for number, volume in enumerate(world.solids.values(), len(world.setting.surfaces)):
                rows = np.flatnonzero(population.footing.mesh == number)
                off = np.abs(volume.sample(population.position[rows].astype(np.float32).astype(np.float64)))
                distance[rows] = np.maximum(distance[rows], off)
            if "clearance" in population.now:
                distance = np.abs(distance - population.now["clearance"])
            size = np.maximum(population.now["size"].astype(np.float64), 1e-9)
            worst = max(worst, float((distance / size).max()))
    return worst


def _spend(found: dict[str, Any], what: str, since: float) -> float:
    now = time.perf_counter()
    found["seconds"][what] = found["seconds"].get(what, 0.0) + now - since
    return now
