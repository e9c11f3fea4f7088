"""`antdsl fit SCENE…`: searches for values of params with which the goals of a spec are met."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from antdsl.atomic_write import create_folder_durably, write_atomically
from antdsl.cli.destinations import choose_default_path, protect_inputs, require_writable_folder
from antdsl.cli.exits import CommandError, ExitCode, report_failures
from antdsl.cli.printing.messages import print_note
from antdsl.cli.scheduler import (
    NO_TLS_OPTION,
    SCHEDULER_OPTION,
    TLS_OPTION,
    choose_stop_exit_code,
    open_engine,
    raise_on_sigterm,
    require_scheduler,
)

if TYPE_CHECKING:
    from antdsl.sweeps.designs import ChosenPoints

RESULT_FILE_NAMES = ("fit.txt", "fit.json", "points.csv")


@report_failures("the fit stopped", "run the same command again")
def run_fit_command(
    scenes: list[Path] = typer.Argument(..., metavar="SCENE…", help="Scenes with which the spec is run."),
    vary: list[str] = typer.Option(..., "--vary", metavar="NAME=A..B", help="A range of a param; may be repeated."),
    spec: str = typer.Option(..., "--to", metavar="SPEC", help="The name of the spec with the goals."),
    points: int = typer.Option(64, "--points", min=8, max=4096, help="Points of the first sample, a power of 2."),
    generations: int = typer.Option(30, "--generations", min=0, max=1000, help="Greatest number of generations of the search."),
    seeds: str = typer.Option("5", "--seeds", metavar="N", help="Run each point with the seeds 1 to N, or A..B."),
    check_seeds: int = typer.Option(5, "--check-seeds", min=0, max=1000, help="Further seeds to check the result with."),
    search_seed: int = typer.Option(1, "--search-seed", min=1, max=2**31 - 1, help="Seed of the choice of points."),
    jobs: int = typer.Option(0, "--jobs", min=0, max=256, help="Number of parallel runs; 0: all available cores."),
    out: Path = typer.Option(
        None, "--out", metavar="DIR", help="Folder of the results. [default: out/fit next to the first scene]"
    ),
    root: list[str] = typer.Option([], "--root", metavar="NAME=DIR", help="Grant scenes a folder of assets outside their own."),
    scheduler: str = SCHEDULER_OPTION,
    tls: Path = TLS_OPTION,
    no_tls: bool = NO_TLS_OPTION,
    quiet: bool = typer.Option(False, "--quiet", "-q", help="Print the result and problems only."),
) -> None:
    """Fit params to the goals of a spec."""
    from dataclasses import replace

    from antdsl.cli.arguments import parse_grants, require_scene
    from antdsl.cli.printing.reports import exit_on_errors
    from antdsl.cli.sweep_arguments import parse_seeds
    from antdsl.diagnostics import Report
    from antdsl.executors import WorkersLostError
    from antdsl.fitting import PointEvaluator, fit_goals
    from antdsl.fitting.evaluation import find_spec
    from antdsl.fitting.report import describe_fit, encode_fit, format_points
    from antdsl.loading import SharedParsedFiles
    from antdsl.numerics.processor.host import count_available_cores
    from antdsl.scene.paths import record_requested_paths
    from antdsl.sweeps.factors import build_end_points

    require_scheduler(scheduler, tls, no_tls)
    for scene in scenes:
        require_scene(scene)
    chosen, numbers, grants = _choose_points(vary, points, search_seed), parse_seeds(seeds), parse_grants(root)
    folder = out if out is not None else choose_default_path(scenes[0].resolve().parent, "out", "fit")
    if scenes[0].is_file():
        require_writable_folder(folder, "--out", *RESULT_FILE_NAMES)
    report = Report()
    with protect_inputs({}, {"--out": (folder, RESULT_FILE_NAMES)}) as inputs, record_requested_paths() as read:
        inputs += scenes
        finders = [
            find_spec(scene, spec, grants, ends, report, SharedParsedFiles())
            for scene in scenes
            for ends in build_end_points(chosen.factors)
        ]
        for finder in finders if report.ok else ():
            finder.make_runs(list(numbers[:1]))
    exit_on_errors(report)
    specs = [each for finder in finders for _, each in finder.scene_and_spec_by_key.values()]
    processes = jobs or count_available_cores()
    engine = open_engine(
        (scheduler, tls, no_tls), processes, max(1, count_available_cores() // processes), [p for p in read if p.is_file()]
    )

    def show_generation(number: int, loss: float) -> None:
        if not quiet:
            print_note(f"generation {number}: {len(evaluator.results)} points, least loss {loss:.4g}")

    try:
        with raise_on_sigterm(), engine as running:
            evaluator = PointEvaluator(scenes, spec, list(numbers), grants, running, specs[0].pass_share)
            result = fit_goals(chosen, evaluator, generations, search_seed, show_generation)
            if result.best is not None and check_seeds:
                others = list(range(numbers[-1] + 1, numbers[-1] + 1 + check_seeds))
                checker = PointEvaluator(scenes, spec, others, grants, running, specs[0].pass_share)
                result = replace(result, check=checker.evaluate([result.best.values])[0])
    except (KeyboardInterrupt, WorkersLostError) as error:
        code = ExitCode.INPUT_OUTPUT if isinstance(error, WorkersLostError) else choose_stop_exit_code(error)
        raise CommandError(code, f"stopped: {error}".rstrip(": "), "run the same command again") from None
    create_folder_durably(folder)
    text = describe_fit(result)
    units = {factor.name: factor.unit for factor in chosen.factors}
    contents = (f"{text}\n".encode(), encode_fit(result, spec), format_points(result, units).encode())
    for name, content in zip(RESULT_FILE_NAMES, contents, strict=True):
        write_atomically(folder / name, content)
    print_note(text)
    print_note(f"in {folder}: {', '.join(RESULT_FILE_NAMES)}")
    if result.best is None:
        raise CommandError(ExitCode.FINDINGS, "error: no run has finished")


def _choose_points(vary: list[str], points: int, seed: int) -> ChosenPoints:
    """Return Sobol points in the ranges of the varied params. Invalid ranges end the command with a usage error."""
    from antdsl.cli.arguments import parse_pairs
    from antdsl.cli.sweep_arguments import require_no_errors
    from antdsl.sweeps.designs import choose_design
    from antdsl.sweeps.factors import parse_factors

    factors, report = parse_factors(parse_pairs(vary, "--vary"))
    require_no_errors(report)
    for factor in factors:
        if factor.levels:
            advice = f"write its ends: `--vary {factor.name}={factor.levels[0]}..{factor.levels[-1]}`"
            report.error("wrong-value", f"a fit needs ranges, but `{factor.name}` has separate values", None, advice)
    require_no_errors(report)
    chosen, report = choose_design("sobol", factors, points, seed)
    require_no_errors(report)
    assert chosen is not None
    return chosen
