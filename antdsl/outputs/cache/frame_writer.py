"""Writes frames and checkpoints in order in a background thread, and returns measurements for each of them.

Unlike a process, a thread receives arrays without a copy to shared memory. They must not change afterwards. Nearly all of its
work (checksums, hashes, files) runs without the interpreter's lock."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from numpy.typing import NDArray

from antdsl.atomic_write import AppendOnlyFile, sync_files, write_atomically
from antdsl.outputs.cache.cache_reader import make_checkpoint_path, make_frame_path
from antdsl.outputs.cache.hashes import HASHES_FILE_NAME, HashLine, add_checkpoint_hash, read_lines
from antdsl.outputs.cache.npz import make_npz_file
from antdsl.outputs.cache.zip_parts import StoredFile

_MAX_PENDING_JOBS = 3  # the running job and the waiting jobs

Results = Mapping[str, Any]
Work = Callable[[], Results]
Arrays = Mapping[str, NDArray[Any]]
Measures = dict[str, Any]


class CacheFileWriter:
    """Writer of files into a cache's folder, in order. It must be closed.

    A frame is written atomically, followed by its line of hashes. A checkpoint is written only after all earlier frames are on
    disk. The methods return measurements, in which `seconds` contains the time spent on each kind of work, by name."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._lines_file = AppendOnlyFile(folder / HASHES_FILE_NAME)
        self._unsynced_files: list[Path] = []
        self._last_line: dict[int, HashLine] = {}  # the last written line

    def frame(self, frame: int, file: StoredFile, line: HashLine) -> Measures:
        """Write the file of a frame, then its line of hashes. Return the time spent."""
        began = time.perf_counter()
        path = make_frame_path(self.folder, frame)
        write_atomically(path, file.parts, sync=False)
        self._unsynced_files.append(path)
        self._write_line(frame, line)
        return _measure_elapsed("write", began)

    def _write_line(self, frame: int, line: HashLine) -> None:
        """Append the line of hashes of a frame."""
        self._last_line = {frame: line}
        self._lines_file.write([line.text(frame)])

    def write_checkpoint(self, frame: int, arrays: Arrays) -> Measures:
        """Flush all earlier frames to disk, then write a checkpoint and its hash. Return the time spent.

        In caches of older versions, checkpoints have no hash."""
        began = time.perf_counter()
        file = make_npz_file(arrays)
        lines = self._last_line or read_lines(self.folder / HASHES_FILE_NAME)
        self._write_line(frame, add_checkpoint_hash(frame, lines[frame], file))
        measures = self.sync_files()
        write_atomically(make_checkpoint_path(self.folder, frame), file.parts)
        measures["seconds"] |= {"checkpoint": time.perf_counter() - began - measures["seconds"]["sync"]}
        return measures

    def sync_files(self) -> Measures:
        """Flush everything written so far to disk. Return the time spent."""
        began = time.perf_counter()
        sync_files(self._unsynced_files)
        self._unsynced_files.clear()
        self._lines_file.sync()
        return _measure_elapsed("sync", began)

    def close(self) -> None:
        """Close the writer. Nothing can be written afterwards."""
        self._lines_file.close()


def _measure_elapsed(label: str, start_time: float) -> Measures:
    """Return a measurement: the seconds since `start_time`, under the name `label`."""
    return {"seconds": {label: time.perf_counter() - start_time}}


class BackgroundWorker:
    """Runner of jobs in a thread, one after the other.

    `report`: a callback that receives the result of each job. It runs in the caller's thread, when the next job is submitted or
    at the end. After an error, no more jobs run, and the next call raises the error."""

    def __init__(self, report: Callable[[Results], None]) -> None:
        self._report = report
        self._jobs: SimpleQueue[Work | None] = SimpleQueue()
        self._results: SimpleQueue[Results | None] = SimpleQueue()  # one per job, None if it did not run
        self._pending_count = 0  # jobs without a reported result
        self._error: BaseException | None = None
        # a daemon thread: a disk that never answers must not keep the program from ending; at worst, an unfinished file remains
        self._thread = threading.Thread(target=self._run_thread, name="cache writer", daemon=True)
        self._thread.start()

    def submit(self, job: Work) -> None:
        """Submit a job, after waiting until not too many jobs are pending. Raises the error of an earlier job."""
        self._report_results(_MAX_PENDING_JOBS - 1)
        self.raise_job_error()
        self._pending_count += 1
        self._jobs.put(job)

    def wait_until_finished(self) -> None:
        """Wait until all jobs have ended and the thread has stopped. Errors of jobs are not raised."""
        if self._thread.is_alive():
            self._jobs.put(None)
            self._thread.join()
        self._report_results(self._pending_count)

    def raise_job_error(self) -> None:
        """Raise the error of an earlier job, if there is one."""
        if self._error is not None:
            raise self._error

    def _report_results(self, max_pending: int) -> None:
        """Wait until at most `max_pending` jobs are pending, and report all results that have arrived."""
        while self._pending_count > max_pending or not self._results.empty():
            measures = self._results.get()
            self._pending_count -= 1
            if measures is not None:
                self._report(measures)

    def _run_thread(self) -> None:
        while (work := self._jobs.get()) is not None:
            measures = None
            if self._error is None:
                try:
                    measures = work()
                except BaseException as problem:  # raised in the caller's thread
                    self._error = problem
            self._results.put(measures)
