"""The importance of each factor of a sweep: Sobol indices and elementary effects. SALib computes them (extra `[sensitivity]`).

The input is the median of a measure over the seeds of each point. All points use the same seeds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.outputs.csv_text import format_csv

INSTALL_HINT = "install it: pip install 'antdsl[sensitivity]'"
_MORRIS_LEVELS = 4  # levels of Morris' grid
_RESAMPLE_COUNT = 1000  # samples of the bootstrap for the intervals
_RESAMPLE_SEED = 1  # seed of the bootstrap

Numbers = NDArray[np.float64]
EffectColumns = Mapping[str, Numbers]


@dataclass(frozen=True, slots=True)
class SensitivityAnalysis:
    """A method that computes the importance of each factor.

    `title`: the title of its table.
    `importance_column`: the column with the importance of a factor.
    `half_width_column`: the column with half the width of the 95 % interval of the importance.
    `compute_columns(shares, values)`: returns columns by name, with one number per factor."""

    title: str
    importance_column: str
    half_width_column: str
    compute_columns: Callable[[Numbers, Numbers], EffectColumns]


@dataclass(frozen=True, slots=True)
class FactorEffect:
    """The effect of one factor on one measure in one scene. `columns`: the numbers that the analysis returns, by name."""

    scene: str
    measure: str
    factor: str
    columns: Mapping[str, float]


def is_salib_available() -> bool:
    """Return whether SALib is installed, without importing it."""
    return find_spec("SALib") is not None


def sample_saltelli(factors: int, count: int, seed: int) -> Numbers:
    """Return `count` × (factors + 2) points for Sobol indices of first and total order, from a scrambled Sobol sequence. Source:
    A. Saltelli and others: Variance based sensitivity analysis of model output, Comp. Phys. Comm. 181 (2010)."""
    from SALib.sample import sobol

    return np.asarray(sobol.sample(_make_salib_problem(factors), count, calc_second_order=False, seed=seed))


def sample_morris(factors: int, count: int, seed: int) -> Numbers:
    """Return `count` trajectories of factors + 1 points. Each point differs from the previous one by one step along one factor.
    Source: M. D. Morris: Factorial sampling plans for preliminary computational experiments, Technometrics 33 (1991)."""
    from SALib.sample import morris

    return np.asarray(morris.sample(_make_salib_problem(factors), count, num_levels=_MORRIS_LEVELS, seed=seed))


def _compute_sobol_indices(shares: Numbers, values: Numbers) -> EffectColumns:
    from SALib.analyze import sobol

    indices = sobol.analyze(
        _make_salib_problem(shares.shape[1]), values, calc_second_order=False, num_resamples=_RESAMPLE_COUNT, seed=_RESAMPLE_SEED
    )
    return {
        "total": indices["ST"],
        "total_95": indices["ST_conf"],
        "first_order": indices["S1"],
        "first_order_95": indices["S1_conf"],
    }


def _compute_elementary_effects(shares: Numbers, values: Numbers) -> EffectColumns:
    """Return the elementary effects of each factor. Source: F. Campolongo, J. Cariboni, A. Saltelli: An effective screening
    design for sensitivity analysis of large models, Environmental Modelling & Software 22 (2007)."""
    from SALib.analyze import morris

    problem = _make_salib_problem(shares.shape[1])
    results = morris.analyze(
        problem, shares, values, num_levels=_MORRIS_LEVELS, num_resamples=_RESAMPLE_COUNT, seed=_RESAMPLE_SEED
    )
    salib_names = {"mu_star": "mu_star", "mu_star_95": "mu_star_conf", "mu": "mu", "sigma": "sigma"}
    return {column: np.asarray(results[salib_name], np.float64) for column, salib_name in salib_names.items()}


SOBOL_INDICES = SensitivityAnalysis(
    "Sobol indices: the share of the variance due to a factor", "total", "total_95", _compute_sobol_indices
)
ELEMENTARY_EFFECTS = SensitivityAnalysis(
    "Elementary effects: the change of a measure over a factor's whole range",
    "mu_star",
    "mu_star_95",
    _compute_elementary_effects,
)


def _make_salib_problem(factors: int) -> dict[str, Any]:
    """Return the description of the factors in SALib's form. Every factor ranges from 0 to 1."""
    return {"num_vars": factors, "names": [str(k) for k in range(factors)], "bounds": [[0.0, 1.0]] * factors}


def find_effects(
    analysis: SensitivityAnalysis,
    names: Sequence[str],
    shares: Numbers,
    scenes: Mapping[str, Sequence[str]],
    medians: Mapping[tuple[str, str], float],
    measures: Sequence[str],
) -> tuple[list[FactorEffect], list[str]]:
    """Return the effect of each factor on each measure, and a sentence about each measure for which the effects are unknown.

    `names`: the names of the factors.
    `shares`: for each point and factor, the position in the factor's range, 0 to 1.
    `scenes`: for each scene name, the labels of the design's points in order.
    `medians`: the median of a measure over seeds, by label and measure."""
    effect_list: list[FactorEffect] = []
    notes: list[str] = []
    for scene, labels in scenes.items():
        where = f" of {scene}" if len(scenes) > 1 else ""
        for measure in measures:
            values = np.array([medians.get((label, measure), math.nan) for label in labels])
            missing = int(np.isnan(values).sum())
            if missing:
                notes.append(f"{measure}{where} is not known at {missing} of {len(values)} points, so its sensitivity is unknown")
            elif np.isinf(values).any():
                late = int(np.isinf(values).sum())
                notes.append(f"{measure}{where} never happened at {late} of {len(values)} points: more `--frames` may tell")
            elif np.ptp(values) == 0:
                notes.append(f"{measure}{where} is {values[0]:g} at all points")
            else:
                columns = analysis.compute_columns(shares, values)
                effect_list += [
                    FactorEffect(scene, measure, name, {column: float(numbers[k]) for column, numbers in columns.items()})
                    for k, name in enumerate(names)
                ]
    return effect_list, notes


def format_effects(analysis: SensitivityAnalysis, effect_list: Sequence[FactorEffect]) -> str:
    """Return effects as text, with one block per scene and measure. The most important factor comes first."""
    lines: list[str] = [analysis.title]
    width = max(len(effect.factor) for effect in effect_list)
    several = len({effect.scene for effect in effect_list}) > 1
    for scene, measure in dict.fromkeys((effect.scene, effect.measure) for effect in effect_list):
        scene_effects = sorted(
            (e for e in effect_list if (e.scene, e.measure) == (scene, measure)),
            key=lambda e: -e.columns[analysis.importance_column],
        )
        names = list(scene_effects[0].columns)
        lines += ["", f"{measure}{f' of {scene}' if several else ''}"]
        lines.append(f"  {'':<{width}}  " + "  ".join(f"{name.replace('_95', ' ±'):>14}" for name in names))
        lines += [f"  {e.factor:<{width}}  " + "  ".join(f"{e.columns[n]:>14.4g}" for n in names) for e in scene_effects]
    return "\n".join(line.rstrip() for line in lines) + "\n"


def format_effects_csv(effect_list: Sequence[FactorEffect]) -> str:
    """Return effects as CSV, with one line per effect."""
    head = ["scene", "measure", "factor", *effect_list[0].columns]
    lines = (
        [each.scene, each.measure, each.factor, *(f"{value:.9g}" for value in each.columns.values())] for each in effect_list
    )
    return format_csv([head, *lines])
