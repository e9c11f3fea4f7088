"""The contents of a `scene.yaml`: one pydantic model for each mapping in it. Scalars are text until these models type them."""

from __future__ import annotations

from fractions import Fraction
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, ConfigDict, Discriminator, Field, Tag

from antdsl import limits
from antdsl.diagnostics.suggestion import nearest_name
from antdsl.program.tables.columns import DEFAULT_ATTRIBUTES
from antdsl.scene.crowd_model import CrowdLine as CrowdLine
from antdsl.scene.crowd_model import Placement as Placement
from antdsl.scene.crowd_model import Walk as Walk
from antdsl.scene.quantities import Quantity
from antdsl.scene.values import (
    Angle,
    AnyQuantity,
    FilePath,
    Fps,
    FrameRange,
    Frames,
    Keys,
    Length,
    Name,
    PointOrName,
    PositiveLength,
    PositiveTime,
    Word,
    integer,
    make_error,
    number,
    one_of,
)
from antdsl.scene.values import Part as Part
from antdsl.scene.values import PlaceKey as PlaceKey
from antdsl.scene.values import Point as Point

UNIT_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0}

Unit = Annotated[str, BeforeValidator(one_of(*UNIT_MM))]
Stick = Annotated[str, BeforeValidator(one_of("triangles", "rays"))]
Orient = Annotated[str, BeforeValidator(one_of("normal", "turns", "probes"))]
Contacts = Annotated[Literal["off", "soft", "hard"], BeforeValidator(one_of("off", "soft", "hard"))]
Axis = Annotated[str, BeforeValidator(one_of("y", "z"))]
Purpose = Annotated[str, BeforeValidator(one_of("render", "proxy"))]

LOOKS = ("metal", "soil", "leaf", "light", "none")
Look = Annotated[str, BeforeValidator(one_of(*LOOKS))]  # of things in pictures


class MeshThing(Part):
    """A mesh file (`####` in its name: one per frame), transformed into the scene. It is scaled, its `up` becomes the scene's, it
    is rotated about x, then y, then z, and moved to `at`.

    `group`: only the faces of that group or object of an .obj file, or only what is at and below that node of glTF. `weld`:
    vertices nearer to each other than this are merged."""

    mesh: FilePath
    group: Word | None = None
    keys: Keys = {}
    units: Unit | None = None
    up: Axis | None = None
    at: Point | None = None
    rotate: tuple[Angle, Angle, Angle] | None = None
    scale: Annotated[float, BeforeValidator(number(-1e6, 1e6))] = 1.0
    voxel: PositiveLength | None = None
    weld: PositiveLength | None = None
    look: Look | None = None

    @property
    def own_units(self) -> str | None:
        """Return the unit of the file format, if its specification defines one."""
        return "m" if self.mesh.lower().endswith((".gltf", ".glb")) else None

    @property
    def own_up(self) -> str | None:
        """Return the file's up axis, if the scene or its format defines one."""
        return self.up or ("y" if self.own_units else None)


class HeightThing(Part):
    """A surface of heights: a 16-bit grey image (.png, .tif), or an array of an .npz file (`array`, if it has several; `layer`,
    if it has three dimensions). `extent`: its size along x and the other level axis, centred at its own origin. A sample of 1 is
    `scale` high, and all are raised by `offset`."""

    height: FilePath
    extent: tuple[PositiveLength, PositiveLength]
    scale: Length
    offset: Length | None = None
    array: Name | None = None
    layer: Annotated[int, BeforeValidator(integer(0, 100_000))] | None = None
    at: Point | None = None
    rotate: tuple[Angle, Angle, Angle] | None = None
    keys: Keys = {}
    look: Look | None = None


class UsdEach(Part):
    """Defaults for items from the points of a USD file where the file has no value: a radius, and values of attributes."""

    model_config = ConfigDict(extra="allow", frozen=True, arbitrary_types_allowed=True, hide_input_in_errors=True)
    __pydantic_extra__: dict[str, AnyQuantity] = Field(init=False)

    radius: PositiveLength | None = None


class UsdThing(Part):
    """Contents at and below a prim of a USD file: meshes, one curve, or points. Units, axes, positions and time are the file's;
    `scale`, `rotate`, `at` and `keys` are applied after them. Items may be all empties of a `kind` below the prim. The prim
    defaults to the whole file, `kind` to the items' own name. `turn`: attributes that receive the direction they face."""

    usd: FilePath
    prim: Word | None = None
    kind: Word | None = None
    turn: Name | tuple[Name, Name, Name] | None = None
    purpose: Purpose = "render"
    at: Point | None = None
    rotate: tuple[Angle, Angle, Angle] | None = None
    scale: Annotated[float, BeforeValidator(number(-1e6, 1e6))] = 1.0
    voxel: PositiveLength | None = None
    weld: PositiveLength | None = None
    keys: Keys = {}
    look: Look | None = None
    each: UsdEach = UsdEach()

    @property
    def path(self) -> str:
        """Return the path of the prim; the whole file if none is named."""
        return "/" if self.prim is None else self.prim


