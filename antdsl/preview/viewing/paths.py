"""Planned paths: where agents will be in the frames to come, of agents with paths that some page shows."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.preview.binary_packets import pack
from antdsl.preview.requests import EVERYBODY
from antdsl.preview.viewing.seen import Packets, Seen, Wanted

_EVERY = 0.1  # seconds between two of them while time goes on: a page leaves out past points automatically


class Paths:
    """The slot `paths`: each agent's places from frame `frame` of the header on; NaN where the agent does not exist."""

    def __init__(self) -> None:
        self._last: tuple[int, Wanted] | None = None
        self._sent = 0.0

    def packets(self, seen: Seen) -> Packets:
        if seen.wanted.planned is None:
            if self._last is not None:
                self._last = None
                yield "paths", pack("paths", {}, frame=0, count=0)
            return
        now = (seen.ahead.version, seen.wanted)
        if now == self._last or (seen.going and self._last is not None and seen.now - self._sent < _EVERY):
            return
        self._last, self._sent = now, seen.now
        first, arrays = min(seen.ahead.frames, default=0), _paths(seen)
        yield "paths", pack("paths", arrays, frame=first, count=len(seen.ahead.frames))


def _paths(seen: Seen) -> dict[str, NDArray[Any]]:
    """By species `NAME/id` int32 (n) and `NAME/path` float32 (n, frames, 3)."""
    ahead, wanted, found = seen.ahead, seen.wanted, dict[str, NDArray[Any]]()
    if not ahead.frames:
        return found
    here, everybody = ahead.frames[min(ahead.frames)], wanted.planned_of_all and len(seen.world) <= EVERYBODY
    for name, places in here.items():
        ids = np.array(sorted({who.agent for who in wanted.planned or () if who.species == name}), np.int64)
        ids = ids[np.isin(ids, places.ids)]
        if everybody:
            ids = places.ids
        if not len(ids):
            continue
        path = np.full((len(ids), len(ahead.frames), 3), np.nan, np.float32)
        for k, frame in enumerate(sorted(ahead.frames)):
            there = ahead.frames[frame].get(name)
            if there is None or not len(there.ids):
                continue
            at = np.minimum(np.searchsorted(there.ids, ids), len(there.ids) - 1)
            alive = there.ids[at] == ids
            path[alive, k] = there.position[at[alive]]
        found |= {f"{name}/id": ids.astype(np.int32), f"{name}/path": path}
    return found
