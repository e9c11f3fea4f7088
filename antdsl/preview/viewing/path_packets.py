"""Packets of planned paths: the positions in the coming frames of the agents that a page has selected."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.records import match_ids
from antdsl.preview.binary_packets import pack_arrays
from antdsl.preview.requests import MAX_PLANNED_AGENTS
from antdsl.preview.viewing.view_state import PageInterest, SlotPackets, ViewState

_UPDATE_INTERVAL_SECONDS = 0.1  # seconds between two of them while time goes on: a page leaves out past points automatically


class PathPackets:
    """A maker of the packet for the slot `paths`: the positions of each agent in the frames from `frame` (in the header) on.
    Positions are NaN in frames where the agent does not exist."""

    def __init__(self) -> None:
        self._last_key: tuple[int, PageInterest] | None = None
        self._last_sent_time = 0.0

    def make_packets(self, view_state: ViewState) -> SlotPackets:
        """Yield the packet of the planned paths if these changed. The rate of packets is limited."""
        if view_state.interest.planned_agents is None:
            if self._last_key is not None:
                self._last_key = None
                yield "paths", pack_arrays("paths", {}, frame=0, count=0)
            return
        now = (view_state.look_ahead.version, view_state.interest)
        if now == self._last_key or (
            view_state.is_advancing
            and self._last_key is not None
            and view_state.time - self._last_sent_time < _UPDATE_INTERVAL_SECONDS
        ):
            return
        self._last_key, self._last_sent_time = now, view_state.time
        first, arrays = min(view_state.look_ahead.frames, default=0), _make_path_arrays(view_state)
        yield "paths", pack_arrays("paths", arrays, frame=first, count=len(view_state.look_ahead.frames))


def _make_path_arrays(view_state: ViewState) -> dict[str, NDArray[Any]]:
    """Return, for each species NAME, the arrays `NAME/id` int32 (n) and `NAME/path` float32 (n, frames, 3)."""
    ahead, interest, arrays = view_state.look_ahead, view_state.interest, dict[str, NDArray[Any]]()
    if not ahead.frames:
        return arrays
    first_positions, is_for_all = (
        ahead.frames[min(ahead.frames)],
        interest.plans_all_agents and len(view_state.world) <= MAX_PLANNED_AGENTS,
    )
    for name, positions in first_positions.items():
        ids = np.array(sorted({who.agent for who in interest.planned_agents or () if who.species == name}), np.int64)
        ids = ids[np.isin(ids, positions["id"])]
        if is_for_all:
            ids = positions["id"]
        if not len(ids):
            continue
        path = np.full((len(ids), len(ahead.frames), 3), np.nan, np.float32)
        for k, frame in enumerate(sorted(ahead.frames)):
            later_positions = ahead.frames[frame].get(name)
            if later_positions is not None:
                at, is_alive = match_ids(ids, later_positions["id"])
                path[is_alive, k] = later_positions["position"][at[is_alive]]
        arrays |= {f"{name}/id": ids.astype(np.int32), f"{name}/path": path}
    return arrays
