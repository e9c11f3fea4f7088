"""Measures what `docs/benchmarks.md` and the pages below it report, and writes their tables, with a row for each backend.

`python tests/benchmarks/page.py` measures all, which takes a quarter of an hour and 6 GiB; with names of cases, those only, and
the others stay as they were measured before (`page.json`). `--agents N` with them takes one size. `--peers FILE` takes what
`peers.py --json FILE` has measured. `--write` measures nothing."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from statistics import mean
from typing import Any

import peers
from beside_bound import BOUND, measure_beside_bound
from counts import counts_of
from page_tables import markdown_table
from pydantic import TypeAdapter

from antdsl.bench import BENCH_CASES, BenchJob, measure_in_process
from antdsl.bench.tables import (
    SET_UP_COLUMNS,
    BenchCaseResult,
    build_phase_table,
    compare_backends,
    find_measured_backend,
    format_full_run,
    format_ratios,
    format_set_up,
    list_messages,
    make_json_document,
)
from antdsl.runtime.backends import BACKENDS

_DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGES = tuple(_DOCS / f"{name}.md" for name in ("benchmarks", "benchmarks_tables", "benchmarks_compared"))
RESULTS_FILE = Path(__file__).with_suffix(".json")
SLOWEST = "reference"  # measured where few agents make few steps
BESIDE_SLOWEST = {("foraging", 125), ("node", 500)}
COMPARED_CASES = ("node", "valley", "valley_of_meshes")
BOUND_CASES = ("foraging",)  # the hand-written frame does the work of these
MOST_COUNTED = 15_000  # agents of a crowd up to which operations are counted
PHASED = ("foraging", "boids", "tunnel", "anthill")
Measurements = dict[str, dict[str, Any]]


def measure(name: str, agents: int | None) -> dict[str, Any]:
    """All of a case with so many agents, as JSON, with the machine. Leaves where a backend has run something else."""
    big = agents is not None and agents >= 1_000_000
    fast = [backend for backend in BACKENDS if backend != SLOWEST]
    slow = [SLOWEST] if (name, agents) in BESIDE_SLOWEST else []
    turns, steps = (3, 1) if big else (20, 0)
    measure_alone = measure_beside_bound if name in BOUND_CASES else measure_in_process
    alone = [measure_alone(BenchJob(name, agents, (each,), turns, steps, 1, full_run=not big)) for each in fast]
    alone += [measure_alone(BenchJob(name, agents, (each,), 3, 1, 1)) for each in slow]
    together = measure_in_process(BenchJob(name, agents, tuple(fast), turns, steps)) if len(fast) > 1 else None
    result = BenchCaseResult(tuple(alone), together)
    if lines := list_messages(result):
        raise SystemExit("\n".join(lines))
    is_small = agents is None or agents <= MOST_COUNTED
    return make_json_document([result]) | {"operations": count_operations(name, agents) if is_small else None}


def count_operations(name: str, agents: int | None) -> int:
    """The operations of compiled blocks in a step, one for each row."""
    shot = BENCH_CASES[name].make_shot(agents)
    return counts_of(shot.plan, shot.setting)["elements"]


def results(measurements: Measurements) -> list[BenchCaseResult]:
    """In the order of the cases and their sizes."""
    order = list(BENCH_CASES)
    all_results = [result_of(each) for each in measurements.values()]
    return sorted(all_results, key=lambda each: (order.index(each.alone[0].job.case), each.alone[0].agents))


def result_of(measurement: dict[str, Any]) -> BenchCaseResult:
    """The result that `measure` has written."""
    (result,) = measurement["results"]
    return TypeAdapter(BenchCaseResult).validate_python(result)


def steps_table(all_results: Iterable[BenchCaseResult]) -> str:
    """The whole step."""
    columns = ("case", "agents", "backend", "CPU ms", "wall ms", "frames per second", "µs per agent", "of the bound")
    rows = []
    for result in all_results:
        for each in result.alone:
            name = find_measured_backend(each)
            cost = each.costs[name]
            rows.append([
                each.job.case,
                f"{each.agents:,}",
                name,
                f"{cost.cpu_ms:.1f}",
                f"{cost.wall_ms:.1f}",
                f"{1000 / cost.wall_ms:.3g}",
                f"{1000 * cost.cpu_ms / each.agents:.2f}",
                format_ratios(each.compute_ratios(name, BOUND)) if BOUND in each.costs else "",
            ])  # fmt: skip
    return markdown_table(columns, rows)


def runs_table(all_results: Iterable[BenchCaseResult]) -> str:
    """Full runs, and the bare step beside them."""
    columns = ("case", "agents", "backend", "CPU ms", "wall ms", "frames per second", "its step", "its feet", "bare step, CPU ms")
    rows = []
    for result in all_results:
        for each in result.alone:
            if each.full_run is not None:
                name = find_measured_backend(each)
                rows.append([each.job.case, f"{each.agents:,}", name, *format_full_run(each), f"{each.costs[name].cpu_ms:.2f}"])
    return markdown_table(columns, rows)


def set_up_table(all_results: Iterable[BenchCaseResult]) -> str:
    """Set-up and memory."""
    columns = ("case", "agents", "backend", *SET_UP_COLUMNS, "bytes per agent", "grew by, MiB")
    rows = []
    for result in all_results:
        for each in result.alone:
            rows.append([
                each.job.case,
                f"{each.agents:,}",
                find_measured_backend(each),
                *format_set_up(each),
                f"{each.state / each.agents:,.0f}",
                f"{each.memory / 2**20:,.0f}",
            ])  # fmt: skip
    return markdown_table(columns, rows)


def phase_tables(all_results: Iterable[BenchCaseResult]) -> str:
    """Phases, a table a case and size; phases under a hundredth of the step are left out."""
    parts = []
    for result in all_results:
        if result.alone[0].job.case in PHASED:
            columns, rows = build_phase_table(result)
            total = sum(float(row[1]) for row in rows)
            display_rows = [row for row in rows if float(row[1]) >= 0.01 * total]
            parts.append(
                f"{result.alone[0].job.case}, {result.alone[0].agents:,} agents:\n\n{markdown_table(columns, display_rows)}"
            )
    return "\n".join(parts)


def comparison_table(all_results: Iterable[BenchCaseResult]) -> str:
    """Beside what others have reported."""
    rows = []
    for result in all_results:
        for each in result.alone:
            if each.job.case in COMPARED_CASES:
                cost = each.costs[find_measured_backend(each)]
                rows.append([
                    BENCH_CASES[each.job.case].description,
                    f"{each.agents:,}",
                    find_measured_backend(each),
                    f"{1000 / (1000 * mean(cost.wall)):.3g}",
                    format_full_run(each)[2],
                    BENCH_CASES[each.job.case].published_figures,
                ])  # fmt: skip
    return markdown_table(("case", "agents", "backend", "frames per second", "of a full run", "reported"), rows)


def operations_table(all_results: Iterable[BenchCaseResult], operations: Mapping[tuple[str, int], int]) -> str:
    """Operations per agent. `operations`: of a step, by case and number of agents."""
    rows = []
    for result in all_results:
        each = result.alone[0]
        if (count := operations.get((each.job.case, each.agents))) is not None:
            rows.append([each.job.case, f"{each.agents:,}", f"{each.nodes:,}", f"{count / each.agents:,.0f}"])
    return markdown_table(("case", "agents", "nodes of the plan", "operations per agent and step"), rows)


def beside_table(all_results: Iterable[BenchCaseResult]) -> str:
    """Ratios of backends that took turns in one process."""
    lines = [
        f"- {one.alone[0].job.case}, {one.alone[0].agents:,} agents: {line}"
        for one in all_results
        for line in compare_backends(one)
    ]
    return "\n".join(lines) + "\n" if lines else "Only one backend was measured.\n"


def machines(measurements: Measurements) -> str:
    """What was measured on."""
    lines = []
    for each in measurements.values():
        words = ", ".join(
            text if name in ("date", "machine", "system") else f"{name} {text}" for name, text in each["machine"].items()
        )
        lines += [f"- {words}"] if f"- {words}" not in lines else []
    return "\n".join(sorted(lines)) + "\n"


def put(text: str, name: str, table: str) -> str:
    """The text with a table between the marks of its name; the same text if it has no such marks."""
    first, last = f"<!-- {name} -->\n", f"<!-- end of {name} -->"
    if first not in text:
        return text
    start, end = text.index(first) + len(first), text.index(last)
    return text[:start] + "\n" + table + "\n" + text[end:]


def write(measurements: Measurements) -> None:
    """Put each table into the page that has its marks. Raises ValueError if not exactly one page has them."""
    measured_cases = {name: each for name, each in measurements.items() if name != "peers"}
    all_results = results(measured_cases)
    operations = {}
    for each in measured_cases.values():
        if each["operations"] is not None:
            first = result_of(each).alone[0]
            operations[first.job.case, first.agents] = each["operations"]
    texts = {page: page.read_text(encoding="utf-8") for page in PAGES}
    tables = {
        "machine": machines(measurements),
        "runs": runs_table(all_results),
        "steps": steps_table(all_results),
        "backends": beside_table(all_results),
        "set-up": set_up_table(all_results),
        "phases": phase_tables(all_results),
        "reported": comparison_table(all_results),
        "operations": operations_table(all_results, operations),
    }
    if "peers" in measurements:
        tables["peers"] = markdown_table(peers.COLUMNS, measurements["peers"]["rows"])
    for name, table in tables.items():
        if sum(f"<!-- {name} -->\n" in text for text in texts.values()) != 1:
            raise ValueError(f"not exactly one page has the marks of the table {name!r}")
        texts = {page: put(text, name, table) for page, text in texts.items()}
    for page, text in texts.items():
        page.write_text(text, encoding="utf-8")


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", help="names of cases")
    parser.add_argument("--agents", type=int, default=None)
    parser.add_argument("--peers", type=Path, default=None)
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    measurements: Measurements = json.loads(RESULTS_FILE.read_text(encoding="utf-8")) if RESULTS_FILE.is_file() else {}
    names = [] if options.write else options.cases or ([] if options.peers else list(BENCH_CASES))
    for name in names:
        for agents in BENCH_CASES[name].agents or (None,):
            if options.agents in (None, agents):
                measurements[f"{name} {agents}"] = measure(name, agents)
                print(name, agents, flush=True)
                RESULTS_FILE.write_text(json.dumps(measurements) + "\n", encoding="utf-8")
    if options.peers is not None:
        measurements["peers"] = json.loads(options.peers.read_text(encoding="utf-8"))
        RESULTS_FILE.write_text(json.dumps(measurements) + "\n", encoding="utf-8")
    write(measurements)


if __name__ == "__main__":
    main()
