"""Paths of agents in a cache: the positions of each agent in the frames around a given frame.

Also finds the same agents in the next frame, for motion blur."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.body import rotate_vectors
from antdsl.numerics.records import join_record_rows, match_ids, select_record_rows
from antdsl.outputs.cache.cache_reader import Cache, CacheError
from antdsl.outputs.cache.frame_agents import IDENTITY_ARRAYS, get_agent_ids, get_species_numbers
from antdsl.outputs.pictures.model import AgentPathLines, Crowd
from antdsl.scene.quantities import QuantityError, parse_number_range

_INTERPOLATED_FIELDS = ("position", "orient", "machine_clips", "feet", "driven_pose")
MAX_WINDOW_SECONDS = 60.0  # maximum on each side of a window
_PATH_LIFT_PER_BODY = 0.06  # body lengths; height of a drawn path above the ground, along the agent's up
_READ_ARRAYS = frozenset(("P", "orient", "pscale", *IDENTITY_ARRAYS))


@dataclass(frozen=True, slots=True)
class PathWindow:
    """The time span that a path covers before and after a frame, in seconds."""

    seconds_before: float = 1.0
    seconds_after: float = 2.0

    @staticmethod
    def parse(text: str) -> PathWindow | None:
        """Return the window that a text such as `1..2` (seconds before and after) describes.

        None for any other text, or if one side exceeds MAX_WINDOW_SECONDS."""
        try:
            seconds = parse_number_range(text)
        except QuantityError:
            return None
        return PathWindow(*seconds) if min(seconds) >= 0 and max(seconds) <= MAX_WINDOW_SECONDS else None


class AgentPaths:
    """Reader of the paths of agents around the frame of a picture. If frames are requested in ascending order, each file is read
    only once."""

    def __init__(self, cache: Cache, dt: float, window: PathWindow) -> None:
        self._cache = cache
        self._frames_before, self._frames_after = round(window.seconds_before / dt), round(window.seconds_after / dt)
        self._existing_frames = frozenset(cache.frames())
        self._cached_frames: OrderedDict[int, dict[str, NDArray[Any]] | None] = OrderedDict()

    def get_paths(self, frame: int, species: int, ids: NDArray[np.int64]) -> AgentPathLines:
        """Return the paths of the agents `ids` of a species. Positions are NaN in frames that do not exist or do not contain the
        agent."""
        positions = np.full((len(ids), self._frames_before + 1 + self._frames_after, 3), np.nan)
        for k in range(positions.shape[1]):
            frame_agents = self._get_agents(frame - self._frames_before + k)
            if frame_agents is None:
                continue
            first, last = np.searchsorted(frame_agents["species"], (species, species + 1))
            row, known = match_ids(ids, frame_agents["ids"][first:last])
            positions[known, k] = frame_agents["place"][first:last][row[known]]
        return AgentPathLines(positions, self._frames_before)

    def _get_agents(self, frame: int) -> dict[str, NDArray[Any]] | None:
        """Return the agents of a frame in the form of `_read_agents`. Recently read frames are cached."""
        if frame not in self._existing_frames:
            return None
        if frame not in self._cached_frames:
            while len(self._cached_frames) > self._frames_before + self._frames_after + 1:
                self._cached_frames.popitem(last=False)
            self._cached_frames[frame] = self._read_agents(frame)
        self._cached_frames.move_to_end(frame)
        return self._cached_frames[frame]

    def _read_agents(self, frame: int) -> dict[str, NDArray[Any]] | None:
        """Return the agents of a frame, sorted by species and id. None if the frame cannot be read.

        The arrays are `ids`, `species` (species numbers), and `place` float32[n, 3] (positions slightly above the ground)."""
        try:
            arrays = self._cache.frame(frame, _READ_ARRAYS)
        except CacheError:  # a damaged frame leaves a gap in the lines
            return None
        place = np.asarray(arrays["P"], np.float64)
        up = rotate_vectors(np.asarray(arrays["orient"], np.float64), np.tile([0.0, 1.0, 0.0], (len(place), 1)))
        place = place + _PATH_LIFT_PER_BODY * np.asarray(arrays["pscale"], np.float64)[:, None] * up
        ids, species = get_agent_ids(arrays), get_species_numbers(arrays)
        agents: dict[str, NDArray[Any]] = {"place": place.astype(np.float32), "ids": ids, "species": species}
        return select_record_rows(agents, np.lexsort((ids, species)))


def match_agents(crowd: Crowd, next_crowd: Crowd) -> Crowd:
    """Return `crowd` with the values that its agents have in `next_crowd`, in the order of `crowd`. Both crowds must have ids.

    The agents of `next_crowd` may be in any order. Agents missing there keep the values of `crowd`."""
    own, ids = np.asarray(crowd.ids), np.asarray(next_crowd.ids)
    order = np.argsort(ids, kind="stable")
    at, is_present = match_ids(own, ids[order])
    rows = len(ids) + np.arange(len(own))
    rows[is_present] = order[at[is_present]]
    joined = {name: join_record_rows(getattr(next_crowd, name), getattr(crowd, name)) for name in _INTERPOLATED_FIELDS}
    return replace(crowd, **select_record_rows(joined, rows), next_crowd=None)
