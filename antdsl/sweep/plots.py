"""Pictures of a table: every run a dot, the median and the quartiles a bar, a panel for each measure. Needs matplotlib."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from antdsl.sweep.table import Result, quantile

HOW = "plots need matplotlib: pip install 'antdsl[plots]'"


def available() -> bool:
    """Whether pictures can be drawn here; nothing is imported."""
    return find_spec("matplotlib") is not None


def draw(results: Sequence[Result], measures: Sequence[str], path: Path) -> None:
    """Write one PNG with a panel a measure. What did not happen stands above the dashed line."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    labels = list(dict.fromkeys(job.label for job, _ in results))
    height = max(2.0, 0.45 * len(labels) + 1.0)
    figure = Figure(figsize=(9.0, height * len(measures)), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(len(measures), 1, squeeze=False)[:, 0]
    for panel, measure in zip(panels, measures, strict=True):
        _panel(panel, results, labels, measure)
    figure.savefig(path, dpi=110, metadata={"Software": "antdsl"})


def _panel(panel, results: Sequence[Result], labels: Sequence[str], measure: str) -> None:  # type: ignore[no-untyped-def]
    known = [float(v) for _, found in results if (v := found.get(measure)) is not None]
    edge = max(known, default=1.0)
    room = 0.08 * (edge - min(known, default=0.0)) or 1.0
    never = edge + room
    for number, label in enumerate(labels):
        values = [found.get(measure) for job, found in results if job.label == label]
        dots = sorted(never if v is None else float(v) for v in values)
        panel.plot(dots, [number] * len(dots), "o", color="#3b6ea5", alpha=0.55, markersize=5, markeredgewidth=0)
        lower, middle, upper = (quantile(dots, share) for share in (0.25, 0.5, 0.75))
        panel.plot([lower, upper], [number, number], "-", color="#222222", linewidth=2)
        panel.plot([middle], [number], "|", color="#222222", markersize=16, markeredgewidth=2)
    if any(found.get(measure) is None for _, found in results):
        panel.axvline(edge + room / 2, linestyle="--", color="#999999", linewidth=1)
        panel.text(never, len(labels) - 0.4, "never", ha="center", va="top", fontsize=8, color="#666666")
    panel.set_yticks(range(len(labels)), labels)
    panel.set_ylim(len(labels) - 0.4, -0.6)
    panel.set_title(measure.replace("empty.", "frame at which it is 0: "), loc="left", fontsize=10)
    panel.grid(axis="x", color="#e4e4e4")
    panel.spines[["top", "right", "left"]].set_visible(False)
