"""The edit `smooth`: orientations and positions are averaged over several frames.

A run itself cannot do this, because it does not know later frames."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, model_validator

from antdsl.bodies.agents.transforms import Floats
from antdsl.outputs.cache.cache_reader import Arrays, CacheError, make_frame_path
from antdsl.outputs.cache.frame_agents import IDENTITY_ARRAYS, get_species_numbers, make_agent_keys
from antdsl.outputs.edits.edit_layer import AgentsLine, EditLayer
from antdsl.outputs.edits.frame_rows import match_rows
from antdsl.outputs.edits.grounding import Grounds, move_on_ground
from antdsl.outputs.edits.verbs.agent_moves import make_moves
from antdsl.scene.notes.selectors import Selector
from antdsl.scene.values import make_value_error, parse_integer_between

MIN_SMOOTHING_FRAMES, MAX_SMOOTHING_FRAMES = 3, 99  # frames


def parse_window(value: object) -> int:
    """Return the number of frames in a window. It must be odd, so that it has as many frames before its middle as after it."""
    width = parse_integer_between(MIN_SMOOTHING_FRAMES, MAX_SMOOTHING_FRAMES)(value)
    if width % 2 == 0:
        raise make_value_error(
            f"`{width}` is not odd", f"write `{width + 1}`, for {width // 2} frames before and {width // 2} after"
        )
    return width


Window = Annotated[int, BeforeValidator(parse_window)]


class SmoothLine(AgentsLine):
    """Replaces orientations by means over `orient` frames, and positions by means over `position` frames.

    Half of these frames are before a frame, half after it."""

    verb = "smooth"
    agents: Selector = Field(alias="smooth")
    orient: Window | None = None
    position: Window | None = None

    @model_validator(mode="after")
    def _check_one(self) -> SmoothLine:
        if self.orient is None and self.position is None:
            raise make_value_error(
                "`smooth` needs `orient` or `position`", "write `orient: 9`, for four frames before and four after"
            )
        return self


@dataclass(frozen=True, slots=True, eq=False)
class FrameValues:
    """One quantity of the agents in a frame. `key` int64[n]: the agents. `values` float64[n, k]. Rotations are unit
    quaternions."""

    key: NDArray[np.int64]
    values: Floats


@dataclass(frozen=True, eq=False)
class SmoothLayer(EditLayer):
    """A view of a cache with smoothed orientations and positions. The values of a window of frames are cached in memory."""

    line: SmoothLine
    required_arrays = ("id", "orient")
    _orientations: dict[int, FrameValues] = field(default_factory=dict, init=False)
    _positions: dict[int, FrameValues] = field(default_factory=dict, init=False)

    def change_frame(self, number: int, arrays: Arrays) -> Arrays:
        """Return a frame with smoothed values of the selected agents."""
        is_selected = self.selection.find(make_agent_keys(arrays))
        rows, changed = np.flatnonzero(is_selected), dict(arrays)
        if self.line.position is not None and "P" in arrays and len(rows):
            self._read_window(self._positions, number, self.line.position, ("P", "v"))
            changed |= self._place(number, arrays, rows, average_values(self._positions, number, self.line.position)[rows])
        if self.line.orient is not None:
            self._read_window(self._orientations, number, self.line.orient, ("orient",))
            smooth = average_rotations(self._orientations, number, self.line.orient)
            changed["orient"] = np.where(is_selected[:, None], smooth, arrays["orient"]).astype(np.float32)
        return changed

    def _place(self, number: int, arrays: Arrays, rows: NDArray[np.intp], values: Floats) -> dict[str, NDArray[np.float32]]:
        """Return the arrays of positions and velocities of a frame, with the positions `values` for the agents in `rows`.

        Agents retain their height above the ground, and feet do not move."""
        changed = {name: arrays[name].copy() for name in ("P", "v") if name in arrays}
        if "v" in changed:
            changed["v"][rows] = values[:, 3:]
        ground = self.inputs.ground.at(number) if self.inputs.ground and "pscale" in arrays else None
        moves = make_moves(rows, values[:, :3])
        moved = {"P": changed["P"]} if ground is None else move_on_ground(arrays, self.manifest, moves, Grounds(ground, ground))
        changed["P"][rows] = values[:, :3] if ground is None else moved["P"][rows]
        return changed

    def _read_window(self, values_by_frame: dict[int, FrameValues], number: int, width: int, names: tuple[str, ...]) -> None:
        """Read the values of the frames around `number` into `values_by_frame`, and remove all other frames."""
        half, existing_frames = width // 2, set(self.frames())
        for each in range(number - half, number + half + 1):
            if each in existing_frames and each not in values_by_frame:
                values_by_frame[each] = self._read_values(each, names)
        for other in [each for each in values_by_frame if abs(each - number) > half]:
            del values_by_frame[other]

    def _read_values(self, number: int, names: tuple[str, ...]) -> FrameValues:
        """Return the values of the arrays `names` in a frame, concatenated along the last axis."""
        arrays = self.source.frame(number, IDENTITY_ARRAYS | set(names))
        ids, parts = arrays.get("id"), [arrays[name] for name in names if name in arrays]
        if ids is None or ids.ndim != 1 or not parts or any(part.ndim != 2 or len(part) != len(ids) for part in parts):
            raise CacheError(f"`{make_frame_path(self.folder, number)}` has no matching ids and {' or '.join(names)}")
        if get_species_numbers(arrays).shape != ids.shape:
            raise CacheError(f"`{make_frame_path(self.folder, number)}` does not have a species for each agent")
        return FrameValues(make_agent_keys(arrays), np.concatenate(parts, axis=1).astype(np.float64))


def average_values(frames: Mapping[int, FrameValues], frame: int, width: int) -> Floats:
    """Return the values [n, k] of a frame, averaged over `width` frames, half of them before the frame and half after it.

    The weights are a raised cosine (J. von Hann's window). An agent's average uses the same number of frames on both sides, and
    only frames in which it exists without a gap. So its first and last values do not change, and it does not lag."""
    total, weight = _sum_values(frames, frame, width, are_rotations=False)
    return np.where(np.isfinite(total), total / weight[:, None], frames[frame].values)


def average_rotations(frames: Mapping[int, FrameValues], frame: int, width: int) -> NDArray[np.float32]:
    """Return the orientations [n, 4] of a frame, averaged in the same way as by `average_values`.

    Each quaternion is added with the sign that is nearer to its neighbour on the side of `frame`, and the sum is normalised.
    For small angles, this is the mean of F. L. Markley et al., Averaging Quaternions, J. Guidance, Control, and Dynamics 30
    (2007)."""
    total, _ = _sum_values(frames, frame, width, are_rotations=True)
    size = np.sqrt((total * total).sum(axis=1))
    good = np.isfinite(size) & (size > 1e-6)
    return np.where(good[:, None], total / np.where(good, size, 1.0)[:, None], frames[frame].values).astype(np.float32)


def _sum_values(frames: Mapping[int, FrameValues], frame: int, width: int, *, are_rotations: bool) -> tuple[Floats, Floats]:
    """Return the weighted sums [n, k] of values over a window, and the sums of weights [n]."""
    current, half = frames[frame], width // 2
    sides = [_collect_side_values(frames, frame, direction, half, are_rotations) for direction in (-1, 1)]
    reach = np.minimum(sides[0][1], sides[1][1])
    total, weights = current.values.copy(), np.ones(len(current.key))
    for k in range(half):
        angle = np.minimum((k + 1) / (reach + 1), 1.0) * np.pi  # beyond its reach, an agent has weight 0
        weight = 0.5 + 0.5 * np.cos(angle)
        total += weight[:, None] * (sides[0][0][k] + sides[1][0][k])
        weights += 2 * weight
    return total, weights


def _collect_side_values(
    frames: Mapping[int, FrameValues], frame: int, direction: int, frame_count: int, are_rotations: bool
) -> tuple[list[Floats], NDArray[np.int64]]:
    """Return, for the agents of a frame, their values in up to `frame_count` frames on one side, nearest first. Also return the
    number of these frames in which each agent exists without a gap.

    `direction`: -1 for earlier frames, 1 for later frames."""
    current = frames[frame]
    last, is_present, count = current.values, np.ones(len(current.key), np.bool_), np.zeros(len(current.key), np.int64)
    values = []
    for k in range(1, frame_count + 1):
        other = frames.get(frame + direction * k)
        if other is None or not len(other.key):
            is_present[:] = False
        else:
            at, is_there = match_rows(current.key, other.key)
            is_present &= is_there
            own = np.where(is_present[:, None], other.values[at], last)
            last = np.where((own * last).sum(axis=1)[:, None] < 0, -own, own) if are_rotations else own
        count[is_present] = k
        values.append(last)
    return values, count
