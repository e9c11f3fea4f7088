"""The cases to run, and their outcomes. A case is one spec in one scene with one seed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from antdsl.diagnostics import Report
from antdsl.files import find_files
from antdsl.loading import ParsedFileCache, SharedParsedFiles
from antdsl.pipeline import RunChoices, Shot, check_path, open_scene
from antdsl.plan.lowering.spec_blocks import lower_spec
from antdsl.plan.lowering.spec_plans import SpecPlan
from antdsl.program.cascading_errors import merge_repeated_findings
from antdsl.program.expectations import Spec, SpecChange
from antdsl.program.model import Program
from antdsl.scene.paths import PathRefused, Roots
from antdsl.source import Span
from antdsl.syntax.nodes import Text

DEFAULT_SCENE = "scene.yaml"
MAX_NAMED_AGENTS = 8  # maximum number of ids in a failure


@dataclass(frozen=True, slots=True)
class SpecFailure:
    """An expectation of a spec that was not met.

    - `values`: for each value in the condition, its text in the source and its formatted value.
    - `agent`: for a condition about each agent, the species and id of the first agent that failed.
    - `other_count`: the number of other agents that failed in the same frame.
    - `agents`: the ids of agents that failed, at most MAX_NAMED_AGENTS.
    - `wait_start_frame`: the frame in which the waiting time that has expired began.
    - `states_and_position`: names and texts that describe the agent's states and position."""

    message: str
    span: Span | None
    frame: int | None = None
    time: float | None = None  # seconds since the spec's first frame
    values: tuple[tuple[str, str], ...] = ()
    agent: tuple[str, int] | None = None
    other_count: int = 0
    agents: tuple[int, ...] = ()
    wait_start_frame: int | None = None
    states_and_position: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, slots=True)
class GoalValue:
    """The value of a goal at the end of a run. `text`: the goal's source line. `tolerance`: the allowed difference, as a
    fraction of the target."""

    text: str
    value: float
    target: float
    tolerance: float


@dataclass(frozen=True, slots=True)
class SavedFrames:
    """A cache with the frames from `first_frame` to `frame`, in which the failure occurred.

    - `folder`: the folder of the cache; None if the cache could not be written. `note`: in this case, the reason, otherwise "".
    - `view_command`: a command that displays the frames. `resume_command`: a command that continues the run from them."""

    folder: Path | None
    note: str = ""
    first_frame: int = 0
    frame: int = 0
    view_command: str = ""
    resume_command: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class ComparisonShot:
    """The reference run of a spec that compares two runs: its shot, and the plan of the spec for that shot."""

    shot: Shot
    plan: SpecPlan


@dataclass(slots=True, eq=False)
class SpecCase:
    """One spec with one seed.

    - `outcome`: passed, failed, allowed or waiting. An allowed case has failed, but enough other seeds of the spec have passed.
      A waiting case has not yet run to its end.
    - `goals`: the values of its goals, after the last frame.
    - `frames`: the number of judged frames. `seconds`: the duration of the run."""

    spec: Spec
    plan: SpecPlan
    scene: Path
    seed: int
    outcome: str = "waiting"
    failures: list[SpecFailure] = field(default_factory=list)
    frames: int = 0
    seconds: float = 0.0
    comparison_shot: ComparisonShot | None = None
    saved_frames: SavedFrames | None = None
    goals: list[GoalValue] = field(default_factory=list)

    @property
    def name(self) -> str:
        """Return the name of the spec."""
        return self.spec.name


@dataclass(slots=True, eq=False)
class SpecRun:
    """One simulation, and the cases that are judged in it."""

    shot: Shot
    seed: int
    cases: list[SpecCase]


