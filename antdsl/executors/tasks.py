"""The function that runs tasks on an engine and yields their results as they arrive. Lost tasks run again."""

from __future__ import annotations

import hashlib
import json
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, wait
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from antdsl.atomic_write import atomic_file, create_folder_durably
from antdsl.limits import MAX_TASK_ANSWER_BYTES, MAX_TASK_OUTPUT_BYTES

TLS_FILE_NAMES = ("ca.pem", "cert.pem", "key.pem")  # in a folder of certificates: of the authority, own certificate, own key
LOOPBACK = "127.0.0.1"  # address of a cluster on this machine
POLL_SECONDS = 0.5  # interval between progress checks
_MAX_TASK_ATTEMPTS = 3  # maximum number of attempts of a task with files that cannot be fetched

TaskAnswer = dict[str, Any]


class TaskRejectedError(Exception):
    """Error for a task that cannot be carried out. The message is written for the requester. The task is not repeated."""


class WorkersLostError(Exception):
    """Error if no process or worker is left to run tasks. The message is written for the requester."""


@dataclass(slots=True)
class WorkerContext:
    """The environment of a task.

    `threads`: the number of threads that the task may use.
    `report_frame`: a function to call with the current frame.
    `cached_values`: objects by name, which stay in the process for later tasks.
    `notes`: messages about deviations from the request, sent with the answer.
    `find_local_path`: a function that converts a path on the requester's machine to a path on this machine.
    `scratch_folder`: a folder for files that the requester fetches; None if all machines see the same folders.
    `name`: the name of the process; empty on the requester's machine."""

    threads: int
    report_frame: Callable[[int], None] = lambda frame: None
    cached_values: dict[str, Any] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    find_local_path: Callable[[str], Path] = Path
    scratch_folder: Path | None = None
    name: str = ""


TaskFunction = Callable[[dict[str, Any], WorkerContext], TaskAnswer]


@dataclass(frozen=True, slots=True)
class Task:
    """A function to run in another process.

    `key`: the task's unique name.
    `function`: a function at module level of antdsl.
    `document`: the argument of `function`, as JSON values.

    The answer may list `files` to fetch, each with path, size and digest. It then also has `worker`, the worker's address, and
    `made`, the task's folder there."""

    key: str
    function: TaskFunction
    document: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class TaskOutcome:
    """The outcome of a task: an answer, or an error message."""

    task: Task
    answer: TaskAnswer | None
    problem: str = ""
    notes: tuple[str, ...] = ()


class Engine(ABC):
    """The interface for running tasks in other processes.

    If a task is lost, its future is cancelled, and the task must be submitted again. If its process has ended, possibly because
    of the task, the future raises BrokenExecutor."""

    @property
    @abstractmethod
    def task_capacity(self) -> int:
        """Return the number of tasks that should be submitted at the same time."""

    @abstractmethod
    def start(self) -> None:
        """Start the engine, or restart it after a stop. Raises WorkersLostError if this fails."""

    @abstractmethod
    def submit(self, task: Task) -> Future[str]:
        """Submit a task. Call this only while fewer than `task_capacity` tasks are running. Raises WorkersLostError if that
        fails."""

    @abstractmethod
    def stop(self) -> None:
        """End all running tasks at once."""

    def find_frame(self, future: Future[str]) -> int | None:
        """Return the current frame of a running task; None if it is unknown. `future`: as returned by `submit`."""
        return None

    def collect_notes(self) -> Iterable[str]:
        """Return the messages about workers that have arrived since the last call."""
        return ()

    def explain_process_end(self) -> str:
        """Return why the processes of the engine ended. Call this only after a future has raised BrokenExecutor."""
        raise NotImplementedError  # only engines with processes on this machine can break

    def describe_failure(self, exception: BaseException) -> str:
        """Return the message about a task that ended with an exception. An exception that is a bug in antdsl is raised again."""
        if isinstance(exception, TaskRejectedError | MemoryError | OSError):
            return str(exception) or "out of memory"
        raise exception

    def fetch_file(self, worker: str, file: str, size: int) -> Iterator[bytes]:
        """Yield the parts of a file that a task wrote on a worker. Raises WorkersLostError if the file is missing or shorter than
        `size`."""
        raise NotImplementedError  # only tasks on other machines leave files to fetch

    def remove_task_files(self, worker: str, folder: str) -> None:
        """Make a worker remove the files that a task has written there. `folder`: the task's folder on the worker."""
        return  # tasks on this machine write directly to the final folder