class CurveThing(Part):
    """A polyline from a JSON file of points (`####` in its name: one per frame)."""

    curve: FilePath
    keys: Keys = {}
    units: Unit | None = None
    up: Axis | None = None
    at: Point | None = None


Strength = Annotated[float, BeforeValidator(number(-1, 1))]
Falloff = Annotated[str, BeforeValidator(one_of("none", "linear", "smooth"))]


class FlowThing(Part):
    """What all flows have: the surface they are on (all if none is named), and a factor, which reverses them below 0."""

    on: Name | None = None
    strength: Strength = 1.0


class SpreadFlow(FlowThing):
    """A flow that decreases with the distance from its source: zero beyond `radius`, constant without one."""

    radius: PositiveLength | None = None
    falloff: Falloff = "smooth"
    cell: PositiveLength | None = None


class TangentFlow(SpreadFlow):
    """A flow along a curve in the direction in which it was drawn: a curve of the world, or a JSON file of points. With `gather`
    it also leads onto the curve: at the radius as much as it leads along."""

    tangent: FilePath
    gather: Annotated[float, BeforeValidator(number(0, 10))] = 0.0


def _target_tag(value: Any) -> str:
    return "point" if isinstance(value, list) else "named"


Target = Annotated[Annotated[Point, Tag("point")] | Annotated[FilePath, Tag("named")], Discriminator(_target_tag)]


class TowardFlow(SpreadFlow):
    """Toward a curve, an item, the nearest of some items, or a point."""

    toward: Target


class AwayFlow(SpreadFlow):
    """Away from a curve, an item, the nearest of some items, or a point."""

    away: Target


class BorderFlow(FlowThing):
    """Inward from the open borders of a surface, where they are nearer than `within`."""

    border: Name
    within: PositiveLength
    falloff: Falloff = "linear"
    cell: PositiveLength | None = None


class SolvedFlow(FlowThing):
    """The cheapest path over the surfaces to a target. A millimetre costs 1, plus `slope` (times the sine of the slope), plus a
    cost within `room` of an obstacle. `maps` add their values times their factors. `crowding` is multiplied by the share of
    ground covered by agents, which is measured again at the interval `every`."""

    solved: Target
    slope: Annotated[float, BeforeValidator(number(0, 1e6))] = 0.0
    room: PositiveLength | None = None
    maps: dict[Name, Annotated[float, BeforeValidator(number(-1e6, 1e6))]] = {}
    crowding: Annotated[float, BeforeValidator(number(0, 1e6))] = 0.0
    every: PositiveTime | None = None
    cell: PositiveLength | None = None


class PaintedThing(Part):
    """Vectors (of a flow) or numbers (of a map) painted on the vertices or faces of a surface: attributes of a .ply file, or an
    array of an .npz file, in the order of that surface's own file."""

    painted: FilePath
    attribute: Name | tuple[Name, ...] | None = None
    on: Name | None = None
    strength: Annotated[float, BeforeValidator(number(-1e6, 1e6))] = 1.0


class ItemThing(Part):
    """One item: its position (with `on`, dropped along the scene's up onto a surface), its size, and the values of its attributes
    (any further key)."""

    model_config = ConfigDict(extra="allow", frozen=True, arbitrary_types_allowed=True, hide_input_in_errors=True)
    __pydantic_extra__: dict[str, AnyQuantity] = Field(init=False)

    at: Point
    on: Name | None = None
    radius: PositiveLength | None = None
    keys: Keys = {}
    look: Look | None = None


# The key that says what a thing of the world is, unless it is the name of an item.
THING_MODELS: dict[str, tuple[str, type[Part]]] = {
    "mesh": ("mesh-thing", MeshThing),
    "height": ("height-thing", HeightThing),
    "usd": ("usd-thing", UsdThing),
    "curve": ("curve-thing", CurveThing),
    "tangent": ("tangent-thing", TangentFlow),
    "toward": ("toward-thing", TowardFlow),
    "away": ("away-thing", AwayFlow),
    "border": ("border-thing", BorderFlow),
    "solved": ("solved-thing", SolvedFlow),
    "painted": ("painted-thing", PaintedThing),
}
# Those that name a file of the thing's own, and what a kind of thing may be here.
FILE_HEADS = ("mesh", "height", "usd", "curve", "painted")
MODELS: dict[str, tuple[type, ...]] = {
    "surface": (MeshThing, HeightThing, UsdThing), "obstacle": (MeshThing, UsdThing), "solid": (MeshThing, UsdThing),
    "curve": (CurveThing, UsdThing), "items": (dict, UsdThing), "flow": (FlowThing, PaintedThing), "map": (PaintedThing,),
}  # fmt: skip


def _thing_tag(value: Any) -> str:
    keywords = (
        [word for word in THING_MODELS if word in value and not isinstance(value[word], dict)] if isinstance(value, dict) else []
    )
    return THING_MODELS[keywords[0]][0] if keywords else "items-thing"


