"""The forms that a thing of the world has in a `scene.yaml`: a pydantic model for each."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

from pydantic import BeforeValidator, ConfigDict, Discriminator, Field, Tag

from antdsl.scene.values import (
    Angle,
    AnyQuantity,
    FilePath,
    Length,
    Part,
    PlaceKeys,
    PointValue,
    PositiveLength,
    PositiveTime,
    SceneName,
    SceneWord,
    integer,
    number,
    one_of,
)

UNIT_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0}

Unit = Annotated[str, BeforeValidator(one_of(*UNIT_MM))]
Axis = Annotated[str, BeforeValidator(one_of("y", "z"))]
Purpose = Annotated[str, BeforeValidator(one_of("render", "proxy"))]

LOOKS = ("metal", "soil", "leaf", "light", "none")
Look = Annotated[str, BeforeValidator(one_of(*LOOKS))]  # of things in pictures


class ThingModel(Part):
    """One form of a thing of the world. The first field of each form is its `head`, the key that says which form it is.
    `names_file`: the head's value is the path of the thing's own file."""

    names_file: ClassVar[bool] = False

    @classmethod
    def head(cls) -> str:
        """Return the key that says which form it is."""
        return next(iter(cls.__annotations__))


class MeshThing(ThingModel):
    """A mesh file (`####` in its name: one per frame), transformed into the scene. It is scaled, its `up` becomes the scene's, it
    is rotated about x, then y, then z, and moved to `at`.

    `group`: only the faces of that group or object of an .obj file, or only what is at and below that node of glTF. `weld`:
    vertices nearer to each other than this are merged."""

    names_file = True

    mesh: FilePath
    group: SceneWord | None = None
    keys: PlaceKeys = {}
    units: Unit | None = None
    up: Axis | None = None
    at: PointValue | None = None
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


class HeightThing(ThingModel):
    """A surface of heights: a 16-bit grey image (.png, .tif), or an array of an .npz file (`array`, if it has several; `layer`,
    if it has three dimensions). `extent`: its size along x and the other level axis, centred at its own origin. A sample of 1 is
    `scale` high, and all are raised by `offset`."""

    names_file = True

    height: FilePath
    extent: tuple[PositiveLength, PositiveLength]
    scale: Length
    offset: Length | None = None
    array: SceneName | None = None
    layer: Annotated[int, BeforeValidator(integer(0, 100_000))] | None = None
    at: PointValue | None = None
    rotate: tuple[Angle, Angle, Angle] | None = None
    keys: PlaceKeys = {}
    look: Look | None = None


class UsdEach(Part):
    """Defaults for items from the points of a USD file where the file has no value: a radius, and values of attributes."""

    model_config = ConfigDict(extra="allow", frozen=True, arbitrary_types_allowed=True, hide_input_in_errors=True)
    __pydantic_extra__: dict[str, AnyQuantity] = Field(init=False)

    radius: PositiveLength | None = None


class UsdThing(ThingModel):
    """Contents at and below a prim of a USD file: meshes, one curve, or points. Units, axes, positions and time are the file's;
    `scale`, `rotate`, `at` and `keys` are applied after them. Items may be all empties of a `kind` below the prim. The prim
    defaults to the whole file, `kind` to the items' own name. `turn`: attributes that receive the direction they face."""

    names_file = True

    usd: FilePath
    prim: SceneWord | None = None
    kind: SceneWord | None = None
    turn: SceneName | tuple[SceneName, SceneName, SceneName] | None = None
    purpose: Purpose = "render"
    at: PointValue | None = None
    rotate: tuple[Angle, Angle, Angle] | None = None
    scale: Annotated[float, BeforeValidator(number(-1e6, 1e6))] = 1.0
    voxel: PositiveLength | None = None
    weld: PositiveLength | None = None
    keys: PlaceKeys = {}
    look: Look | None = None
    each: UsdEach = UsdEach()

    @property
    def path(self) -> str:
        """Return the path of the prim; the whole file if none is named."""
        return "/" if self.prim is None else self.prim


ScaledThing = MeshThing | UsdThing
PlacedThing = ScaledThing | HeightThing


class CurveThing(ThingModel):
    """A polyline from a JSON file of points (`####` in its name: one per frame)."""

    names_file = True

    curve: FilePath
    keys: PlaceKeys = {}
    units: Unit | None = None
    up: Axis | None = None
    at: PointValue | None = None


Strength = Annotated[float, BeforeValidator(number(-1, 1))]
Falloff = Annotated[str, BeforeValidator(one_of("none", "linear", "smooth"))]


class FlowThing(ThingModel):
    """What all flows have: the surface they are on (all if none is named), and a factor, which reverses them below 0."""

    on: SceneName | None = None
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


Target = Annotated[Annotated[PointValue, Tag("point")] | Annotated[FilePath, Tag("named")], Discriminator(_target_tag)]


class TowardFlow(SpreadFlow):
    """Toward a curve, an item, the nearest of some items, or a point."""

    toward: Target


class AwayFlow(SpreadFlow):
    """Away from a curve, an item, the nearest of some items, or a point."""

    away: Target


class BorderFlow(FlowThing):
    """Inward from the open borders of a surface, where they are nearer than `within`."""

    border: SceneName
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
    maps: dict[SceneName, Annotated[float, BeforeValidator(number(-1e6, 1e6))]] = {}
    crowding: Annotated[float, BeforeValidator(number(0, 1e6))] = 0.0
    every: PositiveTime | None = None
    cell: PositiveLength | None = None


class PaintedThing(ThingModel):
    """Vectors (of a flow) or numbers (of a map) painted on the vertices or faces of a surface: attributes of a .ply file, or an
    array of an .npz file, in the order of that surface's own file."""

    names_file = True

    painted: FilePath
    attribute: SceneName | tuple[SceneName, ...] | None = None
    on: SceneName | None = None
    strength: Annotated[float, BeforeValidator(number(-1e6, 1e6))] = 1.0


class ItemThing(Part):
    """One item: its position (with `on`, dropped along the scene's up onto a surface), its size, and the values of its attributes
    (any further key)."""

    model_config = ConfigDict(extra="allow", frozen=True, arbitrary_types_allowed=True, hide_input_in_errors=True)
    __pydantic_extra__: dict[str, AnyQuantity] = Field(init=False)

    at: PointValue
    on: SceneName | None = None
    radius: PositiveLength | None = None
    keys: PlaceKeys = {}
    look: Look | None = None


def angles(thing: PlacedThing) -> tuple[float, float, float]:
    """The rotation of a thing about x, then y, then z, in radians."""
    x, y, z = (angle.number for angle in thing.rotate) if thing.rotate else (0.0, 0.0, 0.0)
    return x, y, z


def millimetres(point: PointValue | None, unit_mm: float) -> tuple[float, float, float]:
    """A point of the scene in millimetres; the origin if there is none."""
    x, y, z = (part.length(unit_mm) for part in point) if point else (0.0, 0.0, 0.0)
    return x, y, z
