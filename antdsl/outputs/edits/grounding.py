"""Moves agents over ground. They retain their height above it, and turn with its normal. The same applies to each foot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.transforms import Floats, multiply_quaternions
from antdsl.outputs.cache.cache_reader import Arrays
from antdsl.outputs.cache.manifest import Manifest
from antdsl.outputs.edits.frame_rows import FrameRows, match_rows
from antdsl.outputs.edits.verbs.agent_moves import AgentMoves, find_axes, find_shortest_rotations, move_agents, rotate_vectors
from antdsl.outputs.edits.verbs.terrain import MirroredTerrain, Terrain

_GROUND_REACH = 10.0  # body lengths in which ground is searched along an agent's up, in addition to the agent's displacement
_LIFT = 0.5  # body lengths: ground up to there above a point counts as below it


@dataclass(frozen=True, slots=True, eq=False)
class Grounds:
    """The ground below agents before (`old`) and after (`new`) a move.

    `down_direction`: the unit vector along which agents fall onto the new ground. None if they reach it along their own up
    direction."""

    old: Terrain | MirroredTerrain
    new: Terrain
    down_direction: Floats | None = None


def move_on_ground(arrays: Arrays, manifest: Manifest, moves: AgentMoves, grounds: Grounds) -> dict[str, NDArray[Any]]:
    """Return a frame in which agents have moved over ground. Agents and feet without ground nearby move rigidly."""
    rows = moves.rows
    start, orient, length = (np.asarray(arrays[name], np.float64)[rows] for name in ("P", "orient", "pscale"))
    up = find_axes(orient)[1]
    lift, reach = _LIFT * length, _GROUND_REACH * length
    displacement = moves.position - start
    distance = np.sqrt((displacement * displacement).sum(axis=1))
    old = grounds.old.find_along(start, up, lift, reach)
    height = ((start - old.position) * up).sum(axis=1)
    turned_up = rotate_vectors(moves.rotation, up)
    if grounds.down_direction is None:
        new = grounds.new.find_along(moves.position - turned_up * height[:, None], turned_up, lift, reach + distance)
    else:
        new = grounds.new.find_below(moves.position, np.broadcast_to(-grounds.down_direction, start.shape), lift)
    aligned = find_shortest_rotations(rotate_vectors(moves.rotation, old.normal), new.normal)
    is_grounded = old.is_hit & new.is_hit
    rotation = np.where(is_grounded[:, None], multiply_quaternions(aligned, moves.rotation), moves.rotation)
    new_up = rotate_vectors(rotation, up)
    position = np.where(is_grounded[:, None], new.position + new_up * (height * moves.size)[:, None], moves.position)
    placed = AgentMoves(rows, position, rotation, moves.size, moves.speed)
    moved = move_agents(arrays, manifest, placed)
    keys = FrameRows(arrays, manifest)
    for name, feet_keys in keys.iterate_agent_arrays():
        if not name.startswith("feet.") or not name.endswith(".P"):
            continue
        at, is_moved = match_rows(feet_keys, keys.keys[rows])
        chosen = np.flatnonzero(is_moved)
        agent = at[chosen]
        chosen, agent = chosen[is_grounded[agent]], agent[is_grounded[agent]]
        legs = moved[name].shape[1]
        each = np.repeat(agent, legs)
        old_feet = np.asarray(arrays[name], np.float64)[chosen].reshape(-1, 3)
        rigid_feet = np.asarray(moved[name], np.float64)[chosen].reshape(-1, 3)
        below = grounds.old.find_along(old_feet, up[each], lift[each], reach[each])
        height_above = ((old_feet - below.position) * up[each]).sum(axis=1) * moves.size[each]
        target = grounds.new.find_along(rigid_feet - new_up[each] * height_above[:, None], new_up[each], lift[each], reach[each])
        is_known = (below.is_hit & target.is_hit)[:, None]
        feet = np.where(is_known, target.position + new_up[each] * height_above[:, None], rigid_feet)
        moved[name][chosen] = feet.reshape(-1, legs, 3)
    return moved
