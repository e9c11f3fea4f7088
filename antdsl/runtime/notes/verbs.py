"""The table of verbs. It maps each verb to its functions, by the stage of a step at which they are called."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from antdsl.runtime.notes import display_verbs, goal_verbs, pace_verbs, part_verb, region_verbs, value_verbs
from antdsl.runtime.notes.active_notes import NotedAgents
from antdsl.runtime.notes.wishes import Floats


@dataclass(frozen=True, slots=True)
class NoteVerbFunctions:
    """The functions of a verb, called for the agents of one species. None means that nothing happens at that stage.

    `begin_step`: acts at the start of the step. `set_values`: changes attributes after the layers.
    `compute_speed_shares`: returns the fraction of its speed at which each agent moves. `add_wishes`: mixes wishes into the
    named registers, first into what states steer, then into the result of all layers. Its last argument tells whether the first
    wish is already part of this result, so that only urgent wishes are added. `limit_steps`: returns the steps (k, 3) mm of
    agents in a substep, without the parts that the note forbids."""

    begin_step: Callable[[NotedAgents], None] | None = None
    set_values: Callable[[NotedAgents], None] | None = None
    compute_speed_shares: Callable[[NotedAgents], pace_verbs.Shares] | None = None
    add_wishes: Callable[[NotedAgents, str, bool], None] | None = None
    limit_steps: Callable[[NotedAgents, Floats], Floats] | None = None


FUNCTIONS_BY_NOTE_VERB: Mapping[str, NoteVerbFunctions] = {
    "hold": NoteVerbFunctions(begin_step=display_verbs.start_displays, compute_speed_shares=pace_verbs.compute_hold_shares),
    "look": NoteVerbFunctions(begin_step=display_verbs.start_displays),
    "play": NoteVerbFunctions(begin_step=display_verbs.start_displays),
    "set": NoteVerbFunctions(set_values=value_verbs.apply_attribute_notes),
    "change": NoteVerbFunctions(begin_step=display_verbs.apply_state_notes),
    "retime": NoteVerbFunctions(compute_speed_shares=pace_verbs.compute_retime_shares),
    "release": NoteVerbFunctions(compute_speed_shares=pace_verbs.compute_hold_shares),
    "reach": NoteVerbFunctions(add_wishes=goal_verbs.steer_to_target),
    "path": NoteVerbFunctions(add_wishes=goal_verbs.steer_along_path),
    "slow": NoteVerbFunctions(compute_speed_shares=region_verbs.compute_slow_region_shares),
    "forbid": NoteVerbFunctions(add_wishes=region_verbs.steer_out_of_region, limit_steps=region_verbs.limit_steps_at_region),
    "confine": NoteVerbFunctions(add_wishes=region_verbs.steer_out_of_region, limit_steps=region_verbs.limit_steps_at_region),
    "attract": NoteVerbFunctions(add_wishes=region_verbs.steer_towards_attractor),
    "repel": NoteVerbFunctions(add_wishes=region_verbs.steer_away_from_repeller),
    "lane": NoteVerbFunctions(add_wishes=region_verbs.steer_along_lane),
    "part": NoteVerbFunctions(add_wishes=part_verb.steer_out_of_the_way, limit_steps=part_verb.limit_steps_at_outline),
    "without": NoteVerbFunctions(),  # `absences` removes these agents at their birth
    "thin": NoteVerbFunctions(),
}
