"""The ids of a crowd line's agents, in the order of their creation.

The agents of a line are numbered from 0. Changes of other lines do not change these numbers."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class CrowdLineIds:
    """The ids of all agents of a crowd line, including dead agents. `ranges`: pairs of a first id and the number of consecutive
    ids."""

    species: str
    ranges: tuple[tuple[int, int], ...] = ()

    def __len__(self) -> int:
        return sum(count for _, count in self.ranges)

    def list_ids_between(self, first: int = 0, last: int | None = None) -> NDArray[np.int64]:
        """Return the ids of the agents with the positions `first` to `last` in the line. Both are included and counted from 0.
        Positions without an agent are omitted."""
        ids = [np.empty(0, np.int64), *(np.arange(start, start + count) for start, count in self.ranges)]
        return np.concatenate(ids)[first : None if last is None else last + 1]

    def find_positions_in_line(self, ids: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the position in this line, counted from 0, of the agent with each id. It is -1 for agents of other lines."""
        numbers, offset = np.full(len(ids), -1, np.int64), 0
        for start, count in self.ranges:
            is_inside = (ids >= start) & (ids < start + count)
            numbers[is_inside] = ids[is_inside] - start + offset
            offset += count
        return numbers

    def resize(self, count: int, next_id: int) -> CrowdLineIds:
        """Return this line resized to `count` agents. If it shrinks, the first ids remain. If it grows, new agents get the ids
        from `next_id` on."""
        ranges, left = [], count
        for start, size in self.ranges:
            ranges.append((start, min(size, left)))
            left -= ranges[-1][1]
        return CrowdLineIds(self.species, _join_ranges([*ranges, (next_id, left)]))


def _join_ranges(ranges: Iterable[tuple[int, int]]) -> tuple[tuple[int, int], ...]:
    """Return the ranges with empty ones removed and adjacent ones joined."""
    joined: list[tuple[int, int]] = []
    for start, count in ranges:
        if joined and joined[-1][0] + joined[-1][1] == start:
            start, count = joined[-1][0], joined.pop()[1] + count
        if count:
            joined.append((start, count))
    return tuple(joined)
