"""The measures of a sweep's runs in each frame, and the table of these measures for all runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from antdsl.scene.values import FrameRange

SERIES_KEY = "series"  # the key of the series among the measures of a run
_MAX_SERIES_NUMBERS = 400_000  # of one run; longer runs store every second frame, or every third, and so on


class MeasureSeries:
    """Collects the measures of a run, frame by frame. `document`: a list for each measure, all of equal length; the list `frame`
    has the frame numbers."""

    def __init__(self, names: Sequence[str], frames: FrameRange) -> None:
        count = (frames.last - frames.first + 1) * (len(names) + 1)
        self.first, self.stride = frames.first, max(1, -(-count // _MAX_SERIES_NUMBERS))
        self.document: dict[str, list[Any]] = {"frame": [], **{name: [] for name in names}}

    def add_frame(self, frame: int, values: Mapping[str, float | int | None]) -> None:
        """Add the measures of one frame. In long runs, only frames at regular intervals are stored."""
        if values and (frame - self.first) % self.stride == 0:
            self.document["frame"].append(frame)
            for name, value in values.items():
                self.document[name].append(value)


def without_series(measures: Mapping[str, Any]) -> dict[str, Any]:
    """Return the measures of a run without the series, that is, only those that are single values."""
    return {name: value for name, value in measures.items() if name != SERIES_KEY}


def collect_series(runs: Sequence[tuple[Mapping[str, Any], Mapping[str, Any]]]) -> dict[str, list[Any]]:
    """Return the series of all runs as the columns of one table; {} if no run has a series.

    `runs`: for each run, the cells that identify it (by column), and its measures."""
    with_series = [(cells, measures[SERIES_KEY]) for cells, measures in runs if SERIES_KEY in measures]
    heads = list(dict.fromkeys(name for cells, _ in with_series for name in cells))
    names = list(dict.fromkeys(name for _, series in with_series for name in series))
    columns: dict[str, list[Any]] = {name: [] for name in (*heads, *names)}
    for cells, series in with_series:
        count = len(series["frame"])
        for name in heads:
            columns[name] += [cells.get(name)] * count
        for name in names:
            columns[name] += series.get(name, [None] * count)
    return columns
