"""The engine that runs tasks on a Dask cluster: a local one that ends with the command, or an existing one.

Dask runs a task again if its worker is lost, so each task runs at least once. Messages have Dask's formats. They contain
functions of antdsl by name, JSON, and the bytes of the project's files.
"""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import Executor, Future
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

import dask
from distributed import Client, KilledWorker, LocalCluster, Security

from antdsl.child_processes import isolate_search_paths
from antdsl.executors.cluster_worker import (
    ProjectPlugin,
    can_see_file,
    describe_worker,
    explain_mismatch,
    read_file_part,
    remove_task_files,
    run_task_on_worker,
)
from antdsl.executors.input_bundle import FileBundle, VisibleFile, pack_files
from antdsl.executors.tasks import LOOPBACK, POLL_SECONDS, TLS_FILE_NAMES, Engine, Task, TaskRejectedError, WorkersLostError
from antdsl.source_hash import hash_sources

_ROLES = ("scheduler", "worker", "nanny")
_CONNECT_SECONDS = 15  # limit for connecting to a scheduler
_FILE_TRANSFER_SECONDS = 5.0  # limit for the transfer of files before tasks are submitted
_MAX_FUTILE_RESUBMITS = 3  # maximum number of resubmissions of all tasks without an answer in between
_ALL_WORKERS_LOST_MESSAGE = "every worker that received the task was lost"
_MAX_MESSAGE_CHARACTERS = 2000  # characters of one sentence of a worker


def load_security(folder: Path) -> Security:
    """Return the settings of mutual TLS with the certificate files in a folder. Peers without a certificate of the same
    authority are rejected."""
    ca, cert, key = (str(folder / name) for name in TLS_FILE_NAMES)
    return Security(require_encryption=True, tls_ca_file=ca, tls_client_cert=cert, tls_client_key=key)


@contextmanager
def start_local_cluster(workers: int, threads: int) -> Iterator[tuple[str, Security]]:
    """Start a scheduler and worker processes on the loopback interface. Yield the address and new certificates.

    The certificates exist only in memory. There is no dashboard, and workers have no memory limit. Dask still starts an HTTP
    server without pages in the scheduler and in each worker. Without an explicit address, that server would listen on every
    interface.
    """
    isolate_search_paths()
    settings: dict[str, list[str]] = {f"distributed.{role}.http.routes": [] for role in _ROLES}
    # modules that a configuration file names must not be loaded
    settings |= {f"distributed.{role}.preload": [] for role in (*_ROLES, "client")}
    with dask.config.set({**settings, "distributed.worker.memory.terminate": False}):
        security = Security.temporary()
        with LocalCluster(
            n_workers=workers,
            threads_per_worker=threads,
            processes=True,
            host=LOOPBACK,
            dashboard_address=f"{LOOPBACK}:0",
            scheduler_kwargs={"dashboard": False},
            memory_limit=0,
            security=security,
            silence_logs=logging.CRITICAL,
        ) as cluster:
            yield cluster.scheduler_address, security


@contextmanager
def connect_cluster(
    address: str, security: Security | None, files: Iterable[Path], visible_file: VisibleFile | None = None
) -> Iterator[Cluster]:
    """Yield a connection to a cluster. Raises WorkersLostError if no scheduler answers, and TaskRejectedError if no worker is
    suitable or the files are too large. `files`: the files that workers receive. `visible_file`: if given, no files are sent.
    Each worker must see this file at its path, and is then assumed to see all others."""
    for name in [name for name in logging.root.manager.loggerDict if name.startswith("distributed")]:
        logging.getLogger(name).setLevel(logging.CRITICAL)  # antdsl reports errors itself
    with ExitStack() as stack:
        try:
            client = stack.enter_context(Client(address, security=security, timeout=_CONNECT_SECONDS, set_as_default=False))
        except (OSError, ValueError) as error:
            raise WorkersLostError(f"no scheduler responds at {address}: {str(error).splitlines()[0]}") from None
        shared = visible_file is not None and all(
            is_visible is True for is_visible in client.run(can_see_file, visible_file, on_error="return").values()
        )
        cluster = Cluster(client, pack_files([] if shared else files), visible_file if shared else None)
        cluster.send_files()
        yield cluster


