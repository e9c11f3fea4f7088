"""`antdsl sweep SCENE…`: runs scenes with varied values and seeds, locally or on a cluster, and writes a table of results."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from antdsl.atomic_write import write_atomically
from antdsl.cli.arguments import UNTIL_OPTION
from antdsl.cli.destinations import choose_default_path, protect_inputs, require_writable_folder
from antdsl.cli.exits import CommandError, ExitCode, report_failures
from antdsl.cli.memory_demand import ANY_MEMORY_OPTION, require_available_memory
from antdsl.cli.printing.messages import print_note, treat_output_as_notes
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
    from antdsl.sweeps import FinishedRunStore, JobOutcome, SweepJob, SweepJobChooser
    from antdsl.sweeps.study import SweepStudy
    from antdsl.sweeps.table import RunResult

RESULT_FILE_NAMES = (
    "table.txt",
    "table.csv",
    "runs.csv",
    "runs.parquet",
    "series.csv",
    "series.parquet",
    "sweep.json",
    "table.png",
    "sensitivity.csv",
    "factors.png",
    "asked.json",
)
DEFAULT_DESIGN_SEED = 1  # seed of a design, if none is named
MAX_PLOT_PANELS = 24  # maximum number of panels in one picture
MAX_PRINTED_LINES = 60  # maximum number of printed lines of a table


class DesignName(StrEnum):
    """The sampling designs that `--design` accepts."""

    grid = "grid"
    latin = "latin"
    sobol = "sobol"
    saltelli = "saltelli"
    morris = "morris"


@report_failures("the sweep stopped", "run the same command again, or add `--resume`, to complete the remaining runs")
def run_sweep_command(
    context: typer.Context,
    scenes: list[Path] = typer.Argument(None, metavar="SCENE…", help="Scenes; the table has one line per scene."),
    vary: list[str] = typer.Option(
        [],
        "--vary",
        metavar="NAME=A,B,C",
        help="Values of a param: forager.smell=30mm,50mm, or a range: 30mm..90mm. Several params are combined.",
    ),
    design: DesignName = typer.Option(
        DesignName.grid,
        "--design",
        help="Choice of values: all combinations, points of a Latin hypercube or a Sobol sequence, Saltelli's sample or Morris' "
        "trajectories. The last two measure the influence of each param.",
    ),
    points: int = typer.Option(None, "--points", metavar="N", min=2, max=1_000_000, help="Number of points of a design."),
    design_seed: int = typer.Option(
        DEFAULT_DESIGN_SEED, "--design-seed", metavar="N", min=1, max=2**31 - 1, help="Seed of the design's random draws."
    ),
    seeds: str = typer.Option("5", "--seeds", metavar="N", help="Run each combination with the seeds 1 to N, or A..B."),
    jobs: int = typer.Option(
        0, "--jobs", min=0, max=256, help="Number of parallel runs; 0: all available cores. Does not change results."
    ),
    out: Path = typer.Option(
        None, "--out", metavar="DIR", help="Folder of the table. [default: out/sweep next to the first scene]"
    ),
    frames: str = typer.Option(None, "--frames", metavar="A..B", help="Frame range; overrides the scenes."),
    until: str = UNTIL_OPTION,
    until_known: list[str] = typer.Option(
        [],
        "--until-known",
        metavar="NAME=WIDTH",
        help="Stop adding seeds once the median of a measure is this precise: motion.turn_p99=0.5, or 10%. "
        "`--seeds` is then the maximum number.",
    ),
    show: list[str] = typer.Option([], "--show", metavar="NAME", help="Measures in the table, by the start of their names."),
    root: list[str] = typer.Option([], "--root", metavar="NAME=DIR", help="Grant scenes a folder of assets outside their own."),
    resume: bool = typer.Option(
        False, "--resume", help="Continue the sweep in --out with its own options. Repeating its command does the same."
    ),
    again: bool = typer.Option(False, "--again", help="Run everything again, including finished runs."),
    scheduler: str = SCHEDULER_OPTION,
    tls: Path = TLS_OPTION,
    no_tls: bool = NO_TLS_OPTION,
    plots: bool = typer.Option(True, "--plots/--no-plots", help="Also plot the table, if matplotlib is installed."),
    any_memory: bool = ANY_MEMORY_OPTION,
    quiet: bool = typer.Option(False, "--quiet", "-q", help="Print the table and problems only."),
) -> None:
    """Run scenes over parameter values and seeds, and report medians and quartiles."""
    from antdsl.cli.arguments import parse_until, require_scene
    from antdsl.cli.printing.reports import exit_on_errors
    from antdsl.cli.sweep_arguments import build_study, load_request, open_scene_shots, parse_widths, reject_missing_scene
    from antdsl.executors import WorkersLostError
    from antdsl.numerics.processor.host import count_available_cores
    from antdsl.scene.paths import record_requested_paths
    from antdsl.sweeps import FinishedRunStore, SweepJobChooser, run_jobs
    from antdsl.sweeps.finished_runs import NotASweepFolderError
    from antdsl.sweeps.study import SweepRequest

    require_scheduler(scheduler, tls, no_tls)
    for scene in scenes or ():
        require_scene(scene)
    request = (
        load_request(context, out)
        if resume
        else SweepRequest(
            scenes=[str(scene) for scene in scenes or ()] or reject_missing_scene(),
            vary=vary,
            design=design.value,
            points=points,
            design_seed=design_seed,
            seeds=seeds,
            frames=frames,
            until=parse_until(until),
            show=show,
            until_known=until_known,
            root=root,
        )
    )
    widths, first = parse_widths(request), Path(request.scenes[0])
    folder = out if out is not None else choose_default_path(first.resolve().parent, "out", "sweep")
    if first.is_file():  # otherwise there is no folder next to the scene
        require_writable_folder(folder, "--out", *RESULT_FILE_NAMES)
    with protect_inputs({}, {"--out": (folder, (*RESULT_FILE_NAMES, "runs"))}) as inputs, record_requested_paths() as read:
        inputs += map(Path, request.scenes)
        study, runs, report = build_study(request)
    exit_on_errors(report)
    try:
        run_store = FinishedRunStore(folder)
    except NotASweepFolderError as error:
        raise CommandError(ExitCode.INPUT_OUTPUT, f"error: {error}", "name another folder with `--out`") from None
    show = show or request.show
    request.model_copy(update={"show": show}).write_request(folder)

    chooser = SweepJobChooser(runs, widths)
    finished_measures: dict[str, Any] = {}
    if not again:
        finished_measures = {
            job.key: stored_measures for job in runs if (stored_measures := run_store.read_measures(job)) is not None
        }
    for job in runs:
        if job.key in finished_measures:
            chooser.record_result(job, finished_measures[job.key])
    todo = len(runs) - len(finished_measures)
    if finished_measures and not quiet:
        print_note(f"{len(finished_measures)} of {len(runs)} runs were finished before")
    others = run_store.count_other_runs(runs) if resume else 0
    if others:
        print_note(
            f"{others} runs in {folder} used different files, values or versions of antdsl, and are not counted", to_stderr=True
        )
    processes = min(jobs or count_available_cores(), max(todo, 1))
    threads = max(1, count_available_cores() // processes)
    if todo and not any_memory and not scheduler:  # machines of a cluster have their own memory
        require_available_memory(open_scene_shots(study, request), processes, len(runs))
    failed_outcomes: list[JobOutcome] = []
    files = [path for path in read if path.is_file()]
    where = open_engine((scheduler, tls, no_tls), processes, threads, files)
    try:
        with raise_on_sigterm(), where as engine, _show_progress(todo, quiet, bool(request.until_known)) as watch:
            for outcome in run_jobs(chooser.iterate_needed_jobs(), engine, watch.show_frame, watch.show_note):
                watch.show_finished(outcome)
                if outcome.measures is None:
                    failed_outcomes.append(outcome)
                else:
                    run_store.write_measures(outcome.job, outcome.measures)
                    finished_measures[outcome.job.key] = outcome.measures
                chooser.record_result(outcome.job, outcome.measures)
                _require_measures(chooser)
    except (KeyboardInterrupt, WorkersLostError) as error:
        _write_tables(run_store, study, chooser, finished_measures, show, plots=False)
        finished = f"{len(finished_measures)} of {len(runs)} runs are finished and stored"
        code, words = (
            (ExitCode.INPUT_OUTPUT, f"error: {error}")
            if isinstance(error, WorkersLostError)
            else (choose_stop_exit_code(error), "stopped")
        )
        raise CommandError(
            code, f"{words}: {finished}", "run the same command again, or add `--resume`, to complete the others"
        ) from None
    _require_measures(chooser)
    _write_tables(run_store, study, chooser, finished_measures, show, plots)
    if failed_outcomes:
        raise CommandError(
            ExitCode.FINDINGS, f"error: {len(failed_outcomes)} of {len(runs)} runs failed and are not in the table"
        )


def _require_measures(chooser: SweepJobChooser) -> None:
    """Raise CommandError if a width goal names a measure that no run has reported."""
    unheard = chooser.list_missing_measures()
    if unheard:
        raise CommandError(
            ExitCode.USAGE,
            f"error: no measure begins with `{unheard[0]}`",
            f"measures begin with: {', '.join(chooser.list_measure_prefixes())}",
        )


def _write_tables(
    run_store: FinishedRunStore,
    study: SweepStudy,
    chooser: SweepJobChooser,
    finished_measures: Mapping[str, Any],
    show: Sequence[str],
    plots: bool,
) -> None:
    """Write the table in all formats, and print it.

    `finished_measures`: the measures of each finished run, by its key. `show`: print only measures with names that begin with
    one of these texts."""
    from antdsl.outputs.parquet_table import encode_parquet
    from antdsl.sweeps import build_rows
    from antdsl.sweeps.figures import is_matplotlib_available
    from antdsl.sweeps.plots import INSTALL_HINT, draw_factors, draw_measures
    from antdsl.sweeps.sensitivity import format_effects as effects_text
    from antdsl.sweeps.sensitivity import format_effects_csv as effects_csv
    from antdsl.sweeps.table import (
        choose_measures,
        collect_run_series,
        collect_runs,
        format_columns,
        format_csv_table,
        format_json_table,
        format_known_medians,
        format_table,
    )

    results: list[RunResult] = [(job, finished_measures[job.key]) for job in chooser.counted_jobs]
    if not results:
        return
    table, known_medians = build_rows(results), chooser.list_known_medians()
    measures = choose_measures(table, show)
    if show and not measures:
        names = ", ".join(dict.fromkeys(row.measure.split(".")[0] for row in table))
        raise CommandError(ExitCode.USAGE, f"error: no measure begins with `{show[0]}`", f"measures begin with: {names}")
    effects, remarks = study.find_effects(table, measures)
    lines = format_table(table, measures)
    words = f"\n{format_known_medians(known_medians)}" if known_medians else ""
    if effects and study.chosen_points.design.analysis is not None:
        words += f"\n{effects_text(study.chosen_points.design.analysis, effects)}"
    tables = {"runs": collect_runs(results, study.unit_by_factor), "series": collect_run_series(results, study.unit_by_factor)}
    texts = {
        "table.txt": lines + words,
        "table.csv": format_csv_table(table),
        "runs.csv": format_columns(tables["runs"]),
        "sweep.json": format_json_table(results, table, known_medians, effects),
    }
    if effects:
        texts["sensitivity.csv"] = effects_csv(effects)
    files = {name: content.encode() for name, content in texts.items()}
    for name, columns in tables.items():
        if columns:
            files.setdefault(f"{name}.csv", format_columns(columns).encode())
            parquet = encode_parquet(columns)
            files |= {} if parquet is None else {f"{name}.parquet": parquet}
    for name, content in files.items():
        write_atomically(run_store.folder / name, content)
    print_note((_truncate_table(lines) + words).rstrip("\n"))
    for remark in remarks:
        print_note(f"note: {remark}", to_stderr=True)
    picture_names = []
    if plots and is_matplotlib_available() and len(measures) <= MAX_PLOT_PANELS:
        if study.range_factors:
            draw_factors(study, results, measures, effects, run_store.folder / "factors.png")
            picture_names.append("factors.png")
        else:
            draw_measures(results, measures, run_store.folder / "table.png")
            picture_names.append("table.png")
    print_note(f"in {run_store.folder}: {', '.join([*files, *picture_names])}")
    if plots and not is_matplotlib_available():
        print_note(INSTALL_HINT)


def _truncate_table(lines: str) -> str:
    """Return the first lines of a table, up to the printed maximum, and a note about the omitted ones."""
    each = lines.splitlines(keepends=True)
    omitted_count = len(each) - 1 - MAX_PRINTED_LINES
    return "".join(each[: MAX_PRINTED_LINES + 1]) + (
        f"… and {omitted_count} more lines, in table.txt\n" if omitted_count > 0 else ""
    )


class _RunProgress:
    """A display of the progress of runs, with one line for each finished run. It prints nothing if the command is quiet."""

    def __init__(self, total: int, quiet: bool, is_maximum: bool) -> None:
        self.total, self.quiet, self.count = total, quiet, 0
        self.of = f"of at most {total}" if is_maximum else f"of {total}"
        self.printed_notes: set[str] = set()

    def show_frame(self, job: SweepJob, frame: int) -> None:
        """Display that a run has reached a frame."""

    def show_finished(self, outcome: JobOutcome) -> None:
        """Display that a run has ended, whether it succeeded or failed."""
        self.count += 1
        if outcome.measures is None:
            print_note(f"failed: {outcome.job.name}: {outcome.problem}", to_stderr=True)
        elif not self.quiet:
            self.print_line(f"{self.count} {self.of}: {outcome.job.name}, {outcome.measures['frames']} frames")

    def show_note(self, sentence: str) -> None:
        """Print a message that says how a run deviates from the request. A message from several runs is printed once."""
        if sentence not in self.printed_notes:
            self.printed_notes.add(sentence)
            print_note(sentence, to_stderr=True)

    def print_line(self, line: str) -> None:
        """Print a line of progress."""
        print_note(line)


class _BarProgress(_RunProgress):
    """A display of progress on one line that is updated in place. It shows finished runs, and the frames of current runs."""

    def __init__(self, total: int, is_maximum: bool, bar: Any) -> None:
        super().__init__(total, False, is_maximum)
        self.bar = bar
        self.task = bar.add_task("", total=float(total), words="")
        self.current_runs: dict[str, tuple[str, int, float]] = {}

    def show_frame(self, job: SweepJob, frame: int) -> None:
        first, last = job.frames
        self.current_runs[job.key] = (job.name, frame, (frame - first) / max(last - first, 1))
        self._update_bar()

    def show_finished(self, outcome: JobOutcome) -> None:
        self.current_runs.pop(outcome.job.key, None)
        super().show_finished(outcome)
        self._update_bar()

    def _update_bar(self) -> None:
        words = " · ".join(f"{name}: {frame}" for name, frame, _ in list(self.current_runs.values())[:4])
        self.bar.update(self.task, completed=self.count + sum(share for *_, share in self.current_runs.values()), words=words)

    def print_line(self, line: str) -> None:
        self.bar.console.print(line, highlight=False, markup=False)


@contextmanager
def _show_progress(total: int, quiet: bool, is_maximum: bool) -> Iterator[_RunProgress]:
    from antdsl.cli.printing.progress import can_draw_bar

    if quiet or not total or not can_draw_bar():
        yield _RunProgress(total, quiet, is_maximum)
        return
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    columns = (BarColumn(24), TaskProgressColumn(), TimeRemainingColumn(), TextColumn("{task.fields[words]}"))
    with treat_output_as_notes(), Progress(*columns, transient=True) as bar:
        yield _BarProgress(total, is_maximum, bar)
