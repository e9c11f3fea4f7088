"""The forms in which a `scene.yaml` can define a thing of the world, each as a pydantic model."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

from pydantic import BeforeValidator, ConfigDict, Discriminator, Field, Tag

from antdsl.scene.light_model import LightColour, LightStrength
from antdsl.scene.looks import LOOK_WORDS
from antdsl.scene.values import (
    Angle,
    AnyQuantity,
    FilePath,
    Length,
    PointValue,
    PositionKeysByFrame,
    PositiveLength,
    PositiveTime,
    SceneName,
    ScenePart,
    SceneWord,
    parse_integer_between,
    parse_number_between,
    parse_one_of,
)

UNIT_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
UP_VECTORS = {"y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}

Unit = Annotated[str, BeforeValidator(parse_one_of(*UNIT_MM))]
Axis = Annotated[str, BeforeValidator(parse_one_of("y", "z"))]
UsdPurposeWord = Annotated[str, BeforeValidator(parse_one_of("render", "proxy"))]

Look = Annotated[str, BeforeValidator(parse_one_of(*LOOK_WORDS))]  # keys for the thing in pictures


class ThingModel(ScenePart):
    """A form in which a scene can define a thing of the world, such as by a mesh file. Its first field is the required key that
    identifies the form.

    `names_file`: whether the value of this key is the path of a file with the thing."""

    names_file: ClassVar[bool] = False

    @classmethod
    def find_form_key(cls) -> str:
        """Return the key that identifies the form."""
        return next(iter(cls.__annotations__))


class MeshThing(ThingModel):
    """A mesh file, transformed into the scene. `####` in its name means one file per frame.

    It is scaled, its `up` becomes the scene's, it is rotated about x, then y, then z, and moved to `at`.
    `group`: only this group or object of an .obj file, or only this node of a glTF file with all below it.
    `weld`: vertices nearer to each other than this are merged."""

    names_file = True

    mesh: FilePath
    group: SceneWord | None = None
    keys: PositionKeysByFrame = {}
    units: Unit | None = None
    up: Axis | None = None
    at: PointValue | None = None
    rotate: tuple[Angle, Angle, Angle] | None = None
    scale: Annotated[float, BeforeValidator(parse_number_between(-1e6, 1e6))] = 1.0
    voxel: PositiveLength | None = None
    weld: PositiveLength | None = None
    look: Look | None = None

    @property
    def own_units(self) -> str | None:
        """Return the unit of length that the file format specifies, or None if it specifies none."""
        return "m" if self.mesh.lower().endswith((".gltf", ".glb")) else None

    @property
    def own_up(self) -> str | None:
        """Return the file's up axis as the scene or the format defines it, or None if neither does."""
        return self.up or ("y" if self.own_units else None)


class HeightThing(ThingModel):
    """A surface of heights: a 16-bit grey image (.png, .tif), or an array of an .npz file.

    `array`: the name of the array, if the file has several.
    `layer`: the first index, if the array has three dimensions.
    `extent`: the size along x and the other horizontal axis, centred at the surface's own origin.
    `scale`: the height of a sample of 1.
    `offset`: added to all heights."""

    names_file = True

    height: FilePath
    extent: tuple[PositiveLength, PositiveLength]
    scale: Length
    offset: Length | None = None
    array: SceneName | None = None
    layer: Annotated[int, BeforeValidator(parse_integer_between(0, 100_000))] | None = None
    at: PointValue | None = None
    rotate: tuple[Angle, Angle, Angle] | None = None
    keys: PositionKeysByFrame = {}
    look: Look | None = None


class UsdItemDefaults(ScenePart):
    """Defaults for items from points of a USD file: a radius, and values of attributes. They apply where the file has no
    value."""

    model_config = ConfigDict(extra="allow", frozen=True, arbitrary_types_allowed=True, hide_input_in_errors=True)
    __pydantic_extra__: dict[str, AnyQuantity] = Field(init=False)

    radius: PositiveLength | None = None


class UsdThing(ThingModel):
    """The contents of a USD file at and below a prim: meshes, one curve, or points.

    Units, axes, positions and time come from the file. Then `scale`, `rotate`, `at` and `keys` are applied.
    `prim`: by default, the complete file.
    `kind`: items may be all empties of this kind below the prim; by default, the name of the items.
    `turn`: the attributes that receive the direction of the empties."""

    names_file = True

    usd: FilePath
    prim: SceneWord | None = None
    kind: SceneWord | None = None
    turn: SceneName | tuple[SceneName, SceneName, SceneName] | None = None
    purpose: UsdPurposeWord = "render"
    at: PointValue | None = None
    rotate: tuple[Angle, Angle, Angle] | None = None
    scale: Annotated[float, BeforeValidator(parse_number_between(-1e6, 1e6))] = 1.0
    voxel: PositiveLength | None = None
    weld: PositiveLength | None = None
    keys: PositionKeysByFrame = {}
    look: Look | None = None
    each: UsdItemDefaults = UsdItemDefaults()

    @property
    def prim_path(self) -> str:
        """Return the path of the prim. It is `/`, the complete file, if the scene names none."""
        return "/" if self.prim is None else self.prim


ScaledThing = MeshThing | UsdThing
PlacedThing = ScaledThing | HeightThing


