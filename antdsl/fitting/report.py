"""The results of a fit as text, as JSON (`fit.json`), and as a table of all points."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from statistics import median
from typing import Any

from antdsl.fitting.evaluation import GoalResult, PointResult
from antdsl.fitting.search import FitResult
from antdsl.outputs.csv_text import format_csv


def describe_fit(result: FitResult) -> str:
    """Return the result as lines of text. They give the fraction of sampled points that pass, the best values, and the goals
    with the seeds of the fit and with other seeds."""
    passed = sum(point.holds for point in result.sample)
    lines = [f"prior: all other lines hold at {passed} of {len(result.sample)} points ({100 * result.prior_share:.0f} %)"]
    problems = [point.problem for point in result.sample if point.problem]
    lines += [f"{len(problems)} points have no results: {problems[0]}"] if problems else []
    if result.best is None:
        return "\n".join([*lines, "no point has results"])
    lines.append("best: " + ", ".join(f"{name}={text}" for name, text in result.best.values.items()))
    lines += _describe_point(result.best)
    if result.check is not None:
        lines += ["with other seeds:", *_describe_point(result.check)]
    return "\n".join(lines)


def _describe_point(point: PointResult) -> list[str]:
    lines = [f"  {_describe_goal(goal)}" for goal in point.goals]
    return [*lines, f"  the other lines hold with {100 * point.passed_share:.0f} % of the seeds"]


def _describe_goal(goal: GoalResult) -> str:
    low, high = min(goal.values), max(goal.values)
    met = "met" if goal.residual <= 1 else "missed"
    numbers = f"{_format_number(median(goal.values))} ({_format_number(low)} – {_format_number(high)})"
    return f"{goal.text}: {numbers}, {met}"


def _format_number(value: float) -> str:
    return f"{value:.6g}" if math.isfinite(value) else "never"


def encode_fit(result: FitResult, spec: str) -> bytes:
    """Return the result as JSON."""
    passed = sum(point.holds for point in result.sample)
    document = {
        "spec": spec,
        "prior": {"points": len(result.sample), "passed": passed, "share": result.prior_share},
        "best": None if result.best is None else _make_entry(result.best),
        "check": None if result.check is None else _make_entry(result.check),
    }
    return (json.dumps(document, indent=1) + "\n").encode()


def _make_entry(point: PointResult) -> dict[str, Any]:
    goals = [
        {
            "text": goal.text,
            "tolerance": goal.tolerance,
            "values": [_make_finite(value) for value in goal.values],
            "targets": [_make_finite(value) for value in goal.targets],
        }
        for goal in point.goals
    ]
    return {
        "values": dict(point.values),
        "loss": _make_finite(point.weighted_loss),
        "passed_share": point.passed_share,
        "goals": goals,
    }


def _make_finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def format_points(result: FitResult, units: Mapping[str, str]) -> str:
    """Return all points as CSV: values without units, the loss, the fraction of seeds that pass, and the median of each goal.

    `units`: the unit of each value, by name."""
    goals = () if result.best is None else tuple(goal.text for goal in result.best.goals)
    heads = [f"{name} ({unit})" if unit else name for name, unit in units.items()]
    rows: list[list[object]] = [["part", *heads, "loss", "passed_share", *goals]]
    for part, points in (("prior", result.sample), ("search", result.searched)):
        for point in points:
            values = [text.removesuffix(units[name]) for name, text in point.values.items()]
            medians = [_make_finite(median(goal.values)) for goal in point.goals] or [None] * len(goals)
            cells = [_make_finite(point.weighted_loss), point.passed_share, *medians]
            rows.append([part, *values, *("" if cell is None else cell for cell in cells)])
    return format_csv(rows)
