"""What is done behind the simulation: frames and checkpoints are written, with lines that tell of them."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from antdsl.outputs.cache.cache_reader import checkpoint_path, frame_path
from antdsl.outputs.cache.hashes import HASHES, Line, read_lines, with_checkpoint
from antdsl.outputs.cache.npz import npz_file
from antdsl.outputs.cache.zip_parts import Stored
from antdsl.whole import AppendedFile, sync_files, write_whole

Arrays = Mapping[str, NDArray[Any]]
Found = dict[str, Any]


class Scribe:
    """Writes into a cache's folder, in order: frames whole, a line with the hash after each, checkpoints only when all frames
    before them are on the disk. What is done gives `seconds` by name. To be closed."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._lines = AppendedFile(folder / HASHES)
        self._unsynced: list[Path] = []
        self._last: dict[int, Line] = {}  # the line of the frame that was written last

    def frame(self, frame: int, file: Stored, line: Line) -> Found:
        """Write a frame as this file, and its line."""
        began = time.perf_counter()
        path = frame_path(self.folder, frame)
        write_whole(path, file.parts, sync=False)
        self._unsynced.append(path)
        self._line(frame, line)
        return _spent("write", began)

    def _line(self, frame: int, line: Line) -> None:
        self._last = {frame: line}
        self._lines.write([line.text(frame)])

    def checkpoint(self, frame: int, arrays: Arrays) -> Found:
        """Write a checkpoint, durably, after everything before it, its hash included: one without is from before there were
        any."""
        began = time.perf_counter()
        file = npz_file(arrays)
        lines = self._last or read_lines(self.folder / HASHES)
        self._line(frame, with_checkpoint(frame, lines[frame], file))
        found = self.sync()
        write_whole(checkpoint_path(self.folder, frame), file.parts)
        found["seconds"] |= {"checkpoint": time.perf_counter() - began - found["seconds"]["sync"]}
        return found

    def sync(self) -> Found:
        """See that all that was written is on the disk."""
        began = time.perf_counter()
        sync_files(self._unsynced)
        self._unsynced.clear()
        self._lines.sync()
        return _spent("sync", began)

    def close(self) -> None:
        """Nothing more is written."""
        self._lines.close()


def _spent(what: str, since: float) -> Found:
    return {"seconds": {what: time.perf_counter() - since}}
