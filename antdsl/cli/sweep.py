"""`antdsl sweep SCENE…`: many runs, with other values and seeds, on local processes; a table at the end."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from antdsl.cli.destinations import folder_to_write, keeping_inputs
from antdsl.cli.exits import Exit, Stop
from antdsl.cli.printing.messages import say

if TYPE_CHECKING:
    from antdsl.sweep import Job, Keeper, Outcome
    from antdsl.sweep.table import Result

RESULTS = ("table.txt", "table.csv", "runs.csv", "sweep.json", "table.png")


def sweep(
    scenes: list[Path] = typer.Argument(..., metavar="SCENE…", help="Scenes; each is a line of the table."),
    vary: list[str] = typer.Option(
        [], "--vary", metavar="NAME=A,B,C", help="Values of a param: forager.smell=30mm,50mm. Several make all combinations."
    ),
    seeds: str = typer.Option("5", "--seeds", metavar="N", help="Run each with the seeds 1 to N, or with A..B."),
    jobs: int = typer.Option(0, "--jobs", min=0, max=256, help="Runs at a time; 0 takes all cores. Changes no result."),
    out: Path = typer.Option(
        None, "--out", metavar="DIR", help="Where the table goes. [default: out/sweep beside the first scene]", show_default=False
    ),
    frames: str = typer.Option(None, "--frames", metavar="A..B", help="Other frames than the scenes'."),
    until: list[str] = typer.Option(
        [], "--until-empty", metavar="NAME", help="End a run once this is all gone: food.load, food.apple.load."
    ),
    show: list[str] = typer.Option([], "--show", metavar="NAME", help="Measures of the table, by the beginning of their name."),
    root: list[str] = typer.Option([], "--root", metavar="NAME=DIR", help="Grant scenes a folder of assets outside their own."),
    again: bool = typer.Option(False, "--again", help="Run everything again, also what was finished before."),
    plots: bool = typer.Option(True, "--plots/--no-plots", help="Draw the table too, where matplotlib is installed."),
    quiet: bool = typer.Option(False, "--quiet", "-q", help="Print the table and problems only."),
) -> None:
    """Run scenes with other values and seeds, and tell medians and quartiles."""
    from antdsl.cli.arguments import frame_range, grants
    from antdsl.cli.printing.reports import demand
    from antdsl.cli.run import cores
    from antdsl.executors import Processes
    from antdsl.sweep import Keeper, run_all, variations
    from antdsl.sweep import jobs as all_jobs
    from antdsl.sweep.finished_runs import OtherFiles

    for scene in scenes:
        if scene.suffix == ".ant":
            raise typer.BadParameter(f"`{scene}` is a program; name scenes that use it", param_hint="SCENE")
    folder = out if out is not None else scenes[0].resolve().parent / "out" / "sweep"
    if scenes[0].is_file():  # else there is no folder beside it to ask
        folder_to_write(folder, "--out", *RESULTS)
    chosen = variations(dict.fromkeys(scenes), _varied(vary))
    numbers = _seeds(seeds)
    with keeping_inputs({}, {"--out": (folder, (*RESULTS, "runs"))}) as inputs:
        inputs += scenes
        made, report = all_jobs(chosen, numbers, frames=frame_range(frames), until=tuple(until), grants=grants(root))
    demand(report)
    try:
        keeper = Keeper(folder)
    except OtherFiles as why:
        raise Stop(Exit.INPUT_OUTPUT, f"error: {why}", "name another folder with `--out`") from None

    done: dict[str, Any] = {}
    if not again:
        done = {job.key: kept for job in made if (kept := keeper.kept(job)) is not None}
    todo = [job for job in made if job.key not in done]
    if done and not quiet:
        say(f"{len(made) - len(todo)} of {len(made)} runs were finished before")
    processes = min(jobs or cores(), max(len(todo), 1))
    threads = max(1, cores() // processes)
    failed: list[Outcome] = []
    try:
        with _stoppable(), _progress(len(todo), quiet) as watch:
            for outcome in run_all(todo, Processes(processes, threads), watch.frame, watch.noted):
                watch.finished(outcome)
                if outcome.measures is None:
                    failed.append(outcome)
                else:
                    keeper.keep(outcome.job, outcome.measures)
                    done[outcome.job.key] = outcome.measures
    except KeyboardInterrupt:
        _tell(keeper, [(job, done[job.key]) for job in made if job.key in done], show, plots=False)
        words = f"stopped: {len(done)} of {len(made)} runs are finished and kept"
        raise Stop(Exit.INTERRUPTED, words, "the same command goes on with the others") from None
    _tell(keeper, [(job, done[job.key]) for job in made if job.key in done], show, plots)
    if failed:
        raise Stop(Exit.FINDINGS, f"error: {len(failed)} of {len(made)} runs failed and are not in the table")


@contextmanager
def _stoppable() -> Iterator[None]:
    """Being asked to end (SIGTERM) is as good as Ctrl-C."""
    import signal

    def stop(number: int, frame: object) -> None:
        raise KeyboardInterrupt

    before = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _varied(words: Sequence[str]) -> dict[str, tuple[str, ...]]:
    from antdsl.cli.arguments import pairs

    found = {}
    for name, values in pairs(words, "--vary").items():
        parts = tuple(part.strip() for part in values.split(","))
        if not all(parts) or len(set(parts)) < len(parts):
            raise typer.BadParameter(f"write values with commas between them, each once: `{name}=1,2,3`", param_hint="--vary")
        found[name] = parts
    return found


def _seeds(text: str) -> range:
    import re

    found = re.fullmatch(r"([0-9]{1,6})(?:\.\.([0-9]{1,6}))?", text.strip())
    first, last = (1, int(found[1])) if found and found[2] is None else (int(found[1]), int(found[2])) if found else (1, 0)
    if not found or last < first:
        raise typer.BadParameter(f"`{text}` is no number of seeds: write N, or A..B", param_hint="--seeds")
    return range(first, last + 1)


def _tell(keeper: Keeper, results: list[Result], show: Sequence[str], plots: bool) -> None:
    """Write the table in all its forms, and print it."""
    from antdsl.outputs.cache.npz import write_whole
    from antdsl.sweep import rows
    from antdsl.sweep.plots import HOW, available, draw
    from antdsl.sweep.table import as_csv, as_json, runs_csv, shown, text

    if not results:
        return
    table = rows(results)
    measures = shown(table, show)
    if show and not measures:
        known = ", ".join(dict.fromkeys(row.measure.split(".")[0] for row in table))
        raise Stop(Exit.USAGE, f"error: no measure begins with `{show[0]}`", f"there are: {known}")
    words = text(table, measures)
    files = {"table.txt": words, "table.csv": as_csv(table), "runs.csv": runs_csv(results), "sweep.json": as_json(results, table)}
    for name, content in files.items():
        write_whole(keeper.folder / name, content.encode(), sync=False)
    say(words.rstrip("\n"))
    drawn = plots and available() and len(measures) <= 24
    if drawn:
        draw(results, measures, keeper.folder / "table.png")
    names = ", ".join([*files, *(["table.png"] if drawn else [])])
    say(f"in {keeper.folder}: {names}")
    if plots and not available():
        say(HOW)


class _Watch:
    """Told how far runs are; prints a line for each that is finished, or nothing."""

    def __init__(self, total: int, quiet: bool) -> None:
        self.total, self.quiet, self.count = total, quiet, 0
        self.notes: set[str] = set()

    def frame(self, job: Job, frame: int) -> None:
        """A run has come to a frame."""

    def finished(self, outcome: Outcome) -> None:
        """A run has ended, one way or the other."""
        self.count += 1
        if outcome.measures is None:
            say(f"failed: {outcome.job.name}: {outcome.problem}", err=True)
        elif not self.quiet:
            self.say(f"{self.count} of {self.total}: {outcome.job.name}, {outcome.measures['frames']} frames")

    def noted(self, sentence: str) -> None:
        """Something was otherwise than asked: told once, however many runs say it."""
        if sentence not in self.notes:
            self.notes.add(sentence)
            say(sentence, err=True)

    def say(self, line: str) -> None:
        say(line)


class _Bar(_Watch):
    """One line that moves: runs that are finished, and the frames of those under way."""

    def __init__(self, total: int, bar: Any) -> None:
        super().__init__(total, False)
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
def _progress(total: int, quiet: bool) -> Iterator[_Watch]:
    from antdsl.cli.printing.progress import fancy

    if quiet or not total or not fancy():
        yield _Watch(total, quiet)
        return
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    columns = (BarColumn(24), TaskProgressColumn(), TimeRemainingColumn(), TextColumn("{task.fields[words]}"))
    with Progress(*columns, transient=True) as bar:
        yield _Bar(total, bar)
