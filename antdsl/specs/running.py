"""Simulation of cases without a display.

One simulation serves all specs with the same scene, seed and params. It ends when all of these have a result."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from time import perf_counter

from antdsl.pipeline import Shot
from antdsl.plan.lowering.spec_plans import JudgementPlan
from antdsl.runtime import BindError, BindingCache, FaultStop, Options, World, bind, step
from antdsl.specs.cases import SpecCase, SpecFailure, SpecRun
from antdsl.specs.comparison import ReferenceRunRecord
from antdsl.specs.coverage import SpecCoverage
from antdsl.specs.failure_cache import FailureSaver, FailureSnapshot, StateSnapshots
from antdsl.specs.golden.golden_comparison import GoldenComparison
from antdsl.specs.judge import SpecJudge, find_last_frame

FrameCallback = Callable[[SpecRun, int, int], None]


@dataclass(slots=True)
class RunContext:
    """The options, callbacks and results that all runs share, except the outcomes of cases.

    - `failure_saver`: saves the frames before failures; None to save nothing. `golden_comparison`: compares golden runs; None to
      skip this.
    - `report_case`: called after each case. `report_frame`: called with a run, the number of the current frame, and the number
      of the last frame.
    - `messages`: sentences for the user about how runs deviate from the request, without duplicates. They change no verdict.
    - `worlds`: the worlds of the current run."""

    options: Options
    coverage: SpecCoverage = field(default_factory=SpecCoverage)
    failure_saver: FailureSaver | None = None
    golden_comparison: GoldenComparison | None = None
    report_case: Callable[[SpecCase], None] = lambda case: None
    report_frame: FrameCallback = lambda run, frame, last: None
    # runs of one scene differ only in seeds and params, and share the ground
    binding_cache: BindingCache = field(default_factory=BindingCache)
    messages: dict[str, None] = field(default_factory=dict)
    worlds: list[World] = field(default_factory=list)  # worlds of the current run


def run_cases(runs: Iterable[SpecRun], context: RunContext) -> None:
    """Simulate all runs and set the outcome of each case. If a run has a problem, such as a fault, only the cases of this run
    fail."""
    for run in runs:
        started = perf_counter()
        moments: dict[int, FailureSnapshot] = {}
        try:
            _judge_run(run, context, moments)
        except BindError as error:
            for problem in error.report.errors:
                _fail_cases(run, SpecFailure(problem.message, problem.span))
        except (OSError, MemoryError) as error:
            _fail_cases(run, SpecFailure(f"the run was aborted: {error or type(error).__name__}".lower(), None))
        finally:
            for world in context.worlds:
                context.messages |= dict.fromkeys(world.backend.list_messages())
            context.worlds.clear()
        for case in run.cases:  # the cost of a run is divided among its cases
            case.outcome = "failed" if case.failures else "passed"
            case.seconds = (perf_counter() - started) / len(run.cases)
            if context.failure_saver is not None and id(case) in moments:
                case.saved_frames = context.failure_saver.save_failure(run, case, moments[id(case)], context.binding_cache)
            context.report_case(case)
        context.binding_cache.drop_unused_values()


def _fail_cases(run: SpecRun, failure: SpecFailure) -> None:
    """Add the same failure to all cases of a run."""
    for case in run.cases:
        case.failures.append(failure)


def _judge_run(run: SpecRun, work: RunContext, failure_points: dict[int, FailureSnapshot]) -> None:
    """Simulate a run and judge its cases. `failure_points`: receives the data of the first failure of each case, by the `id()`
    of the case."""
    rivals = _run_compared(run, work)
    try:
        world = _make_world(run.shot, run.seed, work)
    except FaultStop as error:
        return _fail_with_fault(run, error)
    first, trail = world.frame, None if work.failure_saver is None else StateSnapshots(run.shot.setting)
    judges = [
        (case, SpecJudge(case.plan, world, run.shot.frames.last, rivals.get(id(case)))) for case in run.cases if not case.failures
    ]
    last = max((judge.last for _, judge in judges), default=first)
    watch = None if work.golden_comparison is None else work.golden_comparison.make_watch(run, last - first + 1)
    while True:
        for case, judge in judges:
            if not judge.is_over:
                case.frames = world.frame - first + 1
                judge.judge_frame(world)
                case.failures[:], case.goals = judge.failures, judge.goals
                work.messages |= dict.fromkeys(map(_describe_vacuous_line, judge.fulfilled_at_start))
                if judge.failures and trail is not None and id(case) not in failure_points:
                    failure_points[id(case)] = trail.make_failure_point(world)
        if watch is not None:
            watch.observe_frame(world)
        work.report_frame(run, world.frame - first, last - first)
        if all(judge.is_over for _, judge in judges) and (watch is None or watch.is_over):
            return None if watch is None else watch.finish(world)
        if trail is not None:
            trail.store_copy(world)
        frame_number = world.frame
        try:
            step(world)
        except FaultStop as error:
            if trail is not None and trail.last is not None:
                failure_point = FailureSnapshot(frame_number, None, trail.last)
                failure_points |= {id(case): failure_point for case in run.cases if id(case) not in failure_points}
            return _fail_with_fault(run, error)


def _describe_vacuous_line(line: JudgementPlan) -> str:
    text = " ".join(line.span.text.split())
    return f"{line.span}: `{text}` already holds in the first frame, so it tests nothing; write `always`, or another condition"


def _make_world(shot: Shot, seed: int, work: RunContext) -> World:
    """Return the world of a shot at the first frame."""
    world = bind(shot.plan, replace(shot.setting, seed=seed), work.options, binding_cache=work.binding_cache)
    work.worlds.append(world)
    if world.faults.reported_faults:
        raise FaultStop(world.faults.reported_faults[0])  # a fault at birth
    work.coverage.watch_world(world, shot.program)
    for _ in range(shot.scene.model.preroll):
        step(world)
    world.motion.reset_step_measures()
    return world


def _fail_with_fault(run: SpecRun, stop: FaultStop) -> None:
    _fail_cases(run, _describe_fault(stop, ""))


def _describe_fault(stop: FaultStop, prefix: str) -> SpecFailure:
    """Return the failure that describes a fault. `prefix`: text to put before the message of the fault."""
    fault = stop.fault
    culprit = (fault.species, fault.agent)
    words = f"{prefix}`{fault.value_name}` {fault.reason}"
    return SpecFailure(words, fault.span, fault.frame, None, fault.operands, culprit, 0, (fault.agent,))


def _run_compared(run: SpecRun, work: RunContext) -> dict[int, ReferenceRunRecord]:
    """Simulate the reference runs for the cases of a run. Return their records by the `id()` of the case.

    Cases with the same reference shot share one simulation. If it ends in a fault, all of these cases fail."""
    compared_runs: dict[int, ReferenceRunRecord] = {}
    for shot in {
        id(case.comparison_shot.shot): case.comparison_shot.shot for case in run.cases if case.comparison_shot is not None
    }.values():
        compared_cases = [case for case in run.cases if case.comparison_shot is not None and case.comparison_shot.shot is shot]
        try:
            compared_runs |= _simulate_compared(run, work, shot, compared_cases)
        except FaultStop as error:
            for case in compared_cases:
                case.failures.append(_describe_fault(error, "in the run that is compared with, "))
    return compared_runs


def _simulate_compared(run: SpecRun, work: RunContext, shot: Shot, cases: list[SpecCase]) -> dict[int, ReferenceRunRecord]:
    """Simulate one reference run for several cases, up to the last frame that one of the cases needs. Return the records by the
    `id()` of the case."""
    world = _make_world(shot, run.seed, work)
    first = world.frame
    rivals = {
        id(case): ReferenceRunRecord(case.comparison_shot.plan, world) for case in cases if case.comparison_shot is not None
    }
    last = max(find_last_frame(case.plan, world, first + run.shot.frames.last - run.shot.frames.first) for case in cases)
    while True:
        for compared_run in rivals.values():
            compared_run.record_frame(world)
        work.report_frame(run, world.frame - first, last - first)
        if world.frame >= last:
            return rivals
        step(world)
