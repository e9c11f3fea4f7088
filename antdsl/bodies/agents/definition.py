"""An agent definition: the data that all agents of one kind share, with names in the spelling of the language.

For example, the clip `Armature|Walk` of a file is `armature_walk` in `play armature_walk`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

_NON_NAME_CHARACTERS = re.compile(r"[^a-z0-9_]+")


class BodyError(Exception):
    """Error for a problem with a body file. The message is a predicate that follows the file's name, such as `has no meshes`.

    `code`: the code of the diagnostic. `help`: how to correct the file."""

    def __init__(self, message: str, help: str | None = None, code: str = "bad-body") -> None:
        super().__init__(message)
        self.help, self.code = help, code


@dataclass(frozen=True, slots=True)
class Channel:
    """A named number that clips can animate, in addition to joints. `transform`: the joint that the channel belongs to, "" for
    none."""

    name: str
    default: float = 0.0
    transform: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """A tree of J joints with a rest pose, and channels.

    `names`: the names of the joints, parents before children.
    `parents`: int32[J], the index of each joint's parent, -1 for a root.
    `rest_matrices`: float64[J, 4, 4], local matrices."""

    names: tuple[str, ...]
    parents: NDArray[np.int32]
    rest_matrices: NDArray[np.float64]
    channels: tuple[Channel, ...] = ()

    def find_joint(self, name: str) -> int:
        """Return the index of the joint called `name`. Raises KeyError if there is none."""
        try:
            return self.names.index(name)
        except ValueError:
            raise KeyError(name) from None

    def find_channel(self, name: str) -> int:
        """Return the index of the channel called `name`. Raises KeyError if there is none."""
        for number, each in enumerate(self.channels):
            if each.name == name:
                return number
        raise KeyError(name)

    def find_descendants(self, joint: int) -> NDArray[np.intp]:
        """Return the indices of a joint and all its descendants, parents before children."""
        inside = np.zeros(len(self.names), bool)
        inside[joint] = True
        for number in range(joint + 1, len(self.names)):
            inside[number] = self.parents[number] >= 0 and inside[self.parents[number]]
        return np.flatnonzero(inside)

    @property
    def channel_defaults(self) -> NDArray[np.float32]:
        """Return the default of each channel, float32[C]."""
        return np.array([each.default for each in self.channels], np.float32)


Floats = NDArray[np.float32]
STATE_MATERIAL = "state"  # the material with the colour of the agent's state


@dataclass(frozen=True, slots=True, eq=False)
class SkinWeights:
    """The joints that each of P points follows, and how strongly.

    `names`: the names of the J joints that points follow.
    `joints`: int32[P, K], indices into `names`.
    `weights`: float32[P, K], the weights of these joints, which add up to 1 for each point.
    `inverse_matrices`: float64[J, 4, 4], the inverse bind matrices, from the shape's rest space to the space of each joint.
    """

    names: tuple[str, ...]
    joints: NDArray[np.int32]
    weights: Floats
    inverse_matrices: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class BlendTargets:
    """The inputs of a blend shape: target shapes, and the channels that weight them.

    `shapes`: the library shape that each input blends towards.
    `channels`: the channel that weights each input.
    `attributes`: the point attributes that are blended.
    `point_id`: the point attribute by which points are matched; `primitive_id`: the same for primitives."""

    shapes: tuple[str, ...]
    channels: tuple[str, ...]
    attributes: tuple[str, ...] = ("P", "N")
    point_id: str = "id"
    primitive_id: str = "id"


@dataclass(frozen=True, slots=True)
class InBetweens:
    """The corrective shapes of a blend-shape input. Each shape applies in full at its entry of `weights`, which is never 0 or
    1."""

    shapes: tuple[str, ...]
    weights: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class SkinShape:
    """A mesh of P points and M triangles.

    `normals`: float32[P, 3] or None; `uvs`: float32[P, 2] or None.
    `materials`: the names of materials. `material`: int32[M], the index into `materials` for each triangle.
    `attributes`: other point attributes by name, such as `id`, and the attribute that `dual_quaternion_blend` names.
    """

    name: str
    points: Floats
    faces: NDArray[np.int32]
    normals: Floats | None = None
    uvs: Floats | None = None
    materials: tuple[str, ...] = ()
    material: NDArray[np.int32] | None = None
    attributes: dict[str, NDArray[np.float32] | NDArray[np.int64]] = field(default_factory=dict)
    capture: SkinWeights | None = None
    blend: BlendTargets | None = None
    in_betweens: InBetweens | None = None
    dual_quaternion_blend: str = ""


@dataclass(frozen=True, slots=True)
class Binding:
    """The binding of a shape to a joint. `transform`: the joint, "" for a deforming shape that follows several joints.
    `deformer`: the name of its deformers, "" for a static shape."""

    transform: str
    shape: str
    bounds_scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    deformer: str = ""


@dataclass(frozen=True, slots=True)
class Layer:
    """A named set of shapes that are drawn together."""

    name: str
    static: tuple[Binding, ...] = ()
    deforming: tuple[Binding, ...] = ()


@dataclass(frozen=True, slots=True)
class TransformGroup:
    """A named part of a rig.

    `members`: joints with their weights from 0 to 1.
    `channels`: names of channels."""

    name: str
    members: tuple[tuple[str, float], ...] = ()
    channels: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Clip:
    """An animation clip: F samples of the local transforms of K joints and the values of C channels, `rate` samples per second.

    `translation`: float32[F, K, 3], in the definition's units.
    `rotation`: float32[F, K, 4], unit quaternions x y z w.
    `scale`: float32[F, K, 3]; `shear`: float32[F, K, 3] or None. `transforms.py` defines the order of the parts.
    `values`: float32[F, C], the values of the channels.
    `loop`: whether the clip loops. The last sample of a looping clip repeats its first pose.
    `stride`: the distance covered in one loop, in the definition's units; 0 for a clip in place.
    `marks`: named times in the clip, in seconds.
    `feet`: whether feet are placed on the ground while the clip plays; otherwise legs move as in the clip."""

    name: str
    rate: float
    joints: tuple[str, ...]
    translation: NDArray[np.float32]
    rotation: NDArray[np.float32]
    scale: NDArray[np.float32]
    shear: NDArray[np.float32] | None = None
    channels: tuple[str, ...] = ()
    values: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 0), np.float32))
    loop: bool = True
    stride: float = 0.0
    marks: Mapping[str, float] = field(default_factory=dict)
    feet: bool = True

    @property
    def sample_count(self) -> int:
        """Return the number of samples."""
        return max(len(self.translation), len(self.values))

    @property
    def duration(self) -> float:
        """Return the seconds from the first sample to the last."""
        return (self.sample_count - 1) / self.rate


@dataclass(frozen=True, slots=True)
class Leg:
    """A leg with two bones and a knee, which bends so that the foot stands on the ground.

    `upper`: the joint of the hip, the start of the thigh (femur).
    `lower`: the joint of the knee, the start of the shank (tibia); a descendant of `upper`.
    `foot`: the joint of the part that touches the ground; a descendant of `lower`.
    `ankle`: the joint about which the sole turns until it lies flat on the ground. It is `foot`, or a joint between `lower` and
    `foot`. If empty, the foot has its rotation from the clip.

    There may be other joints between these."""

    name: str
    upper: str
    lower: str
    foot: str
    ankle: str = ""

    def to_entry(self) -> dict[str, str]:
        """Return the leg as an entry of a definition file. An empty ankle is omitted."""
        ankle = {"ankle": self.ankle} if self.ankle else {}
        return {"name": self.name, "upper": self.upper, "lower": self.lower} | ankle | {"foot": self.foot}


@dataclass(frozen=True, slots=True)
class Gait:
    """The stepping pattern of the feet at one speed.

    `speed`: the speed of the body, in length units of the definition per second.
    `stride`: the distance that the body covers in one cycle.
    `duty`: the fraction of the cycle in which each foot is on the ground.
    `lift`: height of a swinging foot, in length units.
    `phases`: for each leg in order, how far it is ahead in the cycle, as a fraction of the cycle.

    At speeds between two gaits of a definition, stride, duty and lift are interpolated linearly, and phases are those of the
    slower gait. Below the slowest gait, that gait applies. Above the fastest gait, that gait applies with a stride that grows
    with the speed, so that the number of cycles per second stays constant.
    """

    name: str
    speed: float
    stride: float
    duty: float
    lift: float
    phases: tuple[float, ...]


RgbColour = tuple[float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Variation:
    """Random differences between the bodies of agents.

    `scales`: for each transform group, its smallest and largest scale.
    `materials`: for each material, a list of linear colours (0 to 1). Each agent's colour is between two neighbours in this
    list.
    """

    scales: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    materials: Mapping[str, tuple[RgbColour, ...]] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return bool(self.scales or self.materials)


NO_VARIATION = Variation()


DEFAULT_FRONT = (1.0, 0.0, 0.0)
DEFAULT_UP = (0.0, 1.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Definition:
    """An agent definition: everything that all agents of one kind share.

    `front` and `up`: the forward and upward axes of the definition's space.
    `length`: the extent of the body along `front`, in the definition's units. In a scene, the body is scaled so that this
    becomes the agent's `size`.
    `unit`: millimetres per unit of length.
    `materials`: base colours (linear, 0 to 1) by name.
    `gaits`: the gaits, from slow to fast.
    `idle`: the clip of agents that play no other clip; "" means the rest pose.
    `variation`: differences between bodies.
    `capsule`: the collision shape, in the definition's units: length and width of the trunk, height of its centre above the
    feet, and distance of its centre ahead of the origin. If None, it is measured from the shapes.
    """

    name: str
    rig: Rig
    shapes: Mapping[str, SkinShape] = field(default_factory=dict)
    layers: Mapping[str, Layer] = field(default_factory=dict)
    clips: Mapping[str, Clip] = field(default_factory=dict)
    groups: Mapping[str, TransformGroup] = field(default_factory=dict)
    metadata: Mapping[str, Any] = field(default_factory=dict)
    materials: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    front: tuple[float, float, float] = DEFAULT_FRONT
    up: tuple[float, float, float] = DEFAULT_UP
    length: float = 1.0
    unit: float = 1.0
    legs: tuple[Leg, ...] = ()
    gaits: tuple[Gait, ...] = ()
    idle: str = ""
    variation: Variation = NO_VARIATION
    capsule: tuple[float, float, float, float] | None = None

    def compute_base_matrix(self) -> NDArray[np.float64]:
        """Return the matrix float64[4, 4] from the definition's space to agent space: length 1, front +x, up +y."""
        ahead, up = np.array(self.front, np.float64), np.array(self.up, np.float64)
        matrix = np.eye(4)
        matrix[0, :3], matrix[1, :3], matrix[2, :3] = ahead, up, np.cross(ahead, up)
        matrix[:3] /= self.length
        return matrix


