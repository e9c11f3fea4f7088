"""Plots of a sweep's table, made with matplotlib.

There is one panel per measure, in which each run is a dot and a bar marks the median and the quartiles. A design over ranges has
one panel for each measure and range."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from antdsl.sweeps.factors import Factor
from antdsl.sweeps.figures import open_figure
from antdsl.sweeps.sensitivity import FactorEffect, SensitivityAnalysis
from antdsl.sweeps.study import SweepStudy
from antdsl.sweeps.table import RunResult, compute_quantile

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLOURS = ("#3b6ea5", "#b5651d", "#4f8a4f", "#8a4f7d", "#7a7a3a", "#555555")  # colours of scenes
_TREND_PARTS = 6  # parts of a range; a median is drawn for each
INSTALL_HINT = "plots need matplotlib: pip install 'antdsl[plots]'"


def draw_measures(results: Sequence[RunResult], measures: Sequence[str], path: Path) -> None:
    """Write one PNG with a panel for each measure. A run in which the measured event did not happen is drawn above a dashed
    line."""
    labels = list(dict.fromkeys(job.label for job, _ in results))
    height = max(2.0, 0.45 * len(labels) + 1.0)
    with open_figure(9.0, height * len(measures), path) as figure:
        panels = figure.subplots(len(measures), 1, squeeze=False)[:, 0]
        for panel, measure in zip(panels, measures, strict=True):
            _draw_panel(panel, results, labels, measure)


def _draw_panel(panel: Axes, results: Sequence[RunResult], labels: Sequence[str], measure: str) -> None:
    known_values = [float(v) for _, measures in results if (v := measures.get(measure)) is not None]
    edge = max(known_values, default=1.0)
    margin = 0.08 * (edge - min(known_values, default=0.0)) or 1.0
    never = edge + margin
    for number, label in enumerate(labels):
        values = [measures.get(measure) for job, measures in results if job.label == label]
        dots = sorted(never if v is None else float(v) for v in values)
        panel.plot(dots, [number] * len(dots), "o", color="#3b6ea5", alpha=0.55, markersize=5, markeredgewidth=0)
        lower, middle, upper = (compute_quantile(dots, share) for share in (0.25, 0.5, 0.75))
        panel.plot([lower, upper], [number, number], "-", color="#222222", linewidth=2)
        panel.plot([middle], [number], "|", color="#222222", markersize=16, markeredgewidth=2)
    if any(measures.get(measure) is None for _, measures in results):
        panel.axvline(edge + margin / 2, linestyle="--", color="#999999", linewidth=1)
        panel.text(never, len(labels) - 0.4, "never", ha="center", va="top", fontsize=8, color="#666666")
    panel.set_yticks(range(len(labels)), labels)
    panel.set_ylim(len(labels) - 0.4, -0.6)
    panel.set_title(_format_title(measure), loc="left", fontsize=10)
    panel.grid(axis="x", color="#e4e4e4")
    panel.spines[["top", "right", "left"]].set_visible(False)


def draw_factors(
    study: SweepStudy, results: Sequence[RunResult], measures: Sequence[str], effects: Sequence[FactorEffect], path: Path
) -> None:
    """Write one PNG with a row per measure and a column per factor with a range. If the importance of factors is known, an
    additional last column displays it.

    Each dot is the median over the seeds of one point, with the quartiles. The line is the median of all points in a part of the
    range, and the band shows their quartiles.
    """
    columns = len(study.range_factors) + bool(effects)
    names = [str(scene) for scene in study.scenes]
    scenes = {variation.label: str(variation.scene) for variation in study.variations}
    with open_figure(1.0 + 3.6 * columns, 0.6 + 2.6 * len(measures), path) as figure:
        panels = figure.subplots(len(measures), columns, squeeze=False)
        for row, measure in zip(panels, measures, strict=True):
            for panel, factor in zip(row, study.range_factors, strict=False):
                _draw_over_range(panel, factor, results, names, scenes, measure)
            if effects and study.chosen_points.design.analysis is not None:
                _draw_bars(row[-1], study.chosen_points.design.analysis, [e for e in effects if e.measure == measure], names)
            row[0].set_ylabel(_format_title(measure), fontsize=9)
        if len(names) > 1:
            marks = [panels[0, 0].plot([], [], "o", color=_choose_colour(k), markersize=5)[0] for k in range(len(names))]
            stems = [scene.stem for scene in study.scenes]
            figure.legend(marks, stems, loc="outside lower center", ncols=4, fontsize=9, frameon=False)


def _draw_over_range(
    panel: Any,
    factor: Factor,
    results: Sequence[RunResult],
    scenes: Sequence[str],
    scene_by_label: Mapping[str, str],
    measure: str,
) -> None:
    values = [float(v) for _, measures in results if (v := measures.get(measure)) is not None]
    edge, lowest = max(values, default=1.0), min(values, default=0.0)
    margin = 0.08 * (edge - lowest) or 1.0
    for number, scene in enumerate(scenes):
        points: dict[str, tuple[float, list[float]]] = {}
        for job, measures in results:
            if scene_by_label[job.label] == scene and measure in measures:
                value = factor.parse_number(dict(job.params)[factor.name])
                measured_value = measures[measure]
                points.setdefault(job.label, (value, []))[1].append(
                    edge + margin if measured_value is None else float(measured_value)
                )
        medians = []
        for value, marks in points.values():
            lower, middle, upper = (compute_quantile(sorted(marks), share) for share in (0.25, 0.5, 0.75))
            panel.plot([value, value], [lower, upper], "-", color=_choose_colour(number), alpha=0.35, linewidth=1)
            panel.plot([value], [middle], "o", color=_choose_colour(number), alpha=0.6, markersize=4, markeredgewidth=0)
            medians.append((value, middle))
        _draw_trend(panel, factor, medians, _choose_colour(number))
    if any(measures.get(measure, 0) is None for _, measures in results):
        panel.axhline(edge + margin / 2, linestyle="--", color="#999999", linewidth=1)
        panel.text(factor.low, edge + margin, "never", ha="left", va="center", fontsize=8, color="#666666")
    panel.set_xlabel(f"{factor.name}{f' ({factor.unit})' if factor.unit else ''}", fontsize=9)
    panel.set_xlim(factor.low, factor.high)
    panel.grid(color="#e4e4e4")
    panel.tick_params(labelsize=8)
    panel.spines[["top", "right"]].set_visible(False)


def _draw_trend(panel: Any, factor: Factor, medians: Sequence[tuple[float, float]], colour: str) -> None:
    """Divide a factor's range into parts, and draw the median and the quartiles of the points in each part."""
    parts: dict[int, list[float]] = {}
    for value, median in medians:
        share = (value - factor.low) / (factor.high - factor.low)
        parts.setdefault(min(int(share * _TREND_PARTS), _TREND_PARTS - 1), []).append(median)
    part_numbers = sorted(parts)
    middles = [factor.low + (part + 0.5) / _TREND_PARTS * (factor.high - factor.low) for part in part_numbers]
    lower, middle, upper = (
        [compute_quantile(sorted(parts[part]), share) for part in part_numbers] for share in (0.25, 0.5, 0.75)
    )
    panel.fill_between(middles, lower, upper, color=colour, alpha=0.15, linewidth=0)
    panel.plot(middles, middle, "-", color=colour, linewidth=1.5)


