"""The layouts of state machines that the page draws as charts. They are computed again only if texts or arrows have changed."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from antdsl import graphs
from antdsl.graphs.model import Chart, PlacedChart
from antdsl.program.model import Program


class ChartMessages:
    """A maker of the messages that describe a program's charts. `missing_package`: the package that must be installed before
    charts can be laid out."""

    def __init__(self) -> None:
        self.missing_package = ""
        self._layout_by_chart: dict[Chart, PlacedChart] = {}

    def is_laid_out(self, program: Program) -> bool:
        """Return whether a layout exists for each chart of a program."""
        return all(_remove_positions(chart) in self._layout_by_chart for chart in graphs.build_charts(program))

    def list_charts(self, program: Program) -> list[dict[str, Any]]:
        """Return one message for each state machine of a program. Layouts that are missing are computed first."""
        machines = [(name, m.name) for name, species in program.species.items() for m in species.machines if m.states]
        charts = graphs.build_charts(program)
        missing = [plain for chart in charts if (plain := _remove_positions(chart)) not in self._layout_by_chart]
        placed, report = graphs.lay_out_charts(list(dict.fromkeys(missing)))
        if not report.ok:
            self.missing_package = f"{report.errors[0].message}: {report.errors[0].help}"
            return []
        self._layout_by_chart |= {each.chart: each for each in placed}
        self._layout_by_chart = {plain: self._layout_by_chart[plain] for plain in map(_remove_positions, charts)}
        return [
            _make_chart_message(species, machine, chart, self._layout_by_chart[_remove_positions(chart)])
            for (species, machine), chart in zip(machines, charts, strict=True)
        ]


def _remove_positions(chart: Chart) -> Chart:
    """Return a chart without its locations in the source file, for use as the input of a layout."""
    boxes = tuple(replace(box, details="", colour=(0.0, 0.0, 0.0)) for box in chart.boxes)
    return replace(chart, boxes=boxes, arrows=tuple(replace(arrow, details="") for arrow in chart.arrows))


def _make_chart_message(species: str, machine: str, chart: Chart, placed_chart: PlacedChart) -> dict[str, Any]:
    boxes = [
        {
            "key": box.key, "kind": box.kind, "name": box.name, "label": box.label, "colour": list(box.colour),
            "details": box.details, "centre": list(place.centre), "width": place.width, "height": place.height,
        }
        for box, (_, place) in zip(chart.boxes, placed_chart.boxes, strict=True)
    ]  # fmt: skip
    arrows = []
    for arrow, route in zip(chart.arrows, placed_chart.arrows, strict=True):
        words = route.words and {"centre": list(route.words.centre), "width": route.words.width, "height": route.words.height}
        arrows.append(
            {
                "source": arrow.source, "target": arrow.target, "lines": list(route.lines), "interrupt": arrow.interrupt,
                "details": arrow.details, "points": [list(point) for point in route.points], "words": words,
            }
        )  # fmt: skip
    return {
        "species": species, "machine": machine, "title": chart.title, "width": placed_chart.width, "height": placed_chart.height,
        "boxes": boxes, "arrows": arrows,
    }  # fmt: skip
