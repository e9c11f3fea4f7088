"""Processes of this machine: each starts from scratch, imports everything once and runs one task after the other."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import MutableSequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from multiprocessing.process import BaseProcess

from antdsl.child_processes import isolate
from antdsl.executors.tasks import LOOK, Task, Work, Worker, perform

_PATIENCE = 5.0  # seconds to wait for the end of a process
_NONE = -(2**62)  # where no frame is known


class Processes:
    """So many processes, with so many threads each."""

    def __init__(self, count: int, threads: int) -> None:
        self._count = count
        self._threads = threads
        self._frames: MutableSequence[int] = []
        self._before: frozenset[BaseProcess] = frozenset()
        self._own: set[BaseProcess] = set()

    @property
    def task_capacity(self) -> int:
        return self._count

    def start(self) -> Executor:
        isolate()
        context = multiprocessing.get_context("spawn")
        self._frames = context.RawArray("q", [_NONE] * self._count)
        self._before, self._own = frozenset(multiprocessing.active_children()), set()
        return ProcessPoolExecutor(self._count, context, _start_process, (self._threads, self._frames))

    def submit(self, executor: Executor, task: Task, place: int) -> Future[str]:
        self._frames[place] = _NONE
        future = executor.submit(_perform, task.work, json.dumps(task.document), place)
        self._own.update(set(multiprocessing.active_children()) - self._before)
        return future

    def frame(self, place: int) -> int | None:
        frame = self._frames[place]
        return None if frame == _NONE else frame

    def take_notes(self) -> tuple[str, ...]:
        return ()

    def break_reason(self) -> str:
        for process in self._own:
            process.join(_PATIENCE)
        codes = [process.exitcode for process in self._own]
        # the pool itself ends the others by SIGTERM once one is gone
        return _describe_end(next((code for code in codes if code not in (None, 0, -signal.SIGTERM)), -signal.SIGTERM))

    def stop(self, executor: Executor) -> None:
        executor.shutdown(wait=False, cancel_futures=True)
        for process in self._own:
            process.terminate()
        until = time.monotonic() + _PATIENCE
        for process in self._own:
            process.join(max(0.0, until - time.monotonic()))
            if process.is_alive():
                process.kill()
                process.join()
        executor.shutdown(wait=True)


def _describe_end(code: int | None) -> str:
    if code is not None and code < 0:
        name = signal.Signals(-code).name if -code in {s.value for s in signal.Signals} else str(-code)
        reason = ", most likely because memory ran out" if name == "SIGKILL" else ""
        return f"its process was ended by {name}{reason}"
    return f"its process ended with code {code}"


_worker = Worker(1)
_frames: MutableSequence[int] = []


def _start_process(threads: int, frames: MutableSequence[int]) -> None:
    """The first thing that a process does."""
    global _worker, _frames
    _worker, _frames = Worker(threads), frames
    if not sys.warnoptions:
        warnings.simplefilter("ignore")  # of libraries, as in the process that the terminal has
    # Ctrl-C reaches the process that requested the tasks, and that one ends this one
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """End this process when its parent ends. Otherwise the processes of a killed pool owner would wait for tasks for ever."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _perform(work: Work, text: str, place: int) -> str:
    said = time.monotonic()

    def report_frame(frame: int) -> None:
        nonlocal said
        if time.monotonic() - said > LOOK:
            said = time.monotonic()
            _frames[place] = frame

    _worker.report_frame = report_frame
    return perform(work, text, _worker)
