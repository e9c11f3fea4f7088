"""Chooses the animation keys of a glTF file, such that the error of poses stays within a tolerance.

A track is one property of one node, in all frames of all agents. Its keys are at the first frame of an agent, at each n-th frame
after it, and at the last frame. n is the largest power of 2 with errors below the track's part of the tolerance. If the first
value alone stays within it, the track is constant. Tracks with the same n have the same key times, and share an accessor for
these. Keys at arbitrary frames (Ramer, 1972; Douglas and Peucker, 1973) would need separate times for each track. For walking
ants, this took 26 to 37 % more bytes and twice as many accessors.

An error is an upper bound of how far a node displaces any joint or point, in body lengths. The errors of a joint and its
ancestors add up, so the tracks of a chain of joints share the tolerance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.transforms import slerp_quaternions

Floats = NDArray[np.float64]
PATHS = ("translation", "rotation", "scale")
_NEGLIGIBLE_SHARE = 1e-6  # of the body's length: rounding errors of constant tracks, which take no share of the tolerance
# Largest error of a quaternion of int16, as the length of the difference (4 components, half a unit each), times 4: twice the
# half angle, and as much for programs that do not normalise quaternions.
_SHORT_ROTATION_ERROR = 4.0 / 32767


@dataclass(frozen=True, slots=True, eq=False)
class AgentRows:
    """The rows of A agents in all frames, sorted by agent and then by frame.

    `frames`: int64[r], the frame number of each row. `starts`: int64[A + 1]; agent k has the rows `starts[k]:starts[k + 1]`, at
    least one."""

    frames: NDArray[np.int64]
    starts: NDArray[np.int64]

    @property
    def counts(self) -> NDArray[np.int64]:
        """Return the number of rows of each agent."""
        return np.diff(self.starts)

    def list_keys(self, agent: int, step: int) -> NDArray[np.int64]:
        """Return the rows of an agent that become keys: the first, every `step`-th row after it, and the last."""
        start, end = self.starts[agent : agent + 2]
        keys = np.arange(start, end, step)
        return keys if keys[-1] == end - 1 else np.append(keys, end - 1)

    def measure_constant_errors(self, values: NDArray[Any]) -> Floats:
        """Return, for each agent, the greatest distance of its `values` (r, k) from their value in its first row."""
        first = np.repeat(values[self.starts[:-1]], self.counts, axis=0)
        return np.asarray(np.maximum.reduceat(_measure_distances(values, first), self.starts[:-1]))

    def choose_steps(self, values: NDArray[Any], tolerances: Floats) -> NDArray[np.int64]:
        """Return, for each agent, the number of rows from key to key: 0 for constant `values` (r, k), 1 for a key in every row.

        `tolerances` float64[A]: the greatest permitted distance for each agent. For k = 4, it is a distance of quaternions."""
        steps = np.where(self.measure_constant_errors(values) <= tolerances, 0, 1)
        agents, step = np.flatnonzero((steps == 1) & (self.counts > 2)), 2
        while len(agents):
            agents = agents[self._measure_key_errors(values, agents, step) <= tolerances[agents]]
            steps[agents] = step
            agents, step = agents[self.counts[agents] > step + 1], 2 * step
        return steps

    def _measure_key_errors(self, values: NDArray[Any], agents: NDArray[np.intp], step: int) -> Floats:
        """Return, for each of `agents`, the greatest distance of `values` from their interpolation between keys at every
        `step`-th row.

        Each agent must have at least 3 rows."""
        counts = self.counts[agents]
        row_ends = np.cumsum(counts)
        place = np.arange(row_ends[-1]) - np.repeat(row_ends - counts, counts)  # of each row, from the agent's first
        last = np.repeat(counts - 1, counts)
        between = np.flatnonzero((place % step != 0) & (place < last))
        first = np.repeat(self.starts[agents], counts)[between]
        place, last = place[between], last[between]
        rows, lower = first + place, place - place % step
        upper = first + np.minimum(lower + step, last)
        lower = first + lower
        share = (self.frames[rows] - self.frames[lower]) / (self.frames[upper] - self.frames[lower])
        a, b = (values[each].astype(np.float64) for each in (lower, upper))
        expected = slerp_quaternions(a, b, share) if values.shape[1] == 4 else a + share[:, None] * (b - a)
        starts = np.flatnonzero(np.diff(first, prepend=-1))
        return np.asarray(np.maximum.reduceat(_measure_distances(values[rows], expected), starts))


def _measure_distances(a: NDArray[Any], b: NDArray[Any]) -> Floats:
    """Return the distance of each row of `a` (n, k) from that of `b`. For quaternions (k = 4), the nearer of both signs
    counts."""
    wide = a.astype(np.float64)
    distances: Floats = np.sqrt(((wide - b) ** 2).sum(axis=1))
    if a.shape[1] == 4:
        np.minimum(distances, np.sqrt(((wide + b) ** 2).sum(axis=1)), out=distances)
    return distances


@dataclass(frozen=True, slots=True, eq=False)
class NodeTracks:
    """The tracks of N nodes, parents before children. The first node is the agent. Transforms are in body lengths.

    `parents`: int64[N], -1 for the first node. `transforms_by_node`: for each node, translations (r, 3), rotations (r, 4) and
    scales (r, 3). `radii`: float64[N], the greatest distance of a mesh point that follows the node from the node, in the space of
    the node."""

    parents: Sequence[int]
    transforms_by_node: Sequence[tuple[NDArray[Any], NDArray[Any], NDArray[Any]]]
    radii: Floats

    def compute_max_displacements_per_unit(self) -> Floats:
        """Return upper bounds, float64[N, 3], of how far a joint or point moves if a node changes by 1.

        The columns are for changes of the node's translation, quaternion and scale."""
        lengths = [
            float(np.sqrt((move.astype(np.float64) ** 2).sum(axis=1)).max(initial=0.0)) for move, _, _ in self.transforms_by_node
        ]
        scales = [float(np.abs(size).max(initial=0.0)) for _, _, size in self.transforms_by_node]
        reaches, growth = self.radii.copy(), np.ones(len(self.parents))
        for node in range(len(self.parents) - 1, 0, -1):
            above = self.parents[node]
            reaches[above] = max(reaches[above], lengths[node] + scales[node] * reaches[node])
        for node in range(1, len(self.parents)):
            growth[node] = growth[self.parents[node]] * scales[self.parents[node]]
        return np.stack([growth, 2 * growth * scales * reaches, growth * reaches], axis=1)

    def sum_along_chains(self, amounts: NDArray[Any]) -> NDArray[Any]:
        """Return, for each node, the greatest sum of `amounts` (N, …) along any chain from the first node through this node to a
        leaf."""
        sums = amounts.copy()
        for node in range(1, len(self.parents)):
            sums[node] += sums[self.parents[node]]
        for node in range(len(self.parents) - 1, 0, -1):
            sums[self.parents[node]] = np.maximum(sums[self.parents[node]], sums[node])
        return sums