class CurveThing(ThingModel):
    """A polyline from a JSON file of points. `####` in its name means one file per frame."""

    names_file = True

    curve: FilePath
    keys: PositionKeysByFrame = {}
    units: Unit | None = None
    up: Axis | None = None
    at: PointValue | None = None


FlowStrength = Annotated[float, BeforeValidator(parse_number_between(-1, 1))]
FalloffWord = Annotated[str, BeforeValidator(parse_one_of("none", "linear", "smooth"))]


class FlowThing(ThingModel):
    """The fields of all flows.

    `on`: the surface of the flow; by default, all surfaces.
    `strength`: a factor; below 0 it reverses the flow."""

    on: SceneName | None = None
    strength: FlowStrength = 1.0


class SpreadFlow(FlowThing):
    """A flow that decreases with the distance from its target. It is 0 beyond `radius`; without a radius, it is constant."""

    radius: PositiveLength | None = None
    falloff: FalloffWord = "smooth"
    cell: PositiveLength | None = None


class TangentFlow(SpreadFlow):
    """A flow along a curve, in the direction in which the curve was drawn. The curve is in the world or in a JSON file of points.

    `gather`: above 0, the flow also leads onto the curve. At the radius, this is the ratio of the part onto the curve to the part
        along it."""

    tangent: FilePath
    gather: Annotated[float, BeforeValidator(parse_number_between(0, 10))] = 0.0


def _find_target_type_tag(value: Any) -> str:
    return "point" if isinstance(value, list) else "named"


FlowTargetValue = Annotated[
    Annotated[PointValue, Tag("point")] | Annotated[FilePath, Tag("named")], Discriminator(_find_target_type_tag)
]


class TowardFlow(SpreadFlow):
    """A flow toward a curve, an item, the nearest of some items, or a point."""

    toward: FlowTargetValue


class AwayFlow(SpreadFlow):
    """A flow away from a curve, an item, the nearest of some items, or a point."""

    away: FlowTargetValue


class BorderFlow(FlowThing):
    """A flow inward from the open borders of a surface, within the distance `within` of a border."""

    border: SceneName
    within: PositiveLength
    falloff: FalloffWord = "linear"
    cell: PositiveLength | None = None


class SolvedFlow(FlowThing):
    """A flow along the cheapest path over the surfaces to a target. A millimetre costs 1, plus the following terms.

    `slope`: times the sine of the ground's slope.
    `room`: a cost within this distance of an obstacle.
    `maps`: the values of maps, each times its factor.
    `crowding`: times the share of the ground covered by agents. The share is measured again after each interval `every`."""

    solved: FlowTargetValue
    slope: Annotated[float, BeforeValidator(parse_number_between(0, 1e6))] = 0.0
    room: PositiveLength | None = None
    maps: dict[SceneName, Annotated[float, BeforeValidator(parse_number_between(-1e6, 1e6))]] = {}
    crowding: Annotated[float, BeforeValidator(parse_number_between(0, 1e6))] = 0.0
    every: PositiveTime | None = None
    cell: PositiveLength | None = None


class PaintedThing(ThingModel):
    """Vectors of a flow or numbers of a map, painted on the vertices or faces of a surface.

    They are attributes of a .ply file, or an array of an .npz file. Their order is that of the surface's own file."""

    names_file = True

    painted: FilePath
    attribute: SceneName | tuple[SceneName, ...] | None = None
    on: SceneName | None = None
    strength: Annotated[float, BeforeValidator(parse_number_between(-1e6, 1e6))] = 1.0


class ItemThing(ScenePart):
    """One item: its position, its size, and the values of its attributes (any further key).

    `on`: a surface onto which the item is dropped along the scene's up."""

    model_config = ConfigDict(extra="allow", frozen=True, arbitrary_types_allowed=True, hide_input_in_errors=True)
    __pydantic_extra__: dict[str, AnyQuantity] = Field(init=False)

    at: PointValue
    on: SceneName | None = None
    radius: PositiveLength | None = None
    keys: PositionKeysByFrame = {}
    look: Look | None = None


class LampThing(ThingModel):
    """A lamp: a sphere that emits light, at a point.

    `power`: its strength; at a distance of ten radii, 100 % is as bright as the sun. `colour`: of its light, as display values
    from 0 to 1; it does not change the brightness. `keys`: its position at some frames."""

    lamp: PointValue
    radius: PositiveLength | None = None
    power: LightStrength = 1.0
    colour: LightColour | None = None
    keys: PositionKeysByFrame = {}

    @property
    def at(self) -> PointValue:
        """Return the lamp's position before the first key."""
        return self.lamp


def convert_rotation(thing: PlacedThing) -> tuple[float, float, float]:
    """Return the rotation of a thing in radians, about x, then y, then z."""
    x, y, z = (angle.number for angle in thing.rotate) if thing.rotate else (0.0, 0.0, 0.0)
    return x, y, z


def convert_point(point: PointValue | None, unit_mm: float) -> tuple[float, float, float]:
    """Return a point of the scene in millimetres. For None, this is the origin."""
    x, y, z = (part.to_millimetres(unit_mm) for part in point) if point else (0.0, 0.0, 0.0)
    return x, y, z
