"""The ids of the agents of a crowd line, in the order of creation.

Agent number k of the line has the k-th id. Changes of other lines do not change these numbers."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class CrowdLineIds:
    """The ids of a crowd line's agents, including dead ones. `ranges`: the first id and the number of ids of each range."""

    species: str
    ranges: tuple[tuple[int, int], ...] = ()

    def __len__(self) -> int:
        return sum(count for _, count in self.ranges)

    def list_ids_between(self, first: int = 0, last: int | None = None) -> NDArray[np.int64]:
        """Return the ids of agents `first` to `last` of the line (numbers from 0, both included). Numbers without an agent are
        left out."""
        ids = [np.empty(0, np.int64), *(np.arange(start, start + count) for start, count in self.ranges)]
        return np.concatenate(ids)[first : None if last is None else last + 1]

    def find_positions_in_line(self, ids: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return, for each id, the number of the agent in this line; -1 for ids of other agents."""
        numbers, offset = np.full(len(ids), -1, np.int64), 0
        for start, count in self.ranges:
            is_inside = (ids >= start) & (ids < start + count)
            numbers[is_inside] = ids[is_inside] - start + offset
            offset += count
        return numbers

    def resize(self, count: int, next_id: int) -> CrowdLineIds:
        """Return this line resized to `count` agents. The first ids are retained; missing ones are numbered from `next_id`."""
        ranges, left = [], count
        for start, size in self.ranges:
            ranges.append((start, min(size, left)))
            left -= ranges[-1][1]
        return CrowdLineIds(self.species, _join_ranges([*ranges, (next_id, left)]))


def _join_ranges(ranges: Iterable[tuple[int, int]]) -> tuple[tuple[int, int], ...]:
    """Return ranges without empty ones, in which adjacent ranges are joined."""
    joined: list[tuple[int, int]] = []
    for start, count in ranges:
        if joined and joined[-1][0] + joined[-1][1] == start:
            start, count = joined[-1][0], joined.pop()[1] + count
        if count:
            joined.append((start, count))
    return tuple(joined)
