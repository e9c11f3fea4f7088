"""The table of a sweep as text, CSV and JSON. It has the median and quartiles over seeds, for each variation and measure."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from antdsl.outputs.csv_text import format_csv
from antdsl.sweeps.finished_runs import describe_job
from antdsl.sweeps.jobs import SweepJob
from antdsl.sweeps.series import collect_series, without_series

if TYPE_CHECKING:
    from antdsl.sweeps.sensitivity import FactorEffect
    from antdsl.sweeps.stopping import MedianEstimate

RunResult = tuple[SweepJob, Mapping[str, Any]]
_DECLARED_PREFIX = "measures."  # of the measures of the program
MACHINE_DEPENDENT_MEASURES = ("seconds", "fps")  # they depend on the machine


@dataclass(frozen=True, slots=True)
class MeasureStatistics:
    """The statistics of one measure over the runs of one variation. The field names are the columns of written files.

    `runs`: the number of runs. `happened`: the number of runs in which the measured event happened. In the other runs, the value
    is infinite, so quantiles may be infinite too. `least`, `most`: the smallest and the largest value."""

    label: str
    measure: str
    runs: int
    happened: int
    median: float
    lower_quartile: float
    upper_quartile: float
    least: float
    most: float


def compute_quantile(values: Sequence[float], share: float) -> float:
    """Return a quantile of sorted values by linear interpolation. `share`: the position of the quantile, 0 to 1.

    The result is infinite if a value next to this position is infinite."""
    place = share * (len(values) - 1)
    low, high = math.floor(place), math.ceil(place)
    if low == high or values[low] == values[high]:
        return values[low]
    return math.inf if math.isinf(values[high]) else values[low] + (place - low) * (values[high] - values[low])


def build_rows(results: Iterable[RunResult]) -> list[MeasureStatistics]:
    """Return one row for each variation and numeric measure, in the order in which runs report the measures."""
    values_by_key: dict[tuple[str, str], list[float]] = {}
    counts: dict[str, int] = {}
    for job, measures in results:
        counts[job.label] = counts.get(job.label, 0) + 1
        for name, value in measures.items():
            if name not in MACHINE_DEPENDENT_MEASURES and (value is None or isinstance(value, int | float)):
                values_by_key.setdefault((job.label, name), []).append(math.inf if value is None else float(value))
    return [_make_row(label, name, values, counts[label]) for (label, name), values in values_by_key.items()]


def _make_row(label: str, name: str, values: list[float], runs: int) -> MeasureStatistics:
    """Return the table row for one measure of one variation. A run may not report the measure, for example because no agent took
    a certain transition. Its value then counts as 0."""
    # a missing count, such as that of a transition that never occurred, is 0
    values = sorted(values + [0.0] * (runs - len(values)))
    median, lower, upper = (compute_quantile(values, share) for share in (0.5, 0.25, 0.75))
    return MeasureStatistics(label, name, runs, sum(map(math.isfinite, values)), median, lower, upper, values[0], values[-1])


def choose_measures(table: Sequence[MeasureStatistics], prefixes: Sequence[str]) -> list[str]:
    """Return the measures to display: those with names that begin with one of `prefixes`.

    Without prefixes, they are the measures that the program declares. If it declares none, they are the frames at which amounts
    ran out, or else the motion measures."""
    names = list(dict.fromkeys(row.measure for row in table))
    if not prefixes:
        declared = [name for name in names if name.startswith(_DECLARED_PREFIX)]
        empty = [row.measure for row in table if row.measure.startswith("empty.") and row.happened]
        prefixes = tuple(dict.fromkeys(declared or empty)) or ("motion.",)
    return [name for name in names if any(name.startswith(start) for start in prefixes)]


def format_table(table: Sequence[MeasureStatistics], measures: Sequence[str]) -> str:
    """Return a text with one line per variation and one column per measure: median (lower quartile – upper quartile)."""
    rows_by_key = {(row.label, row.measure): row for row in table}
    labels = list(dict.fromkeys(row.label for row in table))
    lines = [["", "runs", *map(_make_heading, measures)]]
    for label in labels:
        runs = next(row.runs for row in table if row.label == label)
        lines.append([label, str(runs), *(_format_cell(rows_by_key.get((label, name))) for name in measures)])
    widths = [max(len(line[column]) for line in lines) for column in range(len(lines[0]))]
    return (
        "\n".join("  ".join(f"{cell:<{width}}" for cell, width in zip(line, widths, strict=True)).rstrip() for line in lines)
        + "\n"
    )


def _make_heading(measure: str) -> str:
    if measure.startswith("empty."):
        return f"{measure.removeprefix('empty.')} 0 at"
    return measure.removeprefix(_DECLARED_PREFIX)


def _format_cell(row: MeasureStatistics | None) -> str:
    if row is None:
        return "–"
    words = f"{_format_number(row.median)} ({_format_number(row.lower_quartile)} – {_format_number(row.upper_quartile)})"
    return words if row.happened == row.runs else f"{words}, {row.happened} of {row.runs}"


def _format_number(value: float) -> str:
    return "never" if math.isinf(value) else f"{value:.6g}"


def format_csv_table(table: Sequence[MeasureStatistics]) -> str:
    """Return the table as CSV, with one line per variation and measure. If the event of a measure never happened, its values are
    empty."""
    lines: list[list[object]] = [[column.name for column in fields(MeasureStatistics)]]
    for row in table:
        lines.append(["" if v is None else f"{v:.9g}" if isinstance(v, float) else v for v in _make_finite_entry(row).values()])
    return format_csv(lines)


def collect_runs(results: Sequence[RunResult], units: Mapping[str, str] | None = None) -> dict[str, list[Any]]:
    """Return the columns of the table of runs, by name: label, scene, seed, varied values and all measures. Missing values are
    None.

    `units`: the unit of each varied value that is written as a plain number, by name."""
    identities = [identify_run(job, units or {}) for job, _ in results]
    heads = list(dict.fromkeys(name for cells in identities for name in cells))
    names = dict.fromkeys(name for _, measures in results for name in without_series(measures))
    columns: dict[str, list[Any]] = {head: [cells.get(head) for cells in identities] for head in heads}
    for name in names:
        if name not in MACHINE_DEPENDENT_MEASURES:
            columns[name] = _unify_types([measures.get(name) for _, measures in results])
    return columns


def collect_run_series(results: Sequence[RunResult], units: Mapping[str, str] | None = None) -> dict[str, list[Any]]:
    """Return the columns of the table of frames, by name: label, scene, seed, varied values, frame and measures."""
    return collect_series([(identify_run(job, units or {}), measures) for job, measures in results])


def identify_run(job: SweepJob, units: Mapping[str, str]) -> dict[str, Any]:
    """Return the cells that identify a run, by column. If the values of a column are plain numbers, its name includes the
    unit."""
    cells: dict[str, Any] = {"label": job.label, "scene": Path(job.scene).stem, "seed": job.seed}
    for name, text in job.params:
        unit = units.get(name)
        cells[f"{name} ({unit})" if unit else name] = text if unit is None else float(text.removesuffix(unit))
    return cells


def _unify_types(values: Sequence[Any]) -> list[Any]:
    """Return the values of a column as one type: integers if all are integers, else floats if all are numbers, else texts."""
    if all(v is None or isinstance(v, int) for v in values):
        return list(values)
    is_numeric = all(v is None or isinstance(v, int | float) for v in values)
    return [None if v is None else float(v) if is_numeric else str(v) for v in values]


def format_columns(columns: Mapping[str, Sequence[Any]]) -> str:
    """Return columns as CSV. Missing values are empty."""
    rows = zip(*columns.values(), strict=True)
    return format_csv([list(columns), *(["" if cell is None else cell for cell in row] for row in rows)])


def format_known_medians(medians: Sequence[MedianEstimate]) -> str:
    """Return one line per median, with its confidence interval and whether this interval is as narrow as requested."""
    lines = ["Medians, with 95 % between"]
    label_width, width = (max(map(len, words)) for words in zip(*((k.label, k.measure) for k in medians), strict=True))
    for each in medians:
        interval_text = (
            f"{_format_number(each.low)} and {_format_number(each.high)}"
            if each.runs and each.low > -math.inf
            else "too few runs"
        )
        late = "" if each.met else ", not as close as requested"
        lines.append(f"  {each.label:<{label_width}}  {each.measure:<{width}}  {interval_text}, {each.runs} runs{late}")
    return "\n".join(lines) + "\n"


def format_json_table(
    results: Sequence[RunResult],
    table: Sequence[MeasureStatistics],
    medians: Sequence[MedianEstimate] = (),
    effects: Sequence[FactorEffect] = (),
) -> str:
    """Return one JSON document with all runs, the table, and known medians and effects."""
    document: dict[str, Any] = {
        "runs": [describe_job(job) | {"measures": without_series(measures)} for job, measures in results],
        "table": [_make_finite_entry(row) for row in table],
    }
    if medians:
        document["medians"] = [_make_finite_entry(each) for each in medians]
    if effects:
        document["sensitivity"] = [asdict(effect) for effect in effects]
    return json.dumps(document, indent=1) + "\n"


def _make_finite_entry(record: MeasureStatistics | MedianEstimate) -> dict[str, Any]:
    """Return the fields of a record by name, for JSON. Infinite and unknown numbers become None."""
    return {name: None if isinstance(v, float) and not math.isfinite(v) else v for name, v in asdict(record).items()}
