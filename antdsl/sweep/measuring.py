"""One run of a sweep, without a cache: everything that `antdsl run --summary` reports, and the frame at which each amount ran
out."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from antdsl import __version__
from antdsl.numerics.host import processor_name
from antdsl.outputs.recording import Recording
from antdsl.outputs.starting import start_from_cache
from antdsl.outputs.summary import summary
from antdsl.outputs.surface_error import surface_error
from antdsl.pipeline import open_scene
from antdsl.runtime import BindingCache, Options, World, bind, state_hash, step
from antdsl.source_hash import sources
from antdsl.sweep.jobs import Job, is_match, job_key, start_hashes


class UnusableScene(Exception):
    """The scene can no longer be opened; the message says why."""


def measure(
    job: Job,
    threads: int,
    built: BindingCache,
    report_frame: Callable[[int], None],
    noted: Callable[[str], None] = lambda sentence: None,
) -> dict[str, Any]:
    """Simulate a run and return its measures by name: numbers, or None for what did not happen. `report_frame` is called for each
    frame, `noted` at the end with what differed from the request. `built` stores data that earlier runs made from meshes.

    Everything but `seconds`, `fps` and `processor` is equal for the same job and antdsl."""
    shot, report = open_scene(Path(job.scene), job.choices())
    if shot is None or not report.ok:
        raise UnusableScene("; ".join(problem.message for problem in report.errors))
    if job_key(shot, job.seed, job.until, start_hashes(shot)) != job.key:
        raise UnusableScene(
            "files that the scene reads have changed since the sweep began; the same command begins with them as they are"
        )
    began = time.perf_counter()
    world = bind(shot.plan, shot.setting, Options(threads=threads), built=built)
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
        report_frame(world.frame)
    for sentence in world.backend.messages():
        noted(sentence)
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
