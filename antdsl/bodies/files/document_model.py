"""The JSON documents of a body, as pydantic models: the definition, its rig, layers, transform groups and clips, and the settings
of a clip in the extras of a glTF animation.

Texts, numbers and booleans are strict. `document_errors` turns what does not match into findings. What needs other parts of the
definition, such as the name of a joint, is checked when the definition is built."""

import re
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    FailFast,
    Field,
    PlainValidator,
    Strict,
    Tag,
    TypeAdapter,
    ValidationInfo,
    model_validator,
)

from antdsl import limits
from antdsl.bodies.agents.transforms import ORDERS
from antdsl.scene.model import UNIT_MM
from antdsl.scene.values import make_error

AXES = {f"{sign}{letter}": tuple(float(f"{sign}{each == letter:d}") for each in "xyz") for letter in "xyz" for sign in "+-"}
_UNIT = re.compile(rf"(?:(\d{{1,6}}(?:\.\d{{1,9}})?) )?({'|'.join(UNIT_MM)})")
_NAME_CHARACTERS = 1000
_LEAST_SCALE, _MOST_SCALE = 0.1, 10.0  # times as large as in the rest pose


class Form(BaseModel):
    """An object of a document, in a form of antdsl. `noun`: what it is, in messages."""

    model_config = ConfigDict(extra="forbid", frozen=True, hide_input_in_errors=True)
    noun: ClassVar[str]


class DocumentedForm(Form):
    """An object in a form that others published. A later version may have further keys, so an unknown one is only a warning."""


# ---- values


def _check_text(value: str) -> str:
    if len(value) > _NAME_CHARACTERS or "\0" in value:
        raise make_error("this text is too long, or contains an invisible character")
    return value


def _check_filled(value: str) -> str:
    if not value:
        raise make_error("expected a text here, but it is empty")
    return _check_text(value)


def one_of(*words: str) -> BeforeValidator:
    """One word of a closed list."""

    def check(value: Any) -> Any:
        if value not in words:
            raise make_error(f"this must be one of `{'`, `'.join(words)}`", f'write `"{words[0]}"`')
        return value

    return BeforeValidator(check)


def edition(number: int) -> BeforeValidator:
    """The version of a form, of which one is read."""

    def check(value: Any) -> int:
        if value != number or isinstance(value, bool):
            raise make_error("this version is not supported", f"write `{number}`, if the file is in that form")
        return number

    return BeforeValidator(check)


def at_most(limit: str, what: str, owner: str = "a body") -> BeforeValidator:
    """No more entries than a limit of `antdsl.limits`."""

    def check(entries: Any) -> Any:
        most = getattr(limits, limit)
        if isinstance(entries, list | dict) and len(entries) > most:
            raise make_error(f"{owner} has at most {most:,} {what}", code="too-large")
        return entries

    return BeforeValidator(check)


def _refuse_numbers(entries: Any) -> Any:
    """Refuse numbers at once: a document may have millions of them in a row."""
    if isinstance(entries, list) and entries and isinstance(entries[0], int | float):
        raise make_error("this must be a list of texts or objects, not of numbers")
    return entries


def _check_names(entries: tuple[Any, ...]) -> tuple[Any, ...]:
    first: dict[str, int] = {}
    for number, entry in enumerate(entries):
        if entry.name in first:
            words, place = f"`{entry.name}` is given twice", (number, "name")
            raise make_error(words, "keep one of them", code="duplicate-name", at=place, first=(first[entry.name], "name"))
        first[entry.name] = number
    return entries


def unit_mm(text: object) -> float:
    """Return the millimetres of a length unit such as `mm` or `6 mm`; 0 if the text is not one."""
    match = _UNIT.fullmatch(text) if isinstance(text, str) else None
    return float(match[1] or 1) * UNIT_MM[match[2]] if match else 0.0


def _read_unit(value: Any) -> float:
    unit = unit_mm(value)
    if not unit:
        known = ", ".join(f"`{word}`" for word in UNIT_MM)
        raise make_error(f"the unit of length must be one of {known}, or a multiple of one", 'write `"mm"`, or `"6 mm"`')
    return unit