def _draw_bars(panel: Any, analysis: SensitivityAnalysis, effects: Sequence[FactorEffect], scenes: Sequence[str]) -> None:
    """Draw the importance of each factor as a bar with its 95 % interval."""
    factors = list(dict.fromkeys(effect.factor for effect in effects))
    high = 0.8 / max(len(scenes), 1)
    for number, scene in enumerate(scenes):
        scene_effects = [effect for effect in effects if effect.scene == scene]
        positions = [factors.index(effect.factor) + (number - (len(scenes) - 1) / 2) * high for effect in scene_effects]
        widths, errors = (
            [effect.columns[name] for effect in scene_effects]
            for name in (analysis.importance_column, analysis.half_width_column)
        )
        panel.barh(
            positions, widths, height=high * 0.9, xerr=errors, color=_choose_colour(number), alpha=0.7, error_kw={"linewidth": 1}
        )
    panel.set_yticks(range(len(factors)), factors)
    panel.invert_yaxis()
    panel.set_xlabel(analysis.importance_column.replace("_", " "), fontsize=9)
    panel.tick_params(labelsize=8)
    panel.spines[["top", "right"]].set_visible(False)


def _choose_colour(number: int) -> str:
    return _COLOURS[number % len(_COLOURS)]


def _format_title(measure: str) -> str:
    return measure.replace("empty.", "frame at which it is 0: ")
