"""Submits tasks to an engine and yields their results as they arrive; tasks that were lost run again."""

from __future__ import annotations

import hashlib
import json
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, wait
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from antdsl.limits import MAX_TASK_ANSWER_BYTES, MAX_TASK_OUTPUT_BYTES
from antdsl.whole import atomic_file, make_folder

TLS_FILES = ("ca.pem", "cert.pem", "key.pem")  # in a folder of certificates: the authority's, one's own, and its key
LOOPBACK = "127.0.0.1"  # where a cluster of this machine listens
LOOK = 0.5  # seconds between looks at how far tasks are
_TRIES = 3  # attempts of a task with files that cannot be fetched

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
    task. An answer with `files` (path, size, digest), `worker` and `made` tells which files are to be fetched."""

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


class Engine:
    """Runs tasks. A future that is cancelled is of a lost task, which is submitted again; one that has BrokenExecutor has lost
    its process, perhaps by its own fault."""

    @property
    def task_capacity(self) -> int:
        """Return how many tasks to have running."""
        raise NotImplementedError

    def start(self) -> None:
        """Begin, or begin again after a stop. Raises WorkersLost."""
        raise NotImplementedError

    def submit(self, task: Task) -> Future[str]:
        """Submit a task; fewer than `task_capacity` are running. Raises WorkersLost."""
        raise NotImplementedError

    def stop(self) -> None:
        """End all running tasks at once."""
        raise NotImplementedError

    def frame(self, future: Future[str]) -> int | None:
        """Return the current frame of a running task, if known."""
        return None

    def take_notes(self) -> Iterable[str]:
        """Return the messages about workers since the last call."""
        return ()

    def break_reason(self) -> str:
        """Return what ended the processes, once they are broken."""
        raise NotImplementedError

    def describe_failure(self, why: BaseException) -> str:
        """Return the message for a task that ended with an exception. Raises it if it is a mistake of antdsl."""
        if isinstance(why, TaskRefused | MemoryError | OSError):
            return str(why) or "out of memory"
        raise why

    def fetch(self, worker: str, file: str, size: int) -> Iterator[bytes]:
        """Yield the parts of a file that a task wrote on a worker. Raises WorkersLost if it is missing or ends before its
        size."""
        raise NotImplementedError

    def forget(self, worker: str, folder: str) -> None:
        """Have a worker remove what a task wrote."""


def run_tasks(
    tasks: Iterable[Task],
    engine: Engine,
    report_frame: Callable[[Task, int], None] = lambda task, frame: None,
    noted: Callable[[str], None] = lambda sentence: None,
    folder_of: Callable[[Task], Path] = lambda task: Path(),
) -> Iterator[TaskOutcome]:
    """Run tasks and yield the outcome of each as it is known, once its files are in `folder_of(task)`. `report_frame` is called
    from time to time with the frame that a task has reached, `noted` with messages about workers. `tasks` is read one at a time,
    whenever another one can start.

    Where a process is lost, the cause is unknown: all running tasks are run again, one by one. A task that breaks the engine when
    it runs alone is given up. Raises WorkersLost where the engine cannot start again."""
    waiting, suspects, lost = iter(tasks), deque[Task](), deque[Task]()
    running: dict[Future[str], Task] = {}
    attempts: dict[str, int] = {}
    alone = False
    try:
        engine.start()
        while True:
            if not running:
                alone = bool(suspects)  # and it stays so until that one has ended
            while len(running) < (1 if alone else engine.task_capacity):
                task = suspects.popleft() if alone else lost.popleft() if lost else next(waiting, None)
                if task is None:
                    break
                running[engine.submit(task)] = task
            if not running:
                return
            finished_futures, _ = wait(running, timeout=LOOK, return_when=FIRST_COMPLETED)
            for sentence in engine.take_notes():
                noted(sentence)
            for future, task in running.items():
                frame = engine.frame(future) if future not in finished_futures else None
                if frame is not None:
                    report_frame(task, frame)
            is_broken = any(map(_is_broken, finished_futures))
            if is_broken:
                finished_futures, _ = wait(running)  # with it all the others are broken, or answered just before
            broken_tasks = []
            for future in finished_futures:
                task = running.pop(future)
                if future.cancelled():
                    lost.append(task)
                elif _is_broken(future):
                    broken_tasks.append(task)
                elif (outcome := _fetch_outcome(task, future, engine, folder_of, attempts)) is None:
                    lost.append(task)
                else:
                    yield outcome
            if is_broken:
                why = engine.break_reason()
                engine.stop()
                engine.start()
                if alone:
                    yield TaskOutcome(broken_tasks[0], None, why)
                else:
                    suspects.extend(broken_tasks)
    finally:
        engine.stop()


def _is_broken(future: Future[str]) -> bool:
    return not future.cancelled() and isinstance(future.exception(), BrokenExecutor)


def _fetch_outcome(
    task: Task, future: Future[str], engine: Engine, folder_of: Callable[[Task], Path], attempts: dict[str, int]
) -> TaskOutcome | None:
    """Return the outcome of a task that has ended, after its files were fetched; None if they are lost and it is tried again.
    `attempts`: the failed fetches by key of a task."""
    why = future.exception()
    if why is not None:
        return TaskOutcome(task, None, engine.describe_failure(why))
    document = json.loads(future.result())
    answer, notes = document["answer"], tuple(document["notes"])
    try:
        if answer.get("files"):
            _fetch_files(answer, engine, folder_of(task))
    except WorkersLost as lost:
        attempts[task.key] = attempts.get(task.key, 0) + 1
        return None if attempts[task.key] < _TRIES else TaskOutcome(task, None, str(lost), notes)
    except (OSError, TaskRefused) as refused:
        return TaskOutcome(task, None, str(refused), notes)
    return TaskOutcome(task, answer, notes=notes)


def _fetch_files(answer: Answer, engine: Engine, folder: Path) -> None:
    """Move the files of an answer to a folder, each atomically, and have the worker remove its own."""
    root, left = folder.resolve(), MAX_TASK_OUTPUT_BYTES
    for name, size, digest in answer["files"]:
        path, left = (root / name).resolve(), left - size
        if not path.is_relative_to(root) or left < 0:
            raise TaskRefused(f"a worker made `{name}` of {size:,} bytes, which does not fit in `{folder}`")
        make_folder(path.parent)
        hashed = hashlib.blake2b(digest_size=16)
        with atomic_file(path) as file:
            for data in engine.fetch(answer["worker"], f"{answer['made']}/{name}", size):
                hashed.update(data)
                file.write(data)
            if hashed.hexdigest() != digest:
                raise WorkersLost(f"`{name}` changed during the transfer")
    engine.forget(answer["worker"], answer["made"])


def perform(work: Work, text: str, worker: Worker, say_frame: Callable[[int], None] = lambda frame: None) -> str:
    """Do a task where it runs: JSON in, JSON out. `say_frame` is called from time to time with the current frame."""
    said = time.monotonic()

    def report_frame(frame: int) -> None:
        nonlocal said
        if time.monotonic() - said > LOOK:
            said = time.monotonic()
            say_frame(frame)

    worker.report_frame = report_frame
    worker.notes.clear()
    answer = work(json.loads(text), worker)
    text = json.dumps({"answer": answer, "notes": worker.notes})
    if len(text) > MAX_TASK_ANSWER_BYTES:
        raise TaskRefused(f"its result has {len(text):,} bytes, and more than {MAX_TASK_ANSWER_BYTES:,} are not sent")
    return text


@contextmanager
def refuse_task(*kinds: type[Exception]) -> Iterator[None]:
    """Turn exceptions of these kinds into TaskRefused with the same message."""
    try:
        yield
    except kinds as why:
        raise TaskRefused(str(why)) from None


def document_digest(document: Mapping[str, Any]) -> str:
    """Return a hash of JSON values, for the key of a task."""
    return hashlib.blake2b(json.dumps(document, sort_keys=True).encode(), digest_size=12).hexdigest()