def _read_axis(value: Any, info: ValidationInfo) -> Any:
    if not isinstance(value, str) or value not in AXES:
        letter = value if isinstance(value, str) and f"+{value}" in AXES else "z" if info.field_name == "front" else "y"
        raise make_error(f"`{info.field_name}` must be one of the axes `+x` `-x` `+y` `-y` `+z` `-z`", f'write `"+{letter}"`')
    return AXES[value]


def axis_word(axis: tuple[float, float, float]) -> str:
    """Return the word for an axis, such as `+x`."""
    return next(word for word, each in AXES.items() if each == axis)


Flag = Annotated[bool, Strict()]
Text = Annotated[str, Strict(), AfterValidator(_check_filled)]
AnyText = Annotated[str, Strict(), AfterValidator(_check_text)]  # may be empty
Number = Annotated[float, Strict(), Field(ge=-limits.LARGEST, le=limits.LARGEST)]
Amount = Annotated[float, Strict(), Field(ge=0.0, le=limits.LARGEST)]
Share = Annotated[float, Strict(), Field(ge=0.0, le=1.0)]
SampleRate = Annotated[float, Strict(), Field(ge=0.001, le=100_000.0)]
ReadRate = Annotated[float, Strict(), Field(ge=1.0, le=1000.0)]
Scale = Annotated[float, Strict(), Field(ge=_LEAST_SCALE, le=_MOST_SCALE)]
Colour = tuple[Share, Share, Share]
Entries = BeforeValidator(_refuse_numbers)
Texts = Annotated[tuple[Text, ...], Entries]
Unit = Annotated[float, BeforeValidator(_read_unit)]
Axis = Annotated[tuple[float, float, float], BeforeValidator(_read_axis)]
Row = tuple[Number, Number, Number, Number]
Unique = AfterValidator(_check_names)


def _check_matrix(rows: tuple[Row, Row, Row, Row]) -> tuple[Row, Row, Row, Row]:
    if rows[3] != (0, 0, 0, 1):
        is_transposed = all(row[3] == 0 for row in rows[:3])
        help = "write the translation into the last column" if is_transposed else "write `[0, 0, 0, 1]`"
        raise make_error("the last row of a rest pose must be `[0, 0, 0, 1]`", help)
    return rows


def _check_joints(joints: dict[str, Texts]) -> dict[str, Texts]:
    if not joints:
        raise make_error("a rig has at least one joint", 'write `{"root": []}`', code="bad-rig")
    return joints


Matrix = Annotated[tuple[Row, Row, Row, Row], AfterValidator(_check_matrix), Entries]


# ---- rig, layers, transform groups


class ChannelForm(DocumentedForm):
    noun = "a channel"
    default_value: Number = 0.0
    transform: AnyText = ""


class RigForm(DocumentedForm):
    """`transforms`: the children of each joint, in any order. `antdsl_rest`: the local matrix of a joint by rows."""

    noun = "a rig"
    rig_version: Annotated[int, edition(1)] = Field(examples=["1"])
    transforms: Annotated[dict[Text, Texts], AfterValidator(_check_joints), at_most("JOINTS", "joints", "a rig")] = Field(
        examples=["{}"]
    )
    channels: Annotated[dict[Text, ChannelForm], at_most("CHANNELS", "channels", "a rig")] = Field(
        {}, examples=['{"NAME": {"default_value": 0, "transform": ""}}']
    )
    antdsl_rest: dict[str, Matrix] = {}


def _refuse_deformer(value: str) -> str:
    if value:
        words = f"a static shape cannot have a deformer, but this one has `{value[:60]}`"
        raise make_error(words, 'move it to `deforming`, or write `""`')
    return value


class BindingForm(DocumentedForm):
    noun = "a binding"
    transform: AnyText = ""
    shape: Text
    bounds_scale: tuple[Amount, Amount, Amount] = (1.0, 1.0, 1.0)
    deformer: AnyText = ""


class StaticForm(BindingForm):
    transform: Text
    deformer: Annotated[AnyText, AfterValidator(_refuse_deformer)] = ""


class DeformingForm(BindingForm):
    deformer: Text = Field(examples=['"linearskinning"'])


class LayerForm(DocumentedForm):
    noun = "a layer"
    version: Annotated[int, edition(2)] = Field(examples=["2"])
    name: Text
    static: Annotated[tuple[StaticForm, ...], Entries] = ()
    deforming: Annotated[tuple[DeformingForm, ...], Entries] = ()


