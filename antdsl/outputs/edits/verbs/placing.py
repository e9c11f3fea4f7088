"""Edits of positions: `move`, `rotate`, `scale`, `expand` and `face`. Feet and velocities follow the agents."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, model_validator

from antdsl.bodies.agents.transforms import Floats
from antdsl.numerics.easing import compute_ease_weight
from antdsl.outputs.cache.cache_reader import Arrays
from antdsl.outputs.cache.manifest import Manifest
from antdsl.outputs.edits.cache_selection import find_item_points
from antdsl.outputs.edits.edit_layer import AgentsLine, EditLayer
from antdsl.outputs.edits.edit_values import DEFAULT_EASE_FRAMES, Factor, FrameCount
from antdsl.outputs.edits.frame_rows import FrameRows
from antdsl.outputs.edits.grounding import Grounds, move_on_ground
from antdsl.outputs.edits.verbs.agent_moves import AgentMoves, find_axes, make_moves, make_rotation, move_agents, rotate_vectors
from antdsl.scene.notes.selectors import Selector
from antdsl.scene.thing_models import UNIT_MM, UP_VECTORS
from antdsl.scene.values import Angle, PointOrName, PointValue, make_value_error, parse_one_of

_EACH = "each"
REQUIRED_ARRAYS = ("id", "P", "orient", "pscale")


class GroundLine(AgentsLine):
    """A line that moves agents. `ground`: with `follow`, they keep their height above the ground; with `free`, they move
    rigidly."""

    ground: Annotated[str, BeforeValidator(parse_one_of("follow", "free"))] = "follow"


class EasedLine(AgentsLine):
    """A line for some `frames`. `ease`: the number of frames before and after these over which the change begins and ends."""

    ease: FrameCount = DEFAULT_EASE_FRAMES


class PlacingLine(GroundLine, EasedLine):
    """A line that moves agents in some frames."""

    def list_items(self) -> tuple[tuple[tuple[str, ...], str], ...]:
        """Return the names of items in the line outside selectors, as (keys that lead to the name, name)."""
        values = {key: getattr(self, key, None) for key in ("to", "around")}
        return tuple(((key,), value) for key, value in values.items() if isinstance(value, str))


class MoveLine(PlacingLine):
    """Moves agents `by` a displacement, or their centre `to` a point or an item."""

    verb = "move"
    agents: Selector = Field(alias="move")
    by: PointValue | None = None
    to: PointOrName | None = None

    @model_validator(mode="after")
    def _check_one(self) -> MoveLine:
        if (self.by is None) == (self.to is None):
            raise make_value_error("`move` needs either `by` or `to`", "write `by: [40 mm, 0, 0]`")
        return self


class RotateLine(PlacingLine):
    """Rotates agents about the scene's up axis through their common centre, a point or an item. With `each`, each rotates in
    place."""

    verb = "rotate"
    agents: Selector = Field(alias="rotate")
    by: Angle
    around: PointOrName | None = None

    def list_items(self) -> tuple[tuple[tuple[str, ...], str], ...]:
        """Return the names of items in the line outside selectors, as (keys that lead to the name, name)."""
        return () if self.around == _EACH else super().list_items()


class ScaleLine(PlacingLine):
    """Makes agents larger or smaller."""

    verb = "scale"
    agents: Selector = Field(alias="scale")
    by: Factor


class ExpandLine(PlacingLine):
    """Scales the distances of agents from their centre, a point or an item."""

    verb = "expand"
    agents: Selector = Field(alias="expand")
    by: Factor
    around: PointOrName | None = None


class FaceLine(PlacingLine):
    """Rotates agents about their up axis, so that they face a point or an item."""

    verb = "face"
    agents: Selector = Field(alias="face")
    to: PointOrName


@dataclass(frozen=True, slots=True, eq=False)
class MovedAgents:
    """The m selected agents of frame `number`, with their keys and their rows in the frame.

    `position` [m, 3], `orient` [m, 4], `length` [m]: positions, orientations and body lengths, float64."""

    number: int
    keys: NDArray[np.int64]
    rows: NDArray[np.intp]
    position: Floats
    orient: Floats
    length: Floats


@dataclass(frozen=True, eq=False)
class PlacingLayer(EditLayer):
    """A view of a cache in which some agents are moved. Subclasses define the moves."""

    line: Any
    required_arrays = REQUIRED_ARRAYS

    def is_active(self, number: int) -> bool:
        """Return whether the edit changes frame `number`."""
        return compute_line_ease(self.line, number) > 0

    def change_frame(self, number: int, arrays: Arrays) -> Arrays:
        """Return a frame in which the selected agents are moved."""
        agents = self.take_agents(number, arrays)
        if not len(agents.rows):
            return arrays
        moves = self.place(agents, arrays).scale(compute_line_ease(self.line, number), agents.position)
        ground = self.inputs.ground.at(number) if self.line.ground == "follow" and self.inputs.ground else None
        if ground is None:
            return move_agents(arrays, self.manifest, moves)
        return move_on_ground(arrays, self.manifest, moves, Grounds(ground, ground))

    def take_agents(self, number: int, arrays: Arrays) -> MovedAgents:
        """Return the selected agents of frame `number`."""
        keys = FrameRows(arrays, self.manifest).keys
        rows = np.flatnonzero(self.selection.find(keys))
        position, orient, length = (np.asarray(arrays[name], np.float64)[rows] for name in ("P", "orient", "pscale"))
        return MovedAgents(number, keys[rows], rows, position, orient, length)

    @abstractmethod
    def place(self, agents: MovedAgents, arrays: Arrays) -> AgentMoves:
        """Return the moves of a frame's agents, regardless of the ground."""

    @property
    def up(self) -> Floats:
        """Return the unit vector upwards in the scene."""
        return np.array(UP_VECTORS[self.manifest.up])

    @cached_property
    def first_agents(self) -> MovedAgents:
        """Return the agents in the first frame of the edit."""
        return self.take_agents(self.first_frame, self.source.frame(self.first_frame))

    def find_point(self, value: Any, arrays: Arrays) -> Floats:
        """Return the position [3] of a point or an item. If `value` is None, return the centre of the agents in the first frame
        of the edit."""
        if value is None:
            position = self.first_agents.position
            return position.mean(axis=0) if len(position) else np.zeros(3)
        if isinstance(value, str):
            unit_mm = UNIT_MM[self.manifest.units]
            place: Floats = find_item_points(arrays, self.manifest, unit_mm)[value].mean(axis=0)
            return place / unit_mm - self.manifest.origin
        return convert_displacement(value, self.manifest) - self.manifest.origin


