"""Designs of experiments. A design chooses the points to run from all combinations of a sweep's factor values.

For each point and factor, a design returns a position from 0 to 1 in the factor's range, which the factor converts to a value.
All random draws come from one seed, so equal arguments always choose the same points.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.diagnostics import Report
from antdsl.sweeps import sensitivity
from antdsl.sweeps.factors import Factor

RangeShares = NDArray[np.float64]
ParameterPoint = Mapping[str, str]


@dataclass(frozen=True, slots=True)
class SamplingDesign:
    """A design of experiments.

    `sample_shares(factors, count, seed)`: returns an array (points, factors) of positions from 0 to 1 in the factors' ranges;
    None for a grid.
    `description`: a short text for help texts.
    `count_meaning`: the meaning of `count`, for help texts; empty if the design takes no count.
    `points_per_unit`: if set, the number of points is `count` × (factors + `points_per_unit`). If None, it is `count`.
    `needs_power_of_two`: whether the count must be a power of two.
    `needs_ranges`: whether each factor must be a range of values.
    `analysis`: the method that computes the importance of each factor from the results; None if the design does not allow this.
    """

    name: str
    description: str
    count_meaning: str = ""  # the meaning of `--points`; empty if the design has no such option
    sample_shares: Callable[[int, int, int], RangeShares] | None = None
    points_per_unit: int | None = None  # points per counted unit, plus one for each factor; None: one point
    needs_power_of_two: bool = False
    needs_ranges: bool = False
    analysis: sensitivity.SensitivityAnalysis | None = None


@dataclass(frozen=True, slots=True)
class ChosenPoints:
    """The points that a design has chosen, in order, possibly with duplicates. `shares`: for each point and factor, the position
    in the factor's range, 0 to 1; None for a grid."""

    design: SamplingDesign
    factors: tuple[Factor, ...]
    points: tuple[ParameterPoint, ...]
    shares: RangeShares | None = None

    @property
    def unique_points(self) -> list[ParameterPoint]:
        """Return the points in order, without duplicates."""
        points_by_value = {tuple(point.values()): point for point in self.points}
        return list(points_by_value.values())


def _sample_latin_hypercube(factors: int, count: int, seed: int) -> RangeShares:
    """Return `count` points of a Latin hypercube, as positions from 0 to 1 with shape (count, factors). Source: M. D. McKay, R.
    J. Beckman, W. J. Conover: A comparison of three methods for selecting values of input variables in the analysis of output
    from a computer code, Technometrics 21 (1979)."""
    from scipy.stats import qmc

    return np.asarray(qmc.LatinHypercube(factors, seed=np.random.default_rng(seed)).random(count))


def _sample_sobol(factors: int, count: int, seed: int) -> RangeShares:
    """Return `count` points of a scrambled Sobol sequence, as positions from 0 to 1 with shape (count, factors). Sources: I. M.
    Sobol': On the distribution of points in a cube, USSR Comp. Math. Math. Phys. 7 (1967); A. B. Owen: Scrambling Sobol' and
    Niederreiter-Xing points, J. Complexity 14 (1998)."""
    from scipy.stats import qmc

    return np.asarray(qmc.Sobol(factors, scramble=True, seed=np.random.default_rng(seed)).random(count))


GRID_DESIGN = SamplingDesign("grid", "every combination of the values")
DESIGNS = (
    GRID_DESIGN,
    SamplingDesign(
        "latin",
        "a Latin hypercube: each factor's range is cut into as many parts as points, with one point in each",
        "points",
        _sample_latin_hypercube,
    ),
    SamplingDesign(
        "sobol", "points of a Sobol sequence, which fill the space evenly", "points", _sample_sobol, needs_power_of_two=True
    ),
    SamplingDesign(
        "saltelli",
        "Saltelli's sample, for Sobol indices: the share of the variance due to each factor",
        "points of the sequence behind it",
        sensitivity.sample_saltelli,
        points_per_unit=2,
        needs_power_of_two=True,
        analysis=sensitivity.SOBOL_INDICES,
    ),
    SamplingDesign(
        "morris",
        "Morris' trajectories, for elementary effects: which factors have any influence",
        "trajectories",
        sensitivity.sample_morris,
        points_per_unit=1,
        needs_ranges=True,
        analysis=sensitivity.ELEMENTARY_EFFECTS,
    ),
)
_DESIGN_BY_NAME = {design.name: design for design in DESIGNS}


