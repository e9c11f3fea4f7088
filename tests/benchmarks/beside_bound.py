"""Steps of a case of `antdsl bench` and the frame of `bound.py`, in turn in one process. Needs numba.

`python tests/benchmarks/beside_bound.py foraging --agents 15000` prints CPU time of a step over that of the hand-written frame,
for each backend: the mean of the ratios and its 95 % interval."""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Callable
from pathlib import Path

from antdsl.bench.costs import JOB_ADAPTER, MEASUREMENT_ADAPTER, BenchJob, Measurement, measure_in_process
from antdsl.bench.measuring import measure_job
from antdsl.bench.tables import format_ratios

BOUND = "bound"  # the name of the hand-written frame, next to those of backends


def make_bound(agents: int) -> dict[str, Callable[[], None]]:
    """Return the hand-written frame of `agents` foraging ants, by its name."""
    sys.path.append(str(Path(__file__).resolve().parent))  # where PYTHONSAFEPATH leaves it out
    from bound import Bound

    return {BOUND: Bound(agents).frame}


def measure_beside_bound(job: BenchJob) -> Measurement:
    """Return what a separate process measures of a job, with the hand-written frame in turn. Raises MeasuringError."""
    return measure_in_process(job, [sys.executable, str(Path(__file__).resolve()), "--job"])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("case", nargs="?", default="foraging")
    parser.add_argument("--agents", type=int, default=None)
    parser.add_argument("--backend", action="append", help="may be given several times")
    parser.add_argument("--turns", type=int, default=20)
    parser.add_argument("--job", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.job is not None:
        warnings.simplefilter("ignore")  # what libraries say to programmers
        print(MEASUREMENT_ADAPTER.dump_json(measure_job(JOB_ADAPTER.validate_json(options.job), make_bound)).decode())
        return
    backends = tuple(options.backend or ("native", "numpy"))
    measurement = measure_beside_bound(BenchJob(options.case, options.agents, backends, options.turns))
    for name in backends:
        ratios = format_ratios(measurement.compute_ratios(name, BOUND))
        print(f"{name}: {measurement.costs[name].cpu_ms:.2f} ms, {ratios} of the bound")


if __name__ == "__main__":
    main()
