"""Conversion of the arguments of `antdsl sweep` to runs.

The arguments come from the command line or from an earlier sweep in the same folder. They are checked before any run starts."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from antdsl.cli.exits import CommandError, ExitCode

if TYPE_CHECKING:
    from antdsl.diagnostics import Report
    from antdsl.pipeline import Shot
    from antdsl.sweeps import SweepJob
    from antdsl.sweeps.stopping import WidthGoal
    from antdsl.sweeps.study import SweepRequest, SweepStudy


def reject_missing_scene() -> list[str]:
    """Raise BadParameter because no scene is given on the command line."""
    raise typer.BadParameter("name a scene, or continue a sweep: `--resume --out DIR`", param_hint="SCENE")


# Options that define the runs. A continued sweep has them stored.
_STUDY_OPTIONS = {
    "scenes": "the scenes",
    "vary": "`--vary`",
    "design": "`--design`",
    "points": "`--points`",
    "design_seed": "`--design-seed`",
    "seeds": "`--seeds`",
    "frames": "`--frames`",
    "until": "`--until`",
    "until_known": "`--until-known`",
    "root": "`--root`",
    "again": "`--again`",
}


def load_request(context: typer.Context, folder: Path | None) -> SweepRequest:
    """Return the request that an earlier sweep stored in a folder.

    Raises BadParameter if the command line also has options that define the runs. Raises CommandError if the folder has no
    sweep."""
    from antdsl.sweeps.study import NoStoredSweepError, read_request

    for name, words in _STUDY_OPTIONS.items():
        source = context.get_parameter_source(name)
        if source is not None and source.name == "COMMANDLINE":
            raise typer.BadParameter(f"the sweep continues with its own options: omit {words}", param_hint="--resume")
    if folder is None:
        raise typer.BadParameter("name the sweep to continue: `--resume --out DIR`", param_hint="--resume")
    try:
        return read_request(folder)
    except NoStoredSweepError as error:
        raise CommandError(ExitCode.INPUT_OUTPUT, f"error: {error}", "start one: `antdsl sweep SCENE… --out DIR`") from None


def build_study(request: SweepRequest) -> tuple[SweepStudy, list[SweepJob], Report]:
    """Return the study that a request defines, all its runs, and a report. Wrong arguments end the command with a usage error."""
    from antdsl.cli.arguments import parse_frame_range, parse_grants, parse_pairs
    from antdsl.sweeps import build_jobs, make_variations
    from antdsl.sweeps.designs import choose_design
    from antdsl.sweeps.factors import build_end_points, parse_factors
    from antdsl.sweeps.study import SweepStudy

    scenes = [Path(scene) for scene in dict.fromkeys(request.scenes)]
    for scene in scenes:
        if scene.suffix == ".ant":
            raise typer.BadParameter(f"`{scene}` is a program; name scenes that use it", param_hint="SCENE")
    sweep_factors, report = parse_factors(parse_pairs(request.vary, "--vary"))
    require_no_errors(report)
    chosen, report = choose_design(request.design, sweep_factors, request.points, request.design_seed)
    require_no_errors(report)
    assert chosen is not None
    job_options: dict[str, Any] = {
        "frames": parse_frame_range(request.frames),
        "until": request.until,
        "grants": parse_grants(request.root),
    }
    numbers = parse_seeds(request.seeds)
    _, report = build_jobs(
        make_variations(scenes, build_end_points(sweep_factors) or [{}]), (), **job_options
    )  # each end once, not once for each point beyond it
    if not report.ok:
        return SweepStudy(chosen, (), ()), [], report
    run = make_variations(scenes, chosen.unique_points)
    runs, findings = build_jobs(run, numbers, **job_options)
    report.extend(findings)
    return SweepStudy(chosen, tuple(scenes), tuple(run)), runs, report


def open_scene_shots(study: SweepStudy, request: SweepRequest) -> list[Shot]:
    """Return a shot for each scene of a sweep, opened with the scene's own values. One shot per scene is enough, because the runs
    of a scene differ only in values, not in the things of the world."""
    from antdsl.cli.arguments import parse_grants
    from antdsl.pipeline import RunChoices, open_scene

    shots = (open_scene(scene, RunChoices(parse_grants(request.root)), thorough=False)[0] for scene in study.scenes)
    return [shot for shot in shots if shot is not None]


def require_no_errors(report: Report) -> None:
    """If a report has errors, print it and end the command with a usage error."""
    from antdsl.cli.printing.reports import print_report

    if not report.ok:
        print_report(report, to_stderr=True)
        raise CommandError(ExitCode.USAGE)


def parse_widths(request: SweepRequest) -> list[WidthGoal]:
    """Return the goals that `NAME=WIDTH` arguments define. Raises BadParameter for an invalid width, or if there are too few
    seeds for a goal."""
    from antdsl.cli.arguments import parse_pairs
    from antdsl.scene.quantities import QuantityError, parse_number, split_quantity
    from antdsl.sweeps.stopping import WidthGoal, find_min_runs

    widths = []
    for name, text in parse_pairs(request.until_known, "--until-known").items():
        try:
            digits, unit = split_quantity(text)
            number = parse_number(digits)
        except QuantityError:
            number, unit = 0.0, ""
        if number <= 0 or unit not in ("", "%"):
            words = f"`{text}` is not a width: write `{name}=0.5`, or a share of the median: `{name}=10%`"
            raise typer.BadParameter(words, param_hint="--until-known")
        widths.append(WidthGoal(name, number * (0.01 if unit else 1.0), bool(unit)))
    if widths and len(parse_seeds(request.seeds)) < find_min_runs():
        words = f"a median needs at least {find_min_runs()} runs: write `--seeds 50`, the maximum number of runs"
        raise typer.BadParameter(words, param_hint="--until-known")
    return widths


def parse_seeds(text: str) -> range:
    """Return the range of seeds from `N` (1 to N) or `A..B`. Raises BadParameter for any other text."""
    from antdsl.scene.quantities import QuantityError, parse_integer_range

    try:
        first, last = parse_integer_range(text if ".." in text else f"1..{text}")
    except QuantityError:
        first, last = 1, 0
    if not 0 <= first <= last < 1_000_000:
        raise typer.BadParameter(f"`{text}` is not a number of seeds: write N, or A..B", param_hint="--seeds")
    return range(first, last + 1)
