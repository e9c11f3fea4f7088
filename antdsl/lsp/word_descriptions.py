"""Short descriptions of the words of programs and scenes: for hover, and beside completion proposals. Most have a sample line."""

from __future__ import annotations

from typing import NamedTuple

from antdsl.program.tables.effects import EFFECT_BY_OPERATION
from antdsl.program.tables.senses import find_words
from antdsl.program.tables.things import KIND_BY_WORD


class WordHelp(NamedTuple):
    """A word, or one meaning of it."""

    help: str
    sample: str


STATE_WORD_HELP = {
    "state": WordHelp("the state it is in", "when mood.state == scared -> run"),
    "previous": WordHelp("the state it was in before", "when after 1 s -> previous"),
    "next": WordHelp("the state it goes to, while it changes", "exit { tired = if next == run then 0 else 1 }"),
    "time_in_state": WordHelp("how long it has been in its state", "when time_in_state > 2 s -> rest"),
}
VALUE_HELP = {
    "self": WordHelp("the animal itself", "direction(nearest(food), to: self)"),
    "it": WordHelp("the element that `with:` asks about", "nearest(food, with: distance(it) < 9 mm)"),
    "true": WordHelp("yes", "hungry = true"),
    "false": WordHelp("no", "hungry = false"),
    "dt": WordHelp("how long one step lasts", "exp(-dt / 2 s)"),
    "time": WordHelp("seconds up to the frame that is made: `frame` times `dt`", "when time > 10 s -> rest"),
    "frame": WordHelp("the number of the frame that is made", "when frame == 120 -> rest"),
    **{row.name: WordHelp(row.help, row.sample) for row in find_words("name")},
    "into": WordHelp("the attribute that takes what is dug out", "carve hill(radius: 2 mm, into: soil)"),
    "other": WordHelp("what a number is in the run that the spec compares with", "sooner: total(food.load) == 0"),
    "at_start": WordHelp("what the other side of the comparison was at the start", "always: total(food.load) <= at_start"),
    "motion": WordHelp("how the crowd moves: `motion.turn_p99` and the like", "finally: motion.turn_p99 < 200 deg/s"),
}
# Settings of a field.
SETTING_HELP = {
    "cell": WordHelp("how large its cells are", "field trail on ground { cell 4 mm }"),
    "half_life": WordHelp("the time in which half of it is gone", "field trail on ground { cell 4 mm; half_life 8 s }"),
    "evaporate": WordHelp(
        "the share that goes in a time, such as `10 %/s`", "field heat on ground { cell 10 mm; evaporate 10 %/s }"
    ),
    "keeps": WordHelp(
        "the share that stays in a step, such as `90 %/step`", "field old on ground { cell 4 mm; keeps 90 %/step }"
    ),
    "diffuse": WordHelp(
        "how it spreads, an area in a time, such as `20 mm^2/s`", "field heat on ground { cell 10 mm; diffuse 20 mm^2/s }"
    ),
    "stencil": WordHelp(
        "to how many cells round about it spreads, `4` or `8`",
        "field heat on ground { cell 10 mm; diffuse 20 mm^2/s; stencil 8 }",
    ),
    "combine": WordHelp("`add` what is laid, or keep the `max`", "field heat on ground { cell 10 mm; combine max }"),
    "deposits": WordHelp(
        "whether what is laid spreads and fades in the same step, `first`, or from the next one on, `last`",
        "field heat on ground { cell 10 mm; half_life 8 s; deposits first }",
    ),
    "limit": WordHelp("the most that a cell holds", "field heat on ground { cell 10 mm; limit 5 }"),
}
# Words that begin a line, and `take`.
FORM_HELP = {
    "steer": "what the animal wants in this state, a push",
    "face": "which way the body turns, whichever way it goes",
    "when": "leads to another state",
    "interrupt": "a change that leaves before all others",
    **{row.op: row.help for row in EFFECT_BY_OPERATION.values()},
    "give": "hands an amount to an item",
    "take": "gets an amount from an item, as part of the condition",
    "enter": "once, when the state begins",
    "exit": "once, when the state ends",
    "param": "a value that a scene may set, with its range",
    "let": "a name for a value",
    "latch": "a yes that stays until something else",
    "fuzzy": "rules over shades of truth",
    "start": "the first state",
    "on": "what happens at an event",
    "layers": "which wish wins: the first line first",
    "machine": "states beside others",
    "state": "what an animal does for a while",
    "from": "a change out of any state",
    "use": "brings in behaviours",
    "world": "what a scene must bring",
    "field": "scent on surfaces",
    "species": "a kind of animal",
    "behaviour": "a named wish or value",
    "spec": "what a crowd must do",
    "keep": "memory from step to step",
    "for": "how long it runs",
    "seeds": "with which seeds",
    "set": "with which values",
    "always": "holds in every frame",
    "never": "holds in no frame",
    "eventually": "holds in some frame",
    "finally": "holds in the last frame",
    "sooner": "holds in an earlier frame than in the run that `against` names",
    "pass": "the share of the seeds that is enough",
    "against": "another run to compare with",
    "until": "ends the run",
    "within": "holds before a time is over",
    "each": "asks of every agent",
    "ant": "the edition of the language",
    "play": "the clip that the body plays in this state",
    "wear": "a layer of the body that is shown in this state, beside its own",
    "channel": "the value of a channel of the body in this state",
    "look": "a part of the body turns to something",
}
# Words inside a line. Some of them also begin lines, with another meaning.
INNER_WORD_HELP = {
    "on": WordHelp("where it lies, or in which scene it is checked", "field trail on ground { cell 4 mm }"),
    "in": WordHelp("the range that a param stays in, or the set that is gone through", "param smell = 40 mm in 0 mm .. 200 mm"),
    "from": WordHelp(
        "the agent or item that it is taken from, or where something begins", "when touching(meal) take 1 load from meal -> carry"
    ),
    "to": WordHelp("the agent or item that it is given to, or where something ends", "give all load to nest"),
    "when": WordHelp(
        "this layer counts only for agents for which this holds", "layers { avoid(stones) when speed > 5 mm/s; state }"
    ),
    "until": WordHelp("what ends it", "latch hungry = energy < 0.4 until energy > 0.6"),
    "each": WordHelp("a value about each of another species", "likes = 0 for each roach, strongest 8"),
    "strongest": WordHelp("how many of these values are used, the greatest", "likes = 0 for each roach, strongest 8"),
    "take": WordHelp(
        "gets an amount from an item, as part of the condition", "when touching(meal) take 1 load from meal -> carry"
    ),
    "all": WordHelp("as much as there is", "give all load to nest"),
    "after": WordHelp("so long in this state", "when after 5 s -> rest"),
    "held": WordHelp("it must have been so without a break for that long", "when speed < 1 mm/s held 0.5 s -> rest"),
    "chance": WordHelp(
        "happens at that rate, whatever the frames a second; a share where it is evaluated once", "when chance 20 %/s -> rest"
    ),
    "clip": WordHelp("the clip that is played: `clip done`, or `clip at MARK`", "when clip done -> rest"),
    "done": WordHelp("`clip done`: the clip has been played through", "when clip done -> rest"),
    "for": WordHelp(
        "the shortest time in this state, or what a value is about", "state rest for at least 1 s { when after 2 s -> walk }"
    ),
    "least": WordHelp(
        "`for at least 1 s`: nothing but `interrupt` leaves the state sooner",
        "state rest for at least 1 s { when after 2 s -> walk }",
    ),
    "choose": WordHelp("one of several states, by weight", "when after 5 s -> choose { rest: 2; dig: 1 }"),
    "any": WordHelp("out of every state", "from any except dead when hurt -> flee"),
    "except": WordHelp("but not out of these", "from any except dead when hurt -> flee"),
    "relax": WordHelp("goes back of itself", "fear = 0 relax to 0 over 5 s"),
    "over": WordHelp("how long that takes, until a third is left", "fear = 0 relax to 0 over 5 s"),
    "then": WordHelp("what follows: the next value, or that of `if`", "load = if full then 1 else 0"),
    "if": WordHelp("one of two values", "load = if full then 1 else 0"),
    "else": WordHelp("the value where the condition does not hold", "load = if full then 1 else 0"),
    "is": WordHelp("`x is none`: there is no such thing", "when meal is none -> search"),
    "none": WordHelp("no item, no agent", "source = none of food"),
    "of": WordHelp("of which items or species", "source = none of food"),
    "no": WordHelp("there is none", "when no meal -> search"),
    "not": WordHelp("the opposite", "when not hungry -> rest"),
    "and": WordHelp("both; of shades the lesser", "when hungry and meal -> approach"),
    "or": WordHelp("one at least; of shades the greater", "when hungry or meal -> approach"),
    "as": WordHelp("the name by which a file is called here", 'use "./mine.ant" as mine'),
    "within": WordHelp("before that time is over", "when fear > 0.5 within 2 s: speed > 20 mm/s"),
    "eventually": WordHelp("in that frame or a later one", "when fear > 0.5 eventually: fear < 0.1"),
}
# Arguments of `play`.
PLAY_HELP = {
    "speed": "times as fast as its own speed",
    "weight": "share of the pose, from 0 to 1",
    "on": "only on the joints of that transform group",
    "again": "whether it starts again when the state is entered",
    "add": "`true`: added to all other clips that play",
    "left": "the clip that it gives way to as the agent turns left",
    "right": "the clip that it gives way to as the agent turns right",
    "up": "the clip that it gives way to uphill",
    "down": "the clip that it gives way to downhill",
}
STEP_UNIT_NOTE = "by the step, and so by the frames per second: `antdsl check --strict` tells of it"
# Units that need more explanation than their value.
UNIT_HELP = {
    "step": "one step of the simulation: `response 1 step`, `keeps 90 %/step`. For models that are defined per tick: "
    "how long it lasts depends on the frames per second, and is `dt`: `x + 2 /s * dt`",
    "u": "the scene's own unit, of its key `units`",
    "%": "a hundredth: `30 %` is 0.3, `10 %/s` is a tenth a second",
    "turn": "once round",
}
# Types other than numbers with a unit.
TYPE_HELP = {
    "number": "a number without a unit",
    "push": "a wish or a direction: a vector without a unit",
    "vector": "a vector of any unit",
    "position": "a vector of lengths",
    "velocity": "a vector of speeds",
    "bool": "a yes or no",
    "place": "anything that is somewhere: an item, an agent, a position, a curve",
    "item": "one item, or none",
    "agent": "one agent, or none",
    "field": "a field by its name",
    **{row.word: row.typed for row in KIND_BY_WORD.values() if row.typed},
}
# Queries over all items, agents or cells in a spec.
AGGREGATE_HELP = {
    "total": WordHelp("the sum over all items, agents or cells", "always: total(food.load) < 9"),
    "share": WordHelp("for which part of them it holds, from 0 to 1", "always: share(state == carry) < 0.9"),
}
_HEIGHT_SAMPLE = "world: {arena: {height: hills.png, extent: [400 mm, 400 mm], scale: 30 mm, offset: 2 mm}}"
_WALK_SAMPLE = (
    "crowd: [{species: forager, from: forager.ant, count: 1, walk: {direction: [1, 0, 0], speed: 30 mm/s, length: 40 mm}}]"
)


