"""The table of verbs. It maps each verb to its functions, by the stage of a step at which they are called."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from antdsl.runtime.notes import display_verbs, goal_verbs, pace_verbs, part_verb, region_verbs, value_verbs
from antdsl.runtime.notes.active_notes import NoteAgents
from antdsl.runtime.notes.wishes import Floats


@dataclass(frozen=True, slots=True)
class VerbFunctions:
    """The functions of a verb, called for the agents of one species. None means that nothing happens at that stage.

    `begin`: acts at the start of the step. `values`: changes attributes after the layers. `pace`: returns the fraction of its
    speed at which each agent moves. `wish`: mixes wishes into the named registers, first into what states steer, then into the
    result of all layers. Its last argument tells whether the first wish is already part of this result, so that only urgent
    wishes are added. `step`: returns the steps (k, 3) mm of agents in a substep, without the parts that the note forbids."""

    begin: Callable[[NoteAgents], None] | None = None
    values: Callable[[NoteAgents], None] | None = None
    pace: Callable[[NoteAgents], pace_verbs.Shares] | None = None
    wish: Callable[[NoteAgents, str, bool], None] | None = None
    step: Callable[[NoteAgents, Floats], Floats] | None = None


VERBS: Mapping[str, VerbFunctions] = {
    "hold": VerbFunctions(begin=display_verbs.show_displays, pace=pace_verbs.hold_agents),
    "look": VerbFunctions(begin=display_verbs.show_displays),
    "play": VerbFunctions(begin=display_verbs.show_displays),
    "set": VerbFunctions(values=value_verbs.set_attributes),
    "change": VerbFunctions(begin=display_verbs.change_states),
    "retime": VerbFunctions(pace=pace_verbs.retime_agents),
    "release": VerbFunctions(pace=pace_verbs.hold_agents),
    "reach": VerbFunctions(wish=goal_verbs.lead_to_target),
    "path": VerbFunctions(wish=goal_verbs.lead_along_path),
    "slow": VerbFunctions(pace=region_verbs.slow_in_region),
    "forbid": VerbFunctions(wish=region_verbs.lead_out_of_region, step=region_verbs.stop_at_region),
    "confine": VerbFunctions(wish=region_verbs.lead_out_of_region, step=region_verbs.stop_at_region),
    "attract": VerbFunctions(wish=region_verbs.lead_towards),
    "repel": VerbFunctions(wish=region_verbs.lead_away),
    "lane": VerbFunctions(wish=region_verbs.lead_along_lane),
    "part": VerbFunctions(wish=part_verb.make_way, step=part_verb.stop_at_outline),
    "without": VerbFunctions(),  # `absences` removes these agents at their birth
    "thin": VerbFunctions(),
}
