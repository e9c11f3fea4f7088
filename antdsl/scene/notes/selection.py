"""Applies selectors to the arrays of one frame, from a running world or a cache, and returns the ids of the selected agents."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.randomness import draw_uniform
from antdsl.numerics.vector_rows import length
from antdsl.scene.crowds.line_ids import CrowdLineIds
from antdsl.scene.notes.selectors import AgentConditions, AgentName, AnySelector, Ball, Box, View
from antdsl.scene.thing_models import convert_point

SHARE_RANDOM_SITE = "share"  # of the random draws of `share`
Floats = NDArray[np.float64]
RowMasksBySpecies = dict[str, NDArray[np.bool_]]  # by species, one flag for each row


class StateColumn(NamedTuple):
    """The states of all agents in one machine. `numbers` (n,): indices into `names`."""

    numbers: NDArray[Any]
    names: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class SelectableAgents:
    """The living agents of one species in one frame.

    `ids` int64 (n,). `position` float64 (n, 3): in mm, relative to the scene's coordinate origin. `states`: by machine."""

    ids: NDArray[np.int64]
    position: Floats
    states: Mapping[str, StateColumn] = field(default_factory=dict)


class SelectableCamera(Protocol):
    """A camera in one frame. Positions are in mm, relative to the scene's coordinate origin."""

    def find_position(self) -> Floats:
        """Return the camera's position (3,)."""

    def find_visible(self, position: Floats, view: View) -> NDArray[np.bool_]:
        """Return a mask of the positions (n, 3) that lie within the rectangle `view` of the camera's picture."""


@dataclass(frozen=True, slots=True, eq=False)
class SelectableFrame:
    """All data of one frame that selectors read.

    `lines`: the ids of the agents in each named crowd line.
    `item_points` (k, 3): by the name of an item or of a group of items, positions in mm, relative to the scene's coordinate
    origin.
    `seed`: the seed for the key `share` if the selector has no seed. `unit_mm`: the scene's unit of length. `cameras`: by name,
    in this frame."""

    agents: Mapping[str, SelectableAgents]
    lines: Mapping[str, CrowdLineIds] = field(default_factory=dict)
    item_points: Mapping[str, Floats] = field(default_factory=dict)
    seed: int = 0
    unit_mm: float = 1.0
    cameras: Mapping[str, SelectableCamera] = field(default_factory=dict)


def select_ids(selector: AnySelector, frame: SelectableFrame) -> dict[str, NDArray[np.int64]]:
    """Return the ids of the selected agents in ascending order, by species. Species without selected agents are omitted."""
    masks = select_rows(selector, frame)
    return {name: np.sort(frame.agents[name].ids[mask]) for name, mask in masks.items() if mask.any()}


def select_rows(selector: AnySelector, frame: SelectableFrame) -> RowMasksBySpecies:
    """Return, by species, a mask of the selected agents: bool[n], true for selected rows."""
    if isinstance(selector, AgentName):
        return {name: _find_agents_by_name(selector, name, agents, frame) for name, agents in frame.agents.items()}
    if isinstance(selector, AgentConditions):
        return _select_by_conditions(selector, frame)
    masks = [select_rows(each, frame) for each in selector]
    return {name: np.logical_or.reduce([mask[name] for mask in masks]) for name in frame.agents}


def _find_agents_by_name(name: AgentName, species: str, agents: SelectableAgents, frame: SelectableFrame) -> NDArray[np.bool_]:
    """Return for each agent of a species whether `name` includes it, bool[n]."""
    line = frame.lines.get(name.name)
    if line is None:
        numbers = agents.ids if name.name == species else np.full(len(agents.ids), -1, np.int64)
    else:
        numbers = line.find_positions_in_line(agents.ids) if line.species == species else np.full(len(agents.ids), -1, np.int64)
    if name.first is None or name.last is None:
        return numbers >= 0
    return (numbers >= name.first) & (numbers <= name.last)


