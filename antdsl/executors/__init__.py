"""Tasks that run in other processes.

A task consists of a function of antdsl, its JSON argument, and a key that identifies everything the answer depends on. Tasks are
read from an iterable, and answers are returned as they arrive, in any order.

An `Engine` runs tasks. There are two engines: `processes.py` starts processes on this machine (the standard library's pool).
`cluster.py` uses Dask, and `cluster_worker.py` runs on its workers. Neither of these two is imported before a cluster is
requested. `input_bundle` packs files for transport.

`run_tasks` submits a few tasks at a time and reads the iterable only as far as needed. So the code that creates tasks can use
earlier answers. `run_tasks` also fetches the files that tasks write on other machines, and runs lost tasks again. The caller
stores the answers. After a process is lost, its task may run twice, but it is answered only once."""

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
