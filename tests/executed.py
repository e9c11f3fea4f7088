"""An engine for tests: tasks are done at once, in the process of the test."""

from __future__ import annotations

import json
from concurrent.futures import Future
from typing import Any

from antdsl.executors import Engine, Task, WorkerContext
from antdsl.executors.tasks import run_task


class InThisProcess(Engine):
    """In place of `Processes`; keeps the tasks that it was given."""

    task_capacity = 1

    def __init__(self, count: int = 1, threads: int = 1) -> None:
        self.task_capacity, self.tasks, self._worker = count, list[Task](), WorkerContext(threads)

    def start(self) -> None:
        pass

    def submit(self, task: Task) -> Future[str]:
        self.tasks.append(task)
        future: Future[Any] = Future()
        try:
            future.set_result(run_task(task.function, json.dumps(task.document), self._worker))
        except Exception as why:
            future.set_exception(why)
        return future

    def stop(self) -> None:
        pass
