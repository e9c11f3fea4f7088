"""What the words of programs and scenes mean, in a few words each: for hovering, and beside what completion proposes."""

from __future__ import annotations

from antdsl.program.tables.effects import EFFECTS
from antdsl.program.tables.senses import spoken
from antdsl.program.tables.things import KINDS_OF_THINGS

STATE_WORD_HELP = {
    "state": "the state it is in",
    "previous": "the state it was in before",
    "next": "the state it goes to, while it changes",
    "time_in_state": "how long it has been in its state",
}
WORD_HELP = {
    "self": "the animal itself",
    "it": "the element that `with:` asks about",
    "true": "yes",
    "false": "no",
    "dt": "how long one step lasts",
    "time": "seconds up to the frame that is made: `frame` times `dt`",
    "frame": "the number of the frame that is made",
    **{row.name: row.help for row in spoken("name")},
    "into": "the attribute that takes what is dug out",
    "other": "what a number is in the run that the spec compares with",
    "at_start": "what the other side of the comparison was at the start",
    "motion": "how the crowd moves: `motion.turn_p99` and the like",
}
# Kinds of things of the world.
KINDS = {row.word: row.help for row in KINDS_OF_THINGS.values()}
# Settings of a field.
SETTINGS = {
    "cell": "how large its cells are",
    "half_life": "the time in which half of it is gone",
    "evaporate": "the share that goes in a time, such as `10 %/s`",
    "keeps": "the share that stays in a step, such as `90 %/step`",
    "diffuse": "how it spreads, an area in a time, such as `20 mm^2/s`",
    "combine": "`add` what is laid, or keep the `max`",
    "limit": "the most that a cell holds",
}
# Words that begin a line, and `take`.
FORM_HELP = {
    "steer": "what the animal wants in this state, a push",
    "when": "leads to another state",
    "interrupt": "a change that leaves before all others",
    **{row.op: row.help for row in EFFECTS.values()},
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
    "play": "plays a clip; not yet",
}
# Words inside a line; some of them begin lines too and mean something else there.
INNER_HELP = {
    "on": "where it lies, or which scene it is asked of",
    "in": "the range that a param stays in, or the set that is gone through",
    "from": "from whom it is taken, or where something begins",
    "to": "to whom it is given, or where something ends",
    "when": "this layer counts only for those for whom this holds",
    "until": "what ends it",
    "each": "a value about each of another species",
    "strongest": "how many of these values are kept, the greatest",
    "take": "gets an amount from an item, as part of the condition",
    "all": "as much as there is",
    "after": "so long in this state",
    "held": "it must have been so without a break for that long",
    "chance": "happens at that rate, whatever the frames a second; a share where it is asked once",
    "for": "the shortest time in this state, or what a value is about",
    "least": "`for at least 1 s`: nothing but `interrupt` leaves the state sooner",
    "choose": "one of several states, by weight",
    "any": "out of every state",
    "except": "but not out of these",
    "relax": "goes back of itself",
    "over": "how long that takes, until a third is left",
    "then": "what follows: the next value, or that of `if`",
    "if": "one of two values",
    "else": "the value where the condition does not hold",
    "is": "`x is none`: there is no such thing",
    "none": "no item, no agent",
    "of": "of which items or species",
    "no": "there is none",
    "not": "the opposite",
    "and": "both; of shades the lesser",
    "or": "one at least; of shades the greater",
    "as": "the name by which a file is called here",
    "within": "before that time is over",
    "eventually": "in that frame or a later one",
}
STEPS = "by the step, and so by the frames per second: `antdsl check --strict` tells of it"
# Units of which more is to be said than what they are worth.
UNIT_HELP = {
    "step": "one step of the simulation: `response 1 step`, `keeps 90 %/step`. For models that are defined per tick: "
    "how long it lasts depends on the frames per second, and is `dt`: `x + 2 /s * dt`",
    "u": "the scene's own unit, of its key `units`",
    "%": "a hundredth: `30 %` is 0.3, `10 %/s` is a tenth a second",
    "turn": "once round",
}
# Types that are no numbers with a unit.
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
    **{row.word: row.typed for row in KINDS_OF_THINGS.values() if row.typed},
}
# What is asked of all in a spec.
WHOLE_HELP = {
    "total": "the sum over all items, agents or cells",
    "share": "for which part of them it holds, from 0 to 1",
}
# Keys of a scene.
SCENE_HELP = {
    "antdsl": "the edition of the scene format, `1`",
    "extends": "another scene, of which this one says what differs",
    "units": "what a bare number of this file is in: `mm`, `cm`, `m`",
    "up": "the axis that points up: `x`, `y`, `z`",
    "fps": "frames a second",
    "frames": "first and last frame, `1..240`",
    "preroll": "steps before the first frame, not written",
    "substeps": "how often the moving part is done in a step",
    "contacts": "how bodies keep apart: `off`, `soft`, `hard`",
    "seed": "where all chance begins",
    "from": "the program, or a cache to go on from",
    "world": "what the programs walk on, go round and find",
    "crowd": "which agents, how many, where",
    "set": "other values for params and settings of fields",
    "fields": "what lies in a field at the start",
    "layers": "another order of a species' layers",
    "camera": "from where pictures are taken",
    "lod": "distances from the camera beyond which feelers are simpler",
    "output": "what a cache holds",
    "species": "a species of the program",
    "count": "how many agents",
    "place": "where they begin",
    "body": "what pictures draw",
    "on": "the surface",
    "around": "a point `[x, y, z]`, or an item",
    "radius": "how far about that place",
    "points": "a file of places",
    "density": "a map that says where they are many",
    "by": "`above`, or `area`: undersides too",
    "at": "a place, `[x, y, z]`",
    "look_at": "what the camera looks at",
    "focal": "focal length",
    "mesh": "a file of triangles",
    "voxel": "how fine a solid is",
    "keys": "places at frames",
    "attributes": "what a frame of the cache holds",
    "checkpoint": "frames between full checkpoints",
}
