"""The senses: each a row that defines the words, types, costs, ranges, plan, trace and the editor's help.

To add a sense, add a row here and a function of the same `op` in `antdsl.runtime.sensing`. Only a sense with computed operands
needs a separate rule in `antdsl.plan.lowering.rules.senses`."""

from __future__ import annotations

from math import pi

from antdsl import limits
from antdsl.program.tables.rows import Builtin, Cost, Part, Sense, word

HALF_TURN = (0.0, pi * (1 + 1e-6))  # an angle in float32 may come out a little larger than half a turn
SHARE = (0.0, 1.0)
POSITIVE = (0.0, float("inf"))

_NORMAL = Part("n", size=3)
_CELLS = Cost(12, "{count} cells of {thing}", "fields", times=1, often=16)
_NEAR = Cost(100, "nearest of {thing}", named=True)
_CURVE = Cost(200, "curve {thing}")

_ROWS = (
    Sense(
        "ray",
        "target",
        (Part("hit", "b"), Part("distance"), _NORMAL),
        "nearest surface along the direction (normalised), up to reach; normal toward the agent",
        (
            word(
                "ray(direction: push, reach: length, on: obstacle) -> hit",
                "what lies in that direction, or none",
                sense=True,
                cost=Cost(400, "1 ray on {thing}"),
                sample="ray(heading, reach: 20 mm, on: stones)",
            ),
        ),
        operands="ffff",
        trace="hit at {distance:.4g} mm",
        nothing="nothing",
    ),
    Sense(
        "obstacle.near",
        "target",
        (Part("within", "b"), Part("distance"), _NORMAL),
        "closest point of an obstacle, surface or solid within reach",
        operands="f",
        trace="hit at {distance:.4g} mm",
        nothing="nothing",
    ),
    Sense(
        "field.value",
        "field",
        (Part("value"),),
        "the field in the agent's own cell",
        (
            word(
                "field_value(of: field) -> number",
                "its amount here",
                part="value",
                form="value",
                cost=Cost(15, "{thing}", "fields"),
            ),
        ),
    ),
    Sense(
        "field.ahead",
        "field",
        (Part("value"),),
        "the field where a straight way over the surface ends: so long (first), turned to the left of the heading (second)",
        (
            word(
                "smell(field: field, ahead: length, turn: angle = 0 deg) -> number",
                "how much there is of it where a straight way over the surface ends, turned to the left",
                part="value",
                sense=True,
                cost=Cost(300, "1 path over {thing}", "fields"),
                sample="smell(trail, ahead: 3 mm, turn: 30 deg)",
            ),
        ),
        operands="ff",
    ),
    Sense(
        "field.strongest",
        "field",
        (Part("value"), Part("", size=3)),
        "the strongest of the nearest `count` cells; own position where there is none",
        (
            word(
                "max(field: field, nearest: count = 16) -> number",
                "the strongest of the nearest cells",
                op="field_max",
                part="value",
                sense=True,
                cost=_CELLS,
            ),
            word(
                "strongest(field: field, nearest: count = 16) -> position",
                "where the strongest of the nearest cells lies; its own position where there is nothing",
                sense=True,
                cost=_CELLS,
                sample="direction(strongest(trail, nearest: 16))",
            ),
        ),
        attrs=("count",),
        trace="strongest {value:.4g}",
    ),
    Sense(
        "field.gradient",
        "field",
        (Part("", size=3),),
        "uphill, per mm",
        (
            word(
                "gradient(field: field) -> vector 1/length",
                "uphill in the field, per unit of length",
                sense=True,
                cost=Cost(60, "slope of {thing}", "fields"),
                sample="gradient(trail) * 10 mm",
            ),
        ),
    ),
    Sense(
        "curve.closest",
        "curve",
        (Part("distance"), Part("", size=3), Part("t", size=3)),
        "closest point and unit tangent",
        (
            word(
                "closest(on: curve) -> position",
                "the nearest point of a curve",
                sense=True,
                cost=_CURVE,
                sample="distance(closest(path))",
            ),
            word(
                "tangent(on: curve) -> push",
                "the direction of the curve at its nearest point",
                part="t",
                sense=True,
                cost=_CURVE,
                sample="tangent(path)",
            ),
        ),
        trace="{distance:.4g} mm away",
    ),
    Sense(
        "flow.value",
        "flow",
        (Part("", size=3),),
        "a flow at the agent's position, along its surface; no unit",
        (word("flow_value(of: flow) -> push", "its direction here", form="value", cost=Cost(30, "flow {thing}")),),
    ),
    Sense(
        "flow.reachable",
        "flow",
        (Part("", "b"),),
        "whether a path leads from here to the target of a solved flow; of other flows, whether they are anything here",
        (
            word(
                "reachable(of: flow) -> bool",
                "a path leads from here to the target of a solved flow; of other flows: it is anything here",
                sense=True,
                cost=Cost(30, "flow {thing}"),
                sample="reachable(drift)",
            ),
        ),
    ),
    Sense(
        "map.value",
        "map",
        (Part("value"),),
        "a painted number at the agent's position",
        (
            word(
                "map_value(of: map) -> number", "the painted value here", part="value", form="value", cost=Cost(10, "map {thing}")
            ),
        ),
    ),
    Sense(
        "noise",
        "",
        (Part("value"),),
        "gradient noise at the agent's place and time: cell size (first), number of the pattern, seconds that a cell lasts",
        (
            word(
                "noise(scale: length > 0, seed: whole number = 0, period: time > 0 = 1 s) -> number",
                "a smooth function of place and time, -1 to 1 and about 0: hills `scale` apart, others after a `period`",
                part="value",
                sense=True,
                interval=(-1, 1),
                cost=Cost(600, "noise"),
                sample="noise(scale: 20 mm, seed: 3) > 0.2",
            ),
        ),
        operands="fff",
    ),
    Sense(
        "clear.velocity",
        "",
        (Part("", size=3),),
        "the velocity nearest to one (first three) by which it meets none of the nearest others: within mm, for s, so many",
        (
            word(
                "clear_velocity(wish: velocity, within: length, horizon: time > 0 = 2 s, most: whole number > 0 = 10) "
                "-> velocity",
                "the velocity nearest to `wish` that avoids collisions for `horizon`, if the others do their half",
                sense=True,
                cost=Cost(3000, "clear velocity", within=1),
                sample="match(clear_velocity(heading * max_speed, within: 3 m))",
            ),
        ),
        operands="ffffff",
    ),
    Sense(
        "gap.widest",
        "",
        (Part("", size=3),),
        "unit way into the widest gap between the bearings of the nearest others: within mm, at most so many",
        (
            word(
                "widest_gap(within: length, most: whole number > 0 = 16) -> push",
                "into the widest gap between its neighbours, length 1; nothing without any",
                sense=True,
                cost=Cost(1500, "widest gap", within=0),
                sample="toward(widest_gap(within: 60 mm))",
            ),
        ),
        operands="ff",
    ),
    Sense(
        "clip.value",
        "",
        (Part("value"),),
        "of a clip of the species' body: seconds, stride (body lengths a turn), loop (1 or 0), `mark NAME` (turns, -1 without "
        "it); a second, 0 and 1 for no clip",
        operands="i",
        attrs=("what",),
        quiet=True,  # of the body, which is the same in every step
    ),
    Sense(
        "contact",
        "species",
        (Part("other", "l"), *(Part(f"touched{number}", "l") for number in range(1, limits.TOUCHED + 1))),
        "the id of the deepest agent that the body has begun to touch, -1 for none, and of all that it touches then; operands: "
        "ids of the agents that it touched before",
        operands="l" * limits.TOUCHED,
        trace="begins to touch agent {other:.0f}",
    ),
)
SENSES: dict[str, Sense] = {row.op: row for row in _ROWS}

