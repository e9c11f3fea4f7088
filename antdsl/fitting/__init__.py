"""Fits params to the goals of a spec. The input is ranges of params, scenes and a spec. The output is the best values, and how
common such values are.

`evaluation` runs the spec at one point with one seed, as a task of `executors`. `search` chooses points. It begins with a Sobol
sequence, which fills the ranges evenly. Then SciPy's differential evolution continues from the best of these points. `report`
writes the results."""

from antdsl.fitting.evaluation import PointEvaluator, PointResult
from antdsl.fitting.search import FitResult, fit_goals

__all__ = ["FitResult", "PointEvaluator", "PointResult", "fit_goals"]
