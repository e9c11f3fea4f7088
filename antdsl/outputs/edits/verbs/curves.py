"""The edit `pin`, which puts agents on a curve."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np
from pydantic import Field

from antdsl.bodies.agents.transforms import Floats
from antdsl.outputs.cache.cache_reader import Arrays
from antdsl.outputs.edits.frame_rows import match_rows
from antdsl.outputs.edits.verbs.agent_moves import AgentMoves, find_axes, make_moves
from antdsl.outputs.edits.verbs.placing import MovedAgents, PlacingLayer, PlacingLine, convert_displacement, turn_about_up
from antdsl.scene.notes.selectors import Selector
from antdsl.scene.thing_models import UNIT_MM
from antdsl.scene.values import PointValue, PositiveSpeed

MAX_POINTS = 1000


class PinLine(PlacingLine):
    """Puts agents on a curve, facing along it.

    They are at its point nearest to them. With `speed`, they move along the curve from there."""

    verb = "pin"
    agents: Selector = Field(alias="pin")
    to: Annotated[tuple[PointValue, ...], Field(min_length=2, max_length=MAX_POINTS)]
    speed: PositiveSpeed | None = None


@dataclass(frozen=True, eq=False)
class PinLayer(PlacingLayer):
    """A view of a cache in which some agents are placed on a curve."""

    @cached_property
    def _points(self) -> Floats:
        """Return the points of the curve, in scene units."""
        return np.array([convert_displacement(point, self.manifest) for point in self.line.to]) - self.manifest.origin

    def place(self, agents: MovedAgents, arrays: Arrays) -> AgentMoves:
        """Return the moves that bring the agents onto the curve.

        Agents face along the curve, in whichever direction is nearer to their heading; with a speed, always forwards."""
        position, tangent, along = find_on_curve(self._points, agents.position)
        heading, up = find_axes(agents.orient)
        if self.line.speed is not None:
            at, is_there = match_rows(agents.keys, self.first_agents.keys)
            start = (
                along
                if not len(self.first_agents.keys)
                else np.where(is_there, find_on_curve(self._points, self.first_agents.position)[2][at], along)
            )
            above, below = self.manifest.fps.split("/")
            seconds = (agents.number - self.first_frame) * int(below) / int(above)
            position, tangent = walk_curve(self._points, start + self.line.speed.number / UNIT_MM[self.manifest.units] * seconds)
        else:
            tangent = np.where((tangent * heading).sum(axis=1, keepdims=True) < 0, -tangent, tangent)
        return make_moves(agents.rows, position, turn_about_up(heading, up, tangent))


def find_on_curve(points: Floats, positions: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the point of a polyline [k, 3] nearest to each position [n, 3], and the unit tangent there. Also return the point's
    distance from the start, along the polyline."""
    start, step = points[:-1], np.diff(points, axis=0)
    square = np.maximum((step * step).sum(axis=1), 1e-30)
    lengths = np.sqrt(square)
    starts_along = np.concatenate([[0.0], np.cumsum(lengths)[:-1]])
    count = len(positions)
    best, place, tangent, along = np.full(count, np.inf), np.zeros((count, 3)), np.zeros((count, 3)), np.zeros(count)
    for k in range(len(start)):
        share = np.clip(((positions - start[k]) * step[k]).sum(axis=1) / square[k], 0.0, 1.0)
        point = start[k] + share[:, None] * step[k]
        distance = ((positions - point) ** 2).sum(axis=1)
        is_nearer = distance < best
        best = np.where(is_nearer, distance, best)
        place[is_nearer], tangent[is_nearer] = point[is_nearer], step[k] / lengths[k]
        along[is_nearer] = (starts_along[k] + share * lengths[k])[is_nearer]
    return place, tangent, along


def walk_curve(points: Floats, distances: Floats) -> tuple[Floats, Floats]:
    """Return the points of a polyline [k, 3] at `distances` [n] from its start, and the unit tangents there.

    Beyond the end of the polyline, return its end."""
    step = np.diff(points, axis=0)
    lengths = np.sqrt(np.maximum((step * step).sum(axis=1), 1e-30))
    ends = np.cumsum(lengths)
    which = np.minimum(np.searchsorted(ends, distances, side="right"), len(lengths) - 1)
    share = np.clip((distances - (ends[which] - lengths[which])) / lengths[which], 0.0, 1.0)
    return points[which] + share[:, None] * step[which], step[which] / lengths[which, None]
