"""Submits tasks to a `concurrent.futures.Executor` and yields their results as they arrive; replaces a broken executor."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import Any, Protocol

from antdsl.limits import ANSWER_BYTES

TLS_FILES = ("ca.pem", "cert.pem", "key.pem")  # in a folder of certificates: the authority's, one's own, and its key
LOOPBACK = "127.0.0.1"  # where a cluster of this machine listens
LOOK = 0.5  # seconds between looks at how far tasks are

Answer = dict[str, Any]


class TaskRefused(Exception):
    """A task that cannot be done; the message is for its requester. It is not tried again."""


class WorkersLost(Exception):
    """Nothing is left that can run tasks; the message is for their requester."""


@dataclass(slots=True)
class Worker:
    """The environment of a task. `threads`: how many it may use. `report_frame`: called with frames. `cached_values`: objects by
    name that last from one task of the process to the next. `notes`: messages about deviations from the request, sent with the
    answer. `local_path`: maps a path of the requester to this machine. `scratch`: a folder for fetched files, None where all
    machines see the same folders. `name`: of the process, empty on the requester's machine."""

    threads: int
    report_frame: Callable[[int], None] = lambda frame: None
    cached_values: dict[str, Any] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    local_path: Callable[[str], Path] = Path
    scratch: Path | None = None
    name: str = ""


Work = Callable[[dict[str, Any], Worker], Answer]


@dataclass(frozen=True, slots=True)
class Task:
    """`work`: a function at module level of antdsl; `document`: its argument, as JSON values; `key`: a unique name of the
    task."""

    key: str
    work: Work
    document: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class TaskOutcome:
    """The result of a task: an answer, or the error message."""

    task: Task
    answer: Answer | None
    problem: str = ""
    notes: tuple[str, ...] = ()


class Executors(Protocol):
    """Where tasks run."""

    @property
    def task_capacity(self) -> int:
        """How many tasks to have under way."""

    def start(self) -> Executor:
        """Return a new executor, in place of a broken one."""

    def submit(self, executor: Executor, task: Task, place: int) -> Future[str]:
        """Submit a task. `place`: a number below `task_capacity` that no other running task has."""

    def frame(self, place: int) -> int | None:
        """Return the current frame of the task at a place, if known."""

    def take_notes(self) -> Iterable[str]:
        """Return the messages about workers since the last call."""

    def break_reason(self) -> str:
        """What ended the executor, once it is broken."""

    def stop(self, executor: Executor) -> None:
        """End it, and what it runs, at once."""


def run_tasks(
    tasks: Iterable[Task],
    executors: Executors,
    report_frame: Callable[[Task, int], None] = lambda task, frame: None,
    noted: Callable[[str], None] = lambda sentence: None,
) -> Iterator[TaskOutcome]:
    """Run tasks and yield the outcome of each as it is known. `report_frame` is called from time to time with the frame that a
    task has reached, `noted` with messages about workers. `tasks` is read one at a time, whenever another one can start.

    Where a process is lost, the cause is unknown: all running tasks are run again, one by one. A task that breaks the executor
    when it runs alone is given up. Raises WorkersLost where no executor can be started again."""
    waiting, suspects = iter(tasks), deque[Task]()
    running: dict[Future[str], tuple[Task, int]] = {}
    executor, alone = executors.start(), False
    try:
        while True:
            if not running:
                alone = bool(suspects)  # and it stays so until that one has ended
            while len(running) < (1 if alone else executors.task_capacity):
                task = suspects.popleft() if alone else next(waiting, None)
                if task is None:
                    break
                taken = {place for _, place in running.values()}
                place = next(number for number in count() if number not in taken)
                running[executors.submit(executor, task, place)] = task, place
            if not running:
                return
            finished_futures, _ = wait(running, timeout=LOOK, return_when=FIRST_COMPLETED)
            for sentence in executors.take_notes():
                noted(sentence)
            for future, (task, place) in running.items():
                frame = executors.frame(place) if future not in finished_futures else None
                if frame is not None:
                    report_frame(task, frame)
            if any(_is_broken(future) for future in finished_futures):
                finished_futures, _ = wait(running)  # with it all the others are broken, or answered just before
            lost = []
            for future in finished_futures:
                task, _ = running.pop(future)
                if _is_broken(future):
                    lost.append(task)
                else:
                    yield _outcome_of(task, future)
            if lost:
                why = executors.break_reason()
                executors.stop(executor)
                executor = executors.start()
                if alone:
                    yield TaskOutcome(lost[0], None, why)
                else:
                    suspects.extend(lost)
    finally:
        executors.stop(executor)


def _is_broken(future: Future[str]) -> bool:
    return future.cancelled() or isinstance(future.exception(), BrokenExecutor)


def _outcome_of(task: Task, future: Future[str]) -> TaskOutcome:
    why = future.exception()
    if isinstance(why, TaskRefused | MemoryError | OSError):
        return TaskOutcome(task, None, str(why) or "out of memory")
    if why is not None:
        raise why
    document = json.loads(future.result())
    return TaskOutcome(task, document["answer"], notes=tuple(document["notes"]))


def perform(work: Work, text: str, worker: Worker) -> str:
    """Do a task where it runs: JSON in, JSON out."""
    worker.notes.clear()
    answer = work(json.loads(text), worker)
    text = json.dumps({"answer": answer, "notes": worker.notes})
    if len(text) > ANSWER_BYTES:
        raise TaskRefused(f"its result has {len(text):,} bytes, and more than {ANSWER_BYTES:,} are not sent")
    return text
