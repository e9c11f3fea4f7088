"""Pydantic models of a body's JSON documents: definition, rig, layers, transform groups, clips, and settings in glTF files.

`document_values` has the types of their values. `document_errors` turns mismatches into findings. A value that depends on other
parts of the definition, such as the name of a joint, is checked when the definition is built."""

from typing import Annotated, Any, ClassVar, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Discriminator, FailFast, Field, Tag, model_validator

from antdsl.bodies.agents.transforms import ROTATION_ORDERS
from antdsl.bodies.files.document_values import (
    CHANNELS_EXAMPLE,
    AnyText,
    Axis,
    Channels,
    Colours,
    Duty,
    EntryList,
    Flag,
    Joints,
    Length,
    Matrix,
    NoDeformer,
    NonNegativeNumber,
    Number,
    PathPair,
    PositiveLength,
    ReadRate,
    RgbColour,
    SampleRate,
    Scale,
    Share,
    Text,
    Texts,
    UniqueNames,
    Unit,
    limit_entries,
    require_one_of,
    require_version,
)
from antdsl.scene.values import make_value_error


class Form(BaseModel):
    """An object in antdsl's own JSON form. `noun`: what messages call this kind of object, such as `a clip`."""

    model_config = ConfigDict(extra="forbid", frozen=True, hide_input_in_errors=True)
    noun: ClassVar[str]


class DocumentedForm(Form):
    """An object in a JSON form that Houdini's documentation defines. Unknown keys only cause warnings, because later versions
    may add keys."""


# ---- rig, layers, transform groups


class ChannelForm(DocumentedForm):
    noun = "a channel"
    default_value: Number = 0.0
    transform: AnyText = ""


class RigForm(DocumentedForm):
    """A rig. `transforms`: the children of each joint, in any order. `antdsl_rest`: the local rest matrix of each joint, row by
    row."""

    noun = "a rig"
    rig_version: Annotated[int, require_version(1)] = Field(examples=["1"])
    transforms: Annotated[Joints, limit_entries("MAX_RIG_JOINTS", "joints", "a rig")] = Field(examples=["{}"])
    channels: Annotated[dict[Text, ChannelForm], limit_entries("MAX_RIG_CHANNELS", "channels", "a rig")] = Field(
        {}, examples=['{"NAME": {"default_value": 0, "transform": ""}}']
    )
    antdsl_rest: dict[str, Matrix] = {}


class BindingForm(DocumentedForm):
    noun = "a binding"
    transform: AnyText = ""
    shape: Text
    bounds_scale: tuple[NonNegativeNumber, NonNegativeNumber, NonNegativeNumber] = (1.0, 1.0, 1.0)
    deformer: AnyText = ""


class StaticForm(BindingForm):
    transform: Text
    deformer: NoDeformer = ""


class DeformingForm(BindingForm):
    deformer: Text = Field(examples=['"linearskinning"'])


class LayerForm(DocumentedForm):
    noun = "a layer"
    version: Annotated[int, require_version(2)] = Field(examples=["2"])
    name: Text
    static: Annotated[tuple[StaticForm, ...], EntryList] = ()
    deforming: Annotated[tuple[DeformingForm, ...], EntryList] = ()


class MemberForm(DocumentedForm):
    noun = "a member"
    name: Text
    weight: Share = 1.0


class ChannelName(DocumentedForm):
    noun = "a channel"
    name: Text


class GroupForm(DocumentedForm):
    noun = "a transform group"
    version: Annotated[int, require_version(2)] = Field(examples=["2"])
    name: Text
    members: Annotated[tuple[MemberForm, ...], UniqueNames, EntryList] = ()
    channels: Annotated[tuple[ChannelName, ...], UniqueNames, EntryList] = ()


# ---- clips


class ClipSettings(Form):
    noun = "a clip"
    loop: Flag = True
    stride: NonNegativeNumber = 0.0
    marks: dict[str, NonNegativeNumber] = Field({}, examples=['{"NAME": 0.5}'])
    feet: Flag = True


class ClipForm(ClipSettings):
    """A clip with its samples. Channels are `joint:tx` … `joint:shear3`, or channels of the rig."""

    antdsl_clip: Annotated[int, require_version(1)] = Field(examples=["1"])
    name: Text
    rate: SampleRate = Field(examples=["24"])
    rotation_order: Annotated[str, require_one_of(*ROTATION_ORDERS)] | None = None
    angles: Annotated[str, require_one_of("degrees", "radians")] | None = None
    channels: Channels = Field(examples=[CHANNELS_EXAMPLE])

    @model_validator(mode="after")
    def _check_rotations(self) -> Self:
        rotation = next((name for name in self.channels if ":r" in name), None)
        if rotation is not None and (self.rotation_order is None or self.angles is None):
            missing = '"rotation_order": "xyz"' if self.rotation_order is None else '"angles": "degrees"'
            words, path = "a clip with rotations must also have the order and the unit of the rotations", ("channels", rotation)
            raise make_value_error(words, f"add `{missing}`", code="missing-key", at=path, key=True)
        return self


class ClipReference(ClipSettings):
    """A reference to the clips of another file, or to a clip of the file under `from`. The settings of the reference override
    those in the file."""

    file: Text | None = None
    clip: Text | None = None
    name: Text | None = None
    rate: ReadRate | None = None
    prim: Text | None = None