def _make_crowd_sample(part: str) -> str:
    """Return a sample of a crowd with one more part in its line."""
    return f"crowd: [{{species: forager, from: forager.ant, count: 50, {part}}}]"


# Keys of a scene.
SCENE_KEY_HELP = {
    "antdsl": WordHelp("the edition of the scene format, `1`", "antdsl: 1"),
    "extends": WordHelp("another scene, of which this one says what differs", "extends: scene.yaml"),
    "units": WordHelp("what a bare number of this file is in: `mm`, `cm`, `m`", "units: mm"),
    "up": WordHelp("the axis that points up: `x`, `y`, `z`", "up: y"),
    "fps": WordHelp("frames a second", "fps: 24"),
    "frames": WordHelp("first and last frame, `1..240`", "frames: 1..240"),
    "preroll": WordHelp("steps before the first frame, not written", "preroll: 48"),
    "substeps": WordHelp("how often the moving part is done in a step", "substeps: 2"),
    "stick": WordHelp("how agents stay on meshes: over `triangles`, or by `rays`", "stick: triangles"),
    "orient": WordHelp(
        "what bodies stand across: the ground's `normal`, the last two directions (`turns`), the ways to two `probes`",
        "orient: normal",
    ),
    "contacts": WordHelp("how bodies keep apart: `off`, `soft`, `hard`", "contacts: hard"),
    "seed": WordHelp("where all chance begins", "seed: 7"),
    "from": WordHelp("the program, or a cache to go on from", "from: {cache: out/scene, frame: 240}"),
    "world": WordHelp("what the programs walk on, go round and find", "world: {ground: {mesh: ground.ply}}"),
    "crowd": WordHelp("which agents, how many, where", "crowd: [{species: forager, from: forager.ant, count: 50}]"),
    "set": WordHelp("other values for params and settings of fields", "set: {forager.smell: 60 mm}"),
    "fields": WordHelp("what lies in a field at the start", "fields: {trail: {start: 0.5, around: home, radius: 30 mm}}"),
    "layers": WordHelp("another order of a species' layers", "layers: {forager: [state, avoid]}"),
    "camera": WordHelp("from where pictures are taken", "camera: {at: [0, 300, 200], look_at: [0, 0, 0]}"),
    "lod": WordHelp("distances from the camera beyond which feelers are simpler", "lod: {near: 300 mm, far: 900 mm}"),
    "output": WordHelp("what a cache holds", "output: {checkpoint: 48}"),
    "species": WordHelp("a species of the program", "crowd: [{species: forager, from: forager.ant, count: 50}]"),
    "count": WordHelp("how many agents", "crowd: [{species: forager, from: forager.ant, count: 50}]"),
    "place": WordHelp("where they begin", _make_crowd_sample("place: {on: ground}")),
    "body": WordHelp("what pictures draw", _make_crowd_sample("body: ant")),
    "on": WordHelp("the surface", _make_crowd_sample("place: {on: ground}")),
    "around": WordHelp("a point `[x, y, z]`, or an item", _make_crowd_sample("place: {around: home}")),
    "radius": WordHelp("how far about that place", _make_crowd_sample("place: {around: home, radius: 40 mm}")),
    "points": WordHelp("a file of places", _make_crowd_sample("place: {points: starts.json}")),
    "density": WordHelp("a map that says where they are many", _make_crowd_sample("place: {on: ground, density: damp}")),
    "walk": WordHelp("a way that they are led, deciding nothing", _WALK_SAMPLE),
    "direction": WordHelp("in the scene's axes, `[x, y, z]`", _WALK_SAMPLE),
    "speed": WordHelp("how fast they are led", _WALK_SAMPLE),
    "length": WordHelp("how far they are led", _WALK_SAMPLE),
    "apart": WordHelp("how far from each other at least, or `even`", _make_crowd_sample("place: {on: ground, apart: even}")),
    "by": WordHelp("`above`, or `area`: undersides too", _make_crowd_sample("place: {on: ground, by: area}")),
    "at": WordHelp("a place, `[x, y, z]`", "camera: {at: [0, 300, 200], look_at: [0, 0, 0]}"),
    "look_at": WordHelp("what the camera looks at", "camera: {at: [0, 300, 200], look_at: [0, 0, 0]}"),
    "focal": WordHelp("focal length", "camera: {at: [0, 300, 200], look_at: [0, 0, 0], focal: 35 mm}"),
    "mesh": WordHelp("a file of triangles", "world: {hill: {mesh: hill.ply, voxel: 2 mm}}"),
    "height": WordHelp("a 16-bit image, or an array of an .npz file", _HEIGHT_SAMPLE),
    "extent": WordHelp("how far it goes along x and the other level axis", _HEIGHT_SAMPLE),
    "offset": WordHelp("by how much all heights are raised", _HEIGHT_SAMPLE),
    "voxel": WordHelp("how fine a solid is", "world: {hill: {mesh: hill.ply, voxel: 2 mm}}"),
    "keys": WordHelp("places at frames", "world: {lorry: {mesh: lorry.ply, keys: {1: {at: [0, 0, 0]}, 48: {at: [20, 0, 0]}}}}"),
    "attributes": WordHelp("what a frame of the cache holds", "output: {attributes: [P, v, id, state]}"),
    "checkpoint": WordHelp("frames between full checkpoints", "output: {checkpoint: 48}"),
}


def find_scene_key_help(key: str) -> str:
    """Return the purpose of a scene's key; "" for another word."""
    return SCENE_KEY_HELP[key].help if key in SCENE_KEY_HELP else ""