def collect_cases(
    paths: Iterable[Path], *, grants: Mapping[str, Path] | None = None, seeds: int | None = None, name_filter: str = ""
) -> tuple[list[SpecRun], Report]:
    """Return the runs for programs, scenes and folders, and a report on files, scenes and specs.

    Folders are searched for programs, but not for scenes. `seeds`: run the seeds 1 to this number instead of each spec's own.
    `name_filter`: run only specs with this text in their name."""
    paths = list(paths)
    files, report = find_files(paths)
    parsed = SharedParsedFiles()
    finder = CaseFinder(dict(grants or {}), parsed, report)
    for file in (file for file in files if file.suffix == ".ant" or file in paths):
        program, findings = check_path(file, RunChoices(finder.grants), parsed=parsed, specs=False)
        report.extend(findings)
        if program is None or not findings.ok:
            continue
        for spec in program.specs:
            if name_filter.lower() in spec.name.lower():
                finder.add_spec(file, spec)
    return finder.make_runs(None if seeds is None else range(1, seeds + 1)), report


class CaseFinder:
    """Finds the cases to run. Each scene is opened once for each set of changed params. `params`: values that override the
    params of all scenes."""

    def __init__(
        self, grants: dict[str, Path], parsed_files: ParsedFileCache, report: Report, params: Mapping[str, str] | None = None
    ) -> None:
        self.grants, self.parsed, self.report, self.params = grants, parsed_files, report, dict(params or {})
        self.missing_scene_report = Report()  # scenes that do not exist
        self.shots: dict[tuple[Path, tuple[str, ...]], Shot | None] = {}
        self.scene_and_spec_by_key: dict[tuple[Path, Span], tuple[Path, Spec]] = {}

    def add_spec(self, file: Path, spec: Spec) -> None:
        """Add a spec with its scene. A spec that is reached by several paths is added only once.

        `file`: the path that the user named. If it is a scene, the spec is added only if it runs on this scene."""
        program_path = Path(spec.span.source.path)
        scene = self._find_scene(program_path, spec, file)
        if scene is not None and (file.suffix == ".ant" or scene.resolve() == file.resolve()):
            self.scene_and_spec_by_key.setdefault((scene.resolve(), spec.span), (scene, spec))

    def _find_scene(self, program_path: Path, spec: Spec, file: Path) -> Path | None:
        """Return the path of the scene on which a spec runs, or None. `file`: the path that the user named.

        A spec without `on` runs on the scene that the user named, or on `scene.yaml` next to the program."""
        folder = program_path.resolve().parent
        if spec.scene is None:
            if file.suffix != ".ant":
                return file
            if (folder / DEFAULT_SCENE).is_file():
                return program_path.parent / DEFAULT_SCENE
            message = f"the spec `{spec.name}` names no scene, and there is no `{DEFAULT_SCENE}` here"
            self.report.error(
                "no-scene", message, _find_first_line(spec), f'write `spec "{spec.name}" on "{DEFAULT_SCENE}" {{ … }}`'
            )
            return None
        return self._find_named_scene(program_path, spec.scene)

    def _find_named_scene(self, program_path: Path, name: Text) -> Path | None:
        """Return the path of a scene that a spec names, next to the program or in a granted root; None if there is none."""
        roots = Roots(program_path.resolve().parent, self.grants)
        try:
            roots.measure_file_size(name.text)
        except PathRefused as error:
            self.missing_scene_report.error(error.code, str(error), name.span, error.help)
            return None
        path = roots.resolve_path(name.text)
        return program_path.parent / name.text if (program_path.parent / name.text).resolve() == path.resolve() else path

    def make_runs(self, seeds: Sequence[int] | None) -> list[SpecRun]:
        """Return the runs of all added specs. `seeds`: the seeds to use instead of those that each spec lists."""
        made: dict[tuple[int, int], SpecRun] = {}
        for scene, spec in self.scene_and_spec_by_key.values():
            shot = self._open_shot(scene, spec.changes)
            plan = None if shot is None else self._find_plan(shot, spec, scene)
            other = None if spec.reference_run is None or plan is None else self._find_comparison_shot(scene, spec)
            if shot is None or plan is None or (spec.reference_run is not None and other is None):
                continue
            for seed in seeds or spec.seeds or (shot.scene.model.seed,):
                run = made.setdefault((id(shot), seed), SpecRun(shot, seed, []))
                run.cases.append(SpecCase(plan.spec, plan, scene, seed, comparison_shot=other))
        self.report.extend(merge_repeated_findings(self.missing_scene_report))
        return list(made.values())

    def _find_comparison_shot(self, scene: Path, spec: Spec) -> ComparisonShot | None:
        """Return the reference run of a spec. Return None if the spec has none, or if the scene of the reference run has errors.

        The params that the spec changes also apply to the reference run, except those that its `against` block changes."""
        assert spec.reference_run is not None
        if spec.reference_run.scene is not None:
            scene_path = self._find_named_scene(Path(spec.span.source.path), spec.reference_run.scene)
            if scene_path is None:
                return None
            scene = scene_path
        reference_names = {change.name for change in spec.reference_run.changes}
        shot = self._open_shot(scene, (*(c for c in spec.changes if c.name not in reference_names), *spec.reference_run.changes))
        plan = None if shot is None else self._find_plan(shot, spec, scene)
        return None if shot is None or plan is None else ComparisonShot(shot, plan)

    def _open_shot(self, scene: Path, changes: tuple[SpecChange, ...]) -> Shot | None:
        """Return the shot of a scene with changed params, or None if it has errors. Each shot is opened only once."""
        key = (scene.resolve(), tuple(sorted(f"{c.name} = {' '.join(c.value.span.text.split())}" for c in changes)))
        if key not in self.shots:
            shot, report = open_scene(scene, RunChoices(self.grants, params=self.params, changes=changes), parsed=self.parsed)
            self.report.extend(report)
            self.shots[key] = shot
        return self.shots[key]

    def _find_plan(self, shot: Shot, spec: Spec, scene: Path) -> SpecPlan | None:
        """Return the plan of a spec, lowered for the program of a scene, or None if there are errors."""
        same_spec = _find_same_spec(shot.program, spec)
        if same_spec is None:
            message = f"`{scene.name}` has no crowd from `{Path(spec.span.source.path).name}`"
            advice = "name a scene that uses this program, or add a line to its `crowd`"
            self.report.error("other-scene", message, _find_first_line(spec), advice)
            return None
        plan, report = lower_spec(same_spec, shot.program, shot.plan)
        self.report.extend(report)
        return plan


