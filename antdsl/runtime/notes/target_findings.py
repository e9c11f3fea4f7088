"""Warnings about targets of notes: before a run, agents that cannot arrive in time; after it, agents that did not."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from antdsl.diagnostics import Report
from antdsl.numerics.vector_rows import length
from antdsl.runtime.notes.active_notes import ActiveNote, NotedAgents
from antdsl.runtime.notes.goal_verbs import find_goal_of_reach_note
from antdsl.runtime.notes.regions import measure_distances_to_note_region
from antdsl.runtime.notes.stagger import get_or_compute_delays
from antdsl.runtime.notes.targets import (
    find_ground_goal,
    find_item_points,
    find_path_points,
    find_positions_along_curve,
    make_note_curve,
    rank_agents_along_curve,
)
from antdsl.runtime.notes.wishes import Floats, read_max_speeds
from antdsl.runtime.sensing.selectable_agents import collect_selectable_frame
from antdsl.runtime.world import World
from antdsl.scene import Scene
from antdsl.scene.notes.notes_model import ConfineNote, ForbidNote, Note, PathNote, ReachNote
from antdsl.scene.notes.selection import select_rows
from antdsl.scene.notes.selectors import AgentName

_SUGGESTED_EASE_FRAMES = 24  # frames by which a note should begin earlier
_HELP = "write a later frame, choose nearer agents, give them a larger `max_speed`, or make others give way with `part`"


class MissedTarget(NamedTuple):
    """Agents that were not at the target of a note in its frame: how many there were, and which was farthest away."""

    note: Note
    species: str
    late_count: int
    agent: int
    distance: float


def find_missed_target(agents: NotedAgents) -> MissedTarget | None:
    """Return the agents of a note that are late at the end of a step. None if all are in time, or no frame of the note is due.

    Agents that could arrive in one more step are in time. On a path, the first and the last frame are checked."""
    note, world, p = agents.active.note, agents.world, agents.population
    near = read_max_speeds(p, agents.rows) * world.dt
    frame = world.display_frame - agents.delays
    if isinstance(note, ReachNote):
        is_due = frame == note.frame
        _, distance = find_goal_of_reach_note(agents, note).find_nearest(p.position[agents.rows])
    elif isinstance(note, PathNote):
        is_due = (frame == note.frames.first) | (frame == note.frames.last)
        points = find_path_points(world, note, agents.ids, world.display_frame, agents.delays)
        distance = length(points - p.position[agents.rows])
        near = near + p.now["size"][agents.rows]  # agents keep apart from others on the same path
    elif isinstance(note, ForbidNote | ConfineNote) and note.first_frame - note.ease_frames > world.setting.first_frame:
        is_due, distances = frame == note.first_frame, measure_distances_to_note_region(agents)
        assert distances is not None
        distance, near = -distances.signed_distances, np.zeros(len(agents.rows))
    else:
        return None
    late = np.flatnonzero(is_due & (distance > near))
    if not len(late):
        return None
    farthest = late[np.lexsort((agents.ids[late], -distance[late]))[0]]
    return MissedTarget(note, p.name, len(late), int(agents.ids[farthest]), float(distance[farthest]))


def report_missed_targets(scene: Scene, world: World) -> Report:
    """Return warnings about agents that were not at the targets of notes in time, after a run."""
    report = Report()
    for miss in world.notes.missed_targets if world.notes is not None else ():
        subject = f"`{miss.species}.{miss.agent}`" + (f" and {miss.late_count - 1:,} others" if miss.late_count > 1 else "")
        first = f"`{miss.species}.{miss.agent}`"
        words = f"{subject} missed the target of this note: {first} was {miss.distance:.1f} mm away from it"
        help = _HELP
        if isinstance(miss.note, ForbidNote | ConfineNote):
            side = "inside" if isinstance(miss.note, ForbidNote) else "outside"
            words = (
                f"{subject} were still {side} the region in frame {miss.note.first_frame:.0f}: {first} by {miss.distance:.1f} mm"
            )
            ease = miss.note.ease_frames + _SUGGESTED_EASE_FRAMES
            help = f"begin the note earlier, write `ease: {ease:.0f}`, or slow down the agents that cross the border"
        report.warning("far-target", words, scene.find_span("notes", scene.model.notes.index(miss.note)), help)
    return report


def find_far_targets(scene: Scene, world: World) -> Report:
    """Return warnings about agents that are too far from the targets of notes to arrive in time, at the start of a run."""
    report, frame = Report(), collect_selectable_frame(world)
    for number, note in enumerate(world.setting.notes):
        if not isinstance(note, ReachNote | PathNote) or note.off == "yes":
            continue
        rows_by_species = {name: np.flatnonzero(mask) for name, mask in select_rows(note.selector, frame).items() if mask.any()}
        active = ActiveNote(note, "", rows_by_species, get_or_compute_delays(world, note, rows_by_species, {}))
        for name, rows in rows_by_species.items():
            p = world.populations[name]
            for goal in _find_goals(NotedAgents(world, active, p)):
                most = read_max_speeds(p, rows) * goal.seconds
                worst = int((goal.distance - most).argmax())
                missing = goal.distance[worst] - most[worst]
                if missing > 0:
                    text = f"`{name}.{p.ids[rows[worst]]}` cannot {goal.description} in time: it walks at most "
                    text += f"{most[worst]:.0f} mm in {goal.seconds[worst]:.3g} s, which is {missing:.1f} mm too short"
                    report.warning("far-target", text, scene.find_span("notes", number), _HELP)
    return report


class _ReachableGoal(NamedTuple):
    """A requirement of a note: each agent must walk a `distance` (n,) mm in `seconds` (n,). `description`: a description of
    it."""

    distance: Floats
    seconds: Floats
    description: str


def _find_goals(agents: NotedAgents) -> list[_ReachableGoal]:
    """Return what a `reach` or `path` note requires of its agents. Moving targets are omitted."""
    note, world, position = agents.active.note, agents.world, agents.population.position[agents.rows]
    moves = world.setting.motion
    if isinstance(note, ReachNote):
        named = note.target.name if isinstance(note.target, AgentName) else ""
        moving = named in moves.items or any(named in world.items[each].names for each in moves.items if each in world.items)
        if named and (moving or not len(find_item_points(world, named).points)):
            return []
        if note.along is not None:
            species = agents.split_by_species()
            ranks = rank_agents_along_curve(world, note.along, species)
            own = [each.population.name for each in species].index(agents.population.name)
            distance = find_positions_along_curve(world, note.along, ranks[own], sum(map(len, ranks))).find_nearest(position)[1]
        elif note.target is not None:
            distance = find_ground_goal(world, note.target).find_nearest(position)[1]
        return [_ReachableGoal(distance, np.maximum(note.frame + agents.delays - world.frame, 0) * world.dt, "reach the target")]
    assert isinstance(note, PathNote)
    curve, (first, last) = make_note_curve(world, note.along), note.frames
    begins = first + agents.delays
    to_start = length(position - find_path_points(world, note, agents.ids, first, np.zeros_like(begins)))
    return [
        _ReachableGoal(to_start, np.maximum(begins - world.frame, 0) * world.dt, "be at the beginning of the path"),
        _ReachableGoal(
            np.full(len(position), curve.length), np.full(len(position), (last - first) * world.dt), "walk along the path"
        ),
    ]
