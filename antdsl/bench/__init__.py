"""Measurements of steps: how long they take, and ratios between backends.

`cases` names the measured cases, and `scaling` builds a scene of a case with a given number of agents. `measuring` runs the
set-up and steps of a case in this process, alternating between backends. `costs` does the same in a separate process, so that no
other code affects its memory and start-up. `ratios` has the statistics, and `tables` formats the results. Measurements for
developers are in `tests/benchmarks`. Nothing in this package changes a result.
"""

from antdsl.bench.cases import BENCH_CASES, BenchCase
from antdsl.bench.costs import BenchJob, Measurement, StepCost, measure_in_process
from antdsl.bench.ratios import RatioInterval, compute_bootstrap_interval, measure_in_turn

__all__ = [
    "BENCH_CASES",
    "BenchCase",
    "BenchJob",
    "Measurement",
    "RatioInterval",
    "StepCost",
    "compute_bootstrap_interval",
    "measure_in_process",
    "measure_in_turn",
]
