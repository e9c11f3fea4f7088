"""Runs cases: one simulation for all specs of one scene, seed and set of params, headless, until the last of them has judged."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from time import perf_counter

from antdsl.runtime import BindError, FaultStop, Options, bind, step
from antdsl.specs.cases import Case, Failure, Run
from antdsl.specs.coverage import Coverage
from antdsl.specs.judge import Judge


def run_cases(
    runs: Iterable[Run],
    options: Options,
    coverage: Coverage,
    done: Callable[[Case], None] = lambda case: None,
    frame: Callable[[Run, int, int], None] = lambda run, frame, last: None,
) -> None:
    """Run everything; each case gets its outcome, and `done` is told of it. `frame` is told how far a run is.

    What is wrong with one run, a fault included, fails its cases and no others."""
    for run in runs:
        started = perf_counter()
        try:
            _run(run, options, coverage, frame)
        except BindError as why:
            for problem in why.report.errors:
                _fail(run, Failure(problem.message, problem.span))
        except FaultStop as why:
            found = why.fault
            words = f"`{found.what}` is not finite"
            _fail(run, Failure(words, found.span, found.frame, None, found.operands, (found.species, found.agent)))
        except (OSError, MemoryError) as why:
            _fail(run, Failure(f"the run came to an end: {why or type(why).__name__}".lower(), None))
        for case in run.cases:  # what a run took is shared by its cases
            case.outcome = "failed" if case.failures else "passed"
            case.seconds = (perf_counter() - started) / len(run.cases)
            done(case)


def _fail(run: Run, failure: Failure) -> None:
    for case in run.cases:
        case.failures.append(failure)


def _run(run: Run, options: Options, coverage: Coverage, told: Callable[[Run, int, int], None]) -> None:
    shot = run.shot
    world = bind(shot.plan, replace(shot.setting, seed=run.seed), options)
    if world.faults.told:
        raise FaultStop(world.faults.told[0])  # at birth
    coverage.watch(world, shot.program)
    for _ in range(shot.scene.model.preroll):
        step(world)
    world.motion.reset()
    first = world.frame
    judges = [(case, Judge(case.plan, world, shot.frames.last)) for case in run.cases]
    last = max(judge.last for _, judge in judges)
    while True:
        for case, judge in judges:
            if judge.over:
                continue
            case.frames = world.frame - first + 1
            judge.look(world)
            case.failures[:] = judge.failures
        told(run, world.frame - first, last - first)
        if all(judge.over for _, judge in judges):
            return
        step(world)
