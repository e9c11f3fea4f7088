"""What a `scene.yaml` may say: one pydantic model for each mapping in it. Scalars are text until these models type them."""

from __future__ import annotations

from fractions import Fraction
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Discriminator, Field, Tag

from antdsl import limits
from antdsl.scene.quantities import Quantity
from antdsl.scene.values import (
    Angle,
    AnyQuantity,
    FilePath,
    Fps,
    FrameRange,
    Frames,
    Length,
    Name,
    PositiveLength,
    number,
    one_of,
    refuse,
    whole,
)

UNIT_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0}

Unit = Annotated[str, BeforeValidator(one_of(*UNIT_MM))]
Body = Annotated[str, BeforeValidator(one_of("ant", "person", "arrow", "ball"))]
Axis = Annotated[str, BeforeValidator(one_of("y", "z"))]
Factor = Annotated[float, BeforeValidator(number(1e-9, 1e9))]
Point = tuple[Length, Length, Length]

DEFAULT_ATTRIBUTES = ("P", "v", "orient", "id", "pscale", "Cd", "state")


class Part(BaseModel):
    """A mapping of the scene: keys that are not listed are refused."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, populate_by_name=False, arbitrary_types_allowed=True, hide_input_in_errors=True
    )


class MeshThing(Part):
    """A mesh file, turned and moved into the scene: scaled, its `up` made the scene's, rotated about x, then y, then z, then
    put `at`."""

    mesh: FilePath
    units: Unit | None = None
    up: Axis | None = None
    at: Point | None = None
    rotate: tuple[Angle, Angle, Angle] | None = None
    scale: Annotated[float, BeforeValidator(number(-1e6, 1e6))] = 1.0
    voxel: PositiveLength | None = None


class CurveThing(Part):
    """A polyline from a JSON file of points."""

    curve: FilePath
    units: Unit | None = None
    up: Axis | None = None
    at: Point | None = None


class ItemThing(Part):
    """One item: where it is (with `on`, dropped along the scene's up onto a surface), how large, and the values of its attributes
    (any further key)."""

    model_config = ConfigDict(extra="allow", frozen=True, arbitrary_types_allowed=True, hide_input_in_errors=True)
    __pydantic_extra__: dict[str, AnyQuantity] = Field(init=False)

    at: Point
    on: Name | None = None
    radius: PositiveLength | None = None


def _kind_of_thing(value: Any) -> str:
    if isinstance(value, dict):
        if "mesh" in value:
            return "mesh-thing"
        if "curve" in value:
            return "curve-thing"
    return "items-thing"


def _items(value: Any) -> Any:
    if not isinstance(value, dict):
        raise refuse(
            "a thing of the world is a mapping", "write `{mesh: ground.ply}`, `{curve: way.json}` or `{apple: {at: [0, 0, 0]}}`"
        )
    return value


WorldThing = Annotated[
    Annotated[MeshThing, Tag("mesh-thing")]
    | Annotated[CurveThing, Tag("curve-thing")]
    | Annotated[dict[Name, ItemThing], BeforeValidator(_items), Tag("items-thing")],
    Discriminator(_kind_of_thing),
]


def _point_or_name(value: Any) -> str:
    return "point" if isinstance(value, list) else "named"


class Placement(Part):
    """Where a crowd begins: scattered on a surface (all of it, or within `radius` of a point or an item, by itself of
    the scene's origin), or at given points."""

    on: Name | None = None
    around: Annotated[Annotated[Point, Tag("point")] | Annotated[Name, Tag("named")], Discriminator(_point_or_name)] | None = None
    radius: PositiveLength | None = None
    points: FilePath | None = None


class CrowdLine(Part):
    """Agents of one species. `body` is what pictures draw; by itself it goes by the species' name."""

    species: Name
    source: FilePath = Field(alias="from")
    count: Annotated[int, BeforeValidator(whole(0, limits.AGENTS))]
    place: Placement = Placement()
    body: Body | None = None


class FieldStart(Part):
    """Starting values of a field: `start` everywhere, or only within `radius` of a point or an item (by itself: of the
    origin)."""

    start: Annotated[float, BeforeValidator(number(0, 1e9))]
    around: Annotated[Annotated[Point, Tag("point")] | Annotated[Name, Tag("named")], Discriminator(_point_or_name)] | None = None
    radius: PositiveLength | None = None


class Camera(Part):
    at: Point
    look_at: Point
    focal: PositiveLength | None = None


class Output(Part):
    attributes: tuple[Annotated[str, BeforeValidator(lambda v: v)], ...] = DEFAULT_ATTRIBUTES
    checkpoint: Annotated[int, BeforeValidator(whole(1, 100_000))] = 50


class StartFrom(Part):
    """A frame of another cache, whose agents, items and fields this run begins with."""

    cache: FilePath
    frame: Annotated[int, BeforeValidator(whole(-limits.FRAMES, limits.FRAMES * 1000))]


class SceneModel(Part):
    edition: Annotated[str, BeforeValidator(one_of("1"))] = Field(alias="antdsl")
    units: Unit = "mm"
    up: Axis = "y"
    fps: Fps = Fraction(24)
    frames: Frames = FrameRange(1, 240)
    preroll: Annotated[int, BeforeValidator(whole(0, limits.FRAMES))] = 0
    substeps: Annotated[int, BeforeValidator(whole(1, 64))] = 1
    seed: Annotated[int, BeforeValidator(whole(0, 2**64 - 1))] = 0
    start: StartFrom | None = Field(None, alias="from")
    world: dict[Name, WorldThing] = {}
    crowd: tuple[CrowdLine, ...] = ()
    set: dict[str, AnyQuantity] = {}
    fields: dict[Name, FieldStart] = {}
    layers: dict[Name, tuple[str, ...]] = {}
    camera: Camera | None = None
    output: Output = Output()

    @property
    def unit_mm(self) -> float:
        """Millimetres in one of the scene's length units."""
        return UNIT_MM[self.units]


def millimetres(point: tuple[Quantity, Quantity, Quantity], unit_mm: float) -> tuple[float, float, float]:
    """A point of the scene in millimetres."""
    x, y, z = (part.length(unit_mm) for part in point)
    return x, y, z
