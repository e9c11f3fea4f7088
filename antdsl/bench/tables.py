"""Measurements as table rows for the terminal, and as plain values for JSON."""

from __future__ import annotations

import datetime
import os
import platform
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from statistics import mean
from typing import Any

from antdsl import __version__
from antdsl.bench.cases import BENCH_CASES
from antdsl.bench.costs import Measurement
from antdsl.bench.ratios import MIN_PAIRS, compute_bootstrap_interval
from antdsl.numerics.processor.host import read_processor_name

REPORTED_PACKAGES = ("numpy", "scipy", "llvmlite", "open3d", "open3d-cpu")


@dataclass(frozen=True, slots=True)
class BenchCaseResult:
    """The measurements of a case with one number of agents.

    `alone`: one measurement per backend, each made in a separate process.
    `together`: the measurement of one process in which all backends alternated; None if there is only one backend."""

    alone: tuple[Measurement, ...]
    together: Measurement | None = None


def format_ratios(ratios: Sequence[float]) -> str:
    """Return the mean of ratios as text, with its interval if there are enough turns."""
    return str(compute_bootstrap_interval(ratios)) if len(ratios) >= MIN_PAIRS else f"{mean(ratios):.2f} ({len(ratios)} turns)"


def find_measured_backend(measured: Measurement) -> str:
    """Return the name of the first backend in a measurement."""
    return measured.job.backends[0]


SET_UP_COLUMNS = ("start", "compile", "bind", "first step", "code", "code cached", "second step")
STEP_COLUMNS = (
    "backend", "run, CPU ms", "run, wall ms", "run, frames/s", "step in run, CPU ms", "feet in run, CPU ms",
    "bare step, CPU ms", "wall ms", "frames/s", "µs per agent",
    "bytes per agent", "grew by, MiB", *(f"{name}, CPU s" for name in SET_UP_COLUMNS),
)  # fmt: skip


def format_set_up(measurement: Measurement) -> list[str]:
    """Return the times of a set-up as texts, in the order of SET_UP_COLUMNS. The text of a missing value is ""."""
    one = measurement.set_up
    seconds = (one.start, one.compile, one.bind, one.first, one.code, one.kept, one.second)
    return ["" if each is None else f"{each:.2f}" if each >= 0.1 else f"{each:.4f}" for each in seconds]


def format_full_run(measurement: Measurement) -> list[str]:
    """Return the costs of a full run as five texts.

    They are CPU ms, elapsed ms and frames per second of the run, then CPU ms of its steps and of its feet. All are "" if no run
    was measured."""
    run = measurement.full_run
    if run is None:
        return [""] * 5
    ms = [f"{1000 * each:.2f}" for each in (run.cpu, run.wall, run.step, run.feet)]
    return [*ms[:2], f"{1 / max(run.wall, 1e-9):.1f}", *ms[2:]]


def build_step_rows(result: BenchCaseResult) -> list[list[str]]:
    """Return the rows of the table of steps: one per backend, with the columns STEP_COLUMNS. The column of bytes has the size of
    all stored values of agents; `grew by` is the growth of the process."""
    rows = []
    for measurement in result.alone:
        name = find_measured_backend(measurement)
        cost = measurement.costs[name]
        rows.append(
            [
                name,
                *format_full_run(measurement),
                f"{cost.cpu_ms:.2f}",
                f"{cost.wall_ms:.2f}",
                f"{1000 / max(cost.wall_ms, 1e-9):.1f}",
                f"{1000 * cost.cpu_ms / max(measurement.agents, 1):.2f}",
                f"{measurement.state / max(measurement.agents, 1):,.0f}",
                f"{measurement.memory / 2**20:,.0f}",
                *format_set_up(measurement),
            ]
        )
    return rows


def build_phase_table(result: BenchCaseResult) -> tuple[list[str], list[list[str]]]:
    """Return the column names and the rows of the table of phases, in CPU and elapsed milliseconds. Rows are sorted by the cost
    of the first backend, highest first."""
    columns = ["phase"]
    for measurement in result.alone:
        columns += [f"{find_measured_backend(measurement)}: CPU ms", "wall ms"]
    first = result.alone[0].costs[find_measured_backend(result.alone[0])]
    rows = []
    for phase in sorted(first.phases_cpu, key=lambda phase_name: -first.phases_cpu[phase_name]):
        row = [phase]
        for measurement in result.alone:
            cost = measurement.costs[find_measured_backend(measurement)]
            row += [f"{1000 * each.get(phase, 0.0):.3f}" for each in (cost.phases_cpu, cost.phases_wall)]
        rows.append(row)
    return columns, rows


def compare_backends(result: BenchCaseResult) -> list[str]:
    """Return one line for each further backend, with its ratio to the first. Both were measured alternately in one process."""
    if result.together is None:
        return []
    first, *others = result.together.job.backends
    return [
        f"{name}: {format_ratios(result.together.compute_ratios(name, first))} of the CPU time of {first}, in turn in one process"
        for name in others
    ]


def list_messages(result: BenchCaseResult) -> list[str]:
    """Return the messages about deviations from the request, each line once."""
    measured = [*result.alone, *([] if result.together is None else [result.together])]
    return list(dict.fromkeys(line for each in measured for line in each.told))


def describe_result(result: BenchCaseResult) -> str:
    """Return one line that describes a case: its number of agents, neighbours and nodes, and published figures."""
    measurement = result.alone[0]
    case = BENCH_CASES.get(measurement.job.case)
    words = [f"{measurement.job.case}, {measurement.agents:,} {'agent' if measurement.agents == 1 else 'agents'}"]
    words += [case.description] if case is not None else []
    words += [f"{measurement.neighbours:.1f} neighbours each"] if measurement.neighbours is not None else []
    words.append(f"{measurement.nodes:,} nodes of the plan")
    words += [case.published_figures] if case is not None and case.published_figures else []
    return "; ".join(words)


def make_json_document(results: Sequence[BenchCaseResult]) -> dict[str, Any]:
    """Return all measurements, and the ratios that tables display, as values for JSON."""
    return {"machine": describe_machine(), "results": [asdict(result) for result in results]}


def describe_machine() -> dict[str, str]:
    """Return the date, machine, system and versions, by name."""
    details = {
        "date": datetime.date.today().isoformat(),
        "machine": f"{read_processor_name()}, {os.cpu_count()} cores",
        "system": f"{platform.system()} {platform.machine()}",
        "antdsl": __version__,
        "python": platform.python_version(),
    }
    for name in REPORTED_PACKAGES:
        try:
            details[name] = version(name)
        except PackageNotFoundError:
            continue
    return details
