"""Short descriptions of the words of programs and scenes, mostly with a sample line. Editors show them on hover and in
completions."""

from __future__ import annotations

from typing import NamedTuple

from antdsl.program.tables.effects import EFFECT_BY_OPERATION
from antdsl.program.tables.senses import find_words
from antdsl.program.tables.things import KIND_BY_WORD


class WordHelp(NamedTuple):
    """The help for one meaning of a word. `sample`: a sample line; "" if there is none."""

    help: str
    sample: str


STATE_WORD_HELP = {
    "state": WordHelp("the agent's current state", "when mood.state == scared -> run"),
    "previous": WordHelp("the previous state", "when after 1 s -> previous"),
    "next": WordHelp("the next state, during a transition", "exit { tired = if next == run then 0 else 1 }"),
    "time_in_state": WordHelp("the time since the agent entered its state", "when time_in_state > 2 s -> rest"),
}
VALUE_HELP = {
    "self": WordHelp("the animal itself", "direction(nearest(food), to: self)"),
    "it": WordHelp("the element that `with:` tests", "nearest(food, with: distance(it) < 9 mm)"),
    "true": WordHelp("yes", "hungry = true"),
    "false": WordHelp("no", "hungry = false"),
    "dt": WordHelp("the duration of a step", "exp(-dt / 2 s)"),
    "time": WordHelp("the time of the current frame in seconds: `frame` times `dt`", "when time > 10 s -> rest"),
    "frame": WordHelp("the number of the current frame", "when frame == 120 -> rest"),
    **{row.name: WordHelp(row.help, row.sample) for row in find_words("name")},
    "into": WordHelp("the attribute that receives the dug amount", "carve hill(radius: 2 mm, into: soil)"),
    "other": WordHelp("the value of the number in the reference run", "sooner: total(food.load) == 0"),
    "time_of": WordHelp("the time at which a condition first holds", "measure empty = time_of(total(food.load) == 0)"),
    "at_start": WordHelp("the value of the comparison's other side at the start", "always: total(food.load) <= at_start"),
    "motion": WordHelp("measures of motion, such as `motion.turn_p99`", "finally: motion.turn_p99 < 200 deg/s"),
}
# Settings of a field.
SETTING_HELP = {
    "cell": WordHelp("the size of a cell", "field trail on ground { cell 4 mm }"),
    "half_life": WordHelp(
        "the time in which half of the amount disappears", "field trail on ground { cell 4 mm; half_life 8 s }"
    ),
    "evaporate": WordHelp(
        "the share that evaporates per time, such as `10 %/s`", "field heat on ground { cell 10 mm; evaporate 10 %/s }"
    ),
    "keeps": WordHelp(
        "the share that remains after a step, such as `90 %/step`", "field old on ground { cell 4 mm; keeps 90 %/step }"
    ),
    "diffuse": WordHelp(
        "the rate of spreading, an area per time, such as `20 mm^2/s`", "field heat on ground { cell 10 mm; diffuse 20 mm^2/s }"
    ),
    "stencil": WordHelp(
        "the number of neighbour cells to which it spreads, `4` or `8`",
        "field heat on ground { cell 10 mm; diffuse 20 mm^2/s; stencil 8 }",
    ),
    "combine": WordHelp("whether deposits `add` up, or the `max` counts", "field heat on ground { cell 10 mm; combine max }"),
    "deposits": WordHelp(
        "whether deposits spread and fade in the same step (`first`) or from the next step on (`last`)",
        "field heat on ground { cell 10 mm; half_life 8 s; deposits first }",
    ),
    "limit": WordHelp("the maximum amount of a cell", "field heat on ground { cell 10 mm; limit 5 }"),
}
# Words that begin a line, and `take`.
FORM_HELP = {
    "steer": "the push of the animal in this state",
    "face": "the direction that the body faces while it moves in any direction",
    "when": "a transition to another state",
    "interrupt": "a transition that is checked before all others",
    **{row.op: row.help for row in EFFECT_BY_OPERATION.values()},
    "give": "gives an amount to an item",
    "take": "takes an amount from an item, as part of the condition",
    "enter": "actions when the state begins",
    "exit": "actions when the state ends",
    "param": "a value with a range that a scene may set",
    "let": "a name for a value",
    "latch": "a condition that stays true until another one holds",
    "fuzzy": "rules with degrees of truth",
    "start": "the first state",
    "on": "actions for an event",
    "layers": "the layers of pushes, in order of priority",
    "machine": "a second set of states that runs in parallel",
    "state": "a state with its behaviour and transitions",
    "from": "a transition from any state",
    "use": "makes behaviours of a library or file available",
    "world": "the things that a scene must define",
    "field": "scent on surfaces",
    "species": "a kind of animal",
    "behaviour": "a named push or value",
    "spec": "expectations about a run",
    "measure": "a number or a condition that each run reports",
    "keep": "a value that is remembered from step to step",
    "for": "the duration of the run",
    "seeds": "the seeds of the runs",
    "set": "a value that the spec sets",
    "goal": "a number that the run should reach at its end, within a tolerance",
    "always": "must hold in every frame",
    "never": "must not hold in any frame",
    "eventually": "must hold in at least one frame",
    "finally": "must hold in the last frame",
    "sooner": "must hold in an earlier frame than in the run of `against`",
    "pass": "the share of seeds that must pass",
    "against": "the reference run",
    "until": "ends the run",
    "within": "must hold within a time",
    "each": "expectations about each agent",
    "ant": "the edition of the language",
    "play": "the clip that the body plays in this state",
    "wear": "an additional layer of the body that is visible in this state",
    "channel": "the value of a channel of the body in this state",
    "look": "a part of the body that turns towards a point",
}
# Words inside a line. Some of them also begin lines, with another meaning.
INNER_WORD_HELP = {
    "on": WordHelp("the surface of a field, or the scene of a spec", "field trail on ground { cell 4 mm }"),
    "in": WordHelp("the range of a param, or the set of a reduction", "param smell = 40 mm in 0 mm .. 200 mm"),
    "from": WordHelp(
        "the agent or item that gives an amount, or the start of a range", "when touching(meal) take 1 load from meal -> carry"
    ),
    "to": WordHelp("the agent or item that receives an amount, or the end of a range", "give all load to nest"),
    "when": WordHelp(
        "the layer applies only to agents that fulfil this condition", "layers { avoid(stones) when speed > 5 mm/s; state }"
    ),
    "until": WordHelp("the condition that ends the latch", "latch hungry = energy < 0.4 until energy > 0.6"),
    "each": WordHelp("one value about each agent of a species", "likes = 0 for each roach, strongest 8"),
    "strongest": WordHelp("the maximum number of stored values; the strongest stay", "likes = 0 for each roach, strongest 8"),
    "take": WordHelp(
        "takes an amount from an item, as part of the condition", "when touching(meal) take 1 load from meal -> carry"
    ),
    "all": WordHelp("the complete amount", "give all load to nest"),
    "after": WordHelp("the time in this state", "when after 5 s -> rest"),
    "held": WordHelp("the condition must have held without interruption for this time", "when speed < 1 mm/s held 0.5 s -> rest"),
    "chance": WordHelp(
        "happens at this rate, at any frame rate; a probability where it is evaluated once", "when chance 20 %/s -> rest"
    ),
    "clip": WordHelp("a test of the current clip: `clip done` or `clip at MARK`", "when clip done -> rest"),
    "done": WordHelp("`clip done`: the clip has been played through", "when clip done -> rest"),
    "for": WordHelp(
        "the minimum time in this state, or the species that a value is about",
        "state rest for at least 1 s { when after 2 s -> walk }",
    ),
    "least": WordHelp(
        "`for at least 1 s`: only `interrupt` leaves the state earlier", "state rest for at least 1 s { when after 2 s -> walk }"
    ),
    "choose": WordHelp("one of several states, by weight", "when after 5 s -> choose { rest: 2; dig: 1 }"),
    "any": WordHelp("a transition from every state", "from any except dead when hurt -> flee"),
    "except": WordHelp("the states that `from any` omits", "from any except dead when hurt -> flee"),
    "relax": WordHelp("returns to this value automatically", "fear = 0 relax to 0 over 5 s"),
    "over": WordHelp("the time until about a third of the difference is left", "fear = 0 relax to 0 over 5 s"),
    "then": WordHelp("the next value of `keep`, or the value of `if` where the condition holds", "load = if full then 1 else 0"),
    "if": WordHelp("chooses one of two values", "load = if full then 1 else 0"),
    "else": WordHelp("the value where the condition does not hold", "load = if full then 1 else 0"),
    "is": WordHelp("`x is none`: x does not exist", "when meal is none -> search"),
    "none": WordHelp("no item or agent", "source = none of food"),
    "of": WordHelp("the items or species of `none`", "source = none of food"),
    "no": WordHelp("true if there is none", "when no meal -> search"),
    "not": WordHelp("the opposite", "when not hungry -> rest"),
    "and": WordHelp("true if both hold; of two degrees of truth, the lesser", "when hungry and meal -> approach"),
    "or": WordHelp("true if at least one holds; of two degrees of truth, the greater", "when hungry or meal -> approach"),
    "as": WordHelp("the name of a used file here", 'use "./mine.ant" as mine'),
    "within": WordHelp("within this time", "when fear > 0.5 within 2 s: speed > 20 mm/s"),
    "eventually": WordHelp("in this frame or a later one", "when fear > 0.5 eventually: fear < 0.1"),
}
# Arguments of `play`.
PLAY_HELP = {
    "speed": "factor of the clip's own speed",
    "weight": "share of the pose, from 0 to 1",
    "on": "the transform group with the joints that move",
    "again": "whether the clip restarts when an agent enters the state",
    "add": "`true`: the clip is added to all other clips",
    "left": "the clip that replaces it when the agent turns left",
    "right": "the clip that replaces it when the agent turns right",
    "up": "the clip that replaces it uphill",
    "down": "the clip that replaces it downhill",
}
STEP_UNIT_NOTE = "per step, so it depends on the frames per second: `antdsl check --strict` reports it"
# Units that need more explanation than their value.
UNIT_HELP = {
    "step": "one step of the simulation: `response 1 step`, `keeps 90 %/step`. For models that are defined per tick: "
    "how long it lasts depends on the frames per second, and is `dt`: `x + 2 /s * dt`",
    "u": "the scene's own unit, defined by its key `units`",
    "%": "a hundredth: `30 %` is 0.3, `10 %/s` is 0.1 per second",
    "turn": "360 degrees",
}
# Types other than numbers with a unit.
TYPE_HELP = {
    "number": "a number without a unit",
    "push": "a push or a direction: a vector without a unit",
    "vector": "a vector of any unit",
    "position": "a vector of lengths",
    "velocity": "a vector of speeds",
    "bool": "a yes or no",
    "place": "anything with a position: an item, an agent, a position, a curve",
    "item": "one item, or none",
    "agent": "one agent, or none",
    "field": "a field by its name",
    **{row.word: row.type_meaning for row in KIND_BY_WORD.values() if row.type_meaning},
}
# Queries over all items, agents or cells in a spec.
AGGREGATE_HELP = {
    "total": WordHelp("the sum over all items, agents or cells", "always: total(food.load) < 9"),
    "share": WordHelp("the share for which the condition holds, from 0 to 1", "always: share(state == carry) < 0.9"),
}
_HEIGHT_SAMPLE = "world: {arena: {height: hills.png, extent: [400 mm, 400 mm], scale: 30 mm, offset: 2 mm}}"
_LENS_SAMPLE = "camera: {at: [0, 300, 200], look_at: [0, 0, 0], f_stop: 8, focus: 350 mm}"
_WALK_SAMPLE = (
    "crowd: [{species: forager, from: forager.ant, count: 1, walk: {direction: [1, 0, 0], speed: 30 mm/s, length: 40 mm}}]"
)
_RATE_SAMPLE = "crowd: [{species: forager, from: forager.ant, rate: 20 /s, frames: 49..96, place: {around: home, radius: 9 mm}}]"


