"""The table of all arrays of agents, items and frames, with one row for each array.

A row defines an array and its uses. Rows are used by populations, the state hash, checkpoints, reloads, frames of a cache,
exports, the preview and `docs/cache.md`. Registers that a program declares have no rows; their names, types and roles are in the
plan.

Rows are data. Functions that compute derived arrays are in the tables `VALUE_WRITERS` of `antdsl.outputs.cache.agent_arrays` and
`VALUE_FUNCTIONS` of `antdsl.preview.agent_columns`, by the name of the row."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

ColumnKind = Literal["fixed", "register", "derived"]
RowShape = tuple[int | str, ...]
Interpolation = Literal["", "linear", "rotation", "direction", "phase", "clip"]
ColumnTexts = tuple[str, str, RowShape, str] | tuple[str, str, RowShape, str, Interpolation]


@dataclass(frozen=True, slots=True)
class Column:
    """A row of the table, which describes one array.

    - `kind`: `fixed`: in every population; `register`: a register of the plan, or one per axis; `derived`: computed for frames
      and packets.
    - `type`: a NumPy type code. `shape`: the shape of the array without its first axis. `unit`: the unit of the values in the
      world.
    - `initial_value`: the value for new agents or items.
    - `is_checkpointed`, `is_hashed`: whether checkpoints and the state hash include it; only for arrays that are not derived.
    - `survives_reload`: whether every reload copies the values. Newborns inherit such registers from their parents.
    - `inherited_array`: for a fixed array, the array of the parent from which a newborn gets its value.
    - `save_mode`: whether frames include it: by `default`, on `request` in the scene's `output`, or `always` if there are
      values.
    - `alias`: its name in frames, if that is not `name`. Words in capitals stand for names of the scene.
    - `row_kind`: what one entry along the first axis describes: an agent of any `species`, an agent of `one` species, a `pair`,
      an `event`, an `item` or a `part` of a thing.
    - `exports`: the formats that have a separate attribute for the array. Formats that write all arrays of agents use the
      array's name.
    - `packet`: its name and type in the preview's packet of a frame.
    - `in_preview`: whether the preview stores it for all frames.
    - `interpolation`: how it changes between two frames: `linear`, as a `rotation`, as a `direction`, or as a `phase` from 0 to
      1. `clip` is linear as long as the machine plays the same clips. Other arrays have the values of the nearer frame."""

    name: str
    kind: ColumnKind
    type: str
    shape: RowShape = ()
    help: str = ""
    unit: str = ""
    initial_value: int = 0
    is_checkpointed: bool = True
    is_hashed: bool = True
    survives_reload: bool = True
    inherited_array: str = ""
    save_mode: Literal["", "default", "request", "always"] = ""
    alias: str = ""
    row_kind: str = "species"
    exports: str = ""
    packet: str = ""
    in_preview: bool = False
    interpolation: Interpolation = ""

    @property
    def frame_name(self) -> str:
        """Return the name of the array in frames."""
        return self.alias or self.name

    @property
    def frame_type(self) -> str:
        """Return the type of the array in frames. Positions of agents are float32 there."""
        return "f4" if self.type == "f8" and self.row_kind == "species" else self.type

    @property
    def field(self) -> str:
        """Return the last part of the array's dotted name, such as `weight` of `clips.SPECIES.MACHINE.weight`."""
        return self.name.rpartition(".")[2]

    @property
    def registers(self) -> tuple[str, ...]:
        """Return the names of the plan's registers that the array consists of."""
        return tuple(f"{self.name}.{axis}" for axis in "xyz") if self.shape else (self.name,)

    def compute_dimensions(self, **sizes: int) -> tuple[int, ...]:
        """Return the shape of one entry of the array as numbers. `sizes`: the values of the named sizes in `shape`."""
        return tuple(sizes[size] if isinstance(size, str) else size for size in self.shape)

    def compute_unit_factor(self, scale: float) -> float:
        """Return the factor by which values in the world are multiplied to get values in frames. `scale`: scene units per
        millimetre."""
        return scale if self.unit.startswith("mm") else 1.0


