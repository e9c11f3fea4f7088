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
    """One form of defining a thing of the world in a scene, such as by a mesh file. The first field is the required key that
    identifies the form.

    `names_file`: whether the value of this key is the path of a file with the thing."""

    names_file: ClassVar[bool] = False

    @classmethod
    def find_form_key(cls) -> str:
        """Return the key that identifies the form."""
        return next(iter(cls.__annotations__))


class MeshThing(ThingModel):
    """A mesh from a file. With `####` in the name of the file, there is one file for each frame.

    First the mesh is scaled, then its `up` axis becomes that of the scene. Then it is rotated about x, y and z, in this
    order, and moved to `at`.
    `group`: use only this group or object of an .obj file, or only this node of a glTF file and all nodes below it.
    `weld`: merge vertices that are closer together than this distance."""

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
    """A surface from heights: a grey image with 16 bits (.png, .tif), or an array of an .npz file.

    `array`: the name of the array, if the file contains several.
    `layer`: the first index of the array, if it has three dimensions.
    `extent`: the size along x and along the other horizontal axis. The origin of the surface is in its centre.
    `scale`: the height that a value of 1 stands for.
    `offset`: a height that is added everywhere."""

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
    """The radius and the attributes of items from a USD file, where the file has no values for them."""

    model_config = ConfigDict(extra="allow", frozen=True, arbitrary_types_allowed=True, hide_input_in_errors=True)
    __pydantic_extra__: dict[str, AnyQuantity] = Field(init=False)

    radius: PositiveLength | None = None


class UsdThing(ThingModel):
    """The content of a USD file at and below a prim: meshes, one curve, or points.

    The file defines units, axes, positions and time. Then `scale`, `rotate`, `at` and `keys` are applied.
    `prim`: the path of the prim; by default, the complete file is used.
    `kind`: use all empties of this kind below the prim as items; by default, the kind is the name of the items.
    `turn`: the attributes that get the direction of each empty."""

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
        """Return the path of the prim. If the scene names no prim, the path is `/`, which stands for the complete file."""
        return "/" if self.prim is None else self.prim


ScaledThing = MeshThing | UsdThing
PlacedThing = ScaledThing | HeightThing


class CurveThing(ThingModel):
    """A line through the points of a JSON file. With `####` in the name of the file, there is one file for each frame."""

    names_file = True

    curve: FilePath
    keys: PositionKeysByFrame = {}
    units: Unit | None = None
    up: Axis | None = None
    at: PointValue | None = None


FlowStrength = Annotated[float, BeforeValidator(parse_number_between(-1, 1))]
FalloffWord = Annotated[str, BeforeValidator(parse_one_of("none", "linear", "smooth"))]


class FlowThing(ThingModel):
    """The keys of all flows.

    `on`: the surface of the flow; by default, all surfaces have it.
    `strength`: a factor for the flow; a negative one reverses it."""

    on: SceneName | None = None
    strength: FlowStrength = 1.0


class SpreadFlow(FlowThing):
    """A flow that is strongest at its target and 0 at the distance `radius`. Without a radius, it is equally strong
    everywhere."""

    radius: PositiveLength | None = None
    falloff: FalloffWord = "smooth"
    cell: PositiveLength | None = None


class TangentFlow(SpreadFlow):
    """A flow along a curve, in the direction in which the curve was drawn. The curve is one of the world, or one from a JSON
    file.

    `gather`: if greater than 0, the flow also leads towards the curve. At the distance `radius`, the part towards the curve
    is this many times the part along it."""

    tangent: FilePath
    gather: Annotated[float, BeforeValidator(parse_number_between(0, 10))] = 0.0


def _find_target_type_tag(value: Any) -> str:
    return "point" if isinstance(value, list) else "named"


FlowTargetValue = Annotated[
    Annotated[PointValue, Tag("point")] | Annotated[FilePath, Tag("named")], Discriminator(_find_target_type_tag)
]


class TowardFlow(SpreadFlow):
    """A flow towards a curve, an item, the nearest of several items, or a point."""

    toward: FlowTargetValue


class AwayFlow(SpreadFlow):
    """A flow away from a curve, an item, the nearest of several items, or a point."""

    away: FlowTargetValue


class BorderFlow(FlowThing):
    """A flow away from the open borders of a surface, into the surface. `within`: the distance from a border at which it
    ends."""

    border: SceneName
    within: PositiveLength
    falloff: FalloffWord = "linear"
    cell: PositiveLength | None = None


class SolvedFlow(FlowThing):
    """A flow along the cheapest path over the surfaces to a target. Each millimetre costs 1, and more for the following
    reasons.

    `slope`: this cost, times the sine of the ground's slope.
    `room`: up to this distance from an obstacle, a cost that increases towards the obstacle.
    `maps`: the values of painted maps, each times the factor that you write here.
    `crowding`: this cost, times the share of the ground that agents cover.
    `every`: the time after which that share is measured again."""

    solved: FlowTargetValue
    slope: Annotated[float, BeforeValidator(parse_number_between(0, 1e6))] = 0.0
    room: PositiveLength | None = None
    maps: dict[SceneName, Annotated[float, BeforeValidator(parse_number_between(-1e6, 1e6))]] = {}
    crowding: Annotated[float, BeforeValidator(parse_number_between(0, 1e6))] = 0.0
    every: PositiveTime | None = None
    cell: PositiveLength | None = None


class PaintedThing(ThingModel):
    """A flow or a map, painted on the vertices or faces of a surface. A flow consists of vectors, a map of numbers.

    The values are attributes of a .ply file, or an array of an .npz file. Their order is that of the vertices or faces in the
    surface's own file."""

    names_file = True

    painted: FilePath
    attribute: SceneName | tuple[SceneName, ...] | None = None
    on: SceneName | None = None
    strength: Annotated[float, BeforeValidator(parse_number_between(-1e6, 1e6))] = 1.0


class ItemThing(ScenePart):
    """One item, with its position and its radius. Every further key is an attribute of the item, with its value.

    `on`: the surface onto which the item drops along the scene's up axis."""

    model_config = ConfigDict(extra="allow", frozen=True, arbitrary_types_allowed=True, hide_input_in_errors=True)
    __pydantic_extra__: dict[str, AnyQuantity] = Field(init=False)

    at: PointValue
    on: SceneName | None = None
    radius: PositiveLength | None = None
    keys: PositionKeysByFrame = {}
    look: Look | None = None


class LampThing(ThingModel):
    """A lamp: a sphere that gives light.

    `power`: the strength. At a distance of ten times its radius, a lamp of 100 % is as bright as the sun.
    `colour`: the colour of the light, as three numbers from 0 to 1. It does not change the brightness.
    `keys`: the position of the lamp at some frames."""

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
    """Return the rotation of a thing as angles about x, y and z in radians, which are applied in this order."""
    x, y, z = (angle.number for angle in thing.rotate) if thing.rotate else (0.0, 0.0, 0.0)
    return x, y, z


def convert_point(point: PointValue | None, unit_mm: float) -> tuple[float, float, float]:
    """Return a point of the scene in millimetres. For None, this is the origin."""
    x, y, z = (part.to_millimetres(unit_mm) for part in point) if point else (0.0, 0.0, 0.0)
    return x, y, z