def _make_crowd_sample(part: str) -> str:
    """Return a sample crowd line that contains `part`."""
    return f"crowd: [{{species: forager, from: forager.ant, count: 50, {part}}}]"


# Keys of a scene.
SCENE_KEY_HELP = {
    "antdsl": WordHelp("the edition of the scene format, `1`", "antdsl: 1"),
    "extends": WordHelp("a parent scene; this scene contains the differences", "extends: scene.yaml"),
    "units": WordHelp("the unit of numbers without a unit: `mm`, `cm`, `m`", "units: mm"),
    "up": WordHelp("the axis that points up: `x`, `y`, `z`", "up: y"),
    "fps": WordHelp("frames a second", "fps: 24"),
    "frames": WordHelp("first and last frame, `1..240`", "frames: 1..240"),
    "until": WordHelp("ends the run with the first frame in which it holds", "until: total(food.load) == 0"),
    "preroll": WordHelp("steps before the first frame, not written", "preroll: 48"),
    "substeps": WordHelp("the number of movement steps per frame", "substeps: 2"),
    "stick": WordHelp("how agents stay on meshes: by `triangles` or by `rays`", "stick: triangles"),
    "orient": WordHelp(
        "how bodies are oriented: by the ground's `normal`, the last two directions (`turns`) or two `probes`", "orient: normal"
    ),
    "contacts": WordHelp("how overlapping bodies are separated: `off`, `soft`, `hard`", "contacts: hard"),
    "seed": WordHelp("the seed of all random numbers", "seed: 7"),
    "from": WordHelp("the program, or a cache to continue from", "from: {cache: out/scene, frame: 240}"),
    "world": WordHelp("the things of the world, such as ground, obstacles and items", "world: {ground: {mesh: ground.ply}}"),
    "crowd": WordHelp("the agents: species, numbers and positions", "crowd: [{species: forager, from: forager.ant, count: 50}]"),
    "set": WordHelp("other values for params and settings of fields", "set: {forager.smell: 60 mm}"),
    "fields": WordHelp("the values of a field at the start", "fields: {trail: {start: 0.5, around: home, radius: 30 mm}}"),
    "layers": WordHelp("another order of a species' layers", "layers: {forager: [state, avoid]}"),
    "camera": WordHelp("the camera of pictures", "camera: {at: [0, 300, 200], look_at: [0, 0, 0]}"),
    "cameras": WordHelp("further cameras, by name", "cameras: {wide: {at: [0, 900, 600], look_at: [0, 0, 0]}}"),
    "follow": WordHelp("the agent that a camera follows", "cameras: {hero: {follow: ant.17, by: [80, 40, 0]}}"),
    "smooth": WordHelp("over which time its motion is averaged", "cameras: {hero: {follow: ant.17, smooth: 1 s}}"),
    "lod": WordHelp("distances from the camera beyond which feelers are simpler", "lod: {near: 300 mm, far: 900 mm}"),
    "output": WordHelp("what a cache holds", "output: {checkpoint: 48}"),
    "species": WordHelp("a species of the program", "crowd: [{species: forager, from: forager.ant, count: 50}]"),
    "count": WordHelp("how many agents", "crowd: [{species: forager, from: forager.ant, count: 50}]"),
    "name": WordHelp("of the line; notes and edits name its agents by it", _make_crowd_sample("name: guards")),
    "rate": WordHelp("how many are created per second", _RATE_SAMPLE),
    "seconds": WordHelp(
        "when they are created, from the first frame on", _RATE_SAMPLE.replace("frames: 49..96", "seconds: 2 s .. 4 s")
    ),
    "each": WordHelp("attributes at birth, and the first `state`", _make_crowd_sample("each: {size: {normal: [4 mm, 0.5 mm]}}")),
    "uniform": WordHelp("evenly between two numbers", _make_crowd_sample("each: {size: {uniform: [3 mm, 5 mm]}}")),
    "normal": WordHelp("around a mean, with a deviation", _make_crowd_sample("each: {size: {normal: [4 mm, 0.5 mm]}}")),
    "choice": WordHelp("one of several values, by weight", _make_crowd_sample("each: {size: {choice: {3 mm: 3, 5 mm: 1}}}")),
    "along": WordHelp("a curve on which they begin", _make_crowd_sample("place: {along: way_in}")),
    "edge": WordHelp("a surface with open borders on which they begin", _make_crowd_sample("place: {edge: ground, facing: in}")),
    "in": WordHelp("a box or a ball", _make_crowd_sample("place: {in: {from: [0, 0, 0], to: [90, 20, 90]}}")),
    "ranks": WordHelp("rows behind each other", _make_crowd_sample("place: {ranks: {columns: 5, spacing: 8 mm}}")),
    "clumps": WordHelp("groups", _make_crowd_sample("place: {on: ground, clumps: {number: 4, radius: 30 mm}}")),
    "facing": WordHelp(
        "`out`, `in`, `along`, a point, an item or a direction",
        _make_crowd_sample("place: {around: home, radius: 40 mm, facing: out}"),
    ),
    "place": WordHelp("where they begin", _make_crowd_sample("place: {on: ground}")),
    "body": WordHelp("what pictures draw", _make_crowd_sample("body: ant")),
    "on": WordHelp("the surface", _make_crowd_sample("place: {on: ground}")),
    "around": WordHelp("a point `[x, y, z]`, or an item", _make_crowd_sample("place: {around: home}")),
    "radius": WordHelp("the radius around the place", _make_crowd_sample("place: {around: home, radius: 40 mm}")),
    "points": WordHelp("a file of places", _make_crowd_sample("place: {points: starts.json}")),
    "density": WordHelp("a map of the density of agents", _make_crowd_sample("place: {on: ground, density: damp}")),
    "walk": WordHelp("a guided walk, without decisions", _WALK_SAMPLE),
    "direction": WordHelp("in the scene's axes, `[x, y, z]`", _WALK_SAMPLE),
    "speed": WordHelp("the speed of the guided walk", _WALK_SAMPLE),
    "length": WordHelp("the length of the guided walk", _WALK_SAMPLE),
    "apart": WordHelp("the minimum distance between agents, or `even`", _make_crowd_sample("place: {on: ground, apart: even}")),
    "by": WordHelp("`above`, or `area`, which includes undersides", _make_crowd_sample("place: {on: ground, by: area}")),
    "at": WordHelp("a place, `[x, y, z]`", "camera: {at: [0, 300, 200], look_at: [0, 0, 0]}"),
    "look_at": WordHelp("the point that the camera looks at", "camera: {at: [0, 300, 200], look_at: [0, 0, 0]}"),
    "focal": WordHelp("focal length", "camera: {at: [0, 300, 200], look_at: [0, 0, 0], focal: 35 mm}"),
    "f_stop": WordHelp("focal length by lens diameter, for depth of field", _LENS_SAMPLE),
    "focus": WordHelp("what is sharp: a distance or an agent", _LENS_SAMPLE),
    "mesh": WordHelp("a file of triangles", "world: {hill: {mesh: hill.ply, voxel: 2 mm}}"),
    "height": WordHelp("a 16-bit image, or an array of an .npz file", _HEIGHT_SAMPLE),
    "extent": WordHelp("the size along x and along the other horizontal axis", _HEIGHT_SAMPLE),
    "offset": WordHelp("a height that is added to all heights", _HEIGHT_SAMPLE),
    "start": WordHelp("the value of a field's cells at the start", "fields: {trail: {start: 1, around: home, radius: 30 mm}}"),
    "values": WordHelp("an image or array of values over the ground", "fields: {grass: {values: meadow.png, scale: 3}}"),
    "voxel": WordHelp("the size of a solid's voxels", "world: {hill: {mesh: hill.ply, voxel: 2 mm}}"),
    "keys": WordHelp("places at frames", "world: {lorry: {mesh: lorry.ply, keys: {1: {at: [0, 0, 0]}, 48: {at: [20, 0, 0]}}}}"),
    "attributes": WordHelp("the attributes in the frames of the cache", "output: {attributes: [P, v, id, state]}"),
    "checkpoint": WordHelp("the number of frames between checkpoints", "output: {checkpoint: 48}"),
}


def find_scene_key_help(key: str) -> str:
    """Return the help for a key of scenes; "" if the word is not a key."""
    return SCENE_KEY_HELP[key].help if key in SCENE_KEY_HELP else ""
