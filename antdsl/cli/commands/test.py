"""`antdsl test PATH…`: runs the specs of programs, each with all its seeds. No display is needed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from antdsl.cli.commands.run import BackendName
from antdsl.cli.destinations import (
    protect_inputs,
    redirect_messages,
    require_writable_file,
    require_writable_folder,
    write_result,
)
from antdsl.cli.exits import CommandError, ExitCode
from antdsl.cli.printing.messages import print_note

if TYPE_CHECKING:
    from antdsl.specs import SpecCase, SpecRun


def run_test_command(
    paths: list[Path] = typer.Argument(..., help="Programs (.ant), scenes (.yaml), or folders to search."),
    name_filter: str = typer.Option("", "-k", metavar="NAME", help="Only specs with this in their name."),
    seeds: int = typer.Option(None, "--seeds", metavar="N", min=1, max=1000, help="Run each spec with seeds 1 to N."),
    junit: Path = typer.Option(None, "--junit", metavar="FILE", help="Write the results as JUnit XML, for build servers."),
    json: Path = typer.Option(None, "--json", metavar="FILE", help="Write the results and the coverage as JSON."),
    keep: Path = typer.Option(
        None, "--keep", metavar="DIR", help="Folder for saved failures. [default: out/failed next to the scene]"
    ),
    no_keep: bool = typer.Option(False, "--no-keep", help="Save no failures."),
    update: bool = typer.Option(False, "--update", help="Store these runs as golden runs, which later runs are compared with."),
    show_coverage: bool = typer.Option(False, "--coverage", help="List all states and transitions with their counts."),
    min_coverage: float = typer.Option(
        None,
        "--fail-under",
        metavar="N",
        min=0,
        max=100,
        help="Fail if runs reached less than N % of the states and transitions.",
    ),
    root: list[str] = typer.Option([], "--root", metavar="NAME=DIR", help="Grant scenes a folder of assets outside their own."),
    threads: int = typer.Option(
        0, "--threads", min=0, max=256, help="Threads for rays, kernels and NumPy's chunks; 0: all available cores."
    ),
    backend: BackendName = typer.Option(
        BackendName.native,
        "--backend",
        help="As in `run`; `reference` is slow but simple: one agent at a time. Does not change verdicts.",
    ),
    quiet: bool = typer.Option(False, "--quiet", "-q", help="Print only failures and their number."),
) -> None:
    """Run the specs of programs and report what failed."""
    from antdsl.cli.arguments import parse_grants
    from antdsl.cli.commands.run import choose_threads
    from antdsl.cli.printing.reports import choose_exit_code, print_report
    from antdsl.files import find_files
    from antdsl.runtime import Options
    from antdsl.specs import RunContext, collect_cases, run_cases
    from antdsl.specs.cases import resolve_verdicts
    from antdsl.specs.failure_cache import FailureSaver
    from antdsl.specs.golden.golden_comparison import GoldenComparison
    from antdsl.specs.golden.golden_runs import find_golden_path
    from antdsl.specs.reports import format_json_report, format_junit_report
    from antdsl.specs.text_report import (
        describe_counts,
        describe_coverage,
        describe_failed_case,
        describe_golden,
        describe_uncovered,
        describe_verdict,
        format_case_line,
    )

    require_writable_file(junit, "--junit")
    require_writable_file(json, "--json")
    require_writable_folder(keep, "--keep")
    with protect_inputs({"--junit": junit, "--json": json}) as inputs:
        runs, report = collect_cases(paths, grants=parse_grants(root), seeds=seeds, name_filter=name_filter)
        inputs += [*find_files(paths)[0], *(find_golden_path(case.scene) for run in runs for case in run.cases)]
    print_report(report, to_stderr=True)
    all_cases = [case for run in runs for case in run.cases]
    if not all_cases and report.ok:
        reason = f"no spec has `{name_filter}` in its name" if name_filter else "no spec was found"
        raise CommandError(ExitCode.USAGE, f"error: {reason}", 'write one in a program: `spec "…" on "scene.yaml" { always: … }`')

    with redirect_messages(junit, json) as output:
        progress = _TestProgress(quiet, len(runs))

        def report_case(case: SpecCase) -> None:
            progress.clear_line()
            if case.failures:
                print_note(describe_failed_case(case))
            elif not quiet:
                print_note(format_case_line(case))

        options = Options(backend=backend.value, threads=choose_threads(threads, quiet))
        failure_saver = None if no_keep else FailureSaver(keep, parse_grants(root), options)
        work = RunContext(
            options, failure_saver=failure_saver, golden_comparison=GoldenComparison(update), report_case=report_case
        )
        coverage, goldens = work.coverage, work.golden_comparison
        assert goldens is not None
        is_stopped = False
        try:
            with _interrupt_between_frames() as check_interrupt:

                def frame(run: SpecRun, number: int, last: int) -> None:
                    check_interrupt()
                    progress.show_frame(run, number, last)

                work.report_frame = frame
                run_cases(runs, work)
                goldens.write_golden_files()
        except KeyboardInterrupt:
            is_stopped = True
            progress.clear_line()
        for note in work.messages:
            print_note(note, to_stderr=True)
        print_report(goldens.report, to_stderr=True)
        report.extend(goldens.report)
        verdicts = resolve_verdicts(all_cases)
        lines = [describe_verdict(verdict) for verdict in verdicts]
        lines += [describe_golden(result) for result in goldens.results if not quiet or result.outcome == "differs"]
        lines.append(describe_counts(all_cases, len(report.errors), goldens.results))
        lines += [] if quiet else [describe_coverage(coverage)] * show_coverage + [describe_uncovered(coverage)]
        low = min_coverage is not None and not is_stopped and coverage.covered_share * 100 < min_coverage
        lines += (
            [f"{coverage.covered_share * 100:.4g} % of states and transitions were reached, less than {min_coverage:g} %"]
            if low
            else []
        )
        print_note("\n".join(line for line in lines if line))
        write_result(junit, format_junit_report(all_cases, report, goldens.results).encode(), output)
        write_result(json, format_json_report(all_cases, coverage, report, goldens.results).encode(), output)
    if is_stopped:
        raise CommandError(ExitCode.INTERRUPTED, "stopped by Ctrl-C; the specs above were finished")
    differ = any(result.outcome == "differs" for result in goldens.results)
    if low or differ or any(case.outcome == "failed" for case in all_cases):
        raise CommandError(ExitCode.FINDINGS)
    if not report.ok:
        raise CommandError(choose_exit_code(report))


@contextmanager
def _interrupt_between_frames() -> Iterator[Callable[[], None]]:
    """Yield a function to call between frames. It raises KeyboardInterrupt if the user has pressed Ctrl-C.

    If Ctrl-C raised immediately, a library could swallow the exception. A second Ctrl-C does raise immediately."""
    import signal

    interrupts: list[int] = []

    def note_interrupt(number: int, frame: object) -> None:
        if interrupts:
            raise KeyboardInterrupt
        interrupts.append(number)

    def check_interrupt() -> None:
        if interrupts:
            raise KeyboardInterrupt

    previous_handler = signal.signal(signal.SIGINT, note_interrupt)
    try:
        yield check_interrupt
    finally:
        signal.signal(signal.SIGINT, previous_handler)


class _TestProgress:
    """A display of the current run and its frame. Without a terminal, it shows nothing."""

    def __init__(self, quiet: bool, runs: int) -> None:
        import sys

        self.stream = sys.stderr if sys.stderr.isatty() and not quiet else None
        self.run_count = runs
        self.started_run_ids: set[int] = set()
        self.last_drawn_seconds = 0.0

    def show_frame(self, run: SpecRun, frame: int, last: int) -> None:
        """Display that a run has reached a frame. `last`: the last frame of the run."""
        from time import monotonic

        self.started_run_ids.add(id(run))
        if self.stream is not None and monotonic() - self.last_drawn_seconds > 0.2:
            self.last_drawn_seconds = monotonic()
            name = run.cases[0].name if len(run.cases) == 1 else f"{len(run.cases)} specs"
            words = f"run {len(self.started_run_ids)} of {self.run_count}: {name}, seed {run.seed}, frame {frame} of {last}"
            self.stream.write(f"\r{words[:100]:<100}")
            self.stream.flush()

    def clear_line(self) -> None:
        """Clear the progress line."""
        if self.stream is not None:
            self.stream.write("\r" + " " * 100 + "\r")
            self.stream.flush()
