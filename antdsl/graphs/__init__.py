"""Draws state machines: Program → charts → SVG, PNG, Mermaid or DOT. A layout is made only for SVG and PNG.

`charts(program)`, `lay_out(charts)` and the values of `model` are for callers that draw in another format, or draw live."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from antdsl.diagnostics import Report
from antdsl.graphs.charting import charts as charts
from antdsl.graphs.layout import lay_out as lay_out
from antdsl.graphs.model import Chart as Chart
from antdsl.graphs.model import PlacedChart as PlacedChart

Written = tuple[bytes | None, Report]


def _svg(charts: Sequence[Chart]) -> Written:
    from antdsl.graphs.drawing import draw
    from antdsl.graphs.svg import svg

    placed, report = lay_out(charts)
    return (svg(draw(placed)).encode() if report.ok else None), report


def _png(charts: Sequence[Chart]) -> Written:
    from antdsl.graphs.drawing import draw
    from antdsl.graphs.png import png

    placed, report = lay_out(charts)
    if not report.ok:
        return None, report
    try:
        return png(draw(placed)), report
    except ImportError:
        advice = 'run `pip install "antdsl[graph]"`, or write `--format svg`'
        report.error("missing-extra", "pictures in PNG need the package resvg_py", None, advice)
        return None, report


def _mermaid(charts: Sequence[Chart]) -> Written:
    from antdsl.graphs.mermaid import mermaid

    return mermaid(charts).encode(), Report()


def _dot(charts: Sequence[Chart]) -> Written:
    from antdsl.graphs.dot import dot

    return dot(charts).encode(), Report()


# A format's name with the endings of its files, the usual one first, and the function that writes it. The first is the default.
FORMATS: Mapping[str, tuple[tuple[str, ...], Callable[[Sequence[Chart]], Written]]] = {
    "svg": ((".svg",), _svg),
    "png": ((".png",), _png),
    "mermaid": ((".mmd", ".mermaid"), _mermaid),
    "dot": ((".dot", ".gv"), _dot),
}


def write(charts: Sequence[Chart], format: str) -> Written:
    """Return the bytes of a file in one of `FORMATS`; None with a finding if a required package is not installed."""
    return FORMATS[format][1](charts)
