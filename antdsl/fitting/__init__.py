"""Fits of params to the goals of a spec. The inputs are ranges of params, scenes and a spec. The results are the best values,
and the fraction of sampled points that pass.

`evaluation` runs the spec at one point with one seed, as a task of `executors`. `search` chooses points: first a Sobol sequence,
which fills the ranges evenly, then SciPy's differential evolution from the best of these points. `report` formats the results.
"""

from antdsl.fitting.evaluation import PointEvaluator, PointResult
from antdsl.fitting.search import FitResult, fit_goals

__all__ = ["FitResult", "PointEvaluator", "PointResult", "fit_goals"]
