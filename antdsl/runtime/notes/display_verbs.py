"""Verbs that change states, play clips and turn gazes, by raising events of `note_programs`."""

from __future__ import annotations

import numpy as np

from antdsl.numerics.vector_rows import length
from antdsl.runtime.notes.active_notes import NotedAgents, find_last_active_frames
from antdsl.runtime.notes.regions import select_agents_inside
from antdsl.runtime.notes.targets import find_target_points
from antdsl.runtime.world import AXES, Population, World
from antdsl.scene.crowds.casting_model import FacingDirection
from antdsl.scene.notes.note_programs import (
    LOOK_MACHINE_PREFIX,
    OFF_STATE_NAME,
    ON_STATE_NAME,
    PLAY_MACHINE_NAME,
    format_event_name,
    format_look_target_name,
    split_state_name,
)
from antdsl.scene.notes.notes_model import ChangeNote

_LOOK_DISTANCE_MM = 1e6  # mm, at which agents look that look in a direction


def apply_state_notes(agents: NotedAgents) -> None:
    """Raise the event of a `change` note, which lasts for one frame."""
    note, population = agents.active.note, agents.population
    assert isinstance(note, ChangeNote)
    for machine in population.plan.machines:
        _raise_event(agents, machine.name, split_state_name(note.to, machine.name))


def start_displays(agents: NotedAgents) -> None:
    """Raise the events for the clip and the looks of a note, and set the points at which its agents look."""
    note = agents.active.note
    agents = select_agents_inside(
        agents.select_agents(agents.world.display_frame <= find_last_active_frames(note, agents.delays))
    )  # others fade out
    population, rows = agents.population, agents.rows
    if note.played_clip:
        _raise_event(agents, PLAY_MACHINE_NAME, note.played_clip)
    for group, target in note.looks.items():
        if isinstance(target, FacingDirection):
            direction = np.array([target.direction], np.float64)
            offset = np.broadcast_to(direction * (_LOOK_DISTANCE_MM / length(direction)), (len(rows), 3))
        else:
            offset, distance = find_target_points(agents.world, target).find_nearest(population.position[rows])
            if not np.isfinite(distance).all():
                continue  # the agents that it looked at are dead
        points = population.position[rows] + offset
        for k, axis in enumerate(AXES):
            population.now[f"{format_look_target_name(group)}.{axis}"][rows] = points[:, k]
        _raise_event(agents, f"{LOOK_MACHINE_PREFIX}{group}", ON_STATE_NAME)


def end_displays(world: World, population: Population) -> None:
    """Raise the events that end clips and looks, for all agents of which no note requests any in this step."""
    for machine in population.plan.machines:
        off = format_event_name(machine.name, OFF_STATE_NAME)
        if off in population.events:
            requested = [
                population.events[format_event_name(machine.name, state)] for state in machine.states if state != OFF_STATE_NAME
            ]
            population.events[off][:] = ~np.logical_or.reduce(requested) & (population.now[f"{machine.name}.state"] != 0)


def _raise_event(agents: NotedAgents, machine: str, state: str) -> None:
    flags = agents.population.events.get(format_event_name(machine, state))
    if flags is not None:
        flags[agents.rows] = True
