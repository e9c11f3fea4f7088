"""Fits params to the goals of a spec. Input: ranges of params, scenes and a spec. Output: the best values, and how typical
they are.

`evaluation` runs the spec at one point with one seed, as a task of `executors`. `search` chooses points: first a Sobol sequence,
which fills the ranges evenly, then the differential evolution of SciPy from its best points. `report` writes the results."""

from antdsl.fitting.evaluation import PointEvaluator, PointResult
from antdsl.fitting.search import FitResult, fit_goals

__all__ = ["FitResult", "PointEvaluator", "PointResult", "fit_goals"]
