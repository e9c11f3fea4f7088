"""Tasks on other processes. In: an iterable of tasks, each a function of ours and its JSON, under a key made of all that the
answer depends on. Out: each answer as it comes, in any order.

An `Executors` says where they run: `processes.py` starts processes of this machine (the standard library's pool), `cluster.py`
speaks to Dask, and `cluster_worker.py` is what is done there; neither is imported before a cluster is asked for. A `parcel` is
how files travel.
`run_tasks` hands out a few at a time and takes the iterable only as far as it has to, so that whoever makes the tasks may look
at the answers before it makes more. Who calls keeps the answers: a task may run twice where a process is lost, and is answered
once."""

from antdsl.executors.processes import Processes
from antdsl.executors.tasks import Answered, Executors, Lost, Refused, Task, Worker, run_tasks

__all__ = ["Answered", "Executors", "Lost", "Processes", "Refused", "Task", "Worker", "run_tasks"]
