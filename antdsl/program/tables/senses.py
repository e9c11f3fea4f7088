"""The table of the senses. A row defines the words, types, costs, ranges, plan operation, trace and editor help of one sense.

To add a sense, add a row here and a function with the same `op` in `antdsl.runtime.sensing.world_senses`. Only a sense with
computed operands also needs a rule in `antdsl.plan.lowering.rules.senses`."""

from __future__ import annotations

from math import pi

from antdsl import limits
from antdsl.program.tables.rows import BuiltinRow, ResultPart, SenseRow, UseCost, parse_row

HALF_TURN_INTERVAL = (0.0, pi * (1 + 1e-6))  # slightly more than half a turn, because of float32 rounding
SHARE_INTERVAL = (0.0, 1.0)
POSITIVE_INTERVAL = (0.0, float("inf"))

_NORMAL_PART = ResultPart("n", component_count=3)
_CELLS_COST = UseCost(12, "{count} cells of {thing}", "fields", multiplier_index=1, default_multiplier=16)
_NEAREST_COST = UseCost(100, "nearest of {thing}", needs_thing=True)
_CURVE_COST = UseCost(200, "curve {thing}")

_SENSE_ROWS = (
    SenseRow(
        "ray",
        "target",
        (ResultPart("hit", "b"), ResultPart("distance"), _NORMAL_PART),
        "nearest surface along the direction (normalised), up to reach; normal toward the agent",
        (
            parse_row(
                "ray(direction: push, reach: length, on: obstacle) -> hit",
                "what lies in that direction, or none",
                depends_on_agent=True,
                cost=UseCost(400, "1 ray on {thing}"),
                sample="ray(heading, reach: 20 mm, on: stones)",
            ),
        ),
        operands="ffff",
        trace="hit at {distance:.4g} mm",
        empty_trace="nothing",
    ),
    SenseRow(
        "obstacle.near",
        "target",
        (ResultPart("within", "b"), ResultPart("distance"), _NORMAL_PART),
        "closest point of an obstacle, surface or solid within reach",
        operands="f",
        trace="hit at {distance:.4g} mm",
        empty_trace="nothing",
    ),
    SenseRow(
        "field.value",
        "field",
        (ResultPart("value"),),
        "the field in the agent's own cell",
        (
            parse_row(
                "field_value(of: field) -> number",
                "its amount here",
                part="value",
                form="value",
                cost=UseCost(15, "{thing}", "fields"),
            ),
        ),
    ),
    SenseRow(
        "field.ahead",
        "field",
        (ResultPart("value"),),
        "the field at the end of a straight path over the surface: its length (first), its angle left of the heading (second)",
        (
            parse_row(
                "smell(field: field, ahead: length, turn: angle = 0 deg) -> number",
                "how much there is of it where a straight way over the surface ends, turned to the left",
                part="value",
                depends_on_agent=True,
                cost=UseCost(300, "1 path over {thing}", "fields"),
                sample="smell(trail, ahead: 3 mm, turn: 30 deg)",
            ),
        ),
        operands="ff",
    ),
    SenseRow(
        "field.strongest",
        "field",
        (ResultPart("value"), ResultPart("", component_count=3)),
        "the strongest of the nearest `count` cells; own position where there is none",
        (
            parse_row(
                "max(field: field, nearest: count = 16) -> number",
                "the strongest of the nearest cells",
                op="field_max",
                part="value",
                depends_on_agent=True,
                cost=_CELLS_COST,
            ),
            parse_row(
                "strongest(field: field, nearest: count = 16) -> position",
                "where the strongest of the nearest cells lies; its own position where there is nothing",
                depends_on_agent=True,
                cost=_CELLS_COST,
                sample="direction(strongest(trail, nearest: 16))",
            ),
        ),
        attrs=("count",),
        trace="strongest {value:.4g}",
    ),
    SenseRow(
        "field.gradient",
        "field",
        (ResultPart("", component_count=3),),
        "uphill, per mm",
        (
            parse_row(
                "gradient(field: field) -> vector 1/length",
                "uphill in the field, per unit of length",
                depends_on_agent=True,
                cost=UseCost(60, "slope of {thing}", "fields"),
                sample="gradient(trail) * 10 mm",
            ),
        ),
    ),
    SenseRow(
        "curve.closest",
        "curve",
        (ResultPart("distance"), ResultPart("", component_count=3), ResultPart("t", component_count=3)),
        "closest point and unit tangent",
        (
            parse_row(
                "closest(on: curve) -> position",
                "the nearest point of a curve",
                depends_on_agent=True,
                cost=_CURVE_COST,
                sample="distance(closest(path))",
            ),
            parse_row(
                "tangent(on: curve) -> push",
                "the direction of the curve at its nearest point",
                part="t",
                depends_on_agent=True,
                cost=_CURVE_COST,
                sample="tangent(path)",
            ),
        ),
        trace="{distance:.4g} mm away",
    ),
    SenseRow(
        "flow.value",
        "flow",
        (ResultPart("", component_count=3),),
        "a flow at the agent's position, along its surface; no unit",
        (parse_row("flow_value(of: flow) -> push", "its direction here", form="value", cost=UseCost(30, "flow {thing}")),),
    ),
    SenseRow(
        "flow.reachable",
        "flow",
        (ResultPart("", "b"),),
        "whether a path leads from here to the target of a solved flow; for other flows, whether they are not 0 here",
        (
            parse_row(
                "reachable(of: flow) -> bool",
                "a path leads from here to the target of a solved flow; other flows: the flow is not 0 here",
                depends_on_agent=True,
                cost=UseCost(30, "flow {thing}"),
                sample="reachable(drift)",
            ),
        ),
    ),
    SenseRow(
        "map.value",
        "map",
        (ResultPart("value"),),
        "a painted number at the agent's position",
        (
            parse_row(
                "map_value(of: map) -> number",
                "the painted value here",
                part="value",
                form="value",
                cost=UseCost(10, "map {thing}"),
            ),
        ),
    ),
    SenseRow(
        "camera.position",
        "camera",
        (ResultPart("", component_count=3),),
        "where a camera is in the frame from which the step begins",
        is_untraced=True,  # equal for all agents; what is computed from it is traced
    ),
    SenseRow(
        "camera.in_view",
        "camera",
        (ResultPart("", "b"),),
        "whether the agent's position is in a camera's view, or outside of it by at most a distance (mm)",
        (
            parse_row(
                "in_view(of: camera, margin: length = 0 mm) -> bool",
                "a 16:9 picture of the camera shows its position, or would with `margin` more room on each side",
                depends_on_agent=True,
                cost=UseCost(20, "view of {thing}"),
                sample="in_view(shot, margin: size)",
            ),
        ),
        operands="f",
    ),
    SenseRow(
        "lamp.light",
        "items",
        (ResultPart("value"),),
        "the light of lamps on the ground at the agent's position, less what surfaces, obstacles and solids hide",
        (
            parse_row(
                "light(of: items) -> number",
                "the light of a lamp, or of items that are lamps: 1 is as bright as the sun, 0 is the dark",
                part="value",
                depends_on_agent=True,
                interval=POSITIVE_INTERVAL,
                cost=UseCost(6000, "light of {thing}"),
                sample="light(food) < 0.1",
            ),
        ),
    ),
    SenseRow(
        "noise",
        "",
        (ResultPart("value"),),
        "gradient noise at the agent's place and time: cell size (first), number of the pattern, seconds that a cell lasts",
        (
            parse_row(
                "noise(scale: length > 0, seed: whole number = 0, period: time > 0 = 1 s) -> number",
                "a smooth function of place and time, -1 to 1 and about 0: hills `scale` apart, others after a `period`",
                part="value",
                depends_on_agent=True,
                interval=(-1, 1),
                cost=UseCost(600, "noise"),
                sample="noise(scale: 20 mm, seed: 3) > 0.2",
            ),
        ),
        operands="fff",
    ),
    SenseRow(
        "clear.velocity",
        "",
        (ResultPart("", component_count=3),),
        "the velocity nearest to one (first three) by which it meets none of the nearest others: within mm, for s, so many",
        (
            parse_row(
                "clear_velocity(wish: velocity, within: length, horizon: time > 0 = 2 s, most: whole number > 0 = 10) "
                "-> velocity",
                "the velocity nearest to `wish` that avoids collisions for `horizon`, if the others do their half",
                depends_on_agent=True,
                cost=UseCost(3000, "clear velocity", distance_index=1),
                sample="match(clear_velocity(heading * max_speed, within: 3 m))",
            ),
        ),
        operands="ffffff",
    ),
    SenseRow(
        "gap.widest",
        "",
        (ResultPart("", component_count=3),),
        "unit direction into the widest gap between the bearings of the nearest agents; operands: radius (mm), maximum number",
        (
            parse_row(
                "widest_gap(within: length, most: whole number > 0 = 16) -> push",
                "into the widest gap between its neighbours, length 1; nothing without any",
                depends_on_agent=True,
                cost=UseCost(1500, "widest gap", distance_index=0),
                sample="toward(widest_gap(within: 60 mm))",
            ),
        ),
        operands="ff",
    ),
    SenseRow(
        "clip.value",
        "",
        (ResultPart("value"),),
        "of a clip of the species' body: seconds, stride (body lengths a turn), loop (1 or 0), `mark NAME` (turns, -1 without "
        "it); a second, 0 and 1 for no clip",
        operands="i",
        attrs=("what",),
        is_untraced=True,  # a property of the body, equal in every step
    ),
    SenseRow(
        "contact",
        "species",
        (ResultPart("other", "l"), *(ResultPart(f"touched{number}", "l") for number in range(1, limits.MAX_TOUCHED_AGENTS + 1))),
        "the id of the deepest agent that the body has begun to touch, -1 for none, and of all that it touches then; operands: "
        "ids of the agents that it touched before",
        operands="l" * limits.MAX_TOUCHED_AGENTS,
        trace="begins to touch agent {other:.0f}",
    ),
)
SENSE_BY_OPERATION: dict[str, SenseRow] = {row.op: row for row in _SENSE_ROWS}