def compute_line_ease(line: EasedLine, number: int) -> float:
    """Return how strongly a line applies in frame `number`, from 0 to 1."""
    return 1.0 if line.frames is None else float(compute_ease_weight(*line.frames, line.ease, number))


def convert_displacement(value: Any, manifest: Manifest) -> Floats:
    """Return a displacement that a line contains, in scene units, [3]."""
    unit_mm = UNIT_MM[manifest.units]
    return np.array([part.to_millimetres(unit_mm) / unit_mm for part in value])


@dataclass(frozen=True, eq=False)
class MoveLayer(PlacingLayer):
    """A view of a cache in which some agents are displaced."""

    def place(self, agents: MovedAgents, arrays: Arrays) -> AgentMoves:
        """Return the moves that displace the agents."""
        line = self.line
        by = (
            convert_displacement(line.by, self.manifest)
            if line.by is not None
            else self.find_point(line.to, arrays) - self.find_point(None, arrays)
        )
        return make_moves(agents.rows, agents.position + by)


@dataclass(frozen=True, eq=False)
class RotateLayer(PlacingLayer):
    """A view of a cache in which some agents are rotated."""

    def place(self, agents: MovedAgents, arrays: Arrays) -> AgentMoves:
        """Return the moves that rotate the agents."""
        rotation = make_rotation(self.up, self.line.by.number)
        centre = agents.position if self.line.around == _EACH else self.find_point(self.line.around, arrays)
        offset = agents.position - centre
        return make_moves(agents.rows, centre + rotate_vectors(np.broadcast_to(rotation, (len(offset), 4)), offset), rotation)


@dataclass(frozen=True, eq=False)
class ScaleLayer(PlacingLayer):
    """A view of a cache in which some agents have another size."""

    def place(self, agents: MovedAgents, arrays: Arrays) -> AgentMoves:
        """Return the moves that scale the agents in place."""
        return make_moves(agents.rows, agents.position, size=self.line.by)


@dataclass(frozen=True, eq=False)
class ExpandLayer(PlacingLayer):
    """A view of a cache in which some agents are moved away from a centre or towards it."""

    def place(self, agents: MovedAgents, arrays: Arrays) -> AgentMoves:
        """Return the moves of agents away from a centre, or towards it."""
        centre = self.find_point(self.line.around, arrays)
        return make_moves(agents.rows, centre + self.line.by * (agents.position - centre), speed=self.line.by)


@dataclass(frozen=True, eq=False)
class FaceLayer(PlacingLayer):
    """A view of a cache in which some agents face a point."""

    def place(self, agents: MovedAgents, arrays: Arrays) -> AgentMoves:
        """Return the rotations that turn agents about their up direction towards a point. An agent straight above or below it
        does not turn."""
        heading, up = find_axes(agents.orient)
        return make_moves(
            agents.rows, agents.position, turn_about_up(heading, up, self.find_point(self.line.to, arrays) - agents.position)
        )


def turn_about_up(heading: Floats, up: Floats, direction: Floats) -> Floats:
    """Return the rotations [n, 4] about unit vectors `up` that turn headings towards `direction`. All arguments are [n, 3]."""
    level = direction - up * (direction * up).sum(axis=1, keepdims=True)
    length = np.sqrt((level * level).sum(axis=1, keepdims=True))
    level = np.where(length > 1e-9, level / np.maximum(length, 1e-9), heading)
    cosine = (heading * level).sum(axis=1)
    sine = (np.cross(up, heading) * level).sum(axis=1)
    # the half-angle form has no small divisor except for a half turn
    half = np.sqrt(np.clip((1 + cosine) / 2, 0, 1))
    other = np.where(sine < 0, -1.0, 1.0) * np.sqrt(np.clip((1 - cosine) / 2, 0, 1))
    return np.concatenate([up * other[:, None], half[:, None]], axis=1)
