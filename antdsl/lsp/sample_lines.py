"""Sample lines for calls and for queries of sets. Editors display them on hover, and `antdsl check --explain` prints them."""

from __future__ import annotations

from antdsl.program.tables import senses, set_senses

_PLAIN_CALL_SAMPLES = {
    "abs": "abs(load - 1)",
    "clamp": "clamp(speed, 5 mm/s .. 20 mm/s)",
    "floor": "floor(load)",
    "sqrt": "sqrt(load)",
    "sin": "sin(30 deg)",
    "cos": "cos(30 deg)",
    "exp": "exp(-dt / 2 s)",
    "log": "log(2)",
    "ramp": "ramp(speed, from: 0 mm/s .. 20 mm/s, to: 0.2 .. 1)",
    "mix": "mix(load, 1, 0.5)",
    "min": "min(load, 1)",
    "max": "max(load, 0)",
    "length": "length(velocity)",
    "unit": "unit(velocity)",
    "dot": "dot(heading, up)",
    "cross": "cross(heading, up)",
    "angle": "angle(heading, direction(nearest(food))) < 30 deg",
    "rotate": "rotate(heading, about: up, by: 15 deg)",
    "project": "project(velocity, onto: up)",
    "limit": "limit(velocity, 10 mm/s)",
    "vector": "vector(0, 0, 1)",
    "first": "first(nearest(food, with: load > 0), nearest(food))",
    "uniform": "uniform(3 mm, 5 mm)",
    "normal": "normal(0 deg, 20 deg)",
    "pick": "pick(0.5, 1, 2)",
    "random": "random(rabbit)",
    "rising": "rising(load, 0 .. 1)",
    "falling": "falling(distance(nearest(food)), 0 mm .. 40 mm)",
    "around": "around(load, 0 .. 1)",
}
CALL_SAMPLES = {
    **_PLAIN_CALL_SAMPLES,
    **{row.name: row.sample for row in senses.find_words("call") if row.sample},
    **{row.op: row.sample for row in set_senses.SET_SENSE_BY_OPERATION.values()},
}
SET_QUERY_SAMPLES = {
    "sum": "sum(n in neighbours(20 mm): n.load)",
    "mean": "mean(n in neighbours(20 mm): n.velocity)",
    "min": "min(n in neighbours(20 mm): distance(n))",
    "max": "max(n in neighbours(20 mm): n.speed)",
    "count": "count(n in neighbours(20 mm): n.load > 0)",
    "any": "any(f in all(food, within: 50 mm): f.load > 0)",
    "every": "every(n in neighbours(20 mm): n.load > 0)",
    "best": "best(f in all(food): f.load)",
}
