"""The models of a `scene.yaml`: one pydantic model for each mapping in it. Scalars are texts until these models convert them."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from typing import TYPE_CHECKING, Annotated, Any, Literal, Union

from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag

from antdsl import limits
from antdsl.diagnostics.suggestion import find_nearest_name
from antdsl.program.tables.columns import DEFAULT_ATTRIBUTE_NAMES
from antdsl.scene.camera_models import DEFAULT_CAMERA_NAME, Cameras, CameraValue, PlacedCamera
from antdsl.scene.crowds.casting_model import ClumpFormation, RankFormation
from antdsl.scene.crowds.crowd_model import CrowdLine as CrowdLine
from antdsl.scene.crowds.crowd_model import Placement as Placement
from antdsl.scene.crowds.crowd_model import ScriptedWalk as ScriptedWalk
from antdsl.scene.light_model import LightModel
from antdsl.scene.notes.notes_model import AnyNote
from antdsl.scene.scene_kinds import SCENE_KINDS
from antdsl.scene.thing_models import UNIT_MM as UNIT_MM
from antdsl.scene.thing_models import Axis, ItemThing, ThingModel, Unit, UsdThing
from antdsl.scene.values import (
    AnyQuantity,
    FilePath,
    FrameRange,
    FrameRangeValue,
    FramesPerSecond,
    LengthRange,
    PointOrName,
    PositiveLength,
    SceneName,
    make_value_error,
    parse_condition,
    parse_integer_between,
    parse_number_between,
    parse_one_of,
)
from antdsl.scene.values import PointValue as PointValue
from antdsl.scene.values import PositionKey as PositionKey
from antdsl.scene.values import ScenePart as ScenePart

StickMode = Annotated[str, BeforeValidator(parse_one_of("triangles", "rays"))]
OrientMode = Annotated[str, BeforeValidator(parse_one_of("normal", "turns", "probes"))]
ContactsMode = Annotated[Literal["off", "soft", "hard"], BeforeValidator(parse_one_of("off", "soft", "hard"))]


# The key that identifies the kind of a thing of the world, unless the key is the name of an item.
THING_MODELS: dict[str, type[ThingModel]] = {
    each.find_form_key(): each for kind in SCENE_KINDS.values() for each in kind.models if issubclass(each, ThingModel)
}
FILE_FORM_KEYS = frozenset(head for head, each in THING_MODELS.items() if each.names_file)


def make_thing_type_tag(head: str) -> str:
    """Return the tag by which pydantic selects the form of a thing. It is the last word in the location of an error.

    `head`: the key that identifies the form, such as `mesh`."""
    return f"{head}-thing"


def _find_thing_type_tag(value: Any) -> str:
    keywords = (
        [word for word in THING_MODELS if word in value and not isinstance(value[word], dict)] if isinstance(value, dict) else []
    )
    return make_thing_type_tag(keywords[0]) if keywords else "items-thing"


def _check_items(value: Any) -> Any:
    """Return a mapping of items unchanged. Raises an error for a value that is not such a mapping or has a misspelled key."""
    if not isinstance(value, dict):
        raise make_value_error(
            "a thing of the world is a mapping", "write `{mesh: ground.ply}`, `{curve: way.json}` or `{apple: {at: [0, 0, 0]}}`"
        )
    for word, inner in value.items():
        near = None if isinstance(inner, dict) else find_nearest_name(str(word), THING_MODELS)
        if near:
            raise make_value_error(f"`{word}` is not a kind of thing of the world", f"did you mean `{near}`?")
    if value and not any(isinstance(inner, dict) for inner in value.values()):
        raise make_value_error(
            "no key defines the kind of this thing", "add one of " + ", ".join(f"`{word}`" for word in THING_MODELS)
        )
    return value


if TYPE_CHECKING:
    WorldThing = ThingModel | dict[str, ItemThing]
else:
    _ITEMS = Annotated[dict[SceneName, ItemThing], BeforeValidator(_check_items), Tag("items-thing")]
    _FORMS = tuple(Annotated[each, Tag(make_thing_type_tag(head))] for head, each in THING_MODELS.items())
    WorldThing = Annotated[Union[(*_FORMS, _ITEMS)], Discriminator(_find_thing_type_tag)]


FieldNumber = Annotated[float, BeforeValidator(parse_number_between(0, limits.MAX_FIELD_START))]
FieldFactor = Annotated[float, BeforeValidator(parse_number_between(-limits.MAX_FIELD_START, limits.MAX_FIELD_START))]


def _find_field_value_tag(value: Any) -> str:
    return "vector" if isinstance(value, list) else "number"


FieldValue = Annotated[
    Annotated[FieldNumber, Tag("number")] | Annotated[tuple[FieldFactor, FieldFactor, FieldFactor], Tag("vector")],
    Discriminator(_find_field_value_tag),
]


class FieldStart(ScenePart):
    """A starting value of a field: a number, or a vector in the scene's axes.

    `start`: the value, everywhere, or only within `radius` of a point or an item.
    `around`: the point or item (default: the origin). `on`: only the cells of this surface."""

    start: FieldValue
    around: PointOrName | None = None
    radius: PositiveLength | None = None
    on: SceneName | None = None


class FieldGrid(ScenePart):
    """Starting values of a field from a grid that lies over the ground like a picture: a grey image or an array of a file.

    `extent`: the size along x and the other level axis (default: of the field's surfaces). `at`: the grid's centre.
    `scale`, `offset`: the value of a sample of 1, and what is added to all values.
    `array`, `layer`: the array of an .npz file, and its first index if it has one dimension too many.
    `on`: only the cells of this surface."""

    values: FilePath
    extent: tuple[PositiveLength, PositiveLength] | None = None
    at: PointValue | None = None
    scale: FieldFactor = 1.0
    offset: FieldFactor = 0.0
    array: SceneName | None = None
    layer: Annotated[int, BeforeValidator(parse_integer_between(0, 100_000))] | None = None
    on: SceneName | None = None


def _find_field_start_tag(value: Any) -> str:
    if isinstance(value, list):
        return "several-start"
    return "grid-start" if isinstance(value, dict) and "values" in value else "value-start"


FIELD_START_MODELS: dict[str, type[ScenePart]] = {"value-start": FieldStart, "grid-start": FieldGrid}  # by tag

if TYPE_CHECKING:
    FieldStarts = tuple[FieldStart | FieldGrid, ...]
else:
    _ONE = tuple(Annotated[each, Tag(tag)] for tag, each in FIELD_START_MODELS.items())
    _LINE = Annotated[Union[(*_ONE,)], Discriminator(_find_field_start_tag)]
    _LINES = Annotated[tuple[_LINE, ...], Field(max_length=limits.MAX_FIELD_STARTS), Tag("several-start")]
    FieldStarts = Annotated[
        Union[(*_ONE, _LINES)],
        Discriminator(_find_field_start_tag),
        AfterValidator(lambda value: value if isinstance(value, tuple) else (value,)),
    ]


class LevelOfDetail(ScenePart):
    """Simpler feelers for agents that are far from the camera.

    `near`: up to this distance, feelers find the triangles of meshes.
    `far`: up to this distance, feelers find only boxes around the parts of obstacles. Beyond it, they find nothing."""

    near: PositiveLength
    far: PositiveLength | None = None


class OutputModel(ScenePart):
    """What the cache of a run stores. `attributes`: of the agents. `events`: the events of each frame. `checkpoint`: the
    number of frames from one checkpoint to the next."""

    attributes: tuple[Annotated[str, BeforeValidator(lambda v: v)], ...] = DEFAULT_ATTRIBUTE_NAMES
    checkpoint: Annotated[int, BeforeValidator(parse_integer_between(1, 100_000))] = 50
    events: tuple[Annotated[str, BeforeValidator(parse_one_of("contact", "emit"))], ...] = ()


class Wrap(ScenePart):
    """The range in which the world repeats, for each axis. What leaves the world on one side enters it on the other."""

    x: LengthRange | None = None
    y: LengthRange | None = None
    z: LengthRange | None = None


class StartFrom(ScenePart):
    """A frame of another cache. The run starts with the agents, items and fields of this frame."""

    cache: FilePath
    frame: Annotated[int, BeforeValidator(parse_integer_between(-limits.MAX_FRAMES, limits.MAX_FRAMES * 1000))]


MODEL_BY_PATH: dict[str, type[ScenePart]] = {  # the models of mappings, by key
    "place": Placement, "camera": PlacedCamera, "light": LightModel, "lod": LevelOfDetail, "output": OutputModel,
    "from": StartFrom, "wrap": Wrap, "crowd": CrowdLine, "walk": ScriptedWalk, "ranks": RankFormation, "clumps": ClumpFormation,
}  # fmt: skip


class SceneModel(ScenePart):
    """All keys of a scene."""

    edition: Annotated[str, BeforeValidator(parse_one_of("1"))] = Field(alias="antdsl")
    extends: FilePath | None = None  # removed when the scenes are merged
    units: Unit = "mm"
    up: Axis = "y"
    fps: FramesPerSecond = Fraction(24)
    frames: FrameRangeValue = FrameRange(1, 240)
    until: Annotated[str, BeforeValidator(parse_condition)] | None = None
    preroll: Annotated[int, BeforeValidator(parse_integer_between(0, limits.MAX_FRAMES))] = 0
    substeps: Annotated[int, BeforeValidator(parse_integer_between(1, limits.MAX_SUBSTEPS))] = 1
    stick: StickMode = "triangles"
    orient: OrientMode = "normal"
    contacts: ContactsMode = "off"
    wrap: Wrap | None = None
    seed: Annotated[int, BeforeValidator(parse_integer_between(0, 2**64 - 1))] = 0
    start: StartFrom | None = Field(None, alias="from")
    world: dict[SceneName, WorldThing] = {}
    crowd: tuple[CrowdLine, ...] = ()
    notes: Annotated[tuple[AnyNote, ...], Field(max_length=limits.MAX_NOTES)] = ()
    set: dict[str, AnyQuantity] = {}
    fields: dict[SceneName, FieldStarts] = {}
    layers: dict[SceneName, tuple[str, ...]] = {}
    camera: CameraValue | None = None
    cameras: Cameras = {}
    light: LightModel = LightModel()
    lod: LevelOfDetail | None = None
    output: OutputModel = OutputModel()

    @property
    def unit_mm(self) -> float:
        """Return the scene's unit of length in millimetres."""
        return UNIT_MM[self.units]

    @property
    def named_cameras(self) -> Mapping[str, CameraValue]:
        """Return all cameras by name. The camera of the key `camera` is the default one."""
        return self.cameras if self.camera is None else {DEFAULT_CAMERA_NAME: self.camera, **self.cameras}

    def find_camera_path(self, name: str) -> tuple[str, ...]:
        """Return the keys that lead to the camera `name` in the scene."""
        return ("cameras", name) if name in self.cameras else ("camera",)

    @property
    def has_usd_items(self) -> bool:
        """Return whether names of items may come from a USD file. Such files are read only when the scene is staged."""
        return any(isinstance(value, UsdThing) for value in self.world.values())