class AnimationSettings(ClipSettings):
    """Settings of a clip that glTF cannot express, stored in the extras of its animation. Unknown keys are ignored."""

    model_config = ConfigDict(extra="ignore")
    rate: SampleRate | None = None


def _choose_clip_form(value: Any) -> str:
    """Return the tag by which pydantic selects the model for an entry of `clips`: a clip with samples, or a file reference."""
    return "clip-here" if isinstance(value, dict) and "antdsl_clip" in value else "clip-elsewhere"


ClipEntry = Annotated[
    Annotated[ClipForm, Tag("clip-here")] | Annotated[ClipReference, Tag("clip-elsewhere")], Discriminator(_choose_clip_form)
]


# ---- shapes, legs, gaits, variation


class ShapeReference(Form):
    """A reference to the shapes of a file, or without `file` to an existing shape. It can change their settings and blend
    shapes."""

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
    ankle: Text | None = None


class GaitForm(Form):
    noun = "a gait"
    name: Text = Field(examples=['"walk"'])
    speed: NonNegativeNumber = Field(examples=["10"])
    stride: PositiveLength = Field(examples=["5"])
    duty: Duty = Field(examples=["0.6"])
    lift: NonNegativeNumber = Field(examples=["0.5"])
    phases: Annotated[tuple[Share, ...], FailFast()] = Field(examples=["[0, 0.5]"])


class CapsuleForm(Form):
    noun = "a capsule"
    length: PositiveLength = Field(examples=["1.2"])
    width: PositiveLength = Field(examples=["0.4"])
    height: NonNegativeNumber = Field(examples=["0.5"])
    ahead: Number = 0.0


class BodySettings(Form):
    """Settings of a body that glTF cannot express. The extras of the glTF file store them; lengths are in metres. Unknown keys
    are ignored."""

    model_config = ConfigDict(extra="ignore")
    length: Length | None = None
    legs: Annotated[tuple[LegForm, ...], UniqueNames, EntryList, limit_entries("MAX_BODY_LEGS", "legs")] = ()
    gaits: Annotated[tuple[GaitForm, ...], UniqueNames, EntryList, limit_entries("MAX_BODY_GAITS", "gaits")] = ()
    idle: Text | None = None
    capsule: CapsuleForm | None = None


class VariationForm(Form):
    noun = "variation"
    scale: dict[str, tuple[Scale, Scale]] = Field(default={}, examples=['{"head": [0.9, 1.2]}'])
    materials: dict[str, Colours] = Field(default={}, examples=['{"fur": [[0.4, 0.3, 0.2], [0.1, 0.1, 0.1]]}'])


# ---- the definition


class BaseForm(Form):
    """The entry `from`: a glTF or USD file that provides the parts of a body."""

    noun = "a file to begin from"
    file: Text = Field(examples=['"body.glb"'])
    prim: Text | None = None
    rate: ReadRate | None = None


BaseFile = Annotated[BaseForm, BeforeValidator(lambda value: {"file": value} if isinstance(value, str) else value)]


class BodyForm(Form):
    """An agent definition. The parts `rig`, `layers`, `groups` and `metadata` have the same form inline and in separate files."""

    noun = "a definition"
    antdsl_body: Annotated[int, require_version(1)] = Field(examples=["1"])
    name: Text | None = None
    base: BaseFile | None = Field(None, alias="from", examples=['"body.glb"'])
    front: Axis | None = None
    up: Axis | None = None
    units: Unit | None = None
    length: Length | None = None
    rig: RigForm | None = Field(None, examples=['{"file": "rig.json"}'])
    shapes: Annotated[tuple[ShapeReference, ...], EntryList, limit_entries("MAX_BODY_PARTS", "shapes")] = Field(
        (), examples=['[{"file": "sword.obj", "name": "sword"}]']
    )
    shapelib_includes: Annotated[tuple[PathPair, ...], EntryList] = Field((), examples=['[["$HIP/lib.glb", "/…/lib.glb"]]'])
    layers: Annotated[tuple[LayerForm, ...], EntryList, limit_entries("MAX_BODY_PARTS", "layers")] = ()
    clips: Annotated[tuple[ClipEntry, ...], EntryList, limit_entries("MAX_BODY_PARTS", "clips")] = ()
    groups: Annotated[tuple[GroupForm, ...], EntryList, limit_entries("MAX_BODY_PARTS", "transform groups")] = ()
    metadata: dict[str, Any] = {}
    materials: dict[str, RgbColour] = Field({}, examples=['{"NAME": [0.5, 0.4, 0.3]}'])
    legs: Annotated[tuple[LegForm, ...], UniqueNames, EntryList, limit_entries("MAX_BODY_LEGS", "legs")] = ()
    gaits: Annotated[tuple[GaitForm, ...], UniqueNames, EntryList, limit_entries("MAX_BODY_GAITS", "gaits")] = ()
    idle: Text | None = None
    variation: VariationForm = VariationForm()
    capsule: CapsuleForm | None = Field(None, examples=['{"length": 1.2, "width": 0.4, "height": 0.5}'])


def list_keys(form: type[Form]) -> list[str]:
    """Return the keys of a form, in the order of its fields."""
    return [field.alias or name for name, field in form.model_fields.items()]
