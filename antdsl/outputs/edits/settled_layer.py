"""Agents that were simulated again because of edits. Their frames are stored with the edits, and shown in a view of the cache."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.outputs.cache.cache_reader import Arrays, CacheError, CacheView, select_arrays
from antdsl.outputs.edits.frame_rows import join_frames, keep_rows

SETTLED_PREFIX = "settled."  # of the names of the arrays in the file of the edits
_KEYS, _BEGINS, _FRAMES, _COUNTS = (f"{SETTLED_PREFIX}{name}" for name in ("keys", "begins", "frames", "counts."))
_ROWS = f"{SETTLED_PREFIX}rows."


@dataclass(frozen=True, slots=True, eq=False)
class SettledFrames:
    """The frames of agents that were simulated again.

    `keys` int64[n]: the agents (`make_agent_keys`). `first_frames` int64[n]: the last frame that each agent has from the edits,
    before the new simulation. `frames`: by frame number, the rows of these agents in the arrays of the frame."""

    keys: NDArray[np.int64]
    first_frames: NDArray[np.int64]
    frames: Mapping[int, Arrays]

    @staticmethod
    def of(frames: Mapping[int, Arrays], first_frames: Mapping[int, int]) -> SettledFrames:
        """Return frames of agents as SettledFrames. `first_frames`: by the key of the agent, as in `SettledFrames`."""
        keys = np.array(sorted(first_frames), np.int64)
        return SettledFrames(keys, np.array([first_frames[key] for key in keys.tolist()], np.int64), frames)

    def describe_agents(self) -> str:
        """Return a text that gives the number of agents and the range of frames."""
        count = len(self.keys)
        return f"{count:,} agent{'' if count == 1 else 's'} in frames {min(self.frames)} to {max(self.frames)}"

    def pack(self) -> dict[str, NDArray[Any]]:
        """Return arrays that store these frames. Rows of all frames are concatenated."""
        names = sorted({name for arrays in self.frames.values() for name in arrays})
        packed: dict[str, NDArray[Any]] = {
            _KEYS: self.keys,
            _BEGINS: self.first_frames,
            _FRAMES: np.array([*self.frames], np.int64),
        }
        for name in names:
            parts = [arrays[name] for arrays in self.frames.values() if name in arrays]
            counts = [len(arrays[name]) if name in arrays else -1 for arrays in self.frames.values()]
            packed |= {f"{_COUNTS}{name}": np.array(counts, np.int64), f"{_ROWS}{name}": np.concatenate(parts)}
        return packed

    @staticmethod
    def unpack(arrays: Mapping[str, NDArray[Any]]) -> SettledFrames | None:
        """Return the frames that `pack` has stored in these arrays. None if there are none. Raises CacheError if the arrays are
        damaged."""
        if _KEYS not in arrays:
            return None
        try:
            numbers = arrays[_FRAMES].tolist()
            frames: dict[int, dict[str, NDArray[Any]]] = {number: {} for number in numbers}
            for name, counts in arrays.items():
                if not name.startswith(_COUNTS):
                    continue
                own, rows = name.removeprefix(_COUNTS), arrays[_ROWS + name.removeprefix(_COUNTS)]
                ends = np.cumsum(np.maximum(counts, 0))
                if len(counts) != len(numbers) or ends[-1] != len(rows):
                    raise ValueError(name)
                for number, count, end in zip(numbers, counts.tolist(), ends.tolist(), strict=True):
                    if count >= 0:
                        frames[number][own] = rows[end - count : end]
            keys, begins = (arrays[name].astype(np.int64) for name in (_KEYS, _BEGINS))
            if keys.shape != begins.shape or not frames:
                raise ValueError(_KEYS)
        except (KeyError, ValueError, TypeError, IndexError) as why:
            raise CacheError(f"the settled agents of its edits are damaged: {why}") from None
        return SettledFrames(keys, begins, frames)


@dataclass(frozen=True, eq=False)
class SettledLayer(CacheView):
    """A view of a cache in which some agents are replaced by their new simulation."""

    settled: SettledFrames

    def frame(self, number: int, names: frozenset[str] | None = None) -> Arrays:
        """Return the arrays of a frame with these agents. `names`: the arrays to return; None for all."""
        if number not in self.settled.frames:
            return self.source.frame(number, names)
        keys = self.settled.keys[self.settled.first_frames < number]
        others = keep_rows(self.source.frame(number), self.manifest, lambda agent_keys: ~np.isin(agent_keys, keys))
        return select_arrays(join_frames(others, self.settled.frames[number], self.manifest), names)
