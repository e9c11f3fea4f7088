"""Edits of time: `hold` and `retime`. A frame shows agents as they are at another time in the cache below."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from antdsl.outputs.cache.cache_reader import Arrays, Cache, CacheError
from antdsl.outputs.cache.frame_agents import find_array_subject
from antdsl.outputs.edits.cache_selection import Selection
from antdsl.outputs.edits.edit_layer import AgentsLine, EditLayer
from antdsl.outputs.edits.edit_values import DEFAULT_EASE_FRAMES, FrameCount, FrameOffset, Speed
from antdsl.outputs.edits.frame_rows import join_frames, keep_rows
from antdsl.outputs.edits.verbs.agent_moves import blend_frames
from antdsl.scene.notes.selectors import Selector
from antdsl.scene.values import FrameRangeValue, make_value_error


class TimeLine(AgentsLine):
    """A line that changes the timing of agents. After `frames`, agents continue with a delay.

    `ease`: the number of frames before and after `frames` over which the speed changes.
    `catch_up`: the number of frames after these over which the delay is reduced to 0; without it, the delay remains."""

    ease: FrameCount = DEFAULT_EASE_FRAMES
    catch_up: FrameCount | None = None


class HoldLine(TimeLine):
    """Agents stand still in `frames`."""

    verb = "hold"
    agents: Selector = Field(alias="hold")
    frames: FrameRangeValue
    speed: ClassVar[float] = 0.0
    later: ClassVar[int | None] = None


class RetimeLine(TimeLine):
    """Agents move with another `speed` in `frames`, or `later` by a number of frames in all frames."""

    verb = "retime"
    agents: Selector = Field(alias="retime")
    speed: Speed | None = None
    later: FrameOffset | None = None

    @model_validator(mode="after")
    def _check_one(self) -> RetimeLine:
        if (self.speed is None) == (self.later is None):
            raise make_value_error("`retime` needs either `speed` or `later`", "write `frames: 100..150, speed: 50 %`")
        if self.later is not None and self.frames is not None:
            raise make_value_error("`later` applies to all frames", "leave `frames` out, or write `speed` instead")
        return self


@dataclass(frozen=True, slots=True)
class TimeMap:
    """The time in the cache below that each frame shows.

    From frame `first` to `last`, time passes at `speed`. `ease`, `catch_up`: as in `TimeLine`. `shift`: frames that are added to
    all times."""

    first: float
    last: float
    speed: float = 1.0
    ease: int = 0
    catch_up: int | None = None
    shift: float = 0.0

    def find_time(self, frame: float) -> tuple[float, float]:
        """Return the time in the cache below that a frame shows (in frames), and the speed of time there."""
        delay, slowness = self._find_delay(frame)
        return frame + self.shift - delay, 1.0 - slowness

    def _find_delay(self, frame: float) -> tuple[float, float]:
        """Return the delay at a frame, in frames, and by how much it grows per frame."""
        slowness, ease = 1.0 - self.speed, float(self.ease)
        if frame < self.first - ease:
            return 0.0, 0.0
        if frame < self.first:
            eased = frame - self.first + ease
            return slowness * eased * eased / (2 * ease), slowness * eased / ease
        if frame <= self.last:
            return slowness * (ease / 2 + frame - self.first), slowness
        left = self.last + ease - frame
        delay = slowness * (ease + self.last - self.first)
        if left > 0:
            return delay - slowness * left * left / (2 * ease), slowness * left / ease
        if self.catch_up is None:
            return delay, 0.0
        share = min(-left / self.catch_up, 1.0) if self.catch_up else 1.0
        rate = 6 * share * (1 - share) / self.catch_up if self.catch_up else 0.0
        return delay * (1 - share * share * (3 - 2 * share)), -delay * rate


def read_agents_at(cache: Cache, time: float, selection: Selection) -> dict[str, NDArray[Any]]:
    """Return the selected agents of a cache at a time, given in frames.

    Positions and orientations are interpolated between two frames. All other values are those of the nearer frame. Before the
    first frame and after the last, the time is that of this frame."""
    frames = cache.frames()
    if not frames:
        raise CacheError(f"`{cache.folder}` has no frames")
    time = min(max(time, frames[0]), frames[-1])
    nearest = int(np.floor(time + 0.5))
    share = 0.0 if abs(time - nearest) < 1e-9 else time - nearest
    own = keep_rows(cache.frame(nearest), cache.manifest, selection.find)
    return blend_frames(own, cache.frame(nearest + (1 if share > 0 else -1)), share, cache.manifest) if share else own


def read_shifted(cache: Cache, time_map: TimeMap, number: int, selection: Selection) -> dict[str, NDArray[Any]]:
    """Return the selected agents of a cache at the time that frame `number` shows."""
    (time, speed), frames = time_map.find_time(number), cache.frames()
    agents = read_agents_at(cache, time, selection)
    speed = speed if frames[0] <= time <= frames[-1] else 0.0
    if speed != 1.0 and "v" in agents:
        agents = {**agents, "v": agents["v"] * np.float32(speed)}
    if np.floor(time + 0.5) == np.floor(time_map.find_time(number - 1)[0] + 0.5):  # a frame before had its events
        agents = {name: array[:0] if find_array_subject(name) == "event" else array for name, array in agents.items()}
    return agents


@dataclass(frozen=True, eq=False)
class TimeLayer(EditLayer):
    """A view of a cache in which some agents are shown at another time."""

    line: HoldLine | RetimeLine
    stored_frames = 4

    @property
    def time_map(self) -> TimeMap:
        """Return the time map of the edit."""
        line, frames = self.line, self.line.frames
        if line.later is not None or line.speed is None:
            return TimeMap(self.manifest.first, self.manifest.last, shift=-float(line.later or 0))
        first, last = frames or (self.manifest.first, self.manifest.last)
        return TimeMap(first, last, line.speed, line.ease if frames else 0, line.catch_up)

    def is_active(self, number: int) -> bool:
        """Return whether frame `number` shows another time."""
        time, speed = self.time_map.find_time(number)
        return time != number or speed != 1.0

    def change_frame(self, number: int, arrays: Arrays) -> Arrays:
        """Return a frame in which the selected agents are those of the time that it shows."""
        agents = read_shifted(self.source, self.time_map, number, self.selection)
        others = keep_rows(arrays, self.manifest, lambda keys: ~self.selection.find(keys))
        return join_frames(others, agents, self.manifest)