def _find_same_spec(program: Program, spec: Spec) -> Spec | None:
    """Return the spec of another compiled program that has the same source location as `spec`, or None if there is none."""
    place = (spec.span.source, spec.span.start)
    return next((each for each in program.specs if (each.span.source, each.span.start) == place), None)


def _find_first_line(spec: Spec) -> Span:
    """Return the location of a spec's first line."""
    source, start = spec.span.source, spec.span.start
    end = source.text.find("\n", start)
    return Span(source, start, min(spec.span.end, end if end >= 0 else spec.span.end))


@dataclass(frozen=True, slots=True)
class SpecVerdict:
    """The verdict on a spec that must pass with a required fraction of its seeds.

    `passed_count`: the number of seeds that passed. `case_count`: the number of all seeds. `has_passed`: whether enough seeds
    passed; None while cases are waiting."""

    spec: Spec
    passed_count: int
    case_count: int
    has_passed: bool | None


def resolve_verdicts(cases: Sequence[SpecCase]) -> list[SpecVerdict]:
    """Return the verdicts on all specs that must pass with a required fraction of their seeds. Call this after all runs.

    If enough seeds of a spec have passed, the outcome of its failed cases is changed to `allowed`."""
    groups: dict[tuple[str, int, str], list[SpecCase]] = {}
    for case in cases:
        if case.spec.pass_share < 1:
            groups.setdefault((case.spec.span.source.path, case.spec.span.start, str(case.scene)), []).append(case)
    return [_resolve_verdict(group) for group in groups.values()]


def _resolve_verdict(group: list[SpecCase]) -> SpecVerdict:
    pass_count = sum(case.outcome == "passed" for case in group)
    if any(case.outcome == "waiting" for case in group):
        return SpecVerdict(group[0].spec, pass_count, len(group), None)
    holds = pass_count >= group[0].spec.pass_share * len(group) * (1 - 1e-9)
    for case in group:
        if holds and case.outcome == "failed":
            case.outcome = "allowed"
    return SpecVerdict(group[0].spec, pass_count, len(group), holds)
