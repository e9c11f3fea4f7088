"""The choice of the folder to which a task writes its files.

A worker that can access the requested folder writes to it. Any other worker writes to a local folder. These files are then
fetched in parts, and moved to the requested folder once they are complete."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from antdsl.atomic_write import create_sibling_file
from antdsl.executors import Task, TaskRejectedError, WorkerContext, hash_document
from antdsl.executors.tasks import TaskFunction
from antdsl.limits import MAX_TASK_OUTPUT_BYTES
from antdsl.safe_read import open_size_limited, read_blocks


@dataclass(frozen=True, slots=True)
class Destination:
    """A requested folder with a marker file. A worker that sees the marker can access this folder."""

    folder: str
    token: str

    @classmethod
    def from_document(cls, document: Mapping[str, Any]) -> Destination:
        """Return the destination that is stored in the document of a task."""
        return cls(document["folder"], document["token"])

    def make_task(self, work: TaskFunction, document: Mapping[str, Any]) -> Task:
        """Return a task that writes to this folder. Its key is a hash of `document` and this destination."""
        document = {**document, **asdict(self)}
        key = hash_document(document)
        return Task(key, work, {**document, "key": key})

    def make_frame_tasks(
        self, work: TaskFunction, document: Mapping[str, Any], frames: Sequence[int], chunk: int
    ) -> Iterator[Task]:
        """Yield tasks that write to this folder, each with at most `chunk` of the frames."""
        for start in range(0, len(frames), chunk):
            yield self.make_task(work, {**document, "frames": list(frames[start : start + chunk])})

    def choose_task_folder(self, worker: WorkerContext, key: str) -> Path:
        """Return the folder to which a task writes its files on this machine."""
        if worker.scratch_folder is None or (Path(self.folder) / self.token).is_file():
            return Path(self.folder)
        task_folder = worker.scratch_folder / key
        task_folder.mkdir(exist_ok=True)
        return task_folder

    def describe_files(self, worker: WorkerContext, task_folder: Path, key: str) -> dict[str, Any]:
        """Return the answer of a task that has written its files. It lists the files that must be fetched. Raises
        TaskRejectedError if they are too large."""
        if task_folder == Path(self.folder):
            return {"worker": "", "made": key, "files": []}
        files = [path for path in sorted(task_folder.rglob("*")) if path.is_file()]
        total = sum(path.stat().st_size for path in files)
        if total > MAX_TASK_OUTPUT_BYTES:
            raise TaskRejectedError(
                f"the task made {total:,} bytes, but at most {MAX_TASK_OUTPUT_BYTES:,} can be fetched; name a folder that the "
                "workers can also write to"
            )
        listed = [[path.relative_to(task_folder).as_posix(), path.stat().st_size, _hash_file(path)] for path in files]
        return {"worker": worker.name, "made": key, "files": listed}


@contextmanager
def mark_folder(folder: Path) -> Iterator[Destination]:
    """Yield a folder as a destination. The marker file exists while the context is active."""
    token = create_sibling_file(folder / "seen")
    try:
        yield Destination(str(folder.resolve()), token.name)
    finally:
        token.unlink(missing_ok=True)


def _hash_file(path: Path) -> str:
    hashed = hashlib.blake2b(digest_size=16)
    with open_size_limited(path, MAX_TASK_OUTPUT_BYTES) as file:
        for block in read_blocks(file.fileno(), MAX_TASK_OUTPUT_BYTES):
            hashed.update(block)
    return hashed.hexdigest()
