"""Where agents of a cache were and will be: their places in the frames before and after one, and their rows in the frame
after, for what moves while a shutter is open."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.body import turned
from antdsl.outputs.cache.cache_reader import Cache, CacheError
from antdsl.outputs.pictures.model import Crowd, Paths
from antdsl.scene.quantities import QuantityError, parse_number_range

_MOVED = ("position", "orient", "plays", "feet", "driven")
MOST_SECONDS = 60.0  # of each side of a window
_LIFT = 0.06  # of a body's length: how far above the ground a path is drawn, along the agent's up
_READ = frozenset(["P", "orient", "pscale", "id", "species"])


@dataclass(frozen=True, slots=True)
class Window:
    """Seconds before a frame and after it."""

    seconds_before: float = 1.0
    seconds_after: float = 2.0

    @staticmethod
    def of(text: str) -> Window | None:
        """Parse text such as `1..2`; None for other text, or for more than MOST_SECONDS."""
        try:
            seconds = parse_number_range(text)
        except QuantityError:
            return None
        return Window(*seconds) if min(seconds) >= 0 and max(seconds) <= MOST_SECONDS else None


@dataclass(frozen=True, slots=True, eq=False)
class _FrameAgents:
    """The agents of a frame: positions slightly above the ground, float32[n,3]; ids and species, in ascending order of both."""

    place: NDArray[np.float32]
    ids: NDArray[np.int64]
    species: NDArray[np.int64]


class Walks:
    """The frames around those that are drawn, each read once as long as the requested frames are in order."""

    def __init__(self, cache: Cache, dt: float, window: Window) -> None:
        self._cache, self._window = cache, window
        self._before, self._after = round(window.seconds_before / dt), round(window.seconds_after / dt)
        self._there = frozenset(cache.frames())
        self._kept: OrderedDict[int, _FrameAgents | None] = OrderedDict()

    def at(self, frame: int, species: int, ids: NDArray[np.int64]) -> Paths:
        """Return the paths of some agents of one species; NaN in frames that do not exist or lack the agent."""
        positions = np.full((len(ids), self._before + 1 + self._after, 3), np.nan)
        for k in range(positions.shape[1]):
            frame_agents = self._agents_at(frame - self._before + k)
            if frame_agents is None:
                continue
            first, last = np.searchsorted(frame_agents.species, (species, species + 1))
            own = frame_agents.ids[first:last]
            if not len(own):
                continue
            row = np.minimum(np.searchsorted(own, ids), len(own) - 1)
            known = own[row] == ids
            positions[known, k] = frame_agents.place[first:last][row[known]]
        return Paths(positions, self._before)

    def _agents_at(self, frame: int) -> _FrameAgents | None:
        if frame not in self._there:
            return None
        if frame not in self._kept:
            while len(self._kept) > self._before + self._after + 1:
                self._kept.popitem(last=False)
            self._kept[frame] = self._read(frame)
        self._kept.move_to_end(frame)
        return self._kept[frame]

    def _read(self, frame: int) -> _FrameAgents | None:
        try:
            arrays = self._cache.frame(frame, _READ)
        except CacheError:  # a damaged frame leaves a gap in the lines
            return None
        place = np.asarray(arrays["P"], np.float64)
        up = turned(np.asarray(arrays["orient"], np.float64), np.tile([0.0, 1.0, 0.0], (len(place), 1)))
        place = place + _LIFT * np.asarray(arrays["pscale"], np.float64)[:, None] * up
        ids = np.asarray(arrays["id"], np.int64) if "id" in arrays else np.arange(len(place))
        species = np.asarray(arrays["species"], np.int64) if "species" in arrays else np.zeros(len(place), np.int64)
        order = np.lexsort((ids, species))
        return _FrameAgents(place[order].astype(np.float32), ids[order], species[order])


def follow_agents(now: Crowd, later: Crowd) -> Crowd:
    """Return the agents of `now`, in its order, with their values in `later`, which may have another order. Agents missing in
    `later` are unchanged. Both have ids."""
    own, ids = np.asarray(now.ids), np.asarray(later.ids)
    order = np.argsort(ids, kind="stable")
    at, is_present = match_ids(own, ids[order])
    rows = len(ids) + np.arange(len(own))
    rows[is_present] = order[at[is_present]]
    joined_fields = {
        name: _join_rows(getattr(later, name), getattr(now, name)) for name in ("position", "orient", "plays", "feet", "driven")
    }
    joined_crowd = replace(now, **joined_fields, paths=None)
    return replace(
        now,
        position=joined_crowd.position[rows],
        orient=joined_crowd.orient[rows],
        plays=tuple(each.rows(rows) for each in joined_crowd.plays),
        feet=None if joined_crowd.feet is None else joined_crowd.feet.rows(rows),
        driven=joined_crowd.driven.rows(rows),
        next_crowd=None,
    )


def match_ids(ids: NDArray[np.int64], others: NDArray[np.int64]) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Return the index of each id among others, which ascend, and whether it is among them."""
    if len(ids) == len(others) and np.array_equal(ids, others):
        return np.arange(len(ids)), np.ones(len(ids), np.bool_)
    at = np.minimum(np.searchsorted(others, ids), max(len(others) - 1, 0))
    return at, others[at] == ids if len(others) else np.zeros(len(ids), np.bool_)


def _join_rows(one: Any, other: Any) -> Any:
    """Return the rows of both, concatenated; None where one of them is None."""
    if one is None or other is None:
        return None
    if isinstance(one, np.ndarray):
        return np.concatenate([one, other])
    if isinstance(one, Mapping):
        return {name: _join_rows(each, other[name]) for name, each in one.items() if name in other}
    if isinstance(one, tuple):
        return tuple(_join_rows(a, b) for a, b in zip(one, other, strict=False))
    if not is_dataclass(one) or isinstance(one, type):
        return one  # one for all rows
    return type(one)(*(_join_rows(getattr(one, field.name), getattr(other, field.name)) for field in fields(one)))
