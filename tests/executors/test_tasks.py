"""How tasks are submitted: lazily; which task a broken engine is blamed on; messages about one that fails or is lost."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from concurrent.futures import BrokenExecutor, Future
from typing import Any

import pytest
from executed import InThisProcess

from antdsl.executors import Task, TaskRejectedError, WorkerContext, run_tasks


def doubled(document: Mapping[str, Any], worker: WorkerContext) -> dict[str, Any]:
    if document["n"] < 0:
        raise TaskRejectedError(f"{document['n']} is below 0")
    worker.notes.append(f"had {document['n']}")
    return {"n": 2 * document["n"]}


def tasks(*numbers: int) -> Iterator[Task]:
    return (Task(str(n), doubled, {"n": n}) for n in numbers)


def test_tasks_are_created_on_demand() -> None:
    answers: list[int] = []

    def generate_tasks() -> Iterator[Task]:
        while sum(answers) < 40:
            yield from tasks(5)

    for answered in run_tasks(generate_tasks(), InThisProcess(1)):
        assert answered.answer is not None and answered.notes == ("had 5",)
        answers.append(answered.answer["n"])
    assert answers == [10, 10, 10, 10]


def test_a_failure_is_reported_and_the_others_go_on() -> None:
    ended = {a.task.key: (a.answer, a.problem) for a in run_tasks(tasks(1, -1, 2), InThisProcess(2))}
    assert ended == {"1": ({"n": 2}, ""), "-1": (None, "-1 is below 0"), "2": ({"n": 4}, "")}
    with pytest.raises(TypeError):  # a mistake of ours is none of the task's
        list(run_tasks([Task("x", doubled, {"n": "x"})], InThisProcess(1)))


class Fragile(InThisProcess):
    """Breaks, with all that it runs, as soon as it has one of the tasks that kill; is slow to answer."""

    def __init__(self, count: int, *killers: str) -> None:
        super().__init__(count)
        self.killers, self.pending, self.starts = killers, list[tuple[Future[str], Task]](), 0

    def start(self) -> None:
        self.starts += 1

    def submit(self, task: Task) -> Future[str]:
        future: Future[str] = Future()
        self.pending.append((future, task))
        return future

    def find_frame(self, future: Future[str]) -> int | None:
        pending, self.pending = self.pending, []
        broken = any(task.key in self.killers for _, task in pending)
        for future, task in pending:
            if broken:
                future.set_exception(BrokenExecutor())
            else:
                future.set_result(super().submit(task).result())
        return None

    def explain_process_end(self) -> str:
        return "it was ended"


def test_only_tasks_that_break_the_executor_alone_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("antdsl.executors.tasks.POLL_SECONDS", 0.01)
    fragile = Fragile(3, "7", "4")
    ended = {a.task.key: (a.answer, a.problem) for a in run_tasks(tasks(*range(10)), fragile)}
    assert {key for key, (_, problem) in ended.items() if problem} == {"7", "4"} and ended["7"] == (None, "it was ended")
    assert all(ended[str(n)] == ({"n": 2 * n}, "") for n in range(10) if n not in (7, 4))


class Forgetful(InThisProcess):
    """Loses the first submissions of each task."""

    def __init__(self, count: int, losses: int) -> None:
        super().__init__(count)
        self.losses = losses

    def submit(self, task: Task) -> Future[str]:
        future = super().submit(task)
        if self.tasks.count(task) > self.losses:
            return future
        lost_future: Future[str] = Future()
        lost_future.cancel()
        lost_future.set_running_or_notify_cancel()
        return lost_future


def test_lost_tasks_run_again_and_have_one_outcome() -> None:
    engine = Forgetful(2, 2)
    ended = [a.answer for a in run_tasks(tasks(1, 2, 3), engine)]
    assert sorted(each["n"] for each in ended if each is not None) == [2, 4, 6] and len(engine.tasks) == 9


def large(document: Mapping[str, Any], worker: WorkerContext) -> dict[str, Any]:
    return {"text": "x" * document["n"]}


def test_a_result_larger_than_the_limit_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("antdsl.executors.tasks.MAX_TASK_ANSWER_BYTES", 1000)
    ended = {a.task.key: a for a in run_tasks((Task(str(n), large, {"n": n}) for n in (10, 2000)), InThisProcess(1))}
    assert ended["10"].answer == {"text": "x" * 10}
    assert ended["2000"].answer is None and "the limit is 1,000" in ended["2000"].problem
