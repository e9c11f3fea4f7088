"""The kinds of things of the world: rows from which the words of messages, the plan's lists and the editor's help are made."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class KindOfThing:
    """`word`: as `world { … }` declares it. `called`: in messages, where "a" and the word are not enough. `held`: the list of the
    plan that has the names. `serves`: kinds of things that may stand where this one is wanted."""

    word: str
    help: str
    sample: str
    called: str = ""
    held: str = ""
    serves: tuple[str, ...] = ()


_ROWS = (
    KindOfThing("surface", "what can be walked on", "world { surface floor }", "a surface", "surfaces", ("surface",)),
    KindOfThing(
        "obstacle",
        "what stands in the way, and is gone round",
        "world { obstacle chairs }",
        "an obstacle",
        "obstacles",
        ("obstacle", "surface", "solid"),
    ),
    KindOfThing("solid", "soft ground that may be dug", "world { solid sand }", "a solid", "solids", ("solid",)),
    KindOfThing(
        "items", "things that are placed, each with values of its own", "world { items fruit { load = 0 } }", serves=("items",)
    ),
    KindOfThing("curve", "a line drawn in space", "world { curve path }", "a curve", "curves", ("curve",)),
    KindOfThing("flow", "directions over the ground", "world { flow drift }", "a flow", "flows", ("flow",)),
    KindOfThing("map", "numbers painted on the ground", "world { map damp }", "a map", "maps", ("map",)),
    KindOfThing("species", "animals that another file describes", "world { species beetle { hunger = 0 } }"),
)
KINDS_OF_THINGS: dict[str, KindOfThing] = {row.word: row for row in _ROWS}
HELD: dict[str, str] = {row.word: row.held for row in _ROWS if row.held}
