"""Runs tasks in other processes. The input is an iterable of tasks. A task consists of a function of antdsl, its JSON argument,
and a key that covers everything the answer depends on. The answers are returned as they arrive, in any order.

An `Engine` runs tasks. There are two engines: `processes.py` starts processes of this machine (the standard library's pool).
`cluster.py` uses Dask, and `cluster_worker.py` runs on its workers. Neither of these is imported before a cluster is requested.
`input_bundle` packs files for transport.

`run_tasks` submits a few tasks at a time and reads the iterable only as far as needed. So the code that creates tasks can read
answers before it creates more. `run_tasks` fetches the files that tasks write on other machines, and runs lost tasks again. The
caller stores the answers. If a process is lost, its task may run twice, but is answered once."""

from antdsl.executors.processes import ProcessEngine
from antdsl.executors.tasks import (
    Engine,
    Task,
    TaskOutcome,
    TaskRejectedError,
    WorkerContext,
    WorkersLostError,
    hash_document,
    raise_as_task_rejected,
    run_tasks,
)

__all__ = [
    "Engine",
    "ProcessEngine",
    "Task",
    "TaskOutcome",
    "TaskRejectedError",
    "WorkerContext",
    "WorkersLostError",
    "hash_document",
    "raise_as_task_rejected",
    "run_tasks",
]