class MemberForm(DocumentedForm):
    noun = "a member"
    name: Text
    weight: Share = 1.0


class ChannelName(DocumentedForm):
    noun = "a channel"
    name: Text


class GroupForm(DocumentedForm):
    noun = "a transform group"
    version: Annotated[int, edition(2)] = Field(examples=["2"])
    name: Text
    members: Annotated[tuple[MemberForm, ...], Unique, Entries] = ()
    channels: Annotated[tuple[ChannelName, ...], Unique, Entries] = ()


# ---- clips

_CHANNELS = '{"JOINT:tx": [0, 1]}'
_NUMBERS = TypeAdapter(Annotated[list[Number], FailFast()])


def _read_samples(value: Any) -> NDArray[np.float64]:
    """Return the samples of a channel; a single number is a constant channel."""
    return np.array(_NUMBERS.validate_python(value if isinstance(value, list | dict) else [value]), np.float64)


Samples = Annotated[Any, PlainValidator(_read_samples)]


def _check_channels(channels: dict[str, NDArray[np.float64]]) -> dict[str, NDArray[np.float64]]:
    if not channels:
        raise make_error("a clip has at least one channel", f"write `{_CHANNELS}`")
    longest, first = 1, ""
    for name, samples in channels.items():
        if not len(samples):
            raise make_error(f"`{name[:60]}` has no samples", "leave the channel out", at=(name,), complete=True)
        if len(samples) > 1 and longest > 1 and len(samples) != longest:
            words = f"`{name[:60]}` has {len(samples):,} samples, but `{first[:60]}` has {longest:,}"
            raise make_error(words, "give all the same number, or a single one", at=(name,), key=True)
        if len(samples) > longest:
            longest, first = len(samples), name
    return channels


class ClipSettings(Form):
    noun = "a clip"
    loop: Flag = True
    stride: Amount = 0.0
    marks: dict[str, Amount] = Field({}, examples=['{"NAME": 0.5}'])
    feet: Flag = True


class ClipForm(ClipSettings):
    """A clip with its samples. Channels are `joint:tx` … `joint:shear3`, or numbers of the rig."""

    antdsl_clip: Annotated[int, edition(1)] = Field(examples=["1"])
    name: Text
    rate: SampleRate = Field(examples=["24"])
    rotation_order: Annotated[str, one_of(*ORDERS)] | None = None
    angles: Annotated[str, one_of("degrees", "radians")] | None = None
    channels: Annotated[dict[str, Samples], AfterValidator(_check_channels)] = Field(examples=[_CHANNELS])

    @model_validator(mode="after")
    def _check_rotations(self) -> Self:
        rotation = next((name for name in self.channels if ":r" in name), None)
        if rotation is not None and (self.rotation_order is None or self.angles is None):
            missing = '"rotation_order": "xyz"' if self.rotation_order is None else '"angles": "degrees"'
            words, path = "a clip with rotations must state their order and unit", ("channels", rotation)
            raise make_error(words, f"add `{missing}`", code="missing-key", at=path, key=True)
        return self


class ClipReference(ClipSettings):
    """Clips of another file, or a clip of `from`. The settings that are given replace those of the file."""

    file: Text | None = None
    clip: Text | None = None
    name: Text | None = None
    rate: ReadRate | None = None
    prim: Text | None = None


class AnimationSettings(ClipSettings):
    """What glTF has no place for: the settings of a clip in the extras of its animation. Unknown keys are ignored."""

    model_config = ConfigDict(extra="ignore")
    rate: SampleRate | None = None


def _clip_tag(value: Any) -> str:
    return "clip-here" if isinstance(value, dict) and "antdsl_clip" in value else "clip-elsewhere"


Clip = Annotated[
    Annotated[ClipForm, Tag("clip-here")] | Annotated[ClipReference, Tag("clip-elsewhere")], Discriminator(_clip_tag)
]


# ---- shapes, legs, gaits, variation


class ShapeReference(Form):
    """Shapes of a file, or (without `file`) a shape that is known, with other settings and with the documented attributes of
    blend shapes."""

    noun = "a shape"
    file: Text | None = None
    shape: Text | None = None
    name: Text | None = None
    units: Unit | None = None
    material: Text | None = None
    prim: Text | None = None
    blendshape_shapenames: Texts = ()
    blendshape_channels: Texts = ()
    blendshape_inbetweenweights: Annotated[tuple[Number, ...], FailFast()] = ()
    blendshape_attribs: Text = "P N"
    blendshape_ptidattr: Text = "id"
    blendshape_primidattr: Text = "id"
    deformDualQuaternionBlendAttrib: AnyText = ""