def to_language_name(text: str) -> str:
    """Convert a name to the spelling of the language: lower-case letters, digits and `_`, beginning with a letter.

    Each run of other characters becomes one `_`."""
    name = _NON_NAME_CHARACTERS.sub("_", text.lower()).strip("_")
    return name if name[:1].isalpha() else f"n{name}"


def map_language_names(names: Iterable[str]) -> dict[str, str]:
    """Return, for each of `names`, its unique name in the spelling of the language. Names that are already valid do not change.

    If converted names collide, the later ones get the suffix `_2`, `_3` and so on."""
    names = list(names)
    translations = {name: name for name in names if to_language_name(name) == name}
    taken = set(translations)
    for name in names:
        if name not in translations:
            first = candidate = to_language_name(name)
            count = 2
            while candidate in taken:
                candidate, count = f"{first}_{count}", count + 1
            translations[name] = candidate
            taken.add(candidate)
    return {name: translations[name] for name in names}


def use_language_names(body: Definition) -> Definition:
    """Return the definition with clips (also the idle clip), marks, layers and groups renamed to the spelling of the language.

    Channel names do not change, because clips and shapes refer to them."""
    clips, groups, layers = (map_language_names(each) for each in (body.clips, body.groups, body.layers))
    marked = {name: map_language_names(clip.marks) for name, clip in body.clips.items()}
    if all(name == own for each in (clips, groups, layers, *marked.values()) for name, own in each.items()):
        return body
    return replace(
        body,
        clips={
            clips[name]: replace(clip, name=clips[name], marks={marked[name][mark]: at for mark, at in clip.marks.items()})
            for name, clip in body.clips.items()
        },
        variation=Variation({groups.get(n, n): ends for n, ends in body.variation.scales.items()}, body.variation.materials),
        idle=clips.get(body.idle, body.idle),
        layers={layers[name]: replace(layer, name=layers[name]) for name, layer in body.layers.items()},
        groups={groups[name]: replace(group, name=groups[name]) for name, group in body.groups.items()},
    )
