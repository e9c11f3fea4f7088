"""Ratios between costs that were measured in turn, with 95 % confidence intervals.

Runs that alternate have the same machine load, so their ratio is meaningful, while a single time is not."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import TypeVar

MIN_PAIRS = 20  # pairs from which a ratio is reported with its interval
_RESAMPLE_COUNT = 10_000
ResultType = TypeVar("ResultType")


@dataclass(frozen=True, slots=True)
class RatioInterval:
    """The mean of ratios and its 95 % confidence interval."""

    mean: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.mean:.3f} ({self.low:.3f} to {self.high:.3f})"

    def is_above(self, limit: float) -> bool:
        """Return whether the complete interval is above `limit`, so that chance alone is an unlikely reason."""
        return self.low > limit


def compute_bootstrap_interval(ratios: Sequence[float], seed: int = 1) -> RatioInterval:
    """Return the mean of ratios and its 95 % interval: the 2.5th and 97.5th percentiles of bootstrap means.

    Source: B. Efron, Annals of Statistics 7 (1979). Equal ratios and seeds always give the same interval. Raises ValueError for
    an empty sequence."""
    if not ratios:
        raise ValueError("no ratios were measured")
    draw = random.Random(seed)
    means = sorted(fmean(draw.choices(ratios, k=len(ratios))) for _ in range(_RESAMPLE_COUNT))
    return RatioInterval(fmean(ratios), means[round(0.025 * _RESAMPLE_COUNT)], means[round(0.975 * _RESAMPLE_COUNT)])


def measure_in_turn(
    measure: Callable[[int], ResultType], runners: int, count: int, warm_up_runs: int = 1
) -> list[tuple[ResultType, ...]]:
    """Return the costs of several runners, measured in turn: one tuple per round, with one cost per runner.

    `measure`: returns the cost of the runner with a given number. `count`: the number of rounds; each round starts with another
    runner. `warm_up_runs`: the number of uncounted runs of each runner at the start, which fill caches."""
    for _ in range(warm_up_runs):
        for runner in range(runners):
            measure(runner)
    turn_costs = []
    for number in range(count):
        first = (number + 1) % runners
        order = [(first + k) % runners for k in range(runners)]
        costs = {runner: measure(runner) for runner in order}
        turn_costs.append(tuple(costs[runner] for runner in range(runners)))
    return turn_costs