_ALL_EXPORTS, _SCENE_EXPORTS = "usd gltf geo csv", "usd geo"
# fmt: off
AGENT_COLUMNS = (
    Column("frame", "derived", "i8", (), "its number", save_mode="always", row_kind="frame"),
    Column("speed", "derived", "f4", (), "length of the velocity", "mm/s", packet="speed f4"),
    Column("born", "fixed", "i8", (), "frame of birth", packet="born i4"),
    Column("quarantined", "fixed", "b1", (), "whether it stopped acting after a fault"),
    Column("position", "fixed", "f8", (3,), "position", "mm", survives_reload=False, save_mode="default", alias="P",
           exports=_ALL_EXPORTS, packet="position f4", in_preview=True, interpolation="linear"),
    Column("normal", "fixed", "f4", (3,), "normal of the ground on its side", inherited_array="normal"),
    Column("position", "register", "f4", (3,), "position as programs read it", "mm"),
    Column("velocity", "register", "f4", (3,), "velocity, per second", "mm/s", save_mode="default", alias="v",
           exports=_SCENE_EXPORTS, interpolation="linear"),
    Column("heading", "register", "f4", (3,), "unit vector ahead", packet="heading i1", in_preview=True),
    Column("up", "register", "f4", (3,), "unit vector up", packet="up i1", in_preview=True),
    Column("orient", "derived", "f4", (4,), "quaternion x y z w that turns +x to the heading and +y to the agent's up",
           save_mode="default", exports=_ALL_EXPORTS, interpolation="rotation"),
    Column("ids", "fixed", "i8", (), "number of the agent within its species", is_hashed=False, survives_reload=False,
           save_mode="default", alias="id", exports=_ALL_EXPORTS, packet="id i4", in_preview=True),
    Column("size", "register", "f4", (), "body length", "mm", survives_reload=False, save_mode="default", alias="pscale",
           exports=_ALL_EXPORTS, packet="size f4", in_preview=True, interpolation="linear"),
    Column("Cd", "derived", "f4", (3,), "colour of its state, display (sRGB), 0 to 1",
           save_mode="default", exports="usd gltf geo"),
    Column("state", "derived", "i2", (), "its state in the first machine: an index into the manifest's list", save_mode="default",
           exports=_SCENE_EXPORTS),
    Column("species", "derived", "i2", (), "an index into the manifest's list; always present with more than one species",
           save_mode="request", exports=_ALL_EXPORTS),
    Column("age", "derived", "f4", (), "seconds since birth", save_mode="request", interpolation="linear"),
    Column("group", "register", "f4", (), "which line of the scene's `crowd` made it, from 0", save_mode="request"),
    Column("v_ground", "derived", "f4", (3,), "velocity of the ground below each agent, if a surface moves. `v` is relative to "
           "it: use `v + v_ground` for motion blur", save_mode="always", exports=_SCENE_EXPORTS, interpolation="linear"),
    Column("unwrapped", "derived", "f4", (3,), "position without the jumps at the seam, in a "
           "[periodic world](periodic.md)", save_mode="always", interpolation="linear"),
)


def _make_columns(prefix: str, row_kind: str, *columns: ColumnTexts, kind: ColumnKind = "derived") -> tuple[Column, ...]:
    """Return rows for arrays that are always saved. `prefix`: the start of their names. `columns`: for each array, the name,
    type, shape, help and, optionally, `interpolation`."""
    return tuple(
        Column(
            f"{prefix}{name}", kind, type, shape, help,
            row_kind=row_kind, save_mode="always", interpolation=rest[0] if rest else "",
        )
        for name, type, shape, help, *rest in columns
    )


CLIP_COLUMNS = _make_columns(
    "clips.SPECIES.MACHINE.", "one",
    ("clip", "i2", (), "of a machine that plays clips: an index into the species' `clips` in the manifest, -1 for none"),
    ("turns", "f4", (), "how often that clip has played since it began; the fraction is the phase", "clip"),
    ("weight", "f4", (), "its share from 0 to 1", "clip"),
    ("before", "i2", (), "the previous clip, which fades out"),
    ("before_turns", "f4", (), "how often it has played", "clip"),
    ("before_weight", "f4", (), "its share from 0 to 1", "clip"),
    ("fade", "f4", (), "the share of the pose that the previous clip still has", "clip"),
    ("earlier", "i2", (), "only if an agent has one: a [third clip](clips.md#how-one-clip-gives-way-to-the-next)"),
    ("earlier_turns", "f4", (), "how often it has played", "clip"),
    ("earlier_weight", "f4", (), "its share from 0 to 1", "clip"),
    ("earlier_fade", "f4", (), "its share of the part that fades out", "clip"), kind="register")
STANCE_COLUMNS = _make_columns(
    "feet.SPECIES.", "one",
    ("P", "f4", ("legs", 3), "position of each foot, in the order of the body's legs, if it [stands on its feet](feet.md)",
     "linear"),
    ("down", "u1", ("legs",), "whether it stands"),
    ("phase", "f4", (), "of the gait, from 0 to 1", "phase"),
    ("rise", "f4", (), "height of the trunk above its rest height along its up", "linear"),
    ("tilt", "f4", (4,), "rotation of the trunk from `orient` (x y z w)", "rotation"),
    ("normal", "f4", ("legs", 3), "of a body with [ankles](bodies.md#legs-and-gaits): the direction across each sole, from the "
     "ground on: ahead, up, right", "direction"))