# Words that mean several operations, by the kind of their subject: their rules are in `antdsl.plan.lowering.rules`.
WORDS = (
    word(
        "distance(to: place) -> length",
        "distance; infinite if none",
        sense=True,
        interval=POSITIVE,
        cost=_NEAR,
        sample="distance(nearest(food)) < 20 mm",
    ),
    word(
        "direction(of: place, to: place?) -> push",
        "toward it, length 1 (or from it to another place); zero if none",
        sense=True,
        cost=_NEAR,
        sample="direction(nearest(food))",
    ),
    word(
        "position(of: place) -> position",
        "position of a place; its own position if none",
        sense=True,
        cost=_NEAR,
        sample="position(nearest(food))",
    ),
    word(
        "velocity(of: place) -> velocity",
        "its velocity; zero if it stands still or is none",
        sense=True,
        sample="velocity(nearest(rabbit))",
    ),
    word("touching(x: place) -> bool", "its body touches that thing", sense=True, cost=_NEAR, sample="touching(nest)"),
    word(
        "falloff(from: place, floor: length) -> number",
        "floor / distance, at most 1",
        sense=True,
        interval=SHARE,
        sample="falloff(nearest(food), floor: size)",
    ),
    word(
        "match(velocity: velocity) -> push",
        "the push that reaches a velocity in this step, at most 1: (velocity - own) * mass / (max_force * dt)",
        sense=True,
        sample="match(heading * 10 mm/s)",
    ),
    word(
        "slope() -> angle",
        "angle between the ground and the horizontal",
        form="name",
        sense=True,
        interval=HALF_TURN,
        sample="when slope > 30 deg -> rest",
    ),
    word("uphill() -> push", "the world's up, laid along the ground", form="name", sense=True, sample="steer toward(uphill)"),
)


def find_words(how: str) -> tuple[Builtin, ...]:
    """Return the words of senses with one syntax: by a `call`, by a bare `name`, or as the `value` of a thing."""
    every = (*(word for sense in _ROWS for word in sense.words), *WORDS)
    return tuple(word for word in every if word.form == how)
