"""Sweeps from Python: every combination of scenes, values and seeds, simulated by several processes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, SupportsIndex

from antdsl.api.crowds import import_pandas
from antdsl.api.errors import AntdslError
from antdsl.api.simulation import read_frames, read_seed

if TYPE_CHECKING:
    from os import PathLike


@dataclass(frozen=True, slots=True)
class SweepResult:
    """The results of a sweep. `runs`: one dictionary per run, with the scene, varied values, seed and all measures. `failures`:
    a message for each failed run; failed runs are not in `runs`. `series`: the program's measures in each frame of each run,
    as columns of equal length by name."""

    runs: tuple[Mapping[str, Any], ...]
    failures: tuple[str, ...] = ()
    series: Mapping[str, Sequence[Any]] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.runs)

    def to_pandas(self) -> Any:
        """Return a DataFrame with one row per run. Raises AntdslError if pandas is not installed."""
        return import_pandas().DataFrame(list(self.runs))

    def series_to_pandas(self) -> Any:
        """Return a DataFrame with one row per frame of each run, and the program's measures as columns. Raises AntdslError if
        pandas is not installed."""
        return import_pandas().DataFrame(dict(self.series))

    def __repr__(self) -> str:
        failed = f", {len(self.failures)} failed" if self.failures else ""
        return f"<sweep of {len(self.runs)} runs{failed}>"


def sweep(
    scenes: str | PathLike[str] | Sequence[str | PathLike[str]],
    *,
    seeds: int | Iterable[SupportsIndex] = 5,
    vary: Mapping[str, Sequence[str | float]] | None = None,
    frames: tuple[SupportsIndex, SupportsIndex] | None = None,
    until: str | None = None,
    processes: int | None = None,
    on_result: Callable[[Mapping[str, Any]], object] | None = None,
) -> SweepResult:
    """Run each scene with each seed and each combination of the values in `vary`. Return the measures of each run.

    `scenes`: one path or several. `seeds`: a number N for the seeds 1 to N, or a list of seeds.
    `vary`: the values of each param or field setting by name, with units, such as `{"walker.pace": ["20 mm/s", "40 mm/s"]}`.
    `frames` (first, last), `until`: values that override those of the scenes. `until`: a condition that ends a run, in the
    language of specs, such as `total(food.load) == 0`.
    `processes`: the number of processes; by default, one per core. `on_result`: a function that is called with each finished
    run.

    Raises AntdslError with the report, before any run starts, if a scene, a name or a value is wrong."""
    from itertools import product

    from antdsl.executors import ProcessEngine
    from antdsl.numerics.processor.host import count_available_cores
    from antdsl.sweeps import build_jobs, make_variations, run_jobs
    from antdsl.sweeps.series import collect_series, without_series

    paths = [scenes] if isinstance(scenes, str) or not isinstance(scenes, Sequence) else list(scenes)
    for name, values in (vary or {}).items():
        if isinstance(values, str) or not isinstance(values, Iterable):
            raise AntdslError(f"`{name}` needs a list of values", f"write [{values!r}]")
    if processes is not None and processes < 1:
        raise AntdslError(f"a sweep cannot run in {processes} processes", "write 1 or more")
    names = list(vary or {})
    points = [dict(zip(names, map(str, values), strict=True)) for values in product(*(vary or {}).values())]
    numbers = list(range(1, seeds + 1)) if isinstance(seeds, int) else [read_seed(seed) for seed in seeds]
    if not paths or not numbers or not points:
        raise AntdslError("this sweep has no runs", "write at least one scene, one seed, and one value for each param")
    jobs, report = build_jobs(
        make_variations([Path(path) for path in paths], points), numbers, frames=read_frames(frames), until=until, grants={}
    )
    if not report.ok:
        raise AntdslError.from_report(report)
    workers = min(processes or count_available_cores(), len(jobs))
    cells, measures, failures = dict[str, Mapping[str, Any]](), dict[str, Mapping[str, Any]](), []
    for outcome in run_jobs(jobs, ProcessEngine(workers, max(1, count_available_cores() // workers))):
        if outcome.measures is None:
            failures.append(f"{outcome.job.name}: {outcome.problem}")
            continue
        job = outcome.job
        cells[job.key] = {"scene": Path(job.scene).stem, **dict(job.params), "seed": job.seed}
        measures[job.key] = outcome.measures
        if on_result is not None:
            on_result({**cells[job.key], **without_series(outcome.measures)})
    keys = [job.key for job in jobs if job.key in measures]
    runs = tuple({**cells[key], **without_series(measures[key])} for key in keys)
    return SweepResult(runs, tuple(failures), collect_series([(cells[key], measures[key]) for key in keys]))
