"""The code that runs on each worker of a Dask cluster. It receives a project's files, reports whether it can run tasks, and runs
them.

A worker that has the files and the same antdsl sources offers a resource named after both. A task needs one unit of this
resource. So a worker with other sources, or without space for the files, never gets a task, even if it joins later. A worker
runs one task at a time.
"""

from __future__ import annotations

import asyncio
import functools
import platform
import shutil
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from distributed import get_worker
from distributed.diagnostics.plugin import WorkerPlugin

from antdsl import __version__
from antdsl.executors.input_bundle import FileBundle, VisibleFile, find_unpacked_path
from antdsl.executors.tasks import TaskFunction, TaskRejectedError, WorkerContext, run_task
from antdsl.limits import MAX_TASK_OUTPUT_BYTES, MIB
from antdsl.safe_read import open_size_limited
from antdsl.source_hash import hash_sources

FILE_PART_BYTES = 8 * MIB  # bytes per request of a fetched file


class ProjectPlugin(WorkerPlugin):  # type: ignore[misc]
    """A Dask plugin with the files of a project, which every worker of a cluster receives. The contents of these files are the
    only user data in this object."""

    def __init__(self, bundle: FileBundle, sources: str, visible_file: VisibleFile | None) -> None:
        self.name = f"antdsl-{visible_file.digest if visible_file is not None else bundle.digest}-{sources}"
        self.bundle, self.sources, self.visible_file = bundle, sources, visible_file
        self.worker: WorkerContext | None = None

    async def setup(self, worker: Any) -> None:
        """Install the files. Dask calls this when a worker starts, or when a running worker receives the plugin."""
        if self.sources != hash_sources():
            worker.log_event(self.name, {"refused": explain_mismatch(worker.address, describe_worker(), self.sources)})
            return
        if self.visible_file is not None and not self.visible_file.is_visible():
            message = f"worker {worker.address} gets no tasks: it cannot read `{self.visible_file.path}`, unlike other workers"
            worker.log_event(self.name, {"refused": message})
            return
        folder = Path(worker.local_directory) / self.name
        try:
            await asyncio.to_thread(_unpack_bundle, self.bundle, folder)
        except (OSError, TaskRejectedError) as error:
            words = str(error) if isinstance(error, TaskRejectedError) else f"its disk: {(error.strerror or str(error)).lower()}"
            worker.log_event(
                self.name, {"refused": f"worker {worker.address} gets no tasks, because it does not have the files: {words}"}
            )
            return
        files = folder / "files"
        local_path = Path if self.visible_file is not None else functools.partial(find_unpacked_path, files)
        self.worker = WorkerContext(
            worker.state.nthreads, find_local_path=local_path, scratch_folder=folder / "made", name=worker.address
        )
        # set only once: setting it again would free resources that tasks occupy
        if self.name not in worker.state.total_resources:
            await worker.set_resources(**{self.name: 1})
        worker.log_event(self.name, {"fit": worker.address})


_TASK_LOCK = threading.Lock()


def _unpack_bundle(bundle: FileBundle, folder: Path) -> None:
    """Unpack files to the folder where tasks look for them, unless an earlier command has done so."""
    with _TASK_LOCK:
        complete_mark = folder / "whole"  # exists once all other files are complete
        if complete_mark.is_file():
            return
        shutil.rmtree(folder, ignore_errors=True)
        bundle.unpack(folder / "files")
        (folder / "made").mkdir(parents=True)
        complete_mark.touch()


def describe_worker() -> dict[str, str]:
    """Return the versions and the host name of this worker."""
    return {"antdsl": __version__, "sources": hash_sources(), "host": platform.node()}


def can_see_file(visible_file: VisibleFile) -> bool:
    """Return whether this worker sees the requester's file at the same path."""
    return visible_file.is_visible()


def explain_mismatch(address: str, worker_versions: Mapping[str, str], expected_sources: str) -> str:
    """Return the message about a worker that gets no tasks, because its antdsl sources differ from the requester's.
    `worker_versions`: the result of `describe_worker`."""
    return (
        f"worker {address} on {worker_versions['host']} gets no tasks: its antdsl {worker_versions['antdsl']} has different "
        f"source files ({worker_versions['sources'][:8]}, here {expected_sources[:8]}); install the same version there"
    )


def run_task_on_worker(work: TaskFunction, document_text: str, project_name: str, key: str, attempt: int) -> str:
    """Run a task on this worker, and return its answer as JSON.

    `work`: the task's function. `document_text`: its argument as JSON. `project_name`: the name of the project that has the
    task's files. `key`: the task's key. `attempt`: the number of earlier attempts."""
    dask_worker = get_worker()
    project = dask_worker.plugins.get(project_name)
    if project is None or project.worker is None:
        raise TaskRejectedError(f"worker {dask_worker.address} does not have the files of this command")

    def say_frame(frame: int) -> None:
        dask_worker.log_event(project_name, {"key": key, "frame": frame})

    try:
        return run_task(work, document_text, project.worker, say_frame)
    except OSError as error:
        raise TaskRejectedError(f"worker {dask_worker.address}: {(error.strerror or str(error)).lower()}") from None


def read_file_part(project_name: str, file: str, start: int) -> bytes:
    """Return a part of a file that a task wrote on this worker. `start`: the offset of the part in bytes."""
    folder = Path(get_worker().local_directory) / project_name / "made"
    path = (folder / file).resolve()
    if not path.is_relative_to(folder.resolve()):
        raise TaskRejectedError(f"`{file}` is not one of the files that a task wrote")
    with open_size_limited(path, MAX_TASK_OUTPUT_BYTES, follows_links=False) as handle:
        handle.seek(start)
        return handle.read(FILE_PART_BYTES)


def remove_task_files(name: str, folder: str) -> None:
    """Remove the files that a task wrote on this worker. `name`: the project's name. `folder`: the folder of the task."""
    scratch_folder = Path(get_worker().local_directory) / name / "made"
    path = (scratch_folder / folder).resolve()
    if path.is_relative_to(scratch_folder.resolve()) and path != scratch_folder.resolve():
        shutil.rmtree(path, ignore_errors=True)
