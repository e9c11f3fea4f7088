"""Execution of a sweep's jobs as tasks, without caches.

The measures are those that `antdsl run --summary` reports, and the frame at which each amount ran out. A run that fails or
crashes its process is reported, and the others continue. The distribution of runs over processes does not change any result."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from antdsl import __version__
from antdsl.executors import Engine, Task, TaskRejectedError, WorkerContext, raise_as_task_rejected, run_tasks
from antdsl.measures.run_measures import RunMeasures
from antdsl.numerics.processor.host import read_processor_name
from antdsl.outputs.cache_start import StartError, start_from_cache
from antdsl.outputs.recording import Recording
from antdsl.outputs.summary import summarise_run
from antdsl.outputs.surface_error import measure_surface_error
from antdsl.pipeline import open_scene
from antdsl.runtime import BindError, BindingCache, FaultStop, Options, World, bind, state_hash, step
from antdsl.source_hash import hash_sources
from antdsl.sweeps.jobs import SweepJob, compute_job_key, find_start_hashes
from antdsl.sweeps.series import SERIES_KEY, MeasureSeries


@dataclass(frozen=True, slots=True)
class JobOutcome:
    """The outcome of a job: measures, or an error message."""

    job: SweepJob
    measures: dict[str, Any] | None
    problem: str = ""


def run_jobs(
    jobs: Iterable[SweepJob],
    engine: Engine,
    report_frame: Callable[[SweepJob, int], None] = lambda job, frame: None,
    report_note: Callable[[str], None] = lambda sentence: None,
) -> Iterator[JobOutcome]:
    """Run jobs and yield each outcome as soon as its run ends. The next job is taken from `jobs` only when a process is free.

    `report_frame`: called from time to time with a job and its current frame.
    `report_note`: called with a sentence about each difference between a run and the request.
    """
    tasks = (Task(job.key, measure_job, job.make_document()) for job in jobs)
    for outcome in run_tasks(
        tasks, engine, lambda task, frame: report_frame(SweepJob.from_document(task.document), frame), report_note
    ):
        for sentence in outcome.notes:
            report_note(sentence)
        yield JobOutcome(SweepJob.from_document(outcome.task.document), outcome.answer, outcome.problem)


def measure_job(document: Mapping[str, Any], worker: WorkerContext) -> dict[str, Any]:
    """Simulate the run of a job and return its measures by name. A measure is a number, or None if its event did not happen.

    The process stores data that it has computed from meshes for its next run. With the same version of antdsl, equal jobs give
    equal measures, except `seconds`, `fps` and `processor`.
    """
    built: BindingCache = worker.cached_values.setdefault("built", BindingCache())
    job = SweepJob.from_document(document)
    grants = tuple((name, str(worker.find_local_path(folder))) for name, folder in job.grants)
    job = replace(job, scene=str(worker.find_local_path(job.scene)), grants=grants)
    try:
        with raise_as_task_rejected(BindError, StartError, FaultStop):
            return _simulate_job(job, worker, built)
    finally:
        built.drop_unused_values()


def _simulate_job(job: SweepJob, worker: WorkerContext, binding_cache: BindingCache) -> dict[str, Any]:
    shot, report = open_scene(Path(job.scene), job.make_choices())
    if shot is None or not report.ok:
        raise TaskRejectedError("; ".join(problem.message for problem in report.errors))
    if compute_job_key(shot, job.seed, find_start_hashes(shot)) != job.key:
        raise TaskRejectedError(
            "files that the scene reads have changed since the sweep began; run the same command again to use the new files"
        )
    began = time.perf_counter()
    world = bind(shot.plan, shot.setting, Options(threads=worker.threads), binding_cache=binding_cache)
    recording = Recording(shot, Path(), world, shot.inputs)
    start_from_cache(shot, world)
    for _ in range(shot.scene.model.preroll):
        step(world)
    world.motion.reset_step_measures()
    recording.measures = RunMeasures(shot.measures, shot.until, world)
    empty: dict[str, int | None] = {}
    series = MeasureSeries(shot.measure_names, shot.frames)
    _record_frame(recording.measures, world, series, empty)
    worst = measure_surface_error(world)
    while world.frame < shot.frames.last and not recording.measures.is_over:
        step(world)
        _record_frame(recording.measures, world, series, empty)
        worst = max(worst, measure_surface_error(world))
        recording.steps += 1
        worker.report_frame(world.frame)
    worker.notes += world.backend.list_messages()
    recording.frame, recording.surface_error = world.frame, worst
    recording.last_state_hash = state_hash(world)
    recording.add_time("step", began)
    measures = dict(_flatten_measures("", summarise_run(recording)))
    measures |= {f"empty.{name}": frame for name, frame in empty.items()}
    measures |= {f"left.{name}": amount for name, amount in _read_amounts(world)}
    measures |= {"processor": read_processor_name(), "antdsl": f"{__version__} {hash_sources()[:8]}"}
    measures |= {SERIES_KEY: series.document} if shot.measure_names else {}
    return measures | {"seconds": round(time.perf_counter() - began, 3)}


def _record_frame(measures: RunMeasures, world: World, series: MeasureSeries, empty_frames: dict[str, int | None]) -> None:
    """Record the measures of the world's current frame, and the amounts that became 0 in it."""
    measures.record_frame(world)
    series.add_frame(world.frame, measures.values)
    _record_empty(world, empty_frames)


def _read_amounts(world: World) -> Iterator[tuple[str, float]]:
    for name, items in world.items.items():
        for attribute, values in items.amounts.items():
            for item, value in zip(items.names, values, strict=True):
                yield f"{name}.{item}.{attribute}", float(value)


def _record_empty(world: World, empty_frames: dict[str, int | None]) -> None:
    """Record the current frame for each amount that has become 0 for the first time."""
    for name, amount in _read_amounts(world):
        if amount > 0:
            empty_frames.setdefault(name, None)
        elif name in empty_frames and empty_frames[name] is None:
            empty_frames[name] = world.frame


_PROCESS_MEASURES = frozenset(("seconds", "peak_memory"))  # measures of the process, which may make many runs in a row


def _flatten_measures(name_prefix: str, value: Any) -> Iterator[tuple[str, Any]]:
    if not isinstance(value, dict):
        yield name_prefix, value
        return
    for name, inner in value.items():
        if name_prefix or name not in _PROCESS_MEASURES:
            yield from _flatten_measures(f"{name_prefix}.{name}" if name_prefix else name, inner)