OTHER_COLUMNS = (
    *_make_columns(
        "", "one",
        ("wears.SPECIES", "u8", (), "[worn layers](clips.md#layers-that-are-worn): bit b for layer b of `wears` in the manifest"),
        ("channels.SPECIES.NAME", "f4", (), "the value that a state gives a [channel](clips.md#channels), NaN without one",
         "linear"),
        ("looks.SPECIES.GROUP", "f4", (3,), "where a transform group [looks](clips.md#looking-at-something): ahead, up, right",
         "direction"),
        ("joints.SPECIES.JOINT", "f4", (7,), "what an [edit](edits.md) adds to a joint: shift ahead, up, right in body "
         "lengths, rotation x y z w"),
        ("leans.SPECIES", "f4", (2,), "how much it [turns left and climbs](clips.md#turns-and-slopes), from -1 to 1", "linear")),
    *_make_columns(
        "pairs.SPECIES.NAME.", "pair",
        ("id", "i8", (), "of a value per pair, if `output` requests it: the owner. Rows are by `id` and `other`"),
        ("other", "i8", (), "the other agent"),
        ("value", "f4", (), "the value")),
    *_make_columns(
        "", "item",
        ("items.NAME.ATTRIBUTE", "f8", (), "what each item has left"),
        ("items.NAME.P", "f4", (3,), "positions of items that move")),
    *_make_columns(
        "", "part",
        ("field.NAME.cells", "i4", (), "the cells that are not empty; a field of vectors has `NAME.x`, `NAME.y`, `NAME.z`"),
        ("field.NAME.values", "f4", (), "their values"),
        ("field.NAME.added", "f4", (3,), "positions of cells dug since the start; their numbers continue those of `static.npz`"),
        ("mesh.SURFACE.vertices", "f4", (3,), "positions of the vertices of a mesh that moves"),
        ("solid.NAME.balls", "f8", (4,), "what was dug since the previous frame: centre and radius, in mm, positions less "
         "`solid.NAME.offset` of `static.npz` and the origin. Absent if nothing was dug"),
        ("mesh.SOLID.changed", "i4", (), "every `checkpoint` frames, from `first` on: the bricks that were ever dug"),
        ("mesh.SOLID.vertices", "f8", (3,), "vertices of the current faces of those bricks, which replace all that they had"),
        ("mesh.SOLID.faces", "i4", (3,), "those faces"),
        ("mesh.SOLID.bricks", "i4", (), "the brick of each face")))
EMIT_COLUMNS = _make_columns(
    "events.emit.", "event",
    ("species", "i2", (), "if `output` requests it: the species of an agent that emitted an event in the step"),
    ("id", "i8", (), "its id"),
    ("P", "f4", (3,), "its position"),
    ("N", "f4", (3,), "the normal of its ground"),
    ("event", "i2", (), "an index into the manifest's `events`"))
CONTACT_COLUMNS = _make_columns(
    "events.contact.", "event",
    ("species", "i2", (), "if the scene has `output: {events: [contact]}`, for two bodies that overlap: the species of one"),
    ("id", "i8", (), "its id"),
    ("P", "f4", (3,), "the contact point"),
    ("N", "f4", (3,), "the direction from the other"),
    ("other_species", "i2", (), "the species of the other"),
    ("other", "i8", (), "its id"),
    ("depth", "f4", (), "the penetration depth"))
FEET_COLUMNS = (
    Column("ids", "fixed", "i8", ("n",)),
    *(Column(name, "fixed", "f8", (3, "n", "L"), unit="mm") for name in ("place", "shown", "start")),
    Column("swing", "fixed", "f4", ("n", "L")),
    Column("on", "fixed", "i2", ("n", "L")),
    Column("face", "fixed", "i4", ("n", "L")),
    Column("weight", "fixed", "f8", (2, "n", "L")),
    Column("found", "fixed", "f4", ("n", "L")),
    *(Column(name, "fixed", "f4", ("n",)) for name in ("phase", "rise")),
    Column("slope", "fixed", "f4", (2, "n")),
    Column("position", "fixed", "f8", (3, "n"), unit="mm"),
    *(Column(name, "fixed", "f4", (3, "n")) for name in ("heading", "up")),
    *(Column(name, "fixed", "f4", (3, "n", "S")) for name in ("tread", "sole")),
)  # must match `antdsl.runtime.feet.feet_state.Feet`
# fmt: on

FRAME_COLUMNS = tuple(
    column
    for column in (*AGENT_COLUMNS, *CLIP_COLUMNS, *STANCE_COLUMNS, *OTHER_COLUMNS, *EMIT_COLUMNS, *CONTACT_COLUMNS)
    if column.save_mode
)
FIXED_COLUMN_BY_NAME = {column.name: column for column in AGENT_COLUMNS if column.kind == "fixed"}
REGISTER_COLUMN_BY_NAME = {column.name: column for column in AGENT_COLUMNS if column.kind == "register"}
MIGRATED_REGISTERS = tuple(name for c in REGISTER_COLUMN_BY_NAME.values() if c.survives_reload for name in c.registers)
COLUMN_BY_ATTRIBUTE = {column.frame_name: column for column in AGENT_COLUMNS if column.save_mode in ("default", "request")}
DEFAULT_ATTRIBUTE_NAMES = tuple(name for name, column in COLUMN_BY_ATTRIBUTE.items() if column.save_mode == "default")
