"""Where a task writes its files: to the requested folder, if the worker can access it. Otherwise to a folder of the worker, from
which they are fetched in parts and moved into place when complete."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

from antdsl.bounded import open_bounded, read_blocks
from antdsl.executors import Executors, Task, TaskOutcome, TaskRefused, Worker, WorkersLost, run_tasks
from antdsl.limits import MADE_BYTES
from antdsl.whole import atomic_file, make_folder, new_sibling

_TRIES = 3  # number of attempts of a task with files that cannot be fetched


class FileFetcher(Protocol):
    """Where files of a worker can be had."""

    def fetch(self, worker: str, file: str, size: int) -> Iterator[bytes]: ...

    def forget(self, worker: str, folder: str) -> None: ...


@dataclass(frozen=True, slots=True)
class Destination:
    """A folder with a marker file, by which a worker recognises the folder if it can access it."""

    folder: str
    token: str

    def place(self, worker: Worker, key: str) -> Path:
        """Return the folder to which a task writes its files on this machine."""
        if worker.scratch is None or (Path(self.folder) / self.token).is_file():
            return Path(self.folder)
        task_folder = worker.scratch / key
        task_folder.mkdir(exist_ok=True)
        return task_folder

    def describe_files(self, worker: Worker, place: Path, key: str) -> dict[str, Any]:
        """Return the answer of a task after it has written files: what is to be fetched. Raises Refused if it is too large."""
        if place == Path(self.folder):
            return {"worker": "", "made": key, "files": []}
        files = [path for path in sorted(place.rglob("*")) if path.is_file()]
        total = sum(path.stat().st_size for path in files)
        if total > MADE_BYTES:
            raise TaskRefused(
                f"it made {total:,} bytes, and more than {MADE_BYTES:,} are not fetched; name a folder that workers see too"
            )
        listed = [[path.relative_to(place).as_posix(), path.stat().st_size, _file_digest(path)] for path in files]
        return {"worker": worker.name, "made": key, "files": listed}


@contextmanager
def mark_folder(folder: Path) -> Iterator[Destination]:
    """A folder that is there, marked meanwhile."""
    token = new_sibling(folder / "seen")
    try:
        yield Destination(str(folder.resolve()), token.name)
    finally:
        token.unlink(missing_ok=True)


def run_and_fetch(
    tasks: Iterable[Task],
    executors: Executors,
    folder: Callable[[Task], Path],
    report_frame: Callable[[Task, int], None] = lambda task, frame: None,
    noted: Callable[[str], None] = lambda sentence: None,
) -> Iterator[TaskOutcome]:
    """Run tasks with `Destination.made` answers, and yield each once its files are in their folder. A task runs again if its
    worker is gone before all files are fetched."""
    again: list[Task] = list(tasks)
    for attempt in range(_TRIES):
        waiting, again = again, []
        for answered in run_tasks(waiting, executors, report_frame, noted):
            try:
                if answered.answer is not None and answered.answer["files"]:
                    _fetch(answered.answer, executors, folder(answered.task))
            except WorkersLost as why:
                if attempt == _TRIES - 1:
                    yield replace(answered, answer=None, problem=str(why))
                else:
                    again.append(answered.task)
                continue
            except (OSError, TaskRefused) as why:
                yield replace(answered, answer=None, problem=str(why))
                continue
            yield answered


def _fetch(answer: dict[str, Any], source: Any, folder: Path) -> None:
    fetcher: FileFetcher = source
    root, left = folder.resolve(), MADE_BYTES
    for name, size, digest in answer["files"]:
        path, left = (root / name).resolve(), left - size
        if not path.is_relative_to(root) or left < 0:
            raise TaskRefused(f"a worker made `{name}` of {size:,} bytes, which does not fit in `{folder}`")
        make_folder(path.parent)
        hashed = hashlib.blake2b(digest_size=16)
        with atomic_file(path) as file:
            for data in fetcher.fetch(answer["worker"], f"{answer['made']}/{name}", size):
                hashed.update(data)
                file.write(data)
            if hashed.hexdigest() != digest:
                raise WorkersLost(f"`{name}` changed during the transfer")
    fetcher.forget(answer["worker"], answer["made"])


def _file_digest(path: Path) -> str:
    hashed = hashlib.blake2b(digest_size=16)
    with open_bounded(path, MADE_BYTES) as file:
        for block in read_blocks(file.fileno(), MADE_BYTES):
            hashed.update(block)
    return hashed.hexdigest()
