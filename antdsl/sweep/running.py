"""Runs the jobs of a sweep as tasks. A run that fails, or takes its process with it, is told and the others go on. Which process
does what changes no result."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from antdsl.executors import Executors, Refused, Task, Worker, run_tasks
from antdsl.sweep.jobs import Job


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a job: measures, or the words for what went wrong."""

    job: Job
    measures: dict[str, Any] | None
    problem: str = ""


def run_all(
    jobs: Iterable[Job],
    executors: Executors,
    told: Callable[[Job, int], None] = lambda job, frame: None,
    noted: Callable[[str], None] = lambda sentence: None,
) -> Iterator[Outcome]:
    """Run jobs and give each outcome as it comes; `jobs` is read one at a time, whenever there is room for another. `told` hears
    now and then how far a run is, `noted` what was otherwise than asked, a sentence for each run and cause."""

    def heard(task: Task, frame: int) -> None:
        told(Job.of(task.document), frame)

    tasks = (Task(job.key, measured, job.document()) for job in jobs)
    for answered in run_tasks(tasks, executors, heard, noted):
        for sentence in answered.notes:
            noted(sentence)
        yield Outcome(Job.of(answered.task.document), answered.answer, answered.problem)


def measured(document: Mapping[str, Any], worker: Worker) -> dict[str, Any]:
    """The measures of a job, as a process gives them."""
    from antdsl.outputs.starting import StartError
    from antdsl.runtime import BindError, Built, FaultStop
    from antdsl.sweep.measuring import Unfit, measure

    built: Built = worker.kept.setdefault("built", Built())
    job = Job.of(document)
    grants = tuple((name, str(worker.here(folder))) for name, folder in job.grants)
    job = replace(job, scene=str(worker.here(job.scene)), grants=grants)
    try:
        return measure(job, worker.threads, built, worker.told, worker.notes.append)
    except (BindError, StartError) as why:
        raise Refused("; ".join(problem.message for problem in why.report.errors)) from None
    except (Unfit, FaultStop) as why:
        raise Refused(str(why)) from None
    finally:
        built.forget()