def choose_design(name: str, factors: Sequence[Factor], point_count: int | None, seed: int) -> tuple[ChosenPoints | None, Report]:
    """Return the points that a design chooses, and a report. The points are None if the arguments conflict."""
    report, design = Report(), _DESIGN_BY_NAME[name]
    _check_design_fit(design, factors, point_count, report)
    if not report.ok:
        return None, report
    if design.sample_shares is None or point_count is None:
        levels = [factor.levels for factor in factors]
        combined = tuple(dict(zip((f.name for f in factors), values, strict=True)) for values in itertools.product(*levels))
        return ChosenPoints(design, tuple(factors), combined), report
    shares = design.sample_shares(len(factors), point_count, seed)
    points = tuple(
        {factor.name: factor.format_value_at(float(share)) for factor, share in zip(factors, row, strict=True)} for row in shares
    )
    return ChosenPoints(design, tuple(factors), points, shares), report


def _check_design_fit(design: SamplingDesign, factors: Sequence[Factor], point_count: int | None, report: Report) -> None:
    """Report a number of points or of factors that the design does not support."""
    ranges = [factor for factor in factors if not factor.levels]
    flag = f"`--design {design.name}`"
    if design.sample_shares is None:
        total_points = math.prod(len(factor.levels) for factor in factors)
        for factor in ranges:
            low, high = factor.find_end_values()
            middle = factor.format_value_at(0.5)
            advice = f"write `--vary {factor.name}={low},{middle},{high}`, or choose points within: `--design latin --points 20`"
            report.error("wrong-value", f"a grid needs separate values, but `{factor.name}` is a range", None, advice)
        if point_count is not None:
            report.error(
                "wrong-value",
                "a grid has as many points as its values have combinations",
                None,
                f"leave out `--points {point_count}`",
            )
        if total_points > limits.MAX_SWEEP_POINTS:
            words = f"these values have {total_points:,} combinations, more than the limit of {limits.MAX_SWEEP_POINTS:,}"
            report.error("too-large", words, None, "sample them: `--design latin --points 100`")
        return
    if not factors:
        advice = "add a param with its range: `--vary forager.smell=30mm..90mm`"
        report.error("missing-argument", f"{flag} needs at least one param to vary", None, advice)
        return
    if point_count is None:
        usual = 64 if design.needs_power_of_two else 20
        report.error(
            "missing-argument",
            f"{flag} needs the number of {design.count_meaning}",
            None,
            f"write `{flag[1:-1]} --points {usual}`",
        )
        return
    for factor in factors:
        if factor.levels and design.needs_ranges:
            first, last = factor.levels[0], factor.levels[-1]
            advice = f"write its ends: `--vary {factor.name}={first}..{last}`"
            report.error("wrong-value", f"{flag} steps along ranges, but `{factor.name}` has separate values", None, advice)
    if design.needs_power_of_two and point_count & (point_count - 1):
        near = 1 << point_count.bit_length()
        advice = f"write `--points {near}` or `--points {near >> 1}`"
        report.error(
            "wrong-count", f"a Sobol sequence fills space evenly only at powers of 2, but {point_count} is not one", None, advice
        )
    total_points = point_count * (1 if design.points_per_unit is None else len(factors) + design.points_per_unit)
    if total_points > limits.MAX_SWEEP_POINTS:
        words = (
            f"{flag} with `--points {point_count}` has {total_points:,} points, "
            f"more than the limit of {limits.MAX_SWEEP_POINTS:,}"
        )
        report.error("too-large", words, None, "write a smaller `--points`")
    if design.analysis is not None and not sensitivity.is_salib_available():
        report.error("missing-extra", f"{flag} needs SALib", None, sensitivity.INSTALL_HINT)
