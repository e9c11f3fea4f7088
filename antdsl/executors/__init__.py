"""Tasks in other processes. Input: an iterable of tasks, each a function of ours and its JSON, under a key made of all that the
answer depends on. Output: the answers as they arrive, in any order.

An `Executors` defines where tasks run. `processes.py` starts processes of this machine (the standard library's pool).
`cluster.py` uses Dask, and `cluster_worker.py` runs on its workers; neither is imported before a cluster is requested. Files are
packed into bundles for transport.

`run_tasks` submits a few tasks at a time and reads the iterable only as far as needed. So the code that creates tasks can read
answers before it creates more. The caller stores the answers: a task may run twice where a process is lost, but is answered
once."""

from antdsl.executors.processes import Processes
from antdsl.executors.tasks import Executors, Task, TaskOutcome, TaskRefused, Worker, WorkersLost, run_tasks

__all__ = ["Executors", "Processes", "Task", "TaskOutcome", "TaskRefused", "Worker", "WorkersLost", "run_tasks"]
