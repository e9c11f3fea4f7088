"""The kinds of things of the world, one row each. Type words, message texts for programs and scenes, the plan's lists and the
editor's help come from them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class KindOfThing:
    """`word`: as `world { … }` declares it. `called`: in messages, where "a" and the word are not enough. `serves`: kinds of
    things that may replace this one. `typed`: what it is as the type of an argument; "" if it is no type word. In a scene it is
    `scene_form` as such, in messages `scene`, in an editor `snippet`."""

    word: str
    help: str
    sample: str
    called: str = ""
    serves: tuple[str, ...] = ()
    typed: str = ""
    scene_form: str = ""
    scene: str = ""
    snippet: str = ""


_ROWS = (
    KindOfThing(
        "surface",
        "ground that agents walk on",
        "world { surface floor }",
        called="a surface",
        serves=("surface",),
        typed="the name of a surface",
        scene_form="a mesh",
        scene="{mesh: ground.ply}",
        snippet="{mesh: ${1:ground.ply}}",
    ),
    KindOfThing(
        "obstacle",
        "what stands in the way, and is gone round",
        "world { obstacle chairs }",
        called="an obstacle",
        serves=("obstacle", "surface", "solid"),
        typed="an obstacle, a surface or a solid by its name",
        scene_form="a mesh",
        scene="{mesh: stones.ply}",
        snippet="{mesh: ${1:stones.ply}}",
    ),
    KindOfThing(
        "solid",
        "soft ground that may be dug",
        "world { solid sand }",
        called="a solid",
        serves=("solid",),
        scene_form="a mesh",
        scene="{mesh: hill.ply, voxel: 1 mm}",
        snippet="{mesh: ${1:hill.ply}, voxel: ${2:1 mm}}",
    ),
    KindOfThing(
        "items",
        "things that are placed, each with its own values",
        "world { items fruit { load = 0 } }",
        serves=("items",),
        typed="all items with a name",
        scene_form="items",
        scene="{one: {at: [0, 0, 0]}}",
        snippet="{${1:one}: {at: [${2:0}, 0, ${3:0}]}}",
    ),
    KindOfThing(
        "curve",
        "a line drawn in space",
        "world { curve path }",
        called="a curve",
        serves=("curve",),
        typed="the name of a curve",
        scene_form="a curve",
        scene="{curve: way.json}",
        snippet="{curve: ${1:way.json}}",
    ),
    KindOfThing(
        "flow",
        "directions along the ground",
        "world { flow drift }",
        called="a flow",
        serves=("flow",),
        typed="the name of a flow",
        scene_form="a flow",
        scene="{toward: [0, 0, 0], radius: 50 mm}",
        snippet="{toward: ${1:nest}, radius: ${2:50 mm}}",
    ),
    KindOfThing(
        "map",
        "numbers painted on the ground",
        "world { map damp }",
        called="a map",
        serves=("map",),
        typed="the name of a map",
        scene_form="a map",
        scene="{painted: ground.ply, attribute: NAME}",
        snippet="{painted: ${1:ground.ply}, attribute: ${2:damp}}",
    ),
    KindOfThing(
        "species", "agents that another file describes", "world { species beetle { hunger = 0 } }", typed="the name of a species"
    ),
)
KINDS_OF_THINGS: dict[str, KindOfThing] = {row.word: row for row in _ROWS}