# Words with several operations, one for each kind of argument. Their rules are in `antdsl.plan.lowering.rules`.
GENERIC_WORDS = (
    parse_row(
        "distance(to: place) -> length",
        "distance; infinite if none",
        depends_on_agent=True,
        interval=POSITIVE_INTERVAL,
        cost=_NEAREST_COST,
        sample="distance(nearest(food)) < 20 mm",
    ),
    parse_row(
        "direction(of: place, to: place?) -> push",
        "toward it, length 1 (or from it to another place); zero if none",
        depends_on_agent=True,
        cost=_NEAREST_COST,
        sample="direction(nearest(food))",
    ),
    parse_row(
        "position(of: place) -> position",
        "position of a place; its own position if none",
        depends_on_agent=True,
        cost=_NEAREST_COST,
        sample="position(nearest(food))",
    ),
    parse_row(
        "velocity(of: place) -> velocity",
        "its velocity; zero if it stands still or is none",
        depends_on_agent=True,
        sample="velocity(nearest(rabbit))",
    ),
    parse_row(
        "touching(x: place) -> bool",
        "its body touches that thing",
        depends_on_agent=True,
        cost=_NEAREST_COST,
        sample="touching(nest)",
    ),
    parse_row(
        "falloff(from: place, floor: length) -> number",
        "floor / distance, at most 1",
        depends_on_agent=True,
        interval=SHARE_INTERVAL,
        sample="falloff(nearest(food), floor: size)",
    ),
    parse_row(
        "match(velocity: velocity) -> push",
        "the push that reaches a velocity in this step, at most 1: (velocity - own) * mass / (max_force * dt)",
        depends_on_agent=True,
        sample="match(heading * 10 mm/s)",
    ),
    parse_row(
        "slope() -> angle",
        "angle between the ground and the horizontal",
        form="name",
        depends_on_agent=True,
        interval=HALF_TURN_INTERVAL,
        sample="when slope > 30 deg -> rest",
    ),
    parse_row(
        "uphill() -> push",
        "the world's up, laid along the ground",
        form="name",
        depends_on_agent=True,
        sample="steer toward(uphill)",
    ),
)


def find_words(form: str) -> tuple[BuiltinRow, ...]:
    """Return the words of senses that have the form `form`: a `call`, a bare `name`, or the `value` of a thing."""
    every = (*(word for sense in _SENSE_ROWS for word in sense.words), *GENERIC_WORDS)
    return tuple(word for word in every if word.form == form)
