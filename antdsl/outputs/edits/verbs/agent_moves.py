"""Moves agents in a frame together with their feet, velocities and events, and interpolates agents between two frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.transforms import (
    Floats,
    multiply_quaternions,
    normalise_quaternion,
    quaternion_to_matrix,
    slerp_quaternions,
)
from antdsl.numerics.elementary import cos_float64, sin_float64
from antdsl.outputs.cache.cache_reader import Arrays
from antdsl.outputs.cache.manifest import Manifest
from antdsl.outputs.edits.frame_rows import FrameRows, find_interpolation, match_rows

IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])
_AHEAD, _UP = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True, slots=True, eq=False)
class AgentMoves:
    """New positions, orientations and sizes of m agents in a frame.

    `rows`: the rows of the agents in the frame. `position` [m, 3]: the new positions in scene units. `rotation` [m, 4]: the
    rotation from the old to the new orientation, a quaternion x y z w in the axes of the scene. `size` [m], `speed` [m]: factors
    by which body lengths and velocities are multiplied."""

    rows: NDArray[np.intp]
    position: Floats
    rotation: Floats
    size: Floats
    speed: Floats

    def scale(self, share: float, position: Floats) -> AgentMoves:
        """Return the moves reduced to the fraction `share`. `position` [m, 3]: the old positions."""
        if share >= 1:
            return self
        one = np.broadcast_to(IDENTITY, self.rotation.shape)
        return AgentMoves(
            self.rows,
            position + share * (self.position - position),
            slerp_quaternions(one, self.rotation, np.full(len(self.rows), share)),
            1 + share * (self.size - 1),
            1 + share * (self.speed - 1),
        )


def make_moves(
    rows: NDArray[np.intp], position: Floats, rotation: Floats | None = None, size: float = 1.0, speed: float = 1.0
) -> AgentMoves:
    """Return moves of the agents in `rows` to `position` [m, 3].

    `rotation`: one quaternion [4], or one for each agent [m, 4]. `size`, `speed`: one factor for all agents."""
    count = len(rows)
    turns = np.broadcast_to(IDENTITY if rotation is None else rotation, (count, 4))
    return AgentMoves(rows, position, turns, np.full(count, size), np.full(count, speed))


def rotate_vectors(rotation: Floats, vectors: Floats) -> Floats:
    """Return vectors [n, …, 3] rotated by unit quaternions [n, 4]."""
    matrix = quaternion_to_matrix(rotation)
    shape = (len(vectors), *(1,) * (vectors.ndim - 2), 3)
    columns = [matrix[:, :, k].reshape(shape) * vectors[..., k : k + 1] for k in range(3)]
    return (columns[0] + columns[1]) + columns[2]


def make_rotation(axis: Floats, angle: float) -> Floats:
    """Return the quaternion [4] of a rotation by an angle (rad) about a unit vector [3]."""
    half = np.array([angle / 2])
    return np.concatenate([axis * sin_float64(half), cos_float64(half)])


def find_shortest_rotations(start: Floats, end: Floats) -> Floats:
    """Return the shortest rotation from each unit vector in `start` [n, 3] to that in `end` [n, 3], as quaternions [n, 4].

    For opposite vectors, the rotation is about an arbitrary perpendicular axis."""
    cosine = (start * end).sum(axis=1, keepdims=True)
    across = np.cross(start, np.where(np.abs(start[:, :1]) < 0.9, _AHEAD, _UP))
    opposite = np.concatenate([across, np.zeros((len(start), 1))], axis=1)
    return normalise_quaternion(
        np.where(cosine > -1 + 1e-9, np.concatenate([np.cross(start, end), 1 + cosine], axis=1), opposite)
    )


def find_axes(orient: Floats) -> tuple[Floats, Floats]:
    """Return the heading [n, 3] and the up direction [n, 3] of agents with orientations `orient`, unit quaternions [n, 4]."""
    matrix = quaternion_to_matrix(normalise_quaternion(orient))
    return matrix[:, :, 0], matrix[:, :, 1]


def move_agents(arrays: Arrays, manifest: Manifest, moves: AgentMoves) -> dict[str, NDArray[Any]]:
    """Return a frame in which agents have moved, together with their feet, velocities and events."""
    table, changed = FrameRows(arrays, manifest), dict(arrays)
    if not len(moves.rows):
        return changed
    start = np.asarray(arrays["P"], np.float64)[moves.rows]
    _set_rows(changed, "P", moves.rows, moves.position)
    if "orient" in arrays:
        orient = np.asarray(arrays["orient"], np.float64)[moves.rows]
        _set_rows(changed, "orient", moves.rows, multiply_quaternions(moves.rotation, orient))
    if "pscale" in arrays:
        _set_rows(changed, "pscale", moves.rows, arrays["pscale"][moves.rows] * moves.size)
    if "v" in arrays:
        velocity = np.asarray(arrays["v"], np.float64)[moves.rows] * moves.speed[:, None]
        _set_rows(changed, "v", moves.rows, rotate_vectors(moves.rotation, velocity))
    for name, keys in table.iterate_agent_arrays():
        first, field = name.partition(".")[0], name.rpartition(".")[2]
        if first not in ("feet", "events") or field not in ("P", "N", "rise"):
            continue
        at, is_moved = match_rows(keys, table.keys[moves.rows])
        rows, which = np.flatnonzero(is_moved), at[is_moved]
        values = np.asarray(arrays[name], np.float64)[rows]
        if field == "P":
            shape = (-1, *(1,) * (values.ndim - 2), 3)
            offset = rotate_vectors(moves.rotation[which], values - start[which].reshape(shape))
            values = moves.position[which].reshape(shape) + offset * moves.size[which].reshape(*shape[:-1], 1)
        else:
            values = rotate_vectors(moves.rotation[which], values) if field == "N" else values * moves.size[which]
        _set_rows(changed, name, rows, values)
    return changed


def _set_rows(arrays: dict[str, NDArray[Any]], name: str, rows: NDArray[np.intp], values: Floats) -> None:
    """Replace the rows `rows` of an array by `values`. The array is copied first."""
    arrays[name] = arrays[name].copy()
    arrays[name][rows] = values


def blend_frames(arrays: Arrays, other: Arrays, share: float, manifest: Manifest) -> dict[str, NDArray[Any]]:
    """Return a frame interpolated by the fraction `share` towards another one. That is a later frame if `share` is positive, else
    an earlier one.

    Agents that the other frame does not contain do not change."""
    near, far = FrameRows(arrays, manifest), FrameRows(other, manifest)
    others = dict(far.iterate_agent_arrays())
    blended = dict(arrays)
    same_clips: dict[str, NDArray[np.bool_]] = {}
    for name, row_keys in near.iterate_agent_arrays():
        between = find_interpolation(name)
        if not between or name not in others:
            continue
        at, is_there = match_rows(row_keys, others[name])
        if between == "clip":
            group = name.rpartition(".")[0]
            if group not in same_clips:
                same_clips[group] = _find_same_clips(arrays, other, group, at, share > 0)
            is_there = is_there & same_clips[group]
        rows = np.flatnonzero(is_there)
        values = _interpolate_values(between, arrays[name][rows], other[name][at[rows]], abs(share))
        _set_rows(blended, name, rows, values)
    return blended


def _find_same_clips(one: Arrays, other: Arrays, group: str, other_rows: NDArray[np.intp], is_later: bool) -> NDArray[np.bool_]:
    """Return a mask of the agents that play the same clips in two frames, without having started them again in between.

    `other_rows`: the rows of the agents in the other frame. `is_later`: whether the other frame is the later one."""
    is_same = np.ones(len(other_rows), np.bool_)
    for field in ("clip", "before", "earlier"):
        name, turns = f"{group}.{field}", f"{group}.turns" if field == "clip" else f"{group}.{field}_turns"
        if name in one and name in other and len(other[name]):
            earlier_turns, later_turns = (
                (one[turns], other[turns][other_rows]) if is_later else (other[turns][other_rows], one[turns])
            )
            is_same &= (one[name] == other[name][other_rows]) & (earlier_turns <= later_turns)
        elif name in one or name in other:
            is_same &= False
    return is_same


def _interpolate_values(interpolation: str, one: NDArray[Any], other: NDArray[Any], share: float) -> Floats:
    """Return the values at the fraction `share` between `one` and `other`. `interpolation`: the method."""
    a, b = np.asarray(one, np.float64), np.asarray(other, np.float64)
    if interpolation == "rotation":
        return slerp_quaternions(normalise_quaternion(a), normalise_quaternion(b), np.full(a.shape[:-1], share))
    if interpolation == "phase":
        turn = (b - a + 0.5) % 1.0 - 0.5
        return (a + share * turn) % 1.0
    values = a + share * (b - a)
    if interpolation == "direction":
        length = np.sqrt((values * values).sum(axis=-1, keepdims=True))
        values = np.where(length > 1e-9, values / np.maximum(length, 1e-9), a)
    return np.where(np.isfinite(values), values, a)
