"""Tasks on a Dask cluster: one of this machine that ends with the command, or one that is there.

Dask runs a task again where its worker is lost, at least once in all. Its messages are its own; what we put into them are our
functions by name, JSON, and the bytes of the project's files."""

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
from distributed import Client, LocalCluster, Security

from antdsl.executors.addresses import TLS_FILES
from antdsl.executors.cluster_worker import Project, forget, identity, other_sources, perform_there, read_part
from antdsl.executors.machine import sources
from antdsl.executors.parcel import Parcel
from antdsl.executors.tasks import LOOK, Lost, Refused, Task

_CONNECT = 15  # seconds to wait for a scheduler
_JOIN = 5.0  # seconds to wait for a worker before that is told
_TOLD = 2000  # characters of one sentence of a worker


def security_of(folder: Path) -> Security:
    """Mutual TLS by the files of a folder: whoever else has no certificate of the same authority is not spoken to."""
    ca, cert, key = (str(folder / name) for name in TLS_FILES)
    return Security(require_encryption=True, tls_ca_file=ca, tls_client_cert=cert, tls_client_key=key)


@contextmanager
def local_cluster(workers: int, threads: int) -> Iterator[tuple[str, Security]]:
    """A scheduler and so many worker processes on the loopback interface, with certificates of their own that are nowhere but in
    memory; their address. There is no dashboard, and a worker has no bound of memory."""
    routes: dict[str, list[str]] = {f"distributed.{who}.http.routes": [] for who in ("scheduler", "worker", "nanny")}
    with dask.config.set({**routes, "distributed.worker.memory.terminate": False}):
        security = Security.temporary()
        with LocalCluster(
            n_workers=workers,
            threads_per_worker=threads,
            processes=True,
            host="127.0.0.1",
            dashboard_address=":0",
            scheduler_kwargs={"dashboard": False},
            memory_limit=0,
            security=security,
            silence_logs=logging.CRITICAL,
        ) as cluster:
            yield cluster.scheduler_address, security


@contextmanager
def connected(address: str, security: Security | None, parcel: Parcel) -> Iterator[Cluster]:
    """A cluster whose workers have got the files of a parcel. OSError where no scheduler answers, Refused where all its workers
    are refused."""
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    with ExitStack() as stack:
        with dask.config.set({"distributed.comm.timeouts.connect": _CONNECT, "distributed.admin.log-format": ""}):
            client = stack.enter_context(Client(address, security=security, timeout=_CONNECT, set_as_default=False))
        cluster = Cluster(client, parcel)
        cluster.begin()
        yield cluster


class Cluster:
    """Where tasks run on the workers of a Dask cluster."""

    def __init__(self, client: Any, parcel: Parcel) -> None:
        self._client = client
        self._project = Project(parcel, sources())
        self.name: str = self._project.name
        self._heard: SimpleQueue[dict[str, Any]] = SimpleQueue()
        self._frames: dict[str, int] = {}
        self._keys: dict[int, str] = {}
        self._workers, self._looked = 1, -1e9

    def begin(self) -> None:
        """Send the files to the workers that are there, and have them sent to those that come."""
        client = self._client
        client.subscribe_topic(self.name, lambda event: self._heard.put(event[1]))
        there = client.run(identity, on_error="return")
        unfit = {}
        for address, has in there.items():
            if isinstance(has, BaseException):
                unfit[address] = f"worker {address} cannot run this antdsl, so it is given nothing: {has}"
            elif has["sources"] != sources():
                unfit[address] = other_sources(address, has, sources())
        if there and len(unfit) == len(there):
            raise Refused("\n".join(unfit.values()))
        for words in unfit.values():
            self._heard.put({"refused": words})
        with suppress(ImportError, AttributeError):  # of a worker that has been told of
            client.register_plugin(self._project)
        if not there:
            self._heard.put({"refused": "no worker has come to the scheduler yet; runs begin once one does"})

    @property
    def at_once(self) -> int:
        """Two for each worker, so that none waits for the next."""
        if time.monotonic() - self._looked > LOOK:
            with suppress(OSError):
                self._workers, self._looked = len(self._client.nthreads()), time.monotonic()
        return 2 * max(self._workers, 1)

    def start(self) -> Executor:
        if self._client.status != "running":
            raise Lost("the scheduler is gone")
        executor: Executor = self._client.get_executor(pure=True, resources={self.name: 1})
        return executor

    def submit(self, executor: Executor, task: Task, place: int) -> Future[str]:
        self._keys[place] = task.key
        self._frames.pop(task.key, None)
        return executor.submit(perform_there, task.work, json.dumps(task.document), self.name, task.key)

    def frame(self, place: int) -> int | None:
        return self._frames.get(self._keys[place])

    def notes(self) -> Iterable[str]:
        with suppress(Empty):
            while True:
                said = self._heard.get_nowait()
                if isinstance(said.get("frame"), int):
                    self._frames[str(said.get("key"))] = said["frame"]
                elif "refused" in said:
                    yield "".join(sign if sign.isprintable() else " " for sign in str(said["refused"])[:_TOLD])

    def why_broken(self) -> str:
        return "the scheduler is gone"

    def stop(self, executor: Executor) -> None:
        with suppress(Exception):  # of a scheduler that is gone
            executor.shutdown(wait=False)

    def fetch(self, worker: str, file: str, size: int) -> Iterator[bytes]:
        """The parts of a file that a task has made on a worker. Lost where it is gone or ends before its size."""
        start = 0
        while start < size:
            try:
                part = self._client.run(read_part, self.name, file, start, workers=[worker])[worker]
            except (OSError, KeyError) as why:
                raise Lost(f"worker {worker} is gone: {why}") from None
            if not part:
                raise Lost(f"`{file}` of worker {worker} ends before its size")
            start += len(part)
            yield part

    def forget(self, worker: str, folder: str) -> None:
        """Have a worker remove what a task made."""
        with suppress(OSError, KeyError):
            self._client.run(forget, self.name, folder, workers=[worker])
