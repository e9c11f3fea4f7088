"""An executor for tests: tasks are done at once, in the process of the test."""

from __future__ import annotations

import json
from concurrent.futures import Executor, Future
from typing import Any

from antdsl.executors import Task, Worker
from antdsl.executors.tasks import perform


class InThisProcess:
    """In place of `Processes`; keeps the tasks that it was given."""

    def __init__(self, count: int = 1, threads: int = 1) -> None:
        self.task_capacity, self.tasks, self._worker = count, list[Task](), Worker(threads)

    def start(self) -> Executor:
        return Executor()

    def submit(self, executor: Executor, task: Task, place: int) -> Future[str]:
        self.tasks.append(task)
        future: Future[Any] = Future()
        try:
            future.set_result(perform(task.work, json.dumps(task.document), self._worker))
        except Exception as why:
            future.set_exception(why)
        return future

    def frame(self, place: int) -> int | None:
        return None

    def take_notes(self) -> tuple[str, ...]:
        return ()

    def break_reason(self) -> str:
        raise AssertionError

    def stop(self, executor: Executor) -> None:
        pass