def run_tasks(
    tasks: Iterable[Task],
    engine: Engine,
    report_frame: Callable[[Task, int], None] = lambda task, frame: None,
    report_note: Callable[[str], None] = lambda sentence: None,
    choose_folder: Callable[[Task], Path] = lambda task: Path(),
) -> Iterator[TaskOutcome]:
    """Run tasks and yield the outcome of each as soon as it is known and its files are in `choose_folder(task)`.

    `tasks`: the next one is read only when another task can start.
    `report_frame`: called from time to time with a task and its current frame.
    `report_note`: called with messages about workers.

    If a process is lost, the cause is unknown, so all running tasks run again, one by one. A task that breaks the engine while
    it runs alone fails. Raises WorkersLostError if the engine cannot start again.
    """
    waiting, suspects, lost_tasks = iter(tasks), deque[Task](), deque[Task]()
    running: dict[Future[str], Task] = {}
    attempts: dict[str, int] = {}
    runs_alone = False
    try:
        engine.start()
        while True:
            if not running:
                runs_alone = bool(suspects)  # stays set until that task has ended
            while len(running) < (1 if runs_alone else engine.task_capacity):
                task = suspects.popleft() if runs_alone else lost_tasks.popleft() if lost_tasks else next(waiting, None)
                if task is None:
                    break
                running[engine.submit(task)] = task
            if not running:
                return
            wait(running, timeout=POLL_SECONDS, return_when=FIRST_COMPLETED)
            finished_futures = _find_finished(running)
            for sentence in engine.collect_notes():
                report_note(sentence)
            for future, task in running.items():
                frame = engine.find_frame(future) if future not in finished_futures else None
                if frame is not None:
                    report_frame(task, frame)
            is_broken = any(map(_is_broken, finished_futures))
            if is_broken:
                # if one has broken, all others are broken too, or answered just before
                while len(finished_futures) < len(running):
                    wait(running, timeout=POLL_SECONDS)
                    finished_futures = _find_finished(running)
            broken_tasks = []
            for future in finished_futures:
                task = running.pop(future)
                if future.cancelled():
                    lost_tasks.append(task)
                elif _is_broken(future):
                    broken_tasks.append(task)
                elif (outcome := _fetch_outcome(task, future, engine, choose_folder, attempts)) is None:
                    lost_tasks.append(task)
                else:
                    yield outcome
            if is_broken:
                reason = engine.explain_process_end()
                engine.stop()
                engine.start()
                if runs_alone:
                    yield TaskOutcome(broken_tasks[0], None, reason)
                else:
                    suspects.extend(broken_tasks)
    finally:
        engine.stop()


def _find_finished(running_tasks: Mapping[Future[str], Task]) -> list[Future[str]]:
    """Return the futures of all tasks that have ended. The result of `wait` is not used, because it omits a future that is
    cancelled while its task ends."""
    return [future for future in running_tasks if future.done()]


def _is_broken(future: Future[str]) -> bool:
    """Return whether the process of a task has ended before the task was answered."""
    return not future.cancelled() and isinstance(future.exception(), BrokenExecutor)


def _fetch_outcome(
    task: Task, future: Future[str], engine: Engine, choose_folder: Callable[[Task], Path], attempts: dict[str, int]
) -> TaskOutcome | None:
    """Return the outcome of a task that has ended, after fetching its files.

    Return None if the files are lost, so that the task must run again. `attempts`: the number of failed fetches by task key,
    which is updated."""
    exception = future.exception()
    if exception is not None:
        return TaskOutcome(task, None, engine.describe_failure(exception))
    document = json.loads(future.result())
    answer, notes = document["answer"], tuple(document["notes"])
    try:
        if answer.get("files"):
            _fetch_files(answer, engine, choose_folder(task))
    except WorkersLostError as lost:
        attempts[task.key] = attempts.get(task.key, 0) + 1
        return None if attempts[task.key] < _MAX_TASK_ATTEMPTS else TaskOutcome(task, None, str(lost), notes)
    except (OSError, TaskRejectedError) as error:
        return TaskOutcome(task, None, str(error), notes)
    return TaskOutcome(task, answer, notes=notes)


def _fetch_files(answer: TaskAnswer, engine: Engine, folder: Path) -> None:
    """Move the files of an answer to a folder, each atomically. Then make the worker remove its copies."""
    root, left = folder.resolve(), MAX_TASK_OUTPUT_BYTES
    for name, size, digest in answer["files"]:
        path, left = (root / name).resolve(), left - size
        if not path.is_relative_to(root) or left < 0:
            raise TaskRejectedError(f"a worker made `{name}` of {size:,} bytes, which is too large or leads out of `{folder}`")
        create_folder_durably(path.parent)
        hashed = hashlib.blake2b(digest_size=16)
        with atomic_file(path) as file:
            for data in engine.fetch_file(answer["worker"], f"{answer['made']}/{name}", size):
                hashed.update(data)
                file.write(data)
            if hashed.hexdigest() != digest:
                raise WorkersLostError(f"`{name}` changed during the transfer")
    engine.remove_task_files(answer["worker"], answer["made"])


def run_task(
    work: TaskFunction, document_text: str, worker: WorkerContext, send_frame: Callable[[int], None] = lambda frame: None
) -> str:
    """Run a task in the current process, and return its answer as JSON.

    `work`: the task's function. `document_text`: its argument as JSON. `send_frame`: called from time to time with the current
    frame."""
    last_report = time.monotonic()

    def report_frame(frame: int) -> None:
        nonlocal last_report
        if time.monotonic() - last_report > POLL_SECONDS:
            last_report = time.monotonic()
            send_frame(frame)

    worker.report_frame = report_frame
    worker.notes.clear()
    answer = work(json.loads(document_text), worker)
    document_text = json.dumps({"answer": answer, "notes": worker.notes})
    if len(document_text) > MAX_TASK_ANSWER_BYTES:
        raise TaskRejectedError(
            f"the result of the task has {len(document_text):,} bytes; the limit is {MAX_TASK_ANSWER_BYTES:,}"
        )
    return document_text


@contextmanager
def raise_as_task_rejected(*kinds: type[Exception]) -> Iterator[None]:
    """While the context is active, turn exceptions of these kinds into TaskRejectedError with the same message."""
    try:
        yield
    except kinds as error:
        raise TaskRejectedError(str(error)) from None


def hash_document(document: Mapping[str, Any]) -> str:
    """Return a hash of JSON values, for use in the key of a task."""
    return hashlib.blake2b(json.dumps(document, sort_keys=True).encode(), digest_size=12).hexdigest()
