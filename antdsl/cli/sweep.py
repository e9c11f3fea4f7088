"""`antdsl sweep SCENE…`: many runs, with other values and seeds, on processes or a cluster; a table at the end."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from antdsl.cli.destinations import default_place, folder_to_write, keeping_inputs
from antdsl.cli.exits import Exit, Stop, report_failures
from antdsl.cli.memory_demand import ANY_MEMORY, demand_memory
from antdsl.cli.printing.messages import notes, say
from antdsl.cli.scheduler import NO_TLS, SCHEDULER, TLS, cluster, code_of, demand_scheduler, stoppable
from antdsl.whole import write_atomically

if TYPE_CHECKING:
    from antdsl.sweep import Chooser, Job, Outcome, RunStore
    from antdsl.sweep.study import Study
    from antdsl.sweep.table import Result

RESULTS = (
    "table.txt",
    "table.csv",
    "runs.csv",
    "runs.parquet",
    "sweep.json",
    "table.png",
    "sensitivity.csv",
    "factors.png",
    "asked.json",
)
SEED = 1  # of a design, where none is named
MOST_PANELS = 24  # of one picture
MOST_LINES = 60  # of a table that is printed


class DesignWord(StrEnum):
    grid = "grid"
    latin = "latin"
    sobol = "sobol"
    saltelli = "saltelli"
    morris = "morris"


@report_failures("the sweep stopped", "the same command goes on with the runs that are left, and so does `--resume`")
def sweep(
    context: typer.Context,
    scenes: list[Path] = typer.Argument(None, metavar="SCENE…", help="Scenes; each is a line of the table."),
    vary: list[str] = typer.Option(
        [],
        "--vary",
        metavar="NAME=A,B,C",
        help="Values of a param: forager.smell=30mm,50mm, or all between two: 30mm..90mm. Several make all combinations.",
    ),
    design: DesignWord = typer.Option(
        DesignWord.grid,
        "--design",
        help="Which values are run: all combinations; points of a Latin hypercube or of a Sobol sequence; Saltelli's sample or "
        "Morris' trajectories, which tell how much each param matters.",
    ),
    points: int = typer.Option(
        None, "--points", metavar="N", min=2, max=1_000_000, help="How many points a design has.", show_default=False
    ),
    design_seed: int = typer.Option(SEED, "--design-seed", metavar="N", min=1, max=2**31 - 1, help="Another draw of a design."),
    seeds: str = typer.Option("5", "--seeds", metavar="N", help="Run each with the seeds 1 to N, or with A..B."),
    jobs: int = typer.Option(
        0, "--jobs", min=0, max=256, help="Runs at a time; 0 takes all cores that it may use. Changes no result."
    ),
    out: Path = typer.Option(
        None, "--out", metavar="DIR", help="Where the table goes. [default: out/sweep beside the first scene]", show_default=False
    ),
    frames: str = typer.Option(None, "--frames", metavar="A..B", help="Other frames than the scenes'."),
    until: list[str] = typer.Option(
        [], "--until-empty", metavar="NAME", help="End a run once this is all gone: food.load, food.apple.load."
    ),
    until_known: list[str] = typer.Option(
        [],
        "--until-known",
        metavar="NAME=WIDTH",
        help="Run no more seeds once the median of a measure is known so closely: motion.turn_p99=0.5, or 10%. "
        "Then `--seeds` is how many at most.",
    ),
    show: list[str] = typer.Option([], "--show", metavar="NAME", help="Measures of the table, by the beginning of their name."),
    root: list[str] = typer.Option([], "--root", metavar="NAME=DIR", help="Grant scenes a folder of assets outside their own."),
    resume: bool = typer.Option(
        False, "--resume", help="Continue the sweep in --out with its options. The same command does that too."
    ),
    again: bool = typer.Option(False, "--again", help="Run everything again, also what was finished before."),
    scheduler: str = SCHEDULER,
    tls: Path = TLS,
    no_tls: bool = NO_TLS,
    plots: bool = typer.Option(True, "--plots/--no-plots", help="Draw the table too, where matplotlib is installed."),
    any_memory: bool = ANY_MEMORY,
    quiet: bool = typer.Option(False, "--quiet", "-q", help="Print the table and problems only."),
) -> None:
    """Run scenes with other values and seeds, and tell medians and quartiles."""
    from antdsl.cli.arguments import require_scene
    from antdsl.cli.printing.reports import demand
    from antdsl.cli.sweep_words import load_request, nothing, scene_shots, study_of, widths_of
    from antdsl.executors import Lost, Processes
    from antdsl.numerics.host import cores
    from antdsl.scene.paths import sought
    from antdsl.sweep import Chooser, RunStore, run_all
    from antdsl.sweep.finished_runs import OtherFiles
    from antdsl.sweep.study import SweepRequest

    demand_scheduler(scheduler, tls, no_tls)
    for scene in scenes or ():
        require_scene(scene)
    request = (
        load_request(context, out)
        if resume
        else SweepRequest(
            scenes=[str(scene) for scene in scenes or ()] or nothing(),
            vary=vary,
            design=design.value,
            points=points,
            design_seed=design_seed,
            seeds=seeds,
            frames=frames,
            until_empty=until,
            until_known=until_known,
            root=root,
        )
    )
    widths, first = widths_of(request), Path(request.scenes[0])
    folder = out if out is not None else default_place(first.resolve().parent, "out", "sweep")
    if first.is_file():  # else there is no folder beside it to ask
        folder_to_write(folder, "--out", *RESULTS)
    with keeping_inputs({}, {"--out": (folder, (*RESULTS, "runs"))}) as inputs, sought() as read:
        inputs += map(Path, request.scenes)
        study, runs, report = study_of(request)
    demand(report)
    try:
        run_store = RunStore(folder)
    except OtherFiles as why:
        raise Stop(Exit.INPUT_OUTPUT, f"error: {why}", "name another folder with `--out`") from None
    request.keep(folder)

    chooser = Chooser(runs, widths)
    finished_measures: dict[str, Any] = {}
    if not again:
        finished_measures = {
            job.key: stored_measures for job in runs if (stored_measures := run_store.read_measures(job)) is not None
        }
    for job in runs:
        if job.key in finished_measures:
            chooser.heard(job, finished_measures[job.key])
    todo = len(runs) - len(finished_measures)
    if finished_measures and not quiet:
        say(f"{len(finished_measures)} of {len(runs)} runs were finished before")
    others = run_store.others(runs) if resume else 0
    if others:
        say(
            f"{others} runs in {folder} are of files, values or sources of antdsl that are others now, and are not counted",
            err=True,
        )
    processes = min(jobs or cores(), max(todo, 1))
    threads = max(1, cores() // processes)
    if todo and not any_memory and not scheduler:  # a cluster's machines have memory of their own
        demand_memory(scene_shots(study, request), processes, len(runs))
    failed: list[Outcome] = []
    files = [path for path in read if path.is_file()]
    where = (
        cluster(scheduler, tls, no_tls, processes, threads, files) if scheduler else nullcontext(Processes(processes, threads))
    )
    try:
        with stoppable(), where as executors, _progress(todo, quiet, bool(request.until_known)) as watch:
            for outcome in run_all(chooser.needed_jobs(), executors, watch.frame, watch.noted):
                watch.finished(outcome)
                if outcome.measures is None:
                    failed.append(outcome)
                else:
                    run_store.keep(outcome.job, outcome.measures)
                    finished_measures[outcome.job.key] = outcome.measures
                chooser.heard(outcome.job, outcome.measures)
                _demand_measures(chooser)
    except (KeyboardInterrupt, Lost) as why:
        _tell(run_store, study, chooser, finished_measures, show, plots=False)
        finished = f"{len(finished_measures)} of {len(runs)} runs are finished and stored"
        code, words = (Exit.INPUT_OUTPUT, f"error: {why}") if isinstance(why, Lost) else (code_of(why), "stopped")
        raise Stop(code, f"{words}: {finished}", "the same command goes on with the others, and so does `--resume`") from None
    _demand_measures(chooser)
    _tell(run_store, study, chooser, finished_measures, show, plots)
    if failed:
        raise Stop(Exit.FINDINGS, f"error: {len(failed)} of {len(runs)} runs failed and are not in the table")


def _demand_measures(chooser: Chooser) -> None:
    unheard = chooser.unheard()
    if unheard:
        raise Stop(Exit.USAGE, f"error: no measure begins with `{unheard[0]}`", f"there are: {', '.join(chooser.heard_of())}")


def _tell(
    run_store: RunStore, study: Study, chooser: Chooser, finished_measures: Mapping[str, Any], show: Sequence[str], plots: bool
) -> None:
    """Write the table in all its forms, and print it."""
    from antdsl.sweep import rows
    from antdsl.sweep.figures import available
    from antdsl.sweep.plots import HOW, draw, draw_factors
    from antdsl.sweep.sensitivity import as_csv as effects_csv
    from antdsl.sweep.sensitivity import text as effects_text
    from antdsl.sweep.table import as_csv, as_json, choose_measures, known_text, runs_csv, runs_parquet, text

    results: list[Result] = [(job, finished_measures[job.key]) for job in chooser.counted]
    if not results:
        return
    table, known = rows(results), chooser.known()
    measures = choose_measures(table, show)
    if show and not measures:
        names = ", ".join(dict.fromkeys(row.measure.split(".")[0] for row in table))
        raise Stop(Exit.USAGE, f"error: no measure begins with `{show[0]}`", f"there are: {names}")
    effects, remarks = study.effects(table, measures)
    lines = text(table, measures)
    words = f"\n{known_text(known)}" if known else ""
    if effects and study.chosen.design.analysis is not None:
        words += f"\n{effects_text(study.chosen.design.analysis, effects)}"
    texts = {
        "table.txt": lines + words,
        "table.csv": as_csv(table),
        "runs.csv": runs_csv(results, study.units),
        "sweep.json": as_json(results, table, known, effects),
    }
    if effects:
        texts["sensitivity.csv"] = effects_csv(effects)
    files = {name: content.encode() for name, content in texts.items()}
    parquet = runs_parquet(results, study.units)
    if parquet is not None:
        files["runs.parquet"] = parquet
    for name, content in files.items():
        write_atomically(run_store.folder / name, content)
    say((_beginning(lines) + words).rstrip("\n"))
    for remark in remarks:
        say(f"note: {remark}", err=True)
    drawn = []
    if plots and available() and len(measures) <= MOST_PANELS:
        if study.ranges:
            draw_factors(study, results, measures, effects, run_store.folder / "factors.png")
            drawn.append("factors.png")
        else:
            draw(results, measures, run_store.folder / "table.png")
            drawn.append("table.png")
    say(f"in {run_store.folder}: {', '.join([*files, *drawn])}")
    if plots and not available():
        say(HOW)


def _beginning(lines: str) -> str:
    """What is printed of a table: its first lines."""
    each = lines.splitlines(keepends=True)
    omitted_count = len(each) - 1 - MOST_LINES
    return "".join(each[: MOST_LINES + 1]) + (f"… and {omitted_count} lines more, in table.txt\n" if omitted_count > 0 else "")


class _Watch:
    """A listener for the progress of runs. It prints a line for each finished run, or nothing."""

    def __init__(self, total: int, quiet: bool, at_most: bool) -> None:
        self.total, self.quiet, self.count = total, quiet, 0
        self.of = f"of at most {total}" if at_most else f"of {total}"
        self.notes: set[str] = set()

    def frame(self, job: Job, frame: int) -> None:
        """A run has come to a frame."""

    def finished(self, outcome: Outcome) -> None:
        """A run has ended, one way or the other."""
        self.count += 1
        if outcome.measures is None:
            say(f"failed: {outcome.job.name}: {outcome.problem}", err=True)
        elif not self.quiet:
            self.say(f"{self.count} {self.of}: {outcome.job.name}, {outcome.measures['frames']} frames")

    def noted(self, sentence: str) -> None:
        """Print a message about a deviation from the request; once, however many runs send it."""
        if sentence not in self.notes:
            self.notes.add(sentence)
            say(sentence, err=True)

    def say(self, line: str) -> None:
        say(line)


class _Bar(_Watch):
    """One updating line: finished runs, and the frames of those in progress."""

    def __init__(self, total: int, at_most: bool, bar: Any) -> None:
        super().__init__(total, False, at_most)
        self.bar = bar
        self.task = bar.add_task("", total=float(total), words="")
        self.under_way: dict[str, tuple[str, int, float]] = {}

    def frame(self, job: Job, frame: int) -> None:
        first, last = job.frames
        self.under_way[job.key] = (job.name, frame, (frame - first) / max(last - first, 1))
        self._draw()

    def finished(self, outcome: Outcome) -> None:
        self.under_way.pop(outcome.job.key, None)
        super().finished(outcome)
        self._draw()

    def _draw(self) -> None:
        words = " · ".join(f"{name}: {frame}" for name, frame, _ in list(self.under_way.values())[:4])
        self.bar.update(self.task, completed=self.count + sum(share for *_, share in self.under_way.values()), words=words)

    def say(self, line: str) -> None:
        self.bar.console.print(line, highlight=False, markup=False)


@contextmanager
def _progress(total: int, quiet: bool, at_most: bool) -> Iterator[_Watch]:
    from antdsl.cli.printing.progress import fancy

    if quiet or not total or not fancy():
        yield _Watch(total, quiet, at_most)
        return
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    columns = (BarColumn(24), TaskProgressColumn(), TimeRemainingColumn(), TextColumn("{task.fields[words]}"))
    with notes(), Progress(*columns, transient=True) as bar:
        yield _Bar(total, at_most, bar)
