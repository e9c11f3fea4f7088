"""Verbs that have a region: `slow`, `forbid`, `confine`, `attract`, `repel` and `lane`."""

from __future__ import annotations

import numpy as np

from antdsl.numerics.easing import apply_smoothstep
from antdsl.numerics.vector_rows import length
from antdsl.runtime.notes.active_notes import NotedAgents
from antdsl.runtime.notes.pace_verbs import Shares
from antdsl.runtime.notes.regions import compute_note_share_in_region, measure_distances_to_note_region, remove_inward_steps
from antdsl.runtime.notes.targets import find_ground_goal, make_note_curve
from antdsl.runtime.notes.wishes import Floats, add_velocity_wishes, project_directions_to_ground, read_max_speeds
from antdsl.scene.notes.notes_model import AttractNote, ConfineNote, ForbidNote, LaneNote, RepelNote, SlowNote


def compute_slow_region_shares(agents: NotedAgents) -> Shares:
    """Return the speed fractions for a `slow` note."""
    note, distances = agents.active.note, measure_distances_to_note_region(agents)
    assert isinstance(note, SlowNote)
    share = compute_note_share_in_region(agents, None if distances is None else distances.signed_distances)
    return (1.0 - share * (1.0 - note.speed)).astype(np.float32)


def steer_out_of_region(agents: NotedAgents, register: str, is_final: bool) -> None:
    """Steer agents out of the region of a `forbid` note, or into the region of a `confine` note."""
    distances = measure_distances_to_note_region(agents)
    assert distances is not None
    _add_direction_wish(
        agents, distances.outward_directions, compute_note_share_in_region(agents, distances.signed_distances), register, is_final
    )


def limit_steps_at_region(agents: NotedAgents, step: Floats) -> Floats:
    """Return the steps (k, 3) mm of agents, cut off at the border of a `forbid` or `confine` note's region."""
    distances = measure_distances_to_note_region(agents)
    assert isinstance(agents.active.note, ForbidNote | ConfineNote) and distances is not None
    distances = distances._replace(signed_distances=distances.signed_distances - agents.population.now["radius"][agents.rows])
    return remove_inward_steps(agents, distances, step)


def steer_towards_attractor(agents: NotedAgents, register: str, is_final: bool) -> None:
    """Steer agents towards the target of an `attract` note until they reach it."""
    note = agents.active.note
    assert isinstance(note, AttractNote)
    offset, distance = find_ground_goal(agents.world, note.target).find_nearest(agents.population.position[agents.rows])
    _steer_by_distance(agents, note, offset, np.where(distance > 0, distance, np.inf), register, is_final)


def steer_away_from_repeller(agents: NotedAgents, register: str, is_final: bool) -> None:
    """Steer agents away from the target of a `repel` note."""
    note = agents.active.note
    assert isinstance(note, RepelNote)
    offset, distance = find_ground_goal(agents.world, note.target).find_nearest(agents.population.position[agents.rows])
    _steer_by_distance(agents, note, -offset, distance, register, is_final)


def steer_along_lane(agents: NotedAgents, register: str, is_final: bool) -> None:
    """Steer agents along the curve of a `lane` note, and back towards the curve."""
    note, world, position = agents.active.note, agents.world, agents.population.position[agents.rows]
    assert isinstance(note, LaneNote)
    closest = make_note_curve(world, note.along).find_closest(*position.T)
    nearest, tangent = (
        np.stack([getattr(closest, f"{part}{axis}") for axis in "xyz"], axis=1).astype(np.float64) for part in ("p", "t")
    )
    half = note.width.to_millimetres(world.setting.unit_mm) / 2
    offset = nearest - position
    distance = length(offset)
    share = compute_note_share_in_region(agents, distance - half)
    _add_direction_wish(agents, tangent + offset / half, share, register, is_final)


def _steer_by_distance(
    agents: NotedAgents, note: AttractNote | RepelNote, direction: Floats, distance: Floats, register: str, is_final: bool
) -> None:
    """Steer agents in a direction, with full weight at the target, and with none beyond the radius of the note."""
    share = compute_note_share_in_region(agents, None) * np.isfinite(distance)
    if note.radius is not None:
        share *= apply_smoothstep(2.0 - 2.0 * distance / note.radius.to_millimetres(agents.world.setting.unit_mm))
    _add_direction_wish(agents, direction, share, register, is_final)


def _add_direction_wish(agents: NotedAgents, direction: Floats, share: Floats, register: str, is_final: bool) -> None:
    """Mix a wish for top speed in a direction into what states steer. Do nothing if `is_final`."""
    if is_final:
        return
    p, chosen = agents.population, np.flatnonzero(share > 0)
    rows = agents.rows[chosen]
    velocity = project_directions_to_ground(p, rows, direction[chosen]) * read_max_speeds(p, rows)[:, None]
    add_velocity_wishes(agents.world, p, rows, velocity, share[chosen], register)
