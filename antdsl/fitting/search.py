"""The search for values at which a spec's goals are met: a Sobol sequence, then differential evolution from its best points.

R. Storn, K. Price: Differential evolution, a simple and efficient heuristic for global optimization over continuous spaces, J.
Global Optimization 11 (1997). All points use the same seeds, so that differences between points do not come from the seeds."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.fitting.evaluation import PointEvaluator, PointResult, Values
from antdsl.sweeps.designs import ChosenPoints
from antdsl.sweeps.factors import Factor

_MIN_POPULATION = 8  # of the evolution
_POPULATION_PER_FACTOR = 5
_SUFFICIENT_LOSS = 0.01  # the search ends here: goals are met to a tenth of their tolerance
_WORST_LOSS = 1e9  # of points without results; the evolution needs finite numbers


@dataclass(frozen=True, slots=True)
class FitResult:
    """The result of a fit.

    - `sample`: the results at the points of the Sobol sequence. `searched`: the results at all later points.
    - `best`: the result with the least loss; None if no point has a result.
    - `check`: the result at the best point, evaluated with other seeds."""

    sample: tuple[PointResult, ...]
    searched: tuple[PointResult, ...]
    best: PointResult | None
    check: PointResult | None = None

    @property
    def prior_share(self) -> float:
        """Return the fraction of sampled points at which all lines that are not goals hold."""
        return sum(point.holds for point in self.sample) / len(self.sample)


def fit_goals(
    chosen: ChosenPoints, evaluator: PointEvaluator, generations: int, seed: int, report_generation: Callable[[int, float], None]
) -> FitResult:
    """Return the result of a fit, without checking it with other seeds.

    `chosen`: the Sobol sequence. `generations`: the largest number of generations of the evolution, each with max(8, 5 ×
    factors) points. `report_generation`: called with the number of a generation and the least loss so far."""
    sample = evaluator.evaluate(chosen.points)
    ranked = np.argsort([_bound_loss(point) for point in sample], kind="stable")
    if generations and chosen.shares is not None and _bound_loss(sample[ranked[0]]) > _SUFFICIENT_LOSS:
        count = min(len(sample), max(_MIN_POPULATION, _POPULATION_PER_FACTOR * len(chosen.factors)))
        _run_differential_evolution(
            chosen.factors, evaluator, chosen.shares[ranked[:count]], generations, seed, report_generation
        )
    results = list(evaluator.results.values())
    best = min(results, key=_bound_loss)
    drawn = {id(point) for point in sample}
    searched = tuple(point for point in results if id(point) not in drawn)
    return FitResult(tuple(sample), searched, best if math.isfinite(best.weighted_loss) else None)


def _run_differential_evolution(
    factors: Sequence[Factor],
    evaluator: PointEvaluator,
    population: NDArray[np.float64],
    generations: int,
    seed: int,
    report_generation: Callable[[int, float], None],
) -> None:
    from scipy.optimize import differential_evolution

    generation = 0

    def evaluate_all(function: Any, rows: Iterable[NDArray[np.float64]]) -> list[float]:
        return [_bound_loss(result) for result in evaluator.evaluate([_make_values(factors, row) for row in rows])]

    def end_early(intermediate_result: Any) -> bool:
        nonlocal generation
        generation += 1
        report_generation(generation, float(intermediate_result.fun))
        return bool(intermediate_result.fun <= _SUFFICIENT_LOSS)

    differential_evolution(
        lambda row: math.nan,  # `evaluate_all` evaluates the rows
        [(0.0, 1.0)] * len(factors),
        init=population,
        maxiter=generations,
        updating="deferred",
        workers=evaluate_all,
        polish=False,
        seed=np.random.default_rng(seed),
        callback=end_early,
    )


def _bound_loss(result: PointResult) -> float:
    return min(result.weighted_loss, _WORST_LOSS)


def _make_values(factors: Sequence[Factor], shares: NDArray[np.float64]) -> Values:
    """Return the values of all factors at a position in their ranges. `shares`: the position in each range, 0 to 1."""
    return {factor.name: factor.format_value_at(float(share)) for factor, share in zip(factors, shares, strict=True)}