def _select_by_conditions(conditions: AgentConditions, frame: SelectableFrame) -> RowMasksBySpecies:
    masks = (
        {name: np.ones(len(agents.ids), np.bool_) for name, agents in frame.agents.items()}
        if conditions.of is None
        else select_rows(conditions.of, frame)
    )
    without = None if conditions.without is None else select_rows(conditions.without, frame)
    targets, is_target = _find_targets(conditions, frame)
    for name, agents in frame.agents.items():
        mask = masks[name]
        if conditions.state is not None:
            mask &= _find_in_state(conditions.state, agents)
        if targets is not None and conditions.within is not None:
            mask &= _measure_nearest(agents.position, targets) <= conditions.within.to_millimetres(frame.unit_mm)
        if conditions.region is not None and not isinstance(conditions.region, View):
            mask &= _find_in_region(conditions.region, agents.position, frame)
        if conditions.share is not None:
            seed = frame.seed if conditions.seed is None else conditions.seed
            mask &= draw_uniform(seed, 0, name, SHARE_RANDOM_SITE, 0, agents.ids) < np.float32(conditions.share)
        for view in conditions.views:
            mask &= frame.cameras[view.in_view].find_visible(agents.position, view)
        if without is not None:
            mask &= ~without[name]
        if targets is not None and is_target:
            mask &= ~is_target[name]
    if targets is None or (conditions.most is None and conditions.farthest is None):
        return masks
    sign = 1.0 if conditions.farthest is None else -1.0
    return _select_nearest(masks, frame, targets, sign, conditions.most or conditions.farthest or 0)


def _select_nearest(
    masks: RowMasksBySpecies, frame: SelectableFrame, targets: Floats, sign: float, count: int
) -> RowMasksBySpecies:
    """Return masks of the `count` agents that are nearest to the targets (`sign` 1) or farthest from them (`sign` -1).

    Only agents in `masks` are considered. At equal distances, agents are in the order of species and id."""
    names = sorted(masks)
    rows = {name: np.flatnonzero(masks[name]) for name in names}
    distance = np.concatenate([_measure_nearest(frame.agents[name].position[rows[name]], targets) for name in names])
    ids = np.concatenate([frame.agents[name].ids[rows[name]] for name in names])
    species = np.repeat(np.arange(len(names)), [len(rows[name]) for name in names])
    number = np.concatenate([rows[name] for name in names])
    chosen = np.lexsort((ids, species, sign * distance))[:count]
    selected = {name: np.zeros_like(masks[name]) for name in names}
    for k in chosen.tolist():
        selected[names[species[k]]][number[k]] = True
    return {name: selected[name] for name in masks}


def _find_in_state(state: str, agents: SelectableAgents) -> NDArray[np.bool_]:
    """Return for each agent whether any of its machines is in a state. `state`: `STATE` or `MACHINE.STATE`."""
    mask = np.zeros(len(agents.ids), np.bool_)
    for machine, column in agents.states.items():
        numbers = [k for k, name in enumerate(column.names) if state in (name, f"{machine}.{name}")]
        mask |= np.isin(column.numbers, numbers)
    return mask


def _find_targets(conditions: AgentConditions, frame: SelectableFrame) -> tuple[Floats | None, RowMasksBySpecies | None]:
    """Return the points (k, 3) from which `near` is measured. Return None if there is no `near`.

    Also return a mask of the agents at these points, or None if the points are not agents. These agents do not count as near
    themselves."""
    near = conditions.near
    if near is None:
        return None, None
    if not isinstance(near, AgentName):
        return np.array([convert_point(near, frame.unit_mm)], np.float64), None
    if near.first is None and near.name in frame.item_points:
        return frame.item_points[near.name], None
    if near.first is None and near.name in frame.cameras and near.name not in frame.lines and near.name not in frame.agents:
        return frame.cameras[near.name].find_position()[None], None
    masks = select_rows(near, frame)
    return np.concatenate([np.empty((0, 3)), *(frame.agents[name].position[mask] for name, mask in masks.items())]), masks


def _measure_nearest(position: Floats, targets: Floats) -> Floats:
    """Return the distance (mm) from each position to the nearest target: inf if there are no targets."""
    from scipy.spatial import cKDTree

    if not len(targets) or not len(position):
        return np.full(len(position), np.inf)
    nearest = cKDTree(targets).query(position)[1]
    return length(position - targets[nearest])


def _find_in_region(region: Box | Ball, position: Floats, frame: SelectableFrame) -> NDArray[np.bool_]:
    if isinstance(region, Ball):
        around = region.around
        centres = (
            frame.item_points.get(around, np.empty((0, 3)))[:1]
            if isinstance(around, str)
            else np.array([convert_point(around, frame.unit_mm)], np.float64)
        )
        return _measure_nearest(position, centres) <= region.radius.to_millimetres(frame.unit_mm)
    corners = np.array([convert_point(point, frame.unit_mm) for point in (region.corner, region.opposite)], np.float64)
    is_inside: NDArray[np.bool_] = ((position >= corners.min(axis=0)) & (position <= corners.max(axis=0))).all(axis=1)
    return is_inside