class LegForm(Form):
    noun = "a leg"
    name: Text = Field(examples=['"left"'])
    upper: Text
    lower: Text
    foot: Text


class GaitForm(Form):
    noun = "a gait"
    name: Text = Field(examples=['"walk"'])
    speed: Amount = Field(examples=["10"])
    stride: Annotated[float, Strict(), Field(ge=limits.LEAST_STRIDE, le=limits.LARGEST)] = Field(examples=["5"])
    duty: Annotated[float, Strict(), Field(ge=limits.DUTY[0], le=limits.DUTY[1])] = Field(examples=["0.6"])
    lift: Amount = Field(examples=["0.5"])
    phases: Annotated[tuple[Share, ...], FailFast()] = Field(examples=["[0, 0.5]"])


def _check_colours(colours: tuple[Colour, ...]) -> tuple[Colour, ...]:
    if not 2 <= len(colours) <= limits.BODY_PARTS:
        raise make_error(
            f"a material varies between two colours at least, not {len(colours)}",
            "write two colours, or more",
            code="wrong-count",
        )
    return colours


class VariationForm(Form):
    noun = "variation"
    scale: dict[str, tuple[Scale, Scale]] = Field({}, examples=['{"head": [0.9, 1.2]}'])
    materials: dict[str, Annotated[tuple[Colour, ...], AfterValidator(_check_colours), Entries]] = Field(
        {}, examples=['{"fur": [[0.4, 0.3, 0.2], [0.1, 0.1, 0.1]]}']
    )


# ---- the definition


class BaseForm(Form):
    """The glTF or USD file that provides all parts of a body."""

    noun = "a file to begin from"
    file: Text = Field(examples=['"body.glb"'])
    prim: Text | None = None
    rate: ReadRate | None = None


PathPair = tuple[AnyText, AnyText]
BaseFile = Annotated[BaseForm, BeforeValidator(lambda value: {"file": value} if isinstance(value, str) else value)]


class BodyForm(Form):
    """A definition. `rig`, `layers`, `groups` and `metadata` are here as their own files have them."""

    noun = "a definition"
    antdsl_body: Annotated[int, edition(1)] = Field(examples=["1"])
    name: Text | None = None
    base: BaseFile | None = Field(None, alias="from", examples=['"body.glb"'])
    front: Axis | None = None
    up: Axis | None = None
    units: Unit | None = None
    length: Annotated[float, Strict(), Field(ge=1e-9, le=limits.LARGEST)] | None = None
    rig: RigForm | None = Field(None, examples=['{"file": "rig.json"}'])
    shapes: Annotated[tuple[ShapeReference, ...], Entries, at_most("BODY_PARTS", "shapes")] = Field(
        (), examples=['[{"file": "sword.obj", "name": "sword"}]']
    )
    shapelib_includes: Annotated[tuple[PathPair, ...], Entries] = Field((), examples=['[["$HIP/lib.glb", "/…/lib.glb"]]'])
    layers: Annotated[tuple[LayerForm, ...], Entries, at_most("BODY_PARTS", "layers")] = ()
    clips: Annotated[tuple[Clip, ...], Entries, at_most("BODY_PARTS", "clips")] = ()
    groups: Annotated[tuple[GroupForm, ...], Entries, at_most("BODY_PARTS", "transform groups")] = ()
    metadata: dict[str, Any] = {}
    materials: dict[str, Colour] = Field({}, examples=['{"NAME": [0.5, 0.4, 0.3]}'])
    legs: Annotated[tuple[LegForm, ...], Unique, Entries, at_most("LEGS", "legs")] = ()
    gaits: Annotated[tuple[GaitForm, ...], Unique, Entries, at_most("GAITS", "gaits")] = ()
    idle: Text | None = None
    variation: VariationForm = VariationForm()


def keys_of(form: type[Form]) -> list[str]:
    """The keys of a form, in its order."""
    return [field.alias or name for name, field in form.model_fields.items()]
