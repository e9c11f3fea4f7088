"""Measurement of the set-up and the steps of a job in this process, alternating between backends."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from math import ceil
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np

from antdsl.bench.cases import find_case
from antdsl.bench.costs import BenchJob, FullRunCost, Measurement, SetUpCost, StepCost
from antdsl.bench.ratios import measure_in_turn
from antdsl.machine_code import llvm_compiler
from antdsl.machine_code.object_cache import CACHE_VARIABLE
from antdsl.numerics import stored_tables
from antdsl.numerics.processor.host import measure_memory
from antdsl.pipeline import Shot
from antdsl.plan.traverse import collect_required_nodes, iterate_statements, list_blocks, list_operands
from antdsl.runtime import Options, World, bind, step
from antdsl.runtime.backends import NativeBackend
from antdsl.runtime.backends.native import compile_queue

WARM_UP_STEPS = 4  # steps that are not counted: the rows come into order of place after the first, kernels are loaded
_MIN_TURN_SECONDS = 0.02  # seconds that a turn takes at least, where the number of steps is left open
_MAX_STEPS_PER_TURN = 64
_MIN_RUN_FRAMES = 8  # of a run


StepFunction = Callable[[], None]


def measure_job(
    job: BenchJob, make_comparison_frames: Callable[[int], Mapping[str, StepFunction]] = lambda agents: {}
) -> Measurement:
    """Return the measurement of a job. Raises CaseError for a scene that cannot be opened or scaled.

    `make_comparison_frames`: a function that returns, for a number of agents, further functions to measure, by name. Each
    simulates one frame in another program."""
    with _use_empty_code_folder():
        return _measure_job(job, make_comparison_frames)


def _measure_job(job: BenchJob, make_comparison_frames: Callable[[int], Mapping[str, StepFunction]]) -> Measurement:
    """Return the measurement of a job, as `measure_job` does. Machine code is stored in the current folder for it."""
    start = _import_packages("native" in job.backends)
    case = find_case(job.case)
    shot, compile_ = _time_call(lambda: case.make_shot(job.agents))
    bare = case.make_bare_shot(shot)
    initial_memory, _ = measure_memory()
    options = [Options(backend=_cast_backend_name(name), threads=job.threads) for name in job.backends]
    world, bound_s = _time_call(lambda: bind(bare.plan, bare.setting, options[0]))
    _, first = _time_call(lambda: step(world))
    has_code, code = _time_call(lambda: wait_for_code(world))
    worlds = {job.backends[0]: world}
    for name, each in zip(job.backends[1:], options[1:], strict=True):
        worlds[name] = bind(bare.plan, bare.setting, each)
        step(worlds[name])
        wait_for_code(worlds[name])
    agents = len(world)
    runners: dict[str, StepFunction] = {name: _make_stepper(each) for name, each in worlds.items()}
    _, second = _time_call(runners[job.backends[0]])
    for stepped in runners.values():
        stepped()
    _, step_seconds = _time_call(runners[job.backends[0]])
    steps = job.steps or max(1, min(_MAX_STEPS_PER_TURN, ceil(_MIN_TURN_SECONDS / max(step_seconds, 1e-6))))
    most = measure_memory()[1]  # before other frames are made
    runners |= make_comparison_frames(agents)
    costs = _measure_turns(runners, worlds, steps, job.turns)
    messages = [f"{name}: {sentence}" for name, each in worlds.items() for sentence in each.backend.list_messages()]
    load_seconds, load_messages = _time_code_load(world)
    return Measurement(
        job=job,
        agents=agents,
        steps=steps,
        costs=costs,
        set_up=SetUpCost(start, compile_, bound_s, first, code if has_code else None, load_seconds, second),
        memory=most - initial_memory,
        state=_count_state_bytes(world),
        nodes=_count_nodes(shot),
        neighbours=count_mean_neighbours(world, case.sight_radius_mm) if case.sight_radius_mm else None,
        full_run=_measure_full_run(shot, options[0], choose_run_frames(step_seconds)) if job.full_run else None,
        told=tuple(dict.fromkeys(messages + [f"{job.backends[0]}: {sentence}" for sentence in load_messages])),
    )


def _cast_backend_name(name: str) -> Any:
    """Return the name of a backend, typed as Any. The caller has already checked that it is in `BACKENDS`."""
    return name


@contextmanager
def _use_empty_code_folder() -> Iterator[None]:
    """While the context is active, use an empty folder for machine code and mesh tables, so that nothing is cached at its
    start."""
    previous_values = {name: os.environ.get(name) for name in (CACHE_VARIABLE, stored_tables.TABLE_STORE.variable)}
    with tempfile.TemporaryDirectory(prefix="antdsl-code-") as folder:
        os.environ |= dict.fromkeys(previous_values, folder)
        compile_queue.release_unused_code()
        stored_tables.reset_store()
        try:
            yield
        finally:
            for name, value in previous_values.items():
                os.environ.pop(name)
                if value is not None:
                    os.environ[name] = value
            compile_queue.release_unused_code()
            stored_tables.reset_store()


def _import_packages(include_llvm: bool) -> float:
    """Import all packages that steps need, and return the CPU seconds that this process has used so far. `include_llvm`: also
    import the packages that build machine code."""
    import antdsl.casting.rays
    import antdsl.runtime.backends  # noqa: F401

    if include_llvm:
        llvm_compiler.is_available()
    return process_time()


def _time_call(work: Callable[[], Any]) -> tuple[Any, float]:
    """Return the result of a call and its CPU seconds."""
    began = process_time()
    result = work()
    return result, process_time() - began


def _make_stepper(world: World) -> StepFunction:
    """Return a function that steps a world once."""
    return lambda: step(world)


def wait_for_code(world: World) -> bool:
    """Wait for the machine code of a world's backend, so that no measured step runs without it. Return whether the backend has
    machine code."""
    if not isinstance(world.backend, NativeBackend):
        return False
    world.backend.wait_for_code(world)
    return world.backend.ready_code is not None


def _time_code_load(world: World) -> tuple[float | None, list[str]]:
    """Return the CPU seconds that a world needs to load machine code from the cache, and messages.

    The seconds are None for a backend without machine code, and for code that cannot be cached; the messages then say why."""
    if not wait_for_code(world):
        return None, []
    compile_queue.release_unused_code()
    again = NativeBackend(world.plan)
    _, seconds = _time_call(lambda: again.wait_for_code(world))
    messages = again.list_messages()
    return (None if messages else seconds), messages


def _measure_turns(runners: dict[str, StepFunction], worlds: dict[str, World], steps: int, turns: int) -> dict[str, StepCost]:
    """Return the cost of a step for each runner, by name. The runners alternate, with `turns` turns of `steps` steps each.

    `runners`: functions that simulate one step, by name. `worlds`: the world of each runner that is a backend. Before the first
    turn, each runner makes WARM_UP_STEPS uncounted steps."""
    for run in runners.values():
        for _ in range(WARM_UP_STEPS):
            run()
    for world in worlds.values():
        world.timings.clear()
        world.cpu_seconds.clear()
    names = list(runners)

    def measure_step_seconds(runner_index: int) -> tuple[float, float]:
        """Return the CPU seconds and the elapsed seconds per step of one runner, in one turn."""
        run = runners[names[runner_index]]
        worked, passed = process_time(), perf_counter()
        for _ in range(steps):
            run()
        return (process_time() - worked) / steps, (perf_counter() - passed) / steps

    turn_costs = measure_in_turn(measure_step_seconds, len(names), turns, warm_up_runs=0)
    count = turns * steps
    costs = {}
    for number, name in enumerate(names):
        cpu, wall = ([turn[number][k] for turn in turn_costs] for k in (0, 1))
        own = worlds.get(name)
        phases = [] if own is None else [{p: s / count for p, s in each.items()} for each in (own.cpu_seconds, own.timings)]
        costs[name] = StepCost(cpu, wall, *phases)
    return costs


def _count_state_bytes(world: World) -> int:
    """Return the size in bytes of the arrays that store the agents. An array that is used twice counts once."""
    arrays: dict[int, int] = {}
    for population in world.populations.values():
        held = [population.ids, population.born, population.quarantined, population.position, population.normal]
        for part in (population.start, population.now, population.events, population.raised_events, population.cells):
            held += part.values()
        held += population.footing.columns.values()
        arrays |= {id(array): array.nbytes for array in held}
    return sum(arrays.values())


def _count_nodes(shot: Shot) -> int:
    """Return the number of nodes in the plan, that is, its operations. A node counts once for each block that contains it."""
    return sum(
        len(collect_required_nodes([node for _, each in iterate_statements(block) for node in list_operands(each)]))
        for species in shot.plan.species.values()
        for _, block in list_blocks(species)
    )


def count_mean_neighbours(world: World, sight_radius_mm: float) -> float:
    """Return the mean number of other agents within `sight_radius_mm` of an agent."""
    from scipy.spatial import cKDTree

    tree = cKDTree(np.concatenate([population.position for population in world.populations.values()]))
    return float(tree.count_neighbors(tree, sight_radius_mm) / tree.n - 1)


def choose_run_frames(step: float) -> int:
    """Return the number of frames of a full run that takes about two seconds, within limits. `step`: seconds per bare step."""
    return min(max(int(2.0 / max(8.0 * step, 1e-6)), _MIN_RUN_FRAMES), _MAX_STEPS_PER_TURN)


def _measure_full_run(shot: Shot, options: Options, frames: int) -> FullRunCost:
    """Return the cost of `frames` frames of a full run, and of the same steps without writing. WARM_UP_STEPS frames are
    simulated first and not counted."""
    from antdsl.outputs.recording import begin_recording, record_frames
    from antdsl.scene.values import parse_frame_range

    shot = replace(shot, scene=shot.scene.replace_values(frames=parse_frame_range(f"1..{WARM_UP_STEPS + frames}")))
    with tempfile.TemporaryDirectory() as folder:
        began = (0.0, 0.0)
        recording = begin_recording(shot, Path(folder, "cache"), options, resume=False, force=False)
        for number, _ in enumerate(record_frames(recording), 1):
            if number == WARM_UP_STEPS:
                wait_for_code(recording.world)
                began = process_time(), perf_counter()
        cpu, wall = process_time() - began[0], perf_counter() - began[1]
    world = bind(shot.plan, shot.setting, replace(options, feet=True))
    for _ in range(WARM_UP_STEPS - 1):
        step(world)
    wait_for_code(world)
    world.cpu_seconds.clear()

    def run_frames() -> None:
        for _ in range(frames):
            step(world)

    _, alone = _time_call(run_frames)
    feet = world.cpu_seconds.get("feet", 0.0)
    return FullRunCost(frames, cpu / frames, wall / frames, alone / frames, feet / frames)
