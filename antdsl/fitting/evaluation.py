"""Evaluation of a spec at points. A point has one value for each varied param. Each task runs one point, scene and seed."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

from antdsl.diagnostics import Report
from antdsl.executors import Engine, Task, TaskRejectedError, WorkerContext, hash_document, run_tasks
from antdsl.loading import SharedParsedFiles
from antdsl.pipeline import RunChoices, check_path
from antdsl.runtime import BindingCache, Options
from antdsl.safe_read import resolve_path
from antdsl.specs.cases import CaseFinder
from antdsl.specs.running import RunContext, run_cases

_RESIDUAL_OF_MISSED_GOAL = 1e3  # of a goal that has no finite value, in tolerances
Values = Mapping[str, str]


@dataclass(frozen=True, slots=True)
class GoalResult:
    """The values of one goal, one per seed. `text`: the source line of the goal. `targets`: the target for each seed; targets
    differ only if the target is a value of a reference run. `tolerance`: a fraction of the target."""

    text: str
    values: tuple[float, ...]
    targets: tuple[float, ...]
    tolerance: float

    @property
    def residual(self) -> float:
        """Return the distance of the median value from the median target, as a multiple of the tolerance."""
        value, target = median(self.values), median(self.targets)
        unit = self.tolerance * abs(target)
        distance = abs(value - target)
        if not math.isfinite(distance) or not math.isfinite(unit):
            return _RESIDUAL_OF_MISSED_GOAL
        return (
            min(distance / unit, _RESIDUAL_OF_MISSED_GOAL) if unit > 0 else (0.0 if distance == 0 else _RESIDUAL_OF_MISSED_GOAL)
        )


@dataclass(frozen=True, slots=True)
class PointResult:
    """The results at one point, over all seeds.

    - `values`: the varied values by name.
    - `failed_lines`: for each seed, the number of failed lines that are not goals, summed over all scenes.
    - `pass_share`: the fraction of seeds that must pass."""

    values: Values
    goals: tuple[GoalResult, ...]
    failed_lines: tuple[int, ...]
    pass_share: float
    problem: str = ""

    @property
    def passed_share(self) -> float:
        """Return the fraction of seeds for which all lines that are not goals hold."""
        return sum(count == 0 for count in self.failed_lines) / len(self.failed_lines) if self.failed_lines else 0.0

    @property
    def holds(self) -> bool:
        """Return whether the lines that are not goals hold for enough seeds."""
        return self.passed_share >= self.pass_share * (1 - 1e-9)

    @property
    def weighted_loss(self) -> float:
        """Return the quantity that a fit minimises: the mean squared residual plus the mean number of failed lines."""
        if not self.failed_lines:
            return math.inf
        squares = [goal.residual**2 for goal in self.goals]
        return (sum(squares) / len(squares) if squares else 0.0) + sum(self.failed_lines) / len(self.failed_lines)


@dataclass(slots=True)
class PointEvaluator:
    """Evaluates points, and evaluates each point only once.

    - `scenes`, `spec`: the scenes to run, and the name of the spec.
    - `on_result`: called with the result of each evaluated point.
    - `results`: the results of all points, in the order of evaluation."""

    scenes: Sequence[Path]
    spec: str
    seeds: Sequence[int]
    grants: Mapping[str, Path]
    engine: Engine
    pass_share: float
    on_result: Callable[[PointResult], None] = lambda result: None
    results: dict[tuple[str, ...], PointResult] = field(default_factory=dict)

    def evaluate(self, points: Iterable[Values]) -> list[PointResult]:
        """Return the results at points, in the order of `points`. The runs of all points and seeds share the same processes."""
        points = list(points)
        new_points = {tuple(point.values()): point for point in points if tuple(point.values()) not in self.results}
        answers: dict[tuple[str, ...], dict[int, list[dict[str, Any]]]] = {key: {} for key in new_points}
        problems: dict[tuple[str, ...], str] = {}
        tasks = (
            self._make_task(point, scene, seed) for point in new_points.values() for seed in self.seeds for scene in self.scenes
        )
        for outcome in run_tasks(tasks, self.engine):
            key = tuple(outcome.task.document["set"].values())
            if outcome.answer is None:
                problems.setdefault(key, outcome.problem)
            else:
                answers[key].setdefault(outcome.task.document["seed"], []).append(outcome.answer)
        for key, point in new_points.items():
            self.results[key] = self._combine_answers(point, answers[key], problems.get(key, ""))
            self.on_result(self.results[key])
        return [self.results[tuple(point.values())] for point in points]

    def _make_task(self, point: Values, scene: Path, seed: int) -> Task:
        document = {
            "scene": str(resolve_path(scene)),
            "spec": self.spec,
            "set": dict(point),
            "seed": seed,
            "grants": {name: str(folder) for name, folder in self.grants.items()},
        }
        return Task(hash_document(document), evaluate_spec, document)

    def _combine_answers(self, point: Values, by_seed: Mapping[int, list[dict[str, Any]]], problem: str) -> PointResult:
        complete = {seed: parts for seed, parts in by_seed.items() if len(parts) == len(self.scenes)}
        if problem or len(complete) < len(self.seeds):
            return PointResult(point, (), (), self.pass_share, problem or "not all runs finished")
        rows = [
            [goal for part in sorted(complete[seed], key=lambda part: part["scene"]) for goal in part["goals"]]
            for seed in self.seeds
        ]
        goals = tuple(_make_goal_result(column) for column in zip(*rows, strict=True))
        failed = tuple(sum(part["failed"] for part in complete[seed]) for seed in self.seeds)
        return PointResult(point, goals, failed, self.pass_share)


def _make_goal_result(entries: Sequence[Mapping[str, Any]]) -> GoalResult:
    values, targets = (tuple(math.inf if e[name] is None else float(e[name]) for e in entries) for name in ("value", "target"))
    return GoalResult(str(entries[0]["text"]), values, targets, float(entries[0]["tolerance"]))


def find_spec(
    scene: Path, name: str, grants: Mapping[str, Path], params: Values, report: Report, parsed: SharedParsedFiles
) -> CaseFinder:
    """Return a case finder that contains the spec called `name` of a scene's program. Errors are added to `report`. `parsed`: a
    cache of parsed files."""
    finder = CaseFinder(dict(grants), parsed, report, params)
    program, findings = check_path(scene, RunChoices(grants, params=params), parsed=parsed, specs=False)
    report.extend(findings)
    if program is not None and findings.ok:
        specs = [spec for spec in program.specs if spec.name == name]
        for spec in specs:
            finder.add_spec(scene, spec)
        if not specs:
            known = ", ".join(f"`{spec.name}`" for spec in program.specs) or "none"
            report.error("unknown-name", f"the programs of `{scene}` have no spec `{name}`", None, f"specs are {known}")
        elif not finder.scene_and_spec_by_key:
            report.error(
                "other-scene", f"the spec `{name}` is not for `{scene}`", None, "remove its `on`, or name this scene there"
            )
    return finder


def evaluate_spec(document: Mapping[str, Any], worker: WorkerContext) -> dict[str, Any]:
    """Run the spec of a task. Return the values of its goals, and the number of failed lines that are not goals."""
    grants = {name: worker.find_local_path(folder) for name, folder in document["grants"].items()}
    report = Report()
    parsed = worker.cached_values.setdefault("parsed", SharedParsedFiles())
    built = worker.cached_values.setdefault("built", BindingCache())
    scene = worker.find_local_path(document["scene"])
    finder = find_spec(scene, document["spec"], grants, document["set"], report, parsed)
    runs = finder.make_runs([document["seed"]]) if report.ok else []
    if not report.ok or not runs:
        raise TaskRejectedError("; ".join(problem.message for problem in report.errors))
    run_cases(runs, RunContext(Options(threads=worker.threads), binding_cache=built))
    cases = [case for run in runs for case in run.cases]
    goal_spans = {line.span for case in cases for line in case.plan.judgements if line.goal is not None}
    failed = [failure for case in cases for failure in case.failures if failure.span not in goal_spans]
    if any(line.goal is not None for case in cases for line in case.plan.judgements) and not any(case.goals for case in cases):
        raise TaskRejectedError(failed[0].message if failed else "the run ended before its last frame")
    goals = [
        {
            "text": goal.text,
            "value": goal.value if math.isfinite(goal.value) else None,
            "target": goal.target if math.isfinite(goal.target) else None,
            "tolerance": goal.tolerance,
        }
        for case in cases
        for goal in case.goals
    ]
    return {"scene": document["scene"], "goals": goals, "failed": len(failed)}
