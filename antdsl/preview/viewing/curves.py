"""Curves of counts, totals and spec results over time. New values are sent to pages as they appear."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from antdsl.preview.timeline import Timeline, TimelineBranch

# Points of a history, and of a branch: of a longer one every so many frames are sent
_MAX_HISTORY_POINTS, _MAX_BRANCH_POINTS = 4000, 1000


class SentCurveTracker:
    """A tracker of the curve values of a session that all pages have already received."""

    def __init__(self) -> None:
        self._timeline: Timeline | None = None
        self._last_sent_frame: int | None = None
        self._highest_sent_frame = 0  # the last frame that was sent, again or not
        self._sent_branches: list[TimelineBranch] = []

    def mark_unsent_from(self, frame: int) -> None:
        """Record that the values of `frame` and of all later frames must be sent again, because these frames will be simulated
        again."""
        if self._last_sent_frame is not None and self._last_sent_frame >= frame:
            self._last_sent_frame = frame - 1

    def pop_new_values(self, timeline: Timeline) -> dict[str, Any] | None:
        """Return the values that pages have not received yet, or None if there are none."""
        if timeline is not self._timeline or timeline.branches != self._sent_branches or self._last_sent_frame is None:
            return self.take_full_history(timeline)
        fresh = []
        for frame in reversed(timeline.curves):
            if frame <= self._last_sent_frame:
                break
            fresh.append(frame)
        if not fresh:
            return None
        again = fresh[-1] <= self._highest_sent_frame
        self._last_sent_frame = self._highest_sent_frame = max(fresh)
        return _make_curves_message(again, {frame: timeline.curves[frame] for frame in reversed(fresh)}, None)

    def take_full_history(self, timeline: Timeline) -> dict[str, Any]:
        """Return the complete history with its branches, and mark it as sent."""
        self._timeline, self._sent_branches = timeline, list(timeline.branches)
        self._last_sent_frame = self._highest_sent_frame = timeline.last_frame
        branches = [
            {"first": branch.first, "line": branch.reason, **_make_curve_columns(thin_curves(branch.curves, _MAX_BRANCH_POINTS))}
            for branch in timeline.branches
        ]
        return _make_curves_message(True, thin_curves(timeline.curves, _MAX_HISTORY_POINTS), branches)


def _make_curves_message(
    reset: bool, curves: Mapping[int, Mapping[str, float]], branches: list[dict[str, Any]] | None
) -> dict[str, Any]:
    return {"op": "curves", "reset": reset, **_make_curve_columns(curves), "branches": branches}


def _make_curve_columns(curves: Mapping[int, Mapping[str, float]]) -> dict[str, Any]:
    """Return one list of values per curve, by name, with null for frames without a value."""
    names = dict.fromkeys(name for values in curves.values() for name in values)
    return {
        "frames": list(curves),
        "values": {name: [_drop_nonfinite(values.get(name)) for values in curves.values()] for name in names},
    }


def _drop_nonfinite(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else round(value, 6)


def thin_curves(curves: Mapping[int, Mapping[str, float]], max_frames: int) -> Mapping[int, Mapping[str, float]]:
    """Return at most `max_frames` frames of the curves, evenly spaced and including the last."""
    if len(curves) <= max_frames:
        return curves
    frames = list(curves)
    step = -(-len(frames) // max_frames)
    return {frame: curves[frame] for frame in sorted({*frames[::step], frames[-1]})}
