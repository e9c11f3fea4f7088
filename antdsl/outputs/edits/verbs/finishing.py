"""Edits that read the result of all others: `smooth` and `mirror`.

A run cannot smooth over frames, because it does not know the next one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field

from antdsl.bodies.agents.transforms import Floats
from antdsl.bodies.body import build_orientations
from antdsl.outputs.cache.cache_reader import Arrays, CacheError, make_frame_path
from antdsl.outputs.cache.frame_agents import IDENTITY_ARRAYS, get_species_numbers, make_agent_keys
from antdsl.outputs.cache_bodies import CacheBodies
from antdsl.outputs.edits.edit_layer import AgentsLine, EditLayer
from antdsl.outputs.edits.frame_rows import FrameRows, match_rows
from antdsl.outputs.edits.grounding import Grounds, move_on_ground
from antdsl.outputs.edits.verbs.agent_moves import find_axes, make_moves
from antdsl.outputs.edits.verbs.terrain import MirroredTerrain
from antdsl.scene.crowds.body_choice import number_of_key, species_of_key
from antdsl.scene.notes.selectors import Selector
from antdsl.scene.thing_models import UNIT_MM
from antdsl.scene.values import Length, make_error, parse_integer_between, parse_one_of

MIN_SMOOTHING_FRAMES, MAX_SMOOTHING_FRAMES = 3, 99  # frames


def parse_window(value: object) -> int:
    """Return the number of frames of a window, which is odd, so that it has equally many before and after its middle."""
    width = parse_integer_between(MIN_SMOOTHING_FRAMES, MAX_SMOOTHING_FRAMES)(value)
    if width % 2 == 0:
        raise make_error(f"`{width}` is not odd", f"write `{width + 1}`, for {width // 2} frames before and {width // 2} after")
    return width


class SmoothLine(AgentsLine):
    """Replaces orientations by means over `orient` frames, half before and half after each frame. Positions stay."""

    verb = "smooth"
    agents: Selector = Field(alias="smooth")
    orient: Annotated[int, BeforeValidator(parse_window)]


class MirrorLine(AgentsLine):
    """Mirrors agents across a plane: the coordinate of `axis` is `at` on it."""

    verb = "mirror"
    agents: Selector = Field(alias="mirror")
    axis: Annotated[str, BeforeValidator(parse_one_of("x", "y", "z"))]
    at: Length | None = None


@dataclass(frozen=True, eq=False)
class SmoothLayer(EditLayer):
    """A view of a cache with smooth orientations. Memory holds the orientations of `line.orient` frames."""

    line: SmoothLine
    required_arrays = ("id", "orient")
    _near: dict[int, FrameOrientations] = field(default_factory=dict, init=False)

    def change_frame(self, number: int, arrays: Arrays) -> Arrays:
        """Return a frame with smooth orientations of the selected agents."""
        half, existing_frames = self.line.orient // 2, set(self.frames())
        for each in range(number - half, number + half + 1):
            if each in existing_frames and each not in self._near:
                self._near[each] = self._read_orientations(each)
        for other in [each for each in self._near if abs(each - number) > half]:
            del self._near[other]
        is_selected = self.selection.find(self._near[number].key)
        smooth = smooth_frame(self._near, number, self.line.orient)
        return {**arrays, "orient": np.where(is_selected[:, None], smooth, arrays["orient"]).astype(np.float32)}

    def _read_orientations(self, number: int) -> FrameOrientations:
        arrays = self.source.frame(number, IDENTITY_ARRAYS | {"orient"})
        orient, ids = arrays.get("orient"), arrays.get("id")
        if orient is None or ids is None or ids.ndim != 1 or orient.shape != (len(ids), 4):
            raise CacheError(f"`{make_frame_path(self.folder, number)}` has no matching ids and orientations")
        if get_species_numbers(arrays).shape != ids.shape:
            raise CacheError(f"`{make_frame_path(self.folder, number)}` does not have a species for each agent")
        return FrameOrientations(make_agent_keys(arrays), orient.astype(np.float64))


_LOCAL_SIGN = np.array([1.0, 1.0, -1.0])  # of vectors in the space of agents: their left becomes their right
_ROTATION_SIGN = np.array([-1.0, -1.0, 1.0, 1.0])  # of rotations there, x y z w


@dataclass(frozen=True, eq=False)
class MirrorLayer(EditLayer):
    """A view of a cache in which some agents are mirrored, each with its left and right. The ground is not mirrored: agents
    stay at their height above it."""

    line: MirrorLine
    required_arrays = ("id", "P", "orient", "pscale")

    def change_frame(self, number: int, arrays: Arrays) -> Arrays:
        """Return a frame with the selected agents mirrored."""
        rows = np.flatnonzero(self.selection.find(make_agent_keys(arrays)))
        if not len(rows):
            return arrays
        axis, unit_mm = "xyz".index(self.line.axis), UNIT_MM[self.manifest.units]
        at = (self.line.at.to_millimetres(unit_mm) / unit_mm if self.line.at else 0.0) - self.manifest.origin[axis]
        sign, shift = np.where(np.arange(3) == axis, -1.0, 1.0), np.where(np.arange(3) == axis, 2 * at, 0.0)
        mirrored = self._mirror_arrays(arrays, rows, sign, shift)
        ground = self.inputs.ground.at(number) if self.inputs.ground else None
        if ground is None:
            return mirrored
        moves = make_moves(rows, np.asarray(mirrored["P"], np.float64)[rows])
        return move_on_ground(mirrored, self.manifest, moves, Grounds(MirroredTerrain(ground, sign, shift), ground))

    def _mirror_arrays(self, arrays: Arrays, rows: NDArray[np.intp], sign: Floats, shift: Floats) -> dict[str, NDArray[Any]]:
        """Return a frame in which agents are mirrored without regard to the ground."""
        mirrored, table = dict(arrays), FrameRows(arrays, self.manifest)
        heading, up = find_axes(np.asarray(arrays["orient"], np.float64)[rows])
        for name, keys in table.iterate_agent_arrays():
            own = np.flatnonzero(np.isin(keys, table.keys[rows]))
            values = arrays[name][own]
            first, field = name.partition(".")[0], name.rpartition(".")[2]
            if name == "orient":
                values = build_orientations(heading * sign, up * sign).astype(np.float32)
            elif name == "P" or (first in ("feet", "events") and field == "P"):
                values = values * sign + shift
                values = values[:, self._pair_legs(name.split(".")[1])] if first == "feet" else values
            elif name in ("v", "v_ground") or (first == "events" and field == "N"):
                values = values * sign
            elif first == "feet" and field in ("down", "tilt"):
                values = values * _ROTATION_SIGN if field == "tilt" else values[:, self._pair_legs(name.split(".")[1])]
            elif first in ("looks", "leans"):
                values = values * (_LOCAL_SIGN if first == "looks" else np.array([-1.0, 1.0]))
            else:
                continue
            mirrored[name] = arrays[name].copy()
            mirrored[name][own] = values
        return mirrored

    @cached_property
    def _bodies(self) -> CacheBodies:
        return CacheBodies(self.manifest, self.read_static())

    def _pair_legs(self, key: str) -> NDArray[np.intp]:
        """Return for each leg of a body the leg on the other side."""
        number = next(k for k, entry in enumerate(self.manifest.species) if entry.name == species_of_key(key))
        body = self._bodies.body(number, which=number_of_key(key))
        feet = [body.definition.rig.joint(leg.foot) for leg in body.definition.legs]
        poses = body.compute_poses((), 1)
        feet_rest = np.asarray(poses.world[0, feet, :, 3], np.float64) @ body.definition.compute_base_matrix()[:3, :3].T
        square = ((feet_rest[:, None] - feet_rest[None] * _LOCAL_SIGN) ** 2).sum(axis=2)
        pairs: NDArray[np.intp] = square.argmin(axis=1)
        return pairs


@dataclass(frozen=True, slots=True, eq=False)
class FrameOrientations:
    """The agents of a frame: `key` int64[n], unique in the cache, and `orient` float64[n, 4], unit quaternions."""

    key: NDArray[np.int64]
    orient: NDArray[np.float64]


def smooth_frame(frames: Mapping[int, FrameOrientations], frame: int, width: int) -> NDArray[np.float32]:
    """Return the orientations [n, 4] of a frame as weighted means over `width` frames, half before the frame and half after it.

    Weights fall off as a raised cosine (J. von Hann's window). For each agent, the same number of frames is used on both sides:
    those in which it exists without a gap. So the orientation of an agent in its first or last frame is unchanged, and no agent
    lags.

    Each quaternion is added with the sign nearer to its neighbour on the side of `frame`, and the sum is normalised. For small
    angles this is the mean of F. L. Markley et al., Averaging Quaternions, J. Guidance, Control, and Dynamics 30 (2007)."""
    current, half = frames[frame], width // 2
    sides = [_collect_side_orientations(frames, frame, direction, half) for direction in (-1, 1)]
    reach = np.minimum(sides[0][1], sides[1][1])
    total = current.orient.copy()
    for k in range(half):
        angle = np.minimum((k + 1) / (reach + 1), 1.0) * np.pi  # beyond its reach, an agent has weight 0
        total += (0.5 + 0.5 * np.cos(angle))[:, None] * (sides[0][0][k] + sides[1][0][k])
    size = np.sqrt((total * total).sum(axis=1))
    good = np.isfinite(size) & (size > 1e-6)
    return np.where(good[:, None], total / np.where(good, size, 1.0)[:, None], current.orient).astype(np.float32)


def _collect_side_orientations(
    frames: Mapping[int, FrameOrientations], frame: int, direction: int, frame_count: int
) -> tuple[list[NDArray[np.float64]], NDArray[np.int64]]:
    """Return the orientations of a frame's agents in `frame_count` frames on one side, the nearest first.

    `direction`: -1 for the frames before, 1 for the frames after.
    The second result is the number of these frames in which each agent exists without a gap."""
    current = frames[frame]
    last, is_present, count = current.orient, np.ones(len(current.key), np.bool_), np.zeros(len(current.key), np.int64)
    orientations = []
    for k in range(1, frame_count + 1):
        other = frames.get(frame + direction * k)
        if other is None or not len(other.key):
            is_present[:] = False
        else:
            at, is_there = match_rows(current.key, other.key)
            is_present &= is_there
            orient = np.where(is_present[:, None], other.orient[at], last)
            last = np.where((orient * last).sum(axis=1)[:, None] < 0, -orient, orient)
        count[is_present] = k
        orientations.append(last)
    return orientations, count
