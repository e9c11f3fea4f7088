"""The agents of a species at any time of a cache, by id, in a frame or between two frames.

Between two frames, positions and scales are interpolated linearly. Orientations rotate at a constant rate by the smaller angle.
This matches the velocities and angular velocities, which lead from a frame to the next. An agent that the next frame does not
contain continues at its last velocity."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.records import match_ids
from antdsl.numerics.vector_rows import dot
from antdsl.outputs.cache.cache_reader import Arrays
from antdsl.outputs.cache.frame_agents import find_species_rows, get_agent_ids, iterate_other_numbers
from antdsl.outputs.gallery import Gallery
from antdsl.outputs.pictures.model import Crowd, Picture

Floats = NDArray[np.float64]
_CACHED_FRAMES = 3  # frames in memory: the previous, the current and the next


@dataclass(frozen=True, slots=True, eq=False)
class SpeciesSample:
    """The agents of a species at one time, by ascending id.

    `ids`: int64[n]. `position` [n, 3], `orient` [n, 4] (unit quaternions x y z w), `scale` [n]. `colour`: float64[n, 3], display
    values. `velocity`: [n, 3], units per second. `angular_velocity`: [n, 3], degrees per second about world axes. `own_velocity`:
    [n, 3], velocity relative to the ground, as in the cache. `state`: int64[n], or None. `numbers`: other values, by name.
    `parts`: crowds with one body each, together with the rows of their agents. `is_visible`: bool[n], whether the position of the
    agent can be drawn."""

    ids: NDArray[np.int64]
    position: Floats
    orient: Floats
    scale: Floats
    colour: Floats
    velocity: Floats
    angular_velocity: Floats
    state: NDArray[np.int64] | None
    own_velocity: Floats
    numbers: dict[str, NDArray[np.generic]]
    parts: tuple[tuple[Crowd, NDArray[np.intp]], ...]
    is_visible: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class TimeSample:
    """The agents of all species at one time.

    `time`: the time in frames.
    `share`: the fraction of the time from its frame to the next frame, 0 to 1.
    `dt`: seconds between frames.
    `picture`: the frame at or before the time.
    `species`: the agents in this frame, by species.
    `next_agents`: the agents of the next frame, if the cache has it.
    `previous_agents`: the agents of the previous frame, if the cache has no next frame.
    `shutter_agents`: the agents of the frame for which the shutter is open."""

    time: float
    share: float
    dt: float
    picture: Picture
    species: tuple[SpeciesSample, ...]
    next_agents: tuple[SpeciesSample, ...] | None
    previous_agents: tuple[SpeciesSample, ...] | None
    shutter_agents: tuple[SpeciesSample, ...]

    def agents(self, number: int) -> SpeciesSample:
        """Return the agents of species `number` at this time."""
        agents = self.species[number]
        if not self.share:
            return agents
        return _interpolate_agents(agents, self.next_agents[number] if self.next_agents else None, self.share, self.dt)


@dataclass(slots=True)
class TimeSamples:
    """Samples of a cache at any times. They must be requested in order of time."""

    gallery: Gallery
    _frame_numbers: set[int] = field(default_factory=set)
    _frames: dict[int, tuple[Picture, tuple[SpeciesSample, ...]]] = field(default_factory=dict)
    _samples_with_velocities: dict[int, tuple[SpeciesSample, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._frame_numbers = set(self.gallery.cache.frames())

    def build_sample(self, time: float, frame: int) -> TimeSample:
        """Return the agents at `time`, which belongs to the frame `frame` of the cache. Raises CacheError if a frame is
        damaged."""
        first = int(np.floor(time + 1e-9))
        first = first if first in self._frame_numbers else frame
        share = float(time) - first
        share = 0.0 if abs(share) < 1e-9 else share
        picture, agents = self._read_frame(first)[0], self._read_with_velocities(first)
        return TimeSample(
            time, share, self.gallery.dt, picture, agents, *self._read_adjacent_frames(first), self._read_frame(frame)[1]
        )

    def _read_adjacent_frames(self, frame: int) -> tuple[tuple[SpeciesSample, ...] | None, tuple[SpeciesSample, ...] | None]:
        """Return the agents of the next frame or, if there is none, those of the previous frame: (next, None), (None, previous)
        or (None, None)."""
        next_agents = self._read_frame(frame + 1)[1] if frame + 1 in self._frame_numbers else None
        return next_agents, self._read_frame(frame - 1)[1] if next_agents is None and frame - 1 in self._frame_numbers else None

    def _read_with_velocities(self, frame: int) -> tuple[SpeciesSample, ...]:
        """Return the agents of a frame, by species, with the velocities that lead to the next frame."""
        if frame not in self._samples_with_velocities:
            agents, beside = self._read_frame(frame)[1], self._read_adjacent_frames(frame)
            self._samples_with_velocities = dict(list(self._samples_with_velocities.items())[1 - _CACHED_FRAMES :])
            self._samples_with_velocities[frame] = tuple(
                _compute_velocities(each, self.gallery.dt, *(others[k] if others else None for others in beside))
                for k, each in enumerate(agents)
            )
        return self._samples_with_velocities[frame]

    def _read_frame(self, frame: int) -> tuple[Picture, tuple[SpeciesSample, ...]]:
        """Return the picture of a frame, and its agents by species with the velocities of the cache."""
        if frame not in self._frames:
            self._frames = dict(list(self._frames.items())[1 - _CACHED_FRAMES :])
            arrays = self.gallery.cache.frame(frame)
            picture = self.gallery.make_picture(frame)
            count = len(self.gallery.manifest.species)
            self._frames[frame] = picture, tuple(_read_agents(self.gallery, picture, arrays, number) for number in range(count))
        return self._frames[frame]


def _read_agents(gallery: Gallery, picture: Picture, arrays: Arrays, number: int) -> SpeciesSample:
    """Return the agents of a species in a frame, with the velocities of the cache."""
    name = gallery.manifest.species[number].name
    rows = find_species_rows(arrays, number)
    ids = get_agent_ids(arrays)[rows] if "id" in arrays else np.arange(len(rows))
    if (np.diff(ids) < 0).any():
        order = np.argsort(ids, kind="stable")
        ids, rows = ids[order], rows[order]
    place, orient, scale = (np.asarray(arrays[key], np.float64)[rows] for key in ("P", "orient", "pscale"))
    size = np.linalg.norm(orient, axis=1, keepdims=True)
    is_visible = np.isfinite(place).all(axis=1) & np.isfinite(size[:, 0]) & (size[:, 0] > 0) & np.isfinite(scale) & (scale > 0)
    turn = np.where(is_visible[:, None], orient / np.where(size > 0, size, 1.0), (0.0, 0.0, 0.0, 1.0))
    own, ground = (
        np.nan_to_num(np.asarray(arrays[key], np.float64)[rows]) if key in arrays else np.zeros((len(rows), 3))
        for key in ("v", "v_ground")
    )
    state = np.asarray(arrays["state"], np.int64)[rows] if "state" in arrays else None
    numbers = {key: values[rows] for key, values in iterate_other_numbers(arrays, "usd")}
    if "v" in arrays:
        numbers["speed"] = np.linalg.norm(own, axis=1)
    parts, colour = (
        tuple(_find_part_rows(crowd, ids) for crowd in picture.crowds if crowd.species == name),
        np.zeros((len(rows), 3)),
    )
    for crowd, part_rows in parts:
        colour[part_rows] = crowd.colour
    if any(crowd.feet is not None for crowd, _ in parts):
        phase = np.zeros(len(rows), np.float32)
        for crowd, part_rows in parts:
            phase[part_rows] = 0.0 if crowd.feet is None else crowd.feet.phase
        numbers["phase"] = phase
    return SpeciesSample(
        ids, np.where(is_visible[:, None], place, 0.0), turn, np.where(is_visible, scale, 0.0), colour, own + ground,
        np.zeros((len(rows), 3)), state, own, numbers, parts, is_visible,
    )  # fmt: skip


def _find_part_rows(crowd: Crowd, ids: NDArray[np.int64]) -> tuple[Crowd, NDArray[np.intp]]:
    """Return a crowd, and the rows of its agents within `ids`."""
    if crowd.ids is None or len(crowd.position) == len(ids):
        return crowd, np.arange(len(crowd.position))
    return crowd, np.searchsorted(ids, crowd.ids)


def _compute_velocities(
    agents: SpeciesSample, dt: float, next_agents: SpeciesSample | None, previous_agents: SpeciesSample | None
) -> SpeciesSample:
    """Return the agents with the velocities that lead to the next frame. In the last frame, use the velocities from the previous
    frame."""
    other = next_agents or previous_agents
    if other is None or not len(agents.ids):
        return agents
    at, is_matched = match_ids(agents.ids, other.ids)
    is_matched = is_matched & agents.is_visible
    is_matched[is_matched] &= other.is_visible[at[is_matched]]
    if not is_matched.any():
        return agents
    towards = 1.0 if next_agents is not None else -1.0
    velocity, turning = agents.velocity.copy(), agents.angular_velocity.copy()
    if next_agents is not None:
        velocity[is_matched] = (other.position[at[is_matched]] - agents.position[is_matched]) / dt
    turning[is_matched] = np.degrees(compute_rotation_vectors(agents.orient[is_matched], other.orient[at[is_matched]])) * (
        towards / dt
    )
    return replace(agents, velocity=velocity, angular_velocity=turning)


def compute_rotation_vectors(first: Floats, second: Floats) -> Floats:
    """Return the rotation from each orientation in `first` to that in `second` (n, 4: x y z w, unit), by the smaller angle.

    The result (n, 3) is the axis in world coordinates times the angle in radians."""
    a, b = first, second * np.where((first * second).sum(axis=1) < 0, -1.0, 1.0)[:, None]
    real = (a * b).sum(axis=1)
    axis = a[:, 3:] * b[:, :3] - b[:, 3:] * a[:, :3] - np.cross(b[:, :3], a[:, :3])
    size = np.linalg.norm(axis, axis=1)
    angle = 2.0 * np.arctan2(size, real)
    by = np.where(size > 1e-12, angle / np.maximum(size, 1e-12), 2.0)
    vectors: Floats = axis * by[:, None]
    return vectors


def rotate_orientations(orient: Floats, rotation_vectors: Floats) -> Floats:
    """Return orientations (n, 4) rotated about world axes. `rotation_vectors` (n, 3): axes times radians."""
    angle = np.linalg.norm(rotation_vectors, axis=1)
    by = np.where(angle > 1e-12, np.sin(angle / 2) / np.maximum(angle, 1e-12), 0.5)
    v, w = rotation_vectors * by[:, None], np.cos(angle / 2)[:, None]
    own, real = orient[:, :3], orient[:, 3:]
    quaternions = np.concatenate([w * own + real * v + np.cross(v, own), w * real - dot(v, own)[:, None]], axis=1)
    unit_quaternions: Floats = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
    return unit_quaternions


def _interpolate_agents(agents: SpeciesSample, next_agents: SpeciesSample | None, share: float, dt: float) -> SpeciesSample:
    """Return the agents at the fraction `share` of the time until the next frame."""
    scale = agents.scale
    if next_agents is not None:
        at, is_matched = match_ids(agents.ids, next_agents.ids)
        is_matched[is_matched] &= next_agents.is_visible[at[is_matched]]
        scale = scale.copy()
        scale[is_matched] += (next_agents.scale[at[is_matched]] - scale[is_matched]) * share
    position = agents.position + agents.velocity * (share * dt)
    return replace(
        agents,
        position=position,
        orient=rotate_orientations(agents.orient, np.radians(agents.angular_velocity) * (share * dt)),
        scale=scale,
    )