class Cluster(Engine):
    """The engine that runs tasks on the workers of a Dask cluster."""

    def __init__(self, client: Any, bundle: FileBundle, visible_file: VisibleFile | None) -> None:
        self._client = client
        self._project = ProjectPlugin(bundle, hash_sources(), visible_file)
        self.name: str = self._project.name
        self._event_queue: SimpleQueue[dict[str, Any]] = SimpleQueue()
        self._messages: list[str] = []
        self._reported_messages: set[str] = set()
        self._frame_by_key: dict[str, int] = {}
        self._key_by_future: dict[Future[str], str] = {}  # keys of running tasks
        self._abandoned_keys: set[str] = set()  # keys of tasks that are not submitted again
        self._suitable_workers: set[str] = set()  # workers that reported that they are suitable
        self._present_workers: set[str] = set()  # suitable workers that were present at the last check
        self._last_check_seconds = -1e9
        self._attempt = 0
        self._futile_resubmits = 0  # resubmissions of all tasks since the last answer

    def send_files(self) -> None:
        """Send the files to all workers, including those that join later."""
        client = self._client
        client.subscribe_topic(self.name, lambda event: self._event_queue.put(event[1]))
        worker_identities = client.run(describe_worker, on_error="return")
        unfit = {}
        for address, identity in worker_identities.items():
            if isinstance(identity, BaseException):
                unfit[address] = f"worker {address} gets no tasks, because it cannot run this antdsl: {identity}"
            elif identity["sources"] != hash_sources():
                unfit[address] = explain_mismatch(address, identity, hash_sources())
        if worker_identities and len(unfit) == len(worker_identities):
            raise TaskRejectedError("\n".join(unfit.values()))
        self._messages += unfit.values()
        with suppress(ImportError, AttributeError):  # raised for a worker that has already been reported
            client.register_plugin(self._project)
        deadline = time.monotonic() + _FILE_TRANSFER_SECONDS
        while worker_identities and not self._suitable_workers and time.monotonic() < deadline:
            self._read_events()
            time.sleep(0.02)
        self._present_workers = set(self._suitable_workers)
        if not worker_identities:
            self._messages.append("no worker has joined the scheduler yet; the run continues once one does")

    @property
    def task_capacity(self) -> int:
        """Return the number of tasks to submit at once: two per worker, so that no worker waits for its next task."""
        return 2 * max(len(self._present_workers), 1)

    def start(self) -> None:
        self._require_scheduler()
        self._executor: Executor = self._client.get_executor(pure=True, resources={self.name: 1})

    def submit(self, task: Task) -> Future[str]:
        self._require_scheduler()
        self._frame_by_key.pop(task.key, None)
        future: Future[str] = Future()
        if task.key in self._abandoned_keys:
            future.set_exception(TaskRejectedError(_ALL_WORKERS_LOST_MESSAGE))
        else:
            words = task.function, json.dumps(task.document), self.name, task.key, self._attempt
            future = self._executor.submit(run_task_on_worker, *words)
        self._key_by_future[future] = task.key
        return future

    def _require_scheduler(self) -> None:
        """Raise WorkersLostError if the connection to the scheduler is lost."""
        if self._client.status != "running":
            raise WorkersLostError(self.explain_process_end())

    def find_frame(self, future: Future[str]) -> int | None:
        return self._frame_by_key.get(self._key_by_future.get(future, ""))

    def collect_notes(self) -> Iterable[str]:
        self._read_events()
        self._check_workers()
        messages = [message for message in dict.fromkeys(self._messages) if message not in self._reported_messages]
        self._messages = []
        self._reported_messages.update(messages)  # a rejected worker also reports this message
        return messages

    def _read_events(self) -> None:
        """Read messages from the workers: the current frame of each task, and whether they can run tasks."""
        with suppress(Empty):
            while True:
                event = self._event_queue.get_nowait()
                if isinstance(event.get("frame"), int):
                    self._frame_by_key[str(event.get("key"))] = event["frame"]
                elif "fit" in event:
                    self._suitable_workers.add(str(event["fit"]))
                elif "refused" in event:
                    message = str(event["refused"])[:_MAX_MESSAGE_CHARACTERS]
                    self._messages.append("".join(s if s.isprintable() else " " for s in message))

    def _check_workers(self) -> None:
        """Check from time to time which workers are available. If some are, but none of them was at the last check, cancel all
        tasks, so that they are submitted again. Dask assigns waiting tasks as soon as a worker joins, which is before the
        worker has the files.
        """
        finished_futures = [future for future in self._key_by_future if future.done()]
        if not all(future.cancelled() for future in finished_futures):
            self._futile_resubmits = 0
        for future in finished_futures:
            del self._key_by_future[future]
        if time.monotonic() - self._last_check_seconds < POLL_SECONDS:
            return
        self._last_check_seconds = time.monotonic()
        try:
            present_workers = self._suitable_workers & set(self._client.nthreads())
        except OSError:
            return  # the scheduler has gone; the tasks report this
        if present_workers and not present_workers & self._present_workers:
            self._attempt, self._futile_resubmits = self._attempt + 1, self._futile_resubmits + 1
            if self._futile_resubmits > _MAX_FUTILE_RESUBMITS:
                self._abandoned_keys.update(self._key_by_future.values())
            for future in list(self._key_by_future):
                future.cancel()
        self._present_workers = present_workers

    def explain_process_end(self) -> str:
        return "the connection to the scheduler was lost"

    def describe_failure(self, exception: BaseException) -> str:
        return _ALL_WORKERS_LOST_MESSAGE if isinstance(exception, KilledWorker) else super().describe_failure(exception)

    def stop(self) -> None:
        with suppress(Exception):  # the scheduler may have gone
            self._executor.shutdown(wait=False)

    def fetch_file(self, worker: str, file: str, size: int) -> Iterator[bytes]:
        start = 0
        while start < size:
            try:
                part = self._client.run(read_file_part, self.name, file, start, workers=[worker])[worker]
            except (OSError, KeyError) as error:
                raise WorkersLostError(f"worker {worker} was lost: {error}") from None
            if not part:
                raise WorkersLostError(f"`{file}` of worker {worker} is shorter than expected")
            start += len(part)
            yield part

    def remove_task_files(self, worker: str, folder: str) -> None:
        with suppress(OSError, KeyError):
            self._client.run(remove_task_files, self.name, folder, workers=[worker])
