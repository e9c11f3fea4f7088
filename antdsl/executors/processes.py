"""The engine that runs tasks in processes on this machine.

Each process starts from scratch, imports everything once, and runs one task after the other."""

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
from concurrent.futures import Future, ProcessPoolExecutor
from multiprocessing.process import BaseProcess

from antdsl.child_processes import hide_main_module, isolate_search_paths
from antdsl.executors.tasks import Engine, Task, TaskFunction, WorkerContext, run_task

_EXIT_WAIT_SECONDS = 5.0  # limit for the end of a process
_NO_FRAME = -(2**62)  # marks a task without a known frame


class ProcessEngine(Engine):
    """An engine of `count` processes with `threads` threads each."""

    task_capacity = 0

    def __init__(self, count: int, threads: int) -> None:
        self.task_capacity, self._threads = count, threads
        self._pool: ProcessPoolExecutor | None = None
        self._other_children: frozenset[BaseProcess] = frozenset()
        self._own_processes: set[BaseProcess] = set()

    def start(self) -> None:
        isolate_search_paths()
        context = multiprocessing.get_context("spawn")
        self._frame_by_slot: MutableSequence[int] = context.RawArray("q", [_NO_FRAME] * self.task_capacity)
        # the task that reports in each slot of the frames
        self._future_by_slot: list[Future[str] | None] = [None] * self.task_capacity
        self._other_children, self._own_processes = frozenset(multiprocessing.active_children()), set()
        self._pool = ProcessPoolExecutor(self.task_capacity, context, _initialise_process, (self._threads, self._frame_by_slot))

    def submit(self, task: Task) -> Future[str]:
        assert self._pool is not None
        slot = next(number for number, future in enumerate(self._future_by_slot) if future is None or future.done())
        self._frame_by_slot[slot] = _NO_FRAME
        with hide_main_module():
            future = self._pool.submit(_run_task_in_process, task.function, json.dumps(task.document), slot)
        self._future_by_slot[slot] = future
        self._own_processes.update(set(multiprocessing.active_children()) - self._other_children)
        return future

    def find_frame(self, future: Future[str]) -> int | None:
        frame = self._frame_by_slot[self._future_by_slot.index(future)]
        return None if frame == _NO_FRAME else frame

    def explain_process_end(self) -> str:
        for process in self._own_processes:
            process.join(_EXIT_WAIT_SECONDS)
        codes = [process.exitcode for process in self._own_processes]
        # when one process has ended, the pool itself ends the others by SIGTERM
        return _describe_exit(next((code for code in codes if code not in (None, 0, -signal.SIGTERM)), -signal.SIGTERM))

    def stop(self) -> None:
        if self._pool is None:
            return
        self._pool.shutdown(wait=False, cancel_futures=True)
        for process in self._own_processes:
            process.terminate()
        deadline = time.monotonic() + _EXIT_WAIT_SECONDS
        for process in self._own_processes:
            process.join(max(0.0, deadline - time.monotonic()))
            if process.is_alive():
                process.kill()
                process.join()
        self._pool.shutdown(wait=True)


def _describe_exit(code: int | None) -> str:
    """Return a clause that says why a process ended. `code`: its exit code; a negative one is the number of a signal."""
    if code is not None and code < 0:
        name = signal.Signals(-code).name if -code in {s.value for s in signal.Signals} else str(-code)
        reason = ", most likely because memory ran out" if name == "SIGKILL" else ""
        return f"the worker process was stopped by {name}{reason}"
    return f"the worker process ended with code {code}"


_PROCESS_WORKER = WorkerContext(1)
_frame_by_slot: MutableSequence[int] = []


def _initialise_process(threads: int, frame_by_slot: MutableSequence[int]) -> None:
    """Initialise a process of the pool: its environment, its signals, and a thread that ends it when its parent ends."""
    global _PROCESS_WORKER, _frame_by_slot
    _PROCESS_WORKER, _frame_by_slot = WorkerContext(threads), frame_by_slot
    if not sys.warnoptions:
        warnings.simplefilter("ignore")  # warnings of libraries, as in the main process
    # Ctrl-C reaches the process that requested the tasks, which ends this one
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """End this process when its parent ends. Otherwise, the processes of a killed parent would wait for tasks forever."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _run_task_in_process(work: TaskFunction, document_text: str, slot: int) -> str:
    """Run a task in a process of the pool, and return its answer as JSON.

    `work`: the task's function. `document_text`: its argument as JSON. `slot`: the index of the shared counter that reports the
    task's current frame."""

    def say_frame(frame: int) -> None:
        _frame_by_slot[slot] = frame

    return run_task(work, document_text, _PROCESS_WORKER, say_frame)