@dataclass(frozen=True, slots=True, eq=False)
class KeyPlan:
    """The choice of keys for all tracks.

    `steps`: int64[N, 3, A], the number of rows from key to key (see `AgentRows.choose_steps`), by node, property and agent.
    `has_short_rotations`: whether rotations are written as int16."""

    steps: NDArray[np.int64]
    has_short_rotations: bool


def plan_keys(rows: AgentRows, tracks: NodeTracks, tolerance: float) -> KeyPlan:
    """Return a choice of keys with which no joint or point is displaced by more than `tolerance`, in body lengths."""
    levers = np.maximum(tracks.compute_max_displacements_per_unit(), 1e-12)
    rounding = float(tracks.sum_along_chains(levers[:, 1] / 2).max()) * _SHORT_ROTATION_ERROR
    has_short_rotations = 1.5 * rounding <= tolerance
    left = tolerance - rounding if has_short_rotations else tolerance
    agents = len(rows.counts)
    steps = np.zeros((len(levers), 3, agents), np.int64)
    is_thinned = np.zeros(steps.shape, np.bool_)  # tracks with errors
    for node, path in np.ndindex(levers.shape):
        values, lever = tracks.transforms_by_node[node][path], levers[node, path]
        if (rows.measure_constant_errors(values) * lever > min(tolerance, _NEGLIGIBLE_SHARE)).any():
            steps[node, path] = rows.choose_steps(values, np.full(agents, left / lever))
            is_thinned[node, path] = steps[node, path] != 1
    shares = left / np.maximum(tracks.sum_along_chains(is_thinned.sum(axis=1)), 1)
    for node, path in np.argwhere(is_thinned.any(axis=2)):
        chosen = rows.choose_steps(tracks.transforms_by_node[node][path], shares[node] / levers[node, path])
        steps[node, path] = np.where(is_thinned[node, path], chosen, 1)
    return KeyPlan(steps, has_short_rotations)
