"""Writing of frames and checkpoints, in order, in a thread, with results for each.

It is a thread and not a process, so it receives arrays without a copy into shared memory. No code changes these arrays any more.
Nearly all of its work (checksums, hashes, files) runs without the interpreter's lock."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from numpy.typing import NDArray

from antdsl.outputs.cache.cache_reader import checkpoint_path, frame_path
from antdsl.outputs.cache.hashes import HASHES, Line, read_lines, with_checkpoint
from antdsl.outputs.cache.npz import npz_file
from antdsl.outputs.cache.zip_parts import Stored
from antdsl.whole import AppendedFile, sync_files, write_atomically

_MOST = 3  # pending jobs: one that runs, and the waiting ones

Results = Mapping[str, Any]
Work = Callable[[], Results]
Arrays = Mapping[str, NDArray[Any]]
Measures = dict[str, Any]


class Scribe:
    """Writer of files into a cache's folder, in order. It must be closed.

    A frame is written atomically, then its line with the hash. A checkpoint is written after all earlier frames are on the disk.
    The results of its methods have `seconds`, by name."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._lines = AppendedFile(folder / HASHES)
        self._unsynced: list[Path] = []
        self._last: dict[int, Line] = {}  # the line of the frame that was written last

    def frame(self, frame: int, file: Stored, line: Line) -> Measures:
        """Write the file of a frame, then its line. Return the seconds spent."""
        began = time.perf_counter()
        path = frame_path(self.folder, frame)
        write_atomically(path, file.parts, sync=False)
        self._unsynced.append(path)
        self._line(frame, line)
        return _elapsed("write", began)

    def _line(self, frame: int, line: Line) -> None:
        self._last = {frame: line}
        self._lines.write([line.text(frame)])

    def checkpoint(self, frame: int, arrays: Arrays) -> Measures:
        """Write a checkpoint durably, after everything before it, its hash included. Return the seconds spent.

        In caches of older versions, checkpoints have no hash."""
        began = time.perf_counter()
        file = npz_file(arrays)
        lines = self._last or read_lines(self.folder / HASHES)
        self._line(frame, with_checkpoint(frame, lines[frame], file))
        measures = self.sync()
        write_atomically(checkpoint_path(self.folder, frame), file.parts)
        measures["seconds"] |= {"checkpoint": time.perf_counter() - began - measures["seconds"]["sync"]}
        return measures

    def sync(self) -> Measures:
        """Flush everything written so far to the disk. Return the seconds spent."""
        began = time.perf_counter()
        sync_files(self._unsynced)
        self._unsynced.clear()
        self._lines.sync()
        return _elapsed("sync", began)

    def close(self) -> None:
        """Close the writer. Nothing is written afterwards."""
        self._lines.close()


def _elapsed(what: str, since: float) -> Measures:
    return {"seconds": {what: time.perf_counter() - since}}


class BackgroundWorker:
    """Runner of jobs in a thread, one after the other.

    The callback `report` receives the result of each job in the caller's thread: when the next job is submitted, or at the end.
    After an error no further job runs, and the next call raises the error."""

    def __init__(self, report: Callable[[Results], None]) -> None:
        self._told = report
        self._work: SimpleQueue[Work | None] = SimpleQueue()
        self._found: SimpleQueue[Results | None] = SimpleQueue()  # one per job, None if it did not run
        self._left = 0  # jobs without a reported result
        self._problem: BaseException | None = None
        # a daemon: a disk that never answers must not prevent the program from ending; at worst an unfinished file remains
        self._thread = threading.Thread(target=self._run_thread, name="cache writer", daemon=True)
        self._thread.start()

    def hand_over(self, work: Work) -> None:
        """Submit a job. Block while too many jobs are pending. Raises the error of an earlier job."""
        self._report_results(_MOST - 1)
        self.check()
        self._left += 1
        self._work.put(work)

    def finish(self) -> None:
        """Wait until all jobs have ended and the thread has stopped. Does not raise the errors of jobs."""
        if self._thread.is_alive():
            self._work.put(None)
            self._thread.join()
        self._report_results(self._left)

    def check(self) -> None:
        """Raise the error of an earlier job, if there is one."""
        if self._problem is not None:
            raise self._problem

    def _report_results(self, most: int) -> None:
        """Report the results that arrived since the last call. Block until at most `most` jobs are pending."""
        while self._left > most or not self._found.empty():
            measures = self._found.get()
            self._left -= 1
            if measures is not None:
                self._told(measures)

    def _run_thread(self) -> None:
        while (work := self._work.get()) is not None:
            measures = None
            if self._problem is None:
                try:
                    measures = work()
                except BaseException as problem:  # raised in the caller's thread
                    self._problem = problem
            self._found.put(measures)
