"""The table of the kinds of things of the world, with one row for each kind.

The rows are the source of type words, checks, lowering, message texts for programs and scenes, the plan's lists and the editor's
help. The class that reads a kind from a scene is in `antdsl.scene.scene_kinds`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True)
class ThingKindRow:
    """A kind of thing of the world.

    - `word`: its word in `world { … }`.
    - `label`: its name in messages, such as `a curve`; "" if its type already has a name there.
    - `replaced_kinds`: the argument kinds for which this kind is also allowed.
    - `type_meaning`: its meaning as the type of an argument; "" if it is no type word.
    - `scene_form`: words for its definition in a scene, such as `a mesh`.
    - `scene`: an example of the definition, for messages. `snippet`: the same with placeholders, for an editor.
    - `nearest_op`: the plan operation that finds the nearest point of the thing; "" if the thing has no position.
    - `touching_op`: the plan operation that tests whether agents touch it, if that is not `nearest_op`.
    - `has_values`: whether each of its members has attributes.
    - `is_ground`: whether agents walk on it.
    - `is_blocking`: whether it blocks the path of agents.
    - `is_dug`: whether agents change its shape. The total of such a thing is a volume.
    - `look`: the default material of its meshes in pictures.
    - `wrap_advice`: what to write instead in a periodic world; "" if it continues across the seam.
    - `section`: the key of the scene section that holds its entries.
    - `type_word`: the kind of its values in expressions, if that is not `word`."""

    word: str
    help: str
    sample: str
    label: str = ""
    replaced_kinds: tuple[str, ...] = ()
    type_meaning: str = ""
    scene_form: str = ""
    scene: str = ""
    snippet: str = ""
    nearest_op: str = ""
    touching_op: str = ""
    has_values: bool = False
    is_ground: bool = False
    is_blocking: bool = False
    is_dug: bool = False
    look: Literal["ground", "stone"] = "ground"
    wrap_advice: str = ""
    section: str = "world"
    type_word: str = ""

    @property
    def is_item_group(self) -> bool:
        """Return whether the thing is a group of items with positions and sizes."""
        return self.nearest_op == "set.items"

    @property
    def has_faces(self) -> bool:
        """Return whether the thing consists of triangles or voxels that agents can sense."""
        return self.nearest_op == "obstacle.near"


_STEERING_ADVICE = "steer by fields, items or neighbours, which wrap"
_THING_ROWS = (
    ThingKindRow(
        "surface", "ground that agents walk on", "world { surface floor }", label="a surface",
        type_meaning="the name of a surface", replaced_kinds=("obstacle",), nearest_op="obstacle.near",
        touching_op="surface.touching", is_ground=True,
        scene_form="a mesh", scene="{mesh: ground.ply}", snippet="{mesh: ${1:ground.ply}}",
    ),
    ThingKindRow(
        "obstacle", "what stands in the way, and is gone round", "world { obstacle chairs }", label="an obstacle",
        type_meaning="an obstacle, a surface or a solid by its name", nearest_op="obstacle.near", is_blocking=True, look="stone",
        scene_form="a mesh", scene="{mesh: stones.ply}", snippet="{mesh: ${1:stones.ply}}",
    ),
    ThingKindRow(
        "solid", "soft ground that may be dug", "world { solid sand }", label="a solid",
        replaced_kinds=("obstacle",), nearest_op="obstacle.near", is_ground=True, is_dug=True,
        wrap_advice="declare a `surface` or an `obstacle` in the program",
        scene_form="a mesh", scene="{mesh: hill.ply, voxel: 1 mm}", snippet="{mesh: ${1:hill.ply}, voxel: ${2:1 mm}}",
    ),
    ThingKindRow(
        "items", "things that are placed, each with its own values", "world { items fruit { load = 0 } }",
        type_meaning="all items with a name", nearest_op="set.items", has_values=True,
        scene_form="items", scene="{one: {at: [0, 0, 0]}}", snippet="{${1:one}: {at: [${2:0}, 0, ${3:0}]}}",
    ),
    ThingKindRow(
        "curve", "a line drawn in space", "world { curve path }", label="a curve", type_meaning="the name of a curve",
        nearest_op="curve.closest", wrap_advice=_STEERING_ADVICE,
        scene_form="a curve", scene="{curve: way.json}", snippet="{curve: ${1:way.json}}",
    ),
    ThingKindRow(
        "flow", "directions along the ground", "world { flow drift }", label="a flow", type_meaning="the name of a flow",
        wrap_advice=_STEERING_ADVICE,
        scene_form="a flow", scene="{toward: [0, 0, 0], radius: 50 mm}", snippet="{toward: ${1:nest}, radius: ${2:50 mm}}",
    ),
    ThingKindRow(
        "map", "numbers painted on the ground", "world { map damp }", label="a map", type_meaning="the name of a map",
        wrap_advice=_STEERING_ADVICE,
        scene_form="a map", scene="{painted: ground.ply, attribute: NAME}",
        snippet="{painted: ${1:ground.ply}, attribute: ${2:damp}}",
    ),
    ThingKindRow(
        "camera", "a camera of the scene, which agents know", "world { camera shot }", label="a camera",
        type_meaning="the name of a camera", nearest_op="camera.position", section="cameras",
        scene_form="a camera", scene="{at: [200, 150, 300], look_at: [0, 0, 0]}",
        snippet="{at: [${1:200}, ${2:150}, ${3:300}], look_at: [${4:0}, 0, ${5:0}]}",
    ),
    ThingKindRow(
        "lamp", "a lamp, which lights pictures and can be sensed", "world { lamp bulb }", label="a lamp",
        nearest_op="set.items", type_word="items",
        scene_form="a lamp", scene="{lamp: [0, 60, 0], radius: 5 mm}",
        snippet="{lamp: [${1:0}, ${2:60}, ${3:0}], radius: ${4:5 mm}}",
    ),
    ThingKindRow(
        "species", "agents that another file describes", "world { species beetle { hunger = 0 } }",
        type_meaning="the name of a species", nearest_op="set.every", has_values=True,
    ),
)  # fmt: skip
KIND_BY_WORD: dict[str, ThingKindRow] = {row.word: row for row in _THING_ROWS}
MESH_GROUND_KIND = next(row.word for row in _THING_ROWS if row.is_ground and not row.is_dug)  # the kind of ground that is a mesh
KINDS_WITH_FACES = tuple(row.word for row in _THING_ROWS if row.has_faces)
BLOCKING_KINDS = tuple(row.word for row in _THING_ROWS if row.is_blocking)


def list_replacements(kind: str) -> tuple[str, ...]:
    """Return the kinds of things that may be used where an argument has the kind `kind`. The kind itself comes first."""
    return (kind, *(row.word for row in _THING_ROWS if kind in row.replaced_kinds))
