"""The part that runs on a worker of a Dask cluster. It receives a project's files, reports whether it can run tasks, and runs
them.

A worker that has the files and the same antdsl sources offers a resource named after both. A task needs one unit of this
resource. So a worker with other sources, or without space for the files, never gets a task, even if it joins later. A worker runs
one task at a time.
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
from antdsl.bounded import open_bounded
from antdsl.executors.input_bundle import FileBundle, VisibleFile, unpacked_path
from antdsl.executors.tasks import TaskRefused, Work, Worker, perform
from antdsl.limits import MAX_TASK_OUTPUT_BYTES, MIB
from antdsl.source_hash import sources

PART_BYTES = 8 * MIB  # of a file that is fetched, at a time


class Project(WorkerPlugin):  # type: ignore[misc]
    """The files of a project, as every worker of a cluster receives them. The bytes of the files are the only user data in this
    object."""

    def __init__(self, bundle: FileBundle, sources: str, visible_file: VisibleFile | None) -> None:
        self.name = f"antdsl-{visible_file.digest if visible_file is not None else bundle.digest}-{sources}"
        self.bundle, self.sources, self.visible_file = bundle, sources, visible_file
        self.worker: Worker | None = None

    async def setup(self, worker: Any) -> None:
        """Install the files. Called when a worker starts, or when the project reaches a running worker."""
        if self.sources != sources():
            worker.log_event(self.name, {"refused": explain_mismatch(worker.address, worker_identity(), self.sources)})
            return
        if self.visible_file is not None and not self.visible_file.is_visible():
            message = f"worker {worker.address} does not see `{self.visible_file.path}`, as the others do, so it is given nothing"
            worker.log_event(self.name, {"refused": message})
            return
        folder = Path(worker.local_directory) / self.name
        try:
            await asyncio.to_thread(_unpack_bundle, self.bundle, folder)
        except (OSError, TaskRefused) as why:
            words = str(why) if isinstance(why, TaskRefused) else f"its disk: {(why.strerror or str(why)).lower()}"
            worker.log_event(
                self.name, {"refused": f"worker {worker.address} does not have the files, so it gets no tasks: {words}"}
            )
            return
        files = folder / "files"
        local_path = Path if self.visible_file is not None else functools.partial(unpacked_path, files)
        self.worker = Worker(worker.state.nthreads, local_path=local_path, scratch=folder / "made", name=worker.address)
        if self.name not in worker.state.total_resources:  # said again, it would count as free what a task has
            await worker.set_resources(**{self.name: 1})
        worker.log_event(self.name, {"fit": worker.address})


_one_at_a_time = threading.Lock()


def _unpack_bundle(bundle: FileBundle, folder: Path) -> None:
    """Unpack the files to the folder where tasks look for them, unless an earlier command did."""
    with _one_at_a_time:
        complete_mark = folder / "whole"  # is there once all the others are
        if complete_mark.is_file():
            return
        shutil.rmtree(folder, ignore_errors=True)
        bundle.unpack(folder / "files")
        (folder / "made").mkdir(parents=True)
        complete_mark.touch()


def worker_identity() -> dict[str, str]:
    """Return the versions and the host name of this worker."""
    return {"antdsl": __version__, "sources": sources(), "host": platform.node()}


def sees_file(visible_file: VisibleFile) -> bool:
    """Return whether this worker sees a file of the requester."""
    return visible_file.is_visible()


def explain_mismatch(address: str, has: Mapping[str, str], expected_sources: str) -> str:
    """Return the message that a worker with other sources gets no tasks."""
    return (
        f"worker {address} on {has['host']} has antdsl {has['antdsl']} with other sources ({has['sources'][:8]}, "
        f"here {expected_sources[:8]}), so it is given nothing: install there what is installed here"
    )


def perform_on_worker(work: Work, text: str, name: str, key: str, attempt: int) -> str:
    """Run a task on this worker, and return its answer as JSON. `text`: its argument as JSON. `name`: the project's name.
    `attempt`: the number of earlier attempts."""
    dask_worker = get_worker()
    project = dask_worker.plugins.get(name)
    if project is None or project.worker is None:
        raise TaskRefused(f"worker {dask_worker.address} does not have the files")

    def say_frame(frame: int) -> None:
        dask_worker.log_event(name, {"key": key, "frame": frame})

    try:
        return perform(work, text, project.worker, say_frame)
    except OSError as why:
        raise TaskRefused(f"worker {dask_worker.address}: {(why.strerror or str(why)).lower()}") from None


def read_part(name: str, file: str, start: int) -> bytes:
    """Return a part of a file that a task wrote on this worker. `start`: the offset of the part in bytes."""
    folder = Path(get_worker().local_directory) / name / "made"
    path = (folder / file).resolve()
    if not path.is_relative_to(folder.resolve()):
        raise TaskRefused(f"`{file}` is not one of the files that a task wrote")
    with open_bounded(path, MAX_TASK_OUTPUT_BYTES, follow=False) as handle:
        handle.seek(start)
        return handle.read(PART_BYTES)


def remove_results(name: str, folder: str) -> None:
    """Remove the files of a task after they were fetched."""
    scratch_folder = Path(get_worker().local_directory) / name / "made"
    path = (scratch_folder / folder).resolve()
    if path.is_relative_to(scratch_folder.resolve()) and path != scratch_folder.resolve():
        shutil.rmtree(path, ignore_errors=True)
