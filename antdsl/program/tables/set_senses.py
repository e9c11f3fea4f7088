"""The table of the words that return a set, with one row for each. `SET_CHECKERS` of `antdsl.program.types.sets` checks their
uses, and `antdsl.plan.lowering.sets` lowers them."""

from __future__ import annotations

from antdsl.program.tables.rows import SetSense, UseCost, parse_row

_SET_ROWS = (
    SetSense(
        "neighbours",
        (
            parse_row(
                "neighbours(radius: length, fov: angle = 360 deg, of: species?, most: number?) -> set",
                "others of the same species (or of another) near it and in its field of view",
            ),
        ),
        ("set.agents",),
        UseCost(600, "{thing}", distance_index=0),
        "count(neighbours(radius: 20 mm, fov: 270 deg))",
    ),
    SetSense(
        "all",
        (
            parse_row("all(of: items, within: length?, with: condition?, most: number?) -> set", "items or agents"),
            parse_row("all(of: species, within: length?, with: condition?, most: number?) -> set", "agents"),
        ),
        ("set.items", "set.every", "set.agents"),
        UseCost(100, "all {thing}", distance_index=0),
        "count(all(food, within: 40 mm))",
    ),
    SetSense(
        "feelers",
        (
            parse_row(
                "feelers(on: obstacle, count: count = 3, spread: angle = 35 deg, reach: length) -> set",
                "hits of rays along the velocity, spread evenly up to `spread` to either side about the up axis",
            ),
        ),
        ("ray",),
        UseCost(400, "{count} rays on {thing}", multiplier_index=0, default_multiplier=3),
        "any(feelers(stones, count: 3, spread: 35 deg, reach: 6 mm))",
    ),
    SetSense(
        "nearest",
        (
            parse_row("nearest(of: items, within: length?, with: condition?) -> item", "the nearest, or none"),
            parse_row("nearest(of: species, within: length?, with: condition?) -> agent", "the nearest, or none"),
            parse_row("nearest(of: set) -> any", "the nearest of a set, or none"),
        ),
        (),  # the nearest element of one of the sets above
        None,
        "nearest(food, within: 40 mm)",
    ),
)
SET_SENSE_BY_OPERATION: dict[str, SetSense] = {row.op: row for row in _SET_ROWS}
# the other operations return one element
SET_RESULT_OPERATIONS = frozenset(row.op for row in _SET_ROWS if row.rows[0].result == "set")
