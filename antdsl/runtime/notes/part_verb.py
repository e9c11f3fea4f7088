"""The verb `part`: agents make way for a thing before it reaches them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.easing import apply_smoothstep
from antdsl.numerics.vector_rows import dot, length
from antdsl.runtime.notes.active_notes import NotedAgents
from antdsl.runtime.notes.outlines import (
    compute_outline_centre,
    find_agents_in_thing,
    find_outlines_of_thing,
    is_thing_moving,
    measure_distances_to_outlines,
)
from antdsl.runtime.notes.regions import RegionDistances, remove_inward_steps
from antdsl.runtime.notes.wishes import Floats, add_velocity_wishes, project_directions_to_ground, read_max_speeds
from antdsl.runtime.world import World
from antdsl.scene.notes.notes_model import PartNote

_LOOKAHEAD_SECONDS = (0.0, 0.25, 0.5, 1.0, 1.5, 2.0, 3.0)  # s, at which agents compare their position with the outline
_TURN_SECONDS, _SPARE_SECONDS = 0.25, 0.5  # s, to turn away; and to spare, from which on agents begin to make way
_CLEARANCE_SHARE = 0.25  # of the distance: how far agents are outside the outline when it passes
_URGENT_SHARE = 0.6  # of the need, from which on the other layers count less


def steer_out_of_the_way(agents: NotedAgents, register: str, is_final: bool) -> None:
    """Steer the agents of a `part` note away from the outline of the thing, and out of its path."""
    p, rows = agents.population, agents.rows
    need, direction = _compute_evasion_urgency(agents)
    share = apply_smoothstep((need - _URGENT_SHARE) / (1.0 - _URGENT_SHARE)) if is_final else need
    velocity = project_directions_to_ground(p, rows, direction) * read_max_speeds(p, rows)[:, None]
    add_velocity_wishes(agents.world, p, rows, velocity, share * agents.weight, register)


def limit_steps_at_outline(agents: NotedAgents, step: Floats) -> Floats:
    """Return the steps (k, 3) mm of agents, cut off at the outline of the thing in the new frame."""
    note, world, p, rows = agents.active.note, agents.world, agents.population, agents.rows
    assert isinstance(note, PartNote)
    outlines = find_outlines_of_thing(world, note.thing, world.display_frame)
    reach = float(p.now["radius"][rows].max(initial=0.0) + read_max_speeds(p, rows).max(initial=0.0) * world.dt)
    outside, outward = measure_distances_to_outlines(world, outlines, p.position[rows], reach)
    outside = np.where(_find_agents_of_thing(agents), np.inf, outside)
    distances = RegionDistances(outside - p.now["radius"][rows], outward)
    return remove_inward_steps(agents, distances, step)


def _compute_evasion_urgency(agents: NotedAgents) -> tuple[Floats, Floats]:
    """Return how urgently each agent needs to make way (k,), 0 to 1, and in which direction (k, 3)."""
    note, world, p, rows = agents.active.note, agents.world, agents.population, agents.rows
    assert isinstance(note, PartNote)
    distance = note.distance.to_millimetres(world.setting.unit_mm)
    speed = np.maximum(read_max_speeds(p, rows), 1e-6)
    clear = p.now["radius"][rows] + distance * _CLEARANCE_SHARE
    need, direction = np.zeros(len(rows)), np.zeros((len(rows), 3))
    reach = max(distance, float(clear.max(initial=0.0)))
    centre = compute_outline_centre(world, find_outlines_of_thing(world, note.thing, world.display_frame))
    for seconds in _LOOKAHEAD_SECONDS if is_thing_moving(world, note.thing) else _LOOKAHEAD_SECONDS[:1]:
        outlines = find_outlines_of_thing(world, note.thing, world.display_frame + round(seconds / world.dt))
        outside, outward = measure_distances_to_outlines(world, outlines, p.position[rows], reach)
        outward = _turn_directions_aside(world, outward, compute_outline_centre(world, outlines) - centre)
        if seconds:
            spare = seconds - np.maximum(clear - np.minimum(outside, clear), 0.0) / speed - _TURN_SECONDS
            own = np.where(outside < clear, apply_smoothstep(1.0 - spare / _SPARE_SECONDS), 0.0)
        else:
            own = apply_smoothstep(1.0 - outside / distance)
        direction += own[:, None] * outward
        need = np.maximum(need, own)
    return np.where(_find_agents_of_thing(agents), 0.0, need), direction


def _find_agents_of_thing(agents: NotedAgents) -> NDArray[np.bool_]:
    """Return a mask (k,) of the agents that are part of the thing for which the others make way."""
    note, p = agents.active.note, agents.population
    assert isinstance(note, PartNote)
    own = find_agents_in_thing(agents.world, note.thing).get(p.name, np.zeros(len(p), np.bool_))
    return own[agents.rows]


def _turn_directions_aside(world: World, outward_directions: Floats, travel: Floats) -> Floats:
    """Turn outward directions (k, 3) to the side of a moving thing, so that agents do not run ahead of it. `travel` (3,): its
    motion (mm)."""
    (distance,) = length(travel[None]).tolist()
    if distance < 1e-6:
        return outward_directions
    ahead = travel / distance
    left = np.cross(world.up, ahead)
    side = np.where(dot(outward_directions, np.broadcast_to(left, outward_directions.shape)) < 0, -1.0, 1.0)
    has_direction = (outward_directions != 0).any(axis=1)
    turned: Floats = np.where(has_direction[:, None], side[:, None] * left, 0.0)
    return turned
