"""Runs the jobs of a sweep as tasks, without caches. The measures are everything that `antdsl run --summary` reports, and the
frame at which each amount ran out. If a run fails or crashes its process, this is reported, and the others continue. The
distribution over processes does not change any result."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from antdsl import __version__
from antdsl.executors import Engine, Task, TaskRefused, Worker, refuse_task, run_tasks
from antdsl.numerics.host import processor_name
from antdsl.outputs.recording import Recording
from antdsl.outputs.starting import StartError, start_from_cache
from antdsl.outputs.summary import summary
from antdsl.outputs.surface_error import surface_error
from antdsl.pipeline import open_scene
from antdsl.runtime import BindError, BindingCache, FaultStop, Options, World, bind, state_hash, step
from antdsl.source_hash import sources
from antdsl.sweep.jobs import Job, is_match, job_key, start_hashes


@dataclass(frozen=True, slots=True)
class Outcome:
    """The outcome of a job: measures, or an error message."""

    job: Job
    measures: dict[str, Any] | None
    problem: str = ""


def run_all(
    jobs: Iterable[Job],
    engine: Engine,
    report_frame: Callable[[Job, int], None] = lambda job, frame: None,
    noted: Callable[[str], None] = lambda sentence: None,
) -> Iterator[Outcome]:
    """Run jobs and yield each outcome when it arrives. `jobs` is read one at a time, when there is capacity for another.

    `report_frame`: is called from time to time with the progress of a run.
    `noted`: is called with messages about deviations from the request, one sentence for each run and cause.
    """
    tasks = (Task(job.key, measure, job.document()) for job in jobs)
    for outcome in run_tasks(tasks, engine, lambda task, frame: report_frame(Job.of(task.document), frame), noted):
        for sentence in outcome.notes:
            noted(sentence)
        yield Outcome(Job.of(outcome.task.document), outcome.answer, outcome.problem)


def measure(document: Mapping[str, Any], worker: Worker) -> dict[str, Any]:
    """Simulate the run of a job and return its measures by name. A measure is a number, or None if its event did not happen. Data
    that a run computes from meshes stays in the process for the next run.

    Equal jobs with the same antdsl give equal measures, except `seconds`, `fps` and `processor`.
    """
    built: BindingCache = worker.cached_values.setdefault("built", BindingCache())
    job = Job.of(document)
    grants = tuple((name, str(worker.local_path(folder))) for name, folder in job.grants)
    job = replace(job, scene=str(worker.local_path(job.scene)), grants=grants)
    try:
        with refuse_task(BindError, StartError, FaultStop):
            return _measure(job, worker, built)
    finally:
        built.drop_unused()


def _measure(job: Job, worker: Worker, built: BindingCache) -> dict[str, Any]:
    shot, report = open_scene(Path(job.scene), job.choices())
    if shot is None or not report.ok:
        raise TaskRefused("; ".join(problem.message for problem in report.errors))
    if job_key(shot, job.seed, job.until, start_hashes(shot)) != job.key:
        raise TaskRefused(
            "files that the scene reads have changed since the sweep began; the same command begins with them as they are"
        )
    began = time.perf_counter()
    world = bind(shot.plan, shot.setting, Options(threads=worker.threads), built=built)
    recording = Recording(shot, Path(), world, shot.inputs)
    start_from_cache(shot, world)
    for _ in range(shot.scene.model.preroll):
        step(world)
    world.motion.reset()
    empty: dict[str, int | None] = {}
    _record_empty(world, empty)
    worst = surface_error(world)
    while world.frame < shot.frames.last and not _is_over(world, job.until):
        step(world)
        _record_empty(world, empty)
        worst = max(worst, surface_error(world))
        recording.steps += 1
        worker.report_frame(world.frame)
    worker.notes += world.backend.messages()
    recording.frame, recording.surface_error = world.frame, worst
    recording.hash = state_hash(world)
    recording.add_time("step", began)
    measures = dict(_flatten("", summary(recording)))
    measures |= {f"empty.{name}": frame for name, frame in empty.items()}
    measures |= {f"left.{name}": amount for name, amount in _read_amounts(world)}
    measures |= {"processor": processor_name(), "antdsl": f"{__version__} {sources()[:8]}"}
    return measures | {"seconds": round(time.perf_counter() - began, 3)}


def _read_amounts(world: World) -> Iterator[tuple[str, float]]:
    for name, items in world.items.items():
        for attribute, values in items.amounts.items():
            for item, value in zip(items.names, values, strict=True):
                yield f"{name}.{item}.{attribute}", float(value)


def _record_empty(world: World, empty: dict[str, int | None]) -> None:
    """Store the frame at which an amount becomes 0 for the first time."""
    for name, amount in _read_amounts(world):
        if amount > 0:
            empty.setdefault(name, None)
        elif name in empty and empty[name] is None:
            empty[name] = world.frame


def _is_over(world: World, until: tuple[str, ...]) -> bool:
    return bool(until) and not any(
        amount > 0 for name, amount in _read_amounts(world) for requested_name in until if is_match(requested_name, name)
    )


_PROCESS_MEASURES = frozenset(("seconds", "peak_memory"))  # of the process, and of many runs in a row


def _flatten(head: str, value: Any) -> Iterator[tuple[str, Any]]:
    if not isinstance(value, dict):
        yield head, value
        return
    for name, inner in value.items():
        if head or name not in _PROCESS_MEASURES:
            yield from _flatten(f"{head}.{name}" if head else name, inner)
