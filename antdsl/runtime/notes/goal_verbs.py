"""Verbs that lead agents to a target: `reach` and `path`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import elementary
from antdsl.numerics.easing import apply_smoothstep
from antdsl.numerics.records import match_ids
from antdsl.numerics.vector_rows import dot, length
from antdsl.runtime.notes.active_notes import NotedAgents
from antdsl.runtime.notes.targets import (
    NearestOnMesh,
    PointPerAgent,
    TargetPoints,
    find_ground_goal,
    find_path_points,
    find_positions_along_curve,
    rank_agents_along_curve,
)
from antdsl.runtime.notes.wishes import Floats, add_velocity_wishes, project_directions_to_ground, read_max_speeds
from antdsl.scene.notes.notes_model import PathNote, ReachNote

_COMFORTABLE_SPEED_SHARE = 0.75  # of the greatest speed: agents leave in time to go so fast
_URGENCY_SPEED_SHARES = 0.85, 0.95  # of the greatest speed: the share of the other layers falls from 1 to 0 in between
_CATCH_UP_SECONDS = 0.25  # s, in which an agent comes back to the moving point of its path
_AVOIDANCE_BODY_LENGTHS = 4.0  # bodies: how far agents keep away from their target before they leave for it
_NO_DEPARTURE_FRAME = np.iinfo(np.int64).min  # stands for the frame of a departure that has not been


class TravelPlan(NamedTuple):
    """The motion of agents towards a target, at the start of a step.

    `velocity` (k, 3) mm/s: the velocity at which they arrive in time. `wish_share` (k,): its weight in what states steer.
    `urgency` (k,): its weight in the result of all layers."""

    velocity: Floats
    wish_share: Floats
    urgency: Floats


def steer_to_target(agents: NotedAgents, register: str, is_final: bool) -> None:
    """Steer the agents of a `reach` note to their target."""
    note = agents.active.note
    assert isinstance(note, ReachNote)
    journey = compute_travel_plan(agents, find_goal_of_reach_note(agents, note), note.frame + agents.delays)
    _wish_travel_plan(agents, journey, register, is_final)


def find_goal_of_reach_note(agents: NotedAgents, note: ReachNote) -> TargetPoints | NearestOnMesh | PointPerAgent:
    """Return the target of a `reach` note. If it is a curve, the order of its agents is stored, and computed again when agents
    join."""
    if note.target is not None:
        return find_ground_goal(agents.world, note.target)
    assert note.along is not None, "it has one of both"
    species = agents.split_by_species()
    if not all(match_ids(each.ids, _read_stored_ranks(each)[:, 0])[1].all() for each in species):
        for each, ranks in zip(species, rank_agents_along_curve(agents.world, note.along, species), strict=True):
            order = np.argsort(each.ids)
            each.store_values("places", np.stack([each.ids[order], ranks[order]], axis=1))
    known = _read_stored_ranks(agents)
    at, _ = match_ids(agents.ids, known[:, 0])
    return find_positions_along_curve(
        agents.world, note.along, known[at, 1], sum(len(_read_stored_ranks(each)) for each in species)
    )


def _read_stored_ranks(agents: NotedAgents) -> NDArray[np.int64]:
    """Return the ids of agents and their ranks along the note's curve (k, 2), from the note's memory."""
    return agents.read_stored_values("places", np.empty((0, 2), np.int64))


def steer_along_path(agents: NotedAgents, register: str, is_final: bool) -> None:
    """Steer the agents of a `path` note to the beginning of the path, then along it."""
    note, world = agents.active.note, agents.world
    assert isinstance(note, PathNote)
    count = len(agents.rows)
    now, then = (
        np.broadcast_to(find_path_points(world, note, agents.ids, frame, agents.delays), (count, 3))
        for frame in (world.frame, world.display_frame)
    )
    begins = note.frames.first + agents.delays
    early, late = (np.flatnonzero(mask) for mask in (world.display_frame <= begins, world.display_frame > begins))
    if len(early):
        waiting = agents.select_agents(early)
        _wish_travel_plan(waiting, compute_travel_plan(waiting, PointPerAgent(then[early]), begins[early]), register, is_final)
    agents, now, then = agents.select_agents(late), now[late], then[late]
    position, rows = agents.population.position[agents.rows], agents.rows
    velocity = (then - now) / world.dt + (now - position) * (1.0 / _CATCH_UP_SECONDS)
    speed = length(velocity)
    most = read_max_speeds(agents.population, rows)
    velocity = project_directions_to_ground(agents.population, rows, velocity) * np.minimum(speed, most)[:, None]
    share = agents.weight
    _wish_travel_plan(agents, TravelPlan(velocity, share, share * _compute_urgency(speed, most)), register, is_final)


def compute_travel_plan(
    agents: NotedAgents, target: TargetPoints | NearestOnMesh | PointPerAgent, frames: NDArray[np.int64]
) -> TravelPlan:
    """Return the journey of agents that must be at a target in `frames` (k,), one frame per agent.

    Each agent leaves as late as it can without hurrying. Until then, it stays away from the target."""
    world, p, rows = agents.world, agents.population, agents.rows
    offset, distance = target.find_nearest(p.position[rows])
    direction, most = project_directions_to_ground(p, rows, offset), read_max_speeds(p, rows)
    seconds = np.maximum(frames - world.frame, 1) * world.dt
    heading = np.stack([p.now[f"heading.{axis}"][rows] for axis in "xyz"], axis=1).astype(np.float64)
    turn = compute_turn_seconds(heading, direction, p.now["max_turn"][rows].astype(np.float64))
    needs = np.where(distance > 0, distance / np.maximum(most * _COMFORTABLE_SPEED_SHARE, 1e-9), 0.0) + turn
    left_at = _get_or_record_departures(agents, needs + world.dt * agents.active.note.ease_frames >= seconds)
    since = np.where(left_at == _NO_DEPARTURE_FRAME, 0, world.display_frame + 1 - left_at)
    share = apply_smoothstep(since / (agents.active.note.ease_frames + 1)) * agents.weight
    size = p.now["size"][rows].astype(np.float64)
    exists = np.isfinite(distance)  # targets that are not born yet, or dead, have no distance
    early = np.where(
        exists & (left_at == _NO_DEPARTURE_FRAME), apply_smoothstep(1.0 - distance / (_AVOIDANCE_BODY_LENGTHS * size)), 0.0
    )
    share = np.where(exists, share, 0.0)
    speed = np.where(exists, distance / seconds, 0.0)
    velocity = direction * np.where(left_at == _NO_DEPARTURE_FRAME, -most, np.minimum(speed, most))[:, None]
    return TravelPlan(velocity, np.maximum(share, early), np.maximum(share * _compute_urgency(speed, most), early))


def compute_turn_seconds(heading: Floats, direction: Floats, max_turn: Floats) -> Floats:
    """Return how long (s) agents take to turn from `heading` to `direction` (k, 3). It is 0 where `direction` is 0."""
    across = length(np.cross(heading, direction))
    angle = elementary.atan2(across.astype(np.float32), dot(heading, direction).astype(np.float32)).astype(np.float64)
    return np.where(np.isfinite(max_turn), angle / np.maximum(max_turn, 1e-6), 0.0)


def _compute_urgency(speed: Floats, max_speed: Floats) -> Floats:
    low, high = _URGENCY_SPEED_SHARES
    return apply_smoothstep((speed / np.maximum(max_speed, 1e-9) - low) / (high - low))


def _get_or_record_departures(agents: NotedAgents, is_leaving: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the frame in which each agent left for its target, `_NO_DEPARTURE_FRAME` for agents that have not left yet.

    `is_leaving`: a mask of the agents that leave now, unless they have already left."""
    known = agents.read_stored_values("departures", np.empty((0, 2), np.int64))
    at, has_left = match_ids(agents.ids, known[:, 0])
    frames = np.where(is_leaving, agents.world.display_frame, _NO_DEPARTURE_FRAME)
    frames[has_left] = known[at[has_left], 1]
    walkers = np.flatnonzero(frames != _NO_DEPARTURE_FRAME)
    walkers = walkers[np.argsort(agents.ids[walkers])]
    agents.store_values("departures", np.stack([agents.ids[walkers], frames[walkers]], axis=1))
    return frames


def _wish_travel_plan(agents: NotedAgents, journey: TravelPlan, register: str, is_final: bool) -> None:
    share = journey.urgency if is_final else journey.wish_share
    add_velocity_wishes(agents.world, agents.population, agents.rows, journey.velocity, share, register)
