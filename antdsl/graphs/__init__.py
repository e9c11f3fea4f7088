"""Pictures of a Program's state machines as SVG, PNG, Mermaid or DOT. Only SVG and PNG need a layout.

`build_charts(program)`, `lay_out_charts(charts)` and the classes of `model` are for callers that draw live or in other
formats.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from antdsl.diagnostics import Report
from antdsl.graphs.charting import build_charts as build_charts
from antdsl.graphs.layout import lay_out_charts as lay_out_charts
from antdsl.graphs.model import Chart as Chart
from antdsl.graphs.model import PlacedChart as PlacedChart

FileResult = tuple[bytes | None, Report]


def _write_svg(charts: Sequence[Chart]) -> FileResult:
    from antdsl.graphs.drawing import draw_charts
    from antdsl.graphs.svg import format_svg

    placed_charts, report = lay_out_charts(charts)
    return (format_svg(draw_charts(placed_charts)).encode() if report.ok else None), report


def _write_png(charts: Sequence[Chart]) -> FileResult:
    from antdsl.graphs.drawing import draw_charts
    from antdsl.graphs.png import render_png

    placed_charts, report = lay_out_charts(charts)
    if not report.ok:
        return None, report
    try:
        return render_png(draw_charts(placed_charts)), report
    except ImportError:
        advice = 'run `pip install "antdsl[graph]"`, or write `--format svg`'
        report.error("missing-extra", "pictures in PNG need the package resvg_py", None, advice)
        return None, report


def _write_mermaid(charts: Sequence[Chart]) -> FileResult:
    from antdsl.graphs.mermaid import format_mermaid

    return format_mermaid(charts).encode(), Report()


def _write_dot(charts: Sequence[Chart]) -> FileResult:
    from antdsl.graphs.dot import format_dot

    return format_dot(charts).encode(), Report()


# A format's name with the endings of its files, the usual one first, and the function that writes it. The first is the default.
CHART_FORMATS: Mapping[str, tuple[tuple[str, ...], Callable[[Sequence[Chart]], FileResult]]] = {
    "svg": ((".svg",), _write_svg),
    "png": ((".png",), _write_png),
    "mermaid": ((".mmd", ".mermaid"), _write_mermaid),
    "dot": ((".dot", ".gv"), _write_dot),
}


def write_charts(charts: Sequence[Chart], format: str) -> FileResult:
    """Return the content of a file in one of `CHART_FORMATS`, and a report. The content is None if a required package is not
    installed."""
    return CHART_FORMATS[format][1](charts)
