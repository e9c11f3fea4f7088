"""Runs the jobs of a sweep as tasks. A run that fails, or crashes its process, is reported, and the others continue. The
distribution over processes changes no result."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from antdsl.executors import Executors, Task, TaskRefused, Worker, run_tasks
from antdsl.sweep.jobs import Job


@dataclass(frozen=True, slots=True)
class Outcome:
    """The outcome of a job: measures, or an error message."""

    job: Job
    measures: dict[str, Any] | None
    problem: str = ""


def run_all(
    jobs: Iterable[Job],
    executors: Executors,
    report_frame: Callable[[Job, int], None] = lambda job, frame: None,
    noted: Callable[[str], None] = lambda sentence: None,
) -> Iterator[Outcome]:
    """Run jobs and yield each outcome when it arrives; `jobs` is read one at a time, when there is capacity for another.
    `report_frame` reports the progress of a run from time to time. `noted` reports what differed from the request, a sentence for
    each run and cause."""

    def heard(task: Task, frame: int) -> None:
        report_frame(Job.of(task.document), frame)

    tasks = (Task(job.key, measure_task, job.document()) for job in jobs)
    for answered in run_tasks(tasks, executors, heard, noted):
        for sentence in answered.notes:
            noted(sentence)
        yield Outcome(Job.of(answered.task.document), answered.answer, answered.problem)


def measure_task(document: Mapping[str, Any], worker: Worker) -> dict[str, Any]:
    """Run a job in a worker process and return its measures."""
    from antdsl.outputs.starting import StartError
    from antdsl.runtime import BindError, BindingCache, FaultStop
    from antdsl.sweep.measuring import UnusableScene, measure

    built: BindingCache = worker.cached_values.setdefault("built", BindingCache())
    job = Job.of(document)
    grants = tuple((name, str(worker.local_path(folder))) for name, folder in job.grants)
    job = replace(job, scene=str(worker.local_path(job.scene)), grants=grants)
    try:
        return measure(job, worker.threads, built, worker.report_frame, worker.notes.append)
    except (BindError, StartError) as why:
        raise TaskRefused("; ".join(problem.message for problem in why.report.errors)) from None
    except (UnusableScene, FaultStop) as why:
        raise TaskRefused(str(why)) from None
    finally:
        built.drop_unused()
