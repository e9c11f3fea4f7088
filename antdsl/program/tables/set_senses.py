"""The words that give a set, one row each. `SETS` of `antdsl.program.types.sets` and the lowering of sets evaluate them."""

from __future__ import annotations

from antdsl.program.tables.rows import Arg, Builtin, Cost, SetSense

_WITHIN, _WITH = Arg("within", "length", optional=True), Arg("with", "condition", optional=True)
_MOST = Arg("most", "number", optional=True)  # so many count, the nearest


def _set_builtin(op: str, args: tuple[Arg, ...], help: str, result: str = "set") -> Builtin:
    return Builtin(args, result, help, op)


_SET_ROWS = (
    SetSense(
        "neighbours",
        (
            _set_builtin(
                "neighbours",
                (Arg("radius", "length"), Arg("fov", "angle", "360 deg"), Arg("of", "species", optional=True), _MOST),
                "others of the same species (or of another) near it and in its field of view",
            ),
        ),
        ("set.agents",),
        Cost(600, "{thing}", within=0),
        "count(neighbours(radius: 20 mm, fov: 270 deg))",
    ),
    SetSense(
        "all",
        (
            _set_builtin("all", (Arg("of", "items"), _WITHIN, _WITH, _MOST), "items or agents"),
            _set_builtin("all", (Arg("of", "species"), _WITHIN, _WITH, _MOST), "agents"),
        ),
        ("set.items", "set.every", "set.agents"),
        Cost(100, "all {thing}", within=0),
        "count(all(food, within: 40 mm))",
    ),
    SetSense(
        "feelers",
        (
            _set_builtin(
                "feelers",
                (Arg("on", "obstacle"), Arg("count", "count", "3"), Arg("spread", "angle", "35 deg"), Arg("reach", "length")),
                "hits of rays along the velocity, spread evenly up to `spread` to either side about the up axis",
            ),
        ),
        ("ray",),
        Cost(400, "{count} rays on {thing}", times=0, often=3),
        "any(feelers(stones, count: 3, spread: 35 deg, reach: 6 mm))",
    ),
    SetSense(
        "nearest",
        (
            _set_builtin("nearest", (Arg("of", "items"), _WITHIN, _WITH), "the nearest, or none", "item"),
            _set_builtin("nearest", (Arg("of", "species"), _WITHIN, _WITH), "the nearest, or none", "agent"),
            _set_builtin("nearest", (Arg("of", "set"),), "the nearest of a set, or none", "any"),
        ),
        (),  # the nearest of one of the sets above
        None,
        "nearest(food, within: 40 mm)",
    ),
)
SET_SENSES: dict[str, SetSense] = {row.op: row for row in _SET_ROWS}
GIVES_SET = frozenset(row.op for row in _SET_ROWS if row.rows[0].result == "set")  # the others give one of a set