def _items(value: Any) -> Any:
    if not isinstance(value, dict):
        raise make_error(
            "a thing of the world is a mapping", "write `{mesh: ground.ply}`, `{curve: way.json}` or `{apple: {at: [0, 0, 0]}}`"
        )
    for word, inner in value.items():
        near = None if isinstance(inner, dict) else nearest_name(str(word), THING_MODELS)
        if near:
            raise make_error(f"`{word}` says of no thing of the world what it is", f"did you mean `{near}`?")
    if value and not any(isinstance(inner, dict) for inner in value.values()):
        raise make_error(
            "no key says what this thing of the world is", "add one of " + ", ".join(f"`{word}`" for word in THING_MODELS)
        )
    return value


WorldThing = Annotated[
    Annotated[MeshThing, Tag("mesh-thing")]
    | Annotated[HeightThing, Tag("height-thing")]
    | Annotated[UsdThing, Tag("usd-thing")]
    | Annotated[CurveThing, Tag("curve-thing")]
    | Annotated[TangentFlow, Tag("tangent-thing")]
    | Annotated[TowardFlow, Tag("toward-thing")]
    | Annotated[AwayFlow, Tag("away-thing")]
    | Annotated[BorderFlow, Tag("border-thing")]
    | Annotated[SolvedFlow, Tag("solved-thing")]
    | Annotated[PaintedThing, Tag("painted-thing")]
    | Annotated[dict[Name, ItemThing], BeforeValidator(_items), Tag("items-thing")],
    Discriminator(_thing_tag),
]


class FieldStart(Part):
    """Starting values of a field: `start` everywhere, or only within `radius` of a point or an item (default: the origin)."""

    start: Annotated[float, BeforeValidator(number(0, 1e9))]
    around: PointOrName | None = None
    radius: PositiveLength | None = None


class Camera(Part):
    at: Point
    look_at: Point
    focal: PositiveLength | None = None


class UsdCamera(Part):
    """A camera of a USD file, with its motion."""

    usd: FilePath
    prim: Word


Fit = Annotated[str, BeforeValidator(one_of("fit"))]


def _camera_tag(value: Any) -> str:
    if isinstance(value, str):
        return "camera-word"
    return "usd-camera" if isinstance(value, dict) and "usd" in value else "camera-here"


class LevelOfDetail(Part):
    """Distances from the camera: up to `near`, feelers hit triangles; up to `far`, the boxes of the pieces of obstacles; beyond
    it nothing."""

    near: PositiveLength
    far: PositiveLength | None = None


class Output(Part):
    attributes: tuple[Annotated[str, BeforeValidator(lambda v: v)], ...] = DEFAULT_ATTRIBUTES
    checkpoint: Annotated[int, BeforeValidator(integer(1, 100_000))] = 50
    events: tuple[Annotated[str, BeforeValidator(one_of("contact", "emit"))], ...] = ()


class StartFrom(Part):
    """A frame of another cache: its agents, items and fields are the start of this run."""

    cache: FilePath
    frame: Annotated[int, BeforeValidator(integer(-limits.FRAMES, limits.FRAMES * 1000))]


class SceneModel(Part):
    edition: Annotated[str, BeforeValidator(one_of("1"))] = Field(alias="antdsl")
    extends: FilePath | None = None  # is gone once the scenes are put together
    units: Unit = "mm"
    up: Axis = "y"
    fps: Fps = Fraction(24)
    frames: Frames = FrameRange(1, 240)
    preroll: Annotated[int, BeforeValidator(integer(0, limits.FRAMES))] = 0
    substeps: Annotated[int, BeforeValidator(integer(1, 64))] = 1
    stick: Stick = "triangles"
    orient: Orient = "normal"
    contacts: Contacts = "off"
    seed: Annotated[int, BeforeValidator(integer(0, 2**64 - 1))] = 0
    start: StartFrom | None = Field(None, alias="from")
    world: dict[Name, WorldThing] = {}
    crowd: tuple[CrowdLine, ...] = ()
    set: dict[str, AnyQuantity] = {}
    fields: dict[Name, FieldStart] = {}
    layers: dict[Name, tuple[str, ...]] = {}
    camera: (
        Annotated[
            Annotated[Camera, Tag("camera-here")] | Annotated[UsdCamera, Tag("usd-camera")] | Annotated[Fit, Tag("camera-word")],
            Discriminator(_camera_tag),
        ]
        | None
    ) = None
    lod: LevelOfDetail | None = None
    output: Output = Output()

    @property
    def unit_mm(self) -> float:
        """Millimetres in one of the scene's length units."""
        return UNIT_MM[self.units]

    @property
    def has_usd_items(self) -> bool:
        """Return whether items may get their names from a USD file, which is read when the scene is staged."""
        return any(isinstance(value, UsdThing) for value in self.world.values())


def millimetres(point: tuple[Quantity, Quantity, Quantity], unit_mm: float) -> tuple[float, float, float]:
    """A point of the scene in millimetres."""
    x, y, z = (part.length(unit_mm) for part in point)
    return x, y, z
