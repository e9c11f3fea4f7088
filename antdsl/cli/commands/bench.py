"""`antdsl bench`: measures the duration of steps, phase by phase, and compares backends."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from antdsl.cli.destinations import protect_inputs, redirect_messages, require_writable_file, write_result
from antdsl.cli.exits import CommandError, ExitCode
from antdsl.cli.printing.messages import print_result

if TYPE_CHECKING:
    from antdsl.bench.costs import BenchJob, Measurement
    from antdsl.bench.tables import BenchCaseResult

SLOWEST_BACKEND = "reference"  # skipped unless named: it runs one agent at a time


def run_bench_command(
    cases: list[str] = typer.Argument(None, metavar="[CASE…]", help="Cases of --list, or scenes. [default: a quick selection]"),
    agents: list[int] = typer.Option([], "--agents", metavar="N", min=1, help="Number of agents; may be given several times."),
    backend: list[str] = typer.Option([], "--backend", metavar="NAME", help="Backend; several backends also show ratios."),
    pairs: int = typer.Option(20, "--pairs", min=1, max=10_000, help="Rounds per case; at least 20 give an interval."),
    steps: int = typer.Option(0, "--steps", min=0, max=100_000, help="Steps per turn; 0: enough for 20 ms."),
    threads: int = typer.Option(1, "--threads", min=1, max=256, help="Threads for rays, kernels and NumPy's chunks."),
    steps_only: bool = typer.Option(False, "--steps-only", help="Measure bare steps without full runs."),
    json_: Path = typer.Option(None, "--json", metavar="FILE", help="Write all measurements as JSON; `-` prints them."),
    list_: bool = typer.Option(False, "--list", help="List the cases and stop."),
) -> None:
    """Measure what steps cost: CPU and wall time, memory, set-up."""
    from antdsl.bench import BENCH_CASES

    if list_:
        for case in BENCH_CASES.values():
            sizes = ", ".join(f"{number:,}" for number in case.agents) or "as it is"
            print_result(f"{case.name:<18}{case.description}: {sizes}")
        return
    require_writable_file(json_, "--json")
    with protect_inputs({"--json": json_}) as inputs:
        inputs += [Path(name) for name in cases or [] if name not in BENCH_CASES]
    names = _choose_backends(backend)
    from antdsl.cli.commands.run import choose_threads

    threads = choose_threads(threads)
    jobs = _choose_jobs(cases or [], agents)
    for name in dict.fromkeys(name for name, _ in jobs):
        _require_openable(name)
    with redirect_messages(json_) as output:
        results = []
        for name, count in jobs:
            results.append(_measure_case(name, count, names, pairs, steps, threads, not steps_only))
            _print_result(results[-1])
        if json_ is not None:
            import json

            from antdsl.bench.tables import make_json_document

            write_result(json_, (json.dumps(make_json_document(results), indent=1) + "\n").encode(), output)


def _choose_backends(names: list[str]) -> list[str]:
    """Return the requested backends without duplicates; by default all backends except the slowest. Raises BadParameter for an
    unknown name."""
    from antdsl.runtime.backends import BACKENDS

    for name in names:
        if name not in BACKENDS:
            raise typer.BadParameter(f"unknown backend `{name}`; backends: {', '.join(BACKENDS)}", param_hint="--backend")
    return list(dict.fromkeys(names)) or [name for name in BACKENDS if name != SLOWEST_BACKEND]


def _choose_jobs(cases: list[str], agents: list[int]) -> list[tuple[str, int | None]]:
    """Return pairs of a case and a number of agents to measure. The numbers are those requested, else the case's own, else None.
    Without requested cases, return a quick selection."""
    from antdsl.bench import BENCH_CASES

    if not cases:
        quick = [(case.name, agents or list(case.quick_agent_counts)) for case in BENCH_CASES.values() if case.quick_agent_counts]
        return [(name, count) for name, counts in quick for count in counts]
    jobs: list[tuple[str, int | None]] = []
    for name in cases:
        case = BENCH_CASES.get(name)
        if case is None and not Path(name).is_file():
            raise typer.BadParameter(f"`{name}` is neither a case nor a file; cases: {', '.join(BENCH_CASES)}", param_hint="CASE")
        if Path(name).suffix == ".ant":
            raise typer.BadParameter(f"`{name}` is a program; name a scene that uses it", param_hint="CASE")
        jobs += [(name, count) for count in agents or (case.agents if case is not None else ()) or (None,)]
    return jobs


def _require_openable(name: str) -> None:
    """Report the errors of a scene before any measurement starts."""
    from antdsl.bench import BENCH_CASES
    from antdsl.cli.printing.reports import exit_on_errors
    from antdsl.pipeline import open_scene

    if name not in BENCH_CASES:
        exit_on_errors(open_scene(Path(name))[1])


def _measure_case(
    name: str, agents: int | None, backends: list[str], turns: int, steps: int, threads: int, full_run: bool
) -> BenchCaseResult:
    """Return the measurements of a case. Each backend runs in a separate process, then all run alternately in one process."""
    from antdsl.bench import BenchJob
    from antdsl.bench.tables import BenchCaseResult

    separate_results = [_measure_job(BenchJob(name, agents, (each,), turns, steps, threads, full_run)) for each in backends]
    joint_result = _measure_job(BenchJob(name, agents, tuple(backends), turns, steps, threads)) if len(backends) > 1 else None
    return BenchCaseResult(tuple(separate_results), joint_result)


def _measure_job(job: BenchJob) -> Measurement:
    from antdsl.bench.costs import MeasuringError, measure_in_process

    try:
        return measure_in_process(job)
    except MeasuringError as error:
        raise CommandError(ExitCode.FINDINGS, f"error: {job.case}: {error}") from None


def _print_result(result: BenchCaseResult) -> None:
    from antdsl.cli.printing.bench_tables import print_case_result

    print_case_result(result)
