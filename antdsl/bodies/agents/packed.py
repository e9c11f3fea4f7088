"""Converts an agent definition to a few plain arrays, the form that caches store, and back.

The array `text` (uint8) is a JSON document with all names, counts and bindings. In it, an array of the definition is
`[kind, first, shape]`: the elements from index `first` of the array `kind`, which is `f4`, `f8`, `i4` or `i8`. Metadata is
omitted, because drawing does not need it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from functools import lru_cache
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.bodies.agents.definition import (
    Binding,
    BlendTargets,
    BodyError,
    Channel,
    Clip,
    Definition,
    Gait,
    InBetweens,
    Layer,
    Leg,
    Rig,
    SkinShape,
    SkinWeights,
    TransformGroup,
    Variation,
)

NUMBER_KINDS = ("f4", "f8", "i4", "i8")
ARRAY_NAMES = ("text", *NUMBER_KINDS)
Arrays = dict[str, NDArray[Any]]


def pack_definition(body: Definition) -> Arrays:
    """Return a definition as arrays, by the names in `ARRAY_NAMES`. Equal definitions give equal bytes."""
    flat: dict[str, list[NDArray[Any]]] = {kind: [] for kind in NUMBER_KINDS}
    used = dict.fromkeys(NUMBER_KINDS, 0)

    def pack(array: NDArray[Any] | None) -> list[Any] | None:
        if array is None:
            return None
        kind = f"{array.dtype.kind}{array.dtype.itemsize}"
        flat[kind].append(np.ascontiguousarray(array).reshape(-1))
        first, used[kind] = used[kind], used[kind] + array.size
        return [kind, first, list(array.shape)]

    def shape(shape: SkinShape) -> dict[str, Any]:
        capture, blend, between = shape.capture, shape.blend, shape.in_betweens
        return {
            "name": shape.name, "points": pack(shape.points), "faces": pack(shape.faces), "normals": pack(shape.normals),
            "uvs": pack(shape.uvs), "materials": shape.materials, "material": pack(shape.material),
            "attributes": {name: pack(values) for name, values in shape.attributes.items()},
            "capture": capture and [capture.names, pack(capture.joints), pack(capture.weights), pack(capture.inverse_matrices)],
            "blend": blend and [blend.shapes, blend.channels, blend.attributes, blend.point_id, blend.primitive_id],
            "between": between and [between.shapes, between.weights],
            "dual_quaternion_blend": shape.dual_quaternion_blend,
        }  # fmt: skip

    def clip(clip: Clip) -> dict[str, Any]:
        arrays = (clip.translation, clip.rotation, clip.scale, clip.shear, clip.values)
        return {
            "name": clip.name, "rate": clip.rate, "joints": clip.joints, "channels": clip.channels, "loop": clip.loop,
            "stride": clip.stride, "marks": dict(clip.marks), "feet": clip.feet,
            "arrays": [pack(array) for array in arrays],
        }  # fmt: skip

    def binding(binding: Binding) -> list[Any]:
        return [binding.transform, binding.shape, binding.bounds_scale, binding.deformer]

    rig = body.rig
    document = {
        "body": 1, "name": body.name, "front": body.front, "up": body.up, "length": body.length, "unit": body.unit,
        "materials": dict(body.materials),
        "rig": [rig.names, pack(rig.parents), pack(rig.rest_matrices), [[c.name, c.default, c.transform] for c in rig.channels]],
        "shapes": [shape(each) for each in body.shapes.values()],
        "layers": [[each.name, [[binding(b) for b in part] for part in (each.static, each.deforming)]]
                   for each in body.layers.values()],
        "clips": [clip(each) for each in body.clips.values()],
        "groups": [[each.name, each.members, each.channels] for each in body.groups.values()],
        "legs": [[each.name, each.upper, each.lower, each.foot, each.ankle] for each in body.legs], "idle": body.idle,
        "gaits": [[each.name, each.speed, each.stride, each.duty, each.lift, each.phases] for each in body.gaits],
    }  # fmt: skip
    if body.variation:
        document["variation"] = [dict(body.variation.scales), dict(body.variation.materials)]
    if body.capsule is not None:
        document["capsule"] = list(body.capsule)
    text = json.dumps(document, ensure_ascii=True, separators=(",", ":"), allow_nan=False)
    packed_arrays: Arrays = {"text": np.frombuffer(text.encode("ascii"), np.uint8)}
    return packed_arrays | {kind: np.concatenate([np.zeros(0, kind), *flat[kind]]) for kind in NUMBER_KINDS}


@lru_cache(maxsize=16)
def hash_definition(body: Definition) -> str:
    """Return a hash of everything that `pack_definition` stores. It is cached, so the definition must not change afterwards."""
    hasher = hashlib.blake2b(digest_size=16)
    for name, array in pack_definition(body).items():
        hasher.update(f"{name} {array.size} ".encode())
        hasher.update(array.astype(array.dtype.newbyteorder("<"), copy=False).tobytes())
    return hasher.hexdigest()


def unpack_definition(arrays: Mapping[str, NDArray[Any]]) -> Definition:
    """Return the definition that was stored in `arrays` by `pack_definition`.

    The arrays are not trusted: every range, type, shape and index is checked. Raises BodyError if they are damaged. Names by
    which parts refer to each other are checked separately, by `body_arrays.unpack_checked_definition`."""
    try:
        definition = _read_definition(arrays)
        _check_bounds(definition)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError, RecursionError):
        raise BodyError("is damaged: the data of a body in it is inconsistent") from None
    return definition


def _read_definition(arrays: Mapping[str, NDArray[Any]]) -> Definition:
    """Return the definition that was stored in `arrays`. Damaged arrays raise errors of many types."""
    text = arrays["text"]
    if text.dtype != np.uint8 or text.ndim != 1 or text.size > limits.MAX_BODY_JSON_BYTES:
        raise ValueError
    said = json.loads(text.tobytes())
    if said["body"] != 1:
        raise ValueError

    def read_array(place: Any, *expected_sides: int | None, kind: str = "f4") -> NDArray[Any]:
        """Return the array that `place` (`[kind, first, shape]`) refers to. `expected_sides`: its length along each axis; None
        allows any length."""
        own, first, shape = place
        sides = tuple(_read_integer(side) for side in shape)
        if (
            own != kind
            or len(sides) != len(expected_sides)
            or any(w is not None and w != s for s, w in zip(sides, expected_sides, strict=True))
        ):
            raise ValueError
        from_, array = _read_integer(first), arrays[kind]
        if array.dtype != np.dtype(kind) or array.ndim != 1 or from_ + prod(sides) > array.size:
            raise ValueError
        return array[from_ : from_ + prod(sides)].reshape(sides)

    def shape(entry: Any) -> SkinShape:
        points = read_array(entry["points"], None, 3)
        faces = read_array(entry["faces"], None, 3, kind="i4")
        attributes = {}
        for name, place in entry["attributes"].items():
            sides: tuple[int | None, ...] = (len(points), *(None for _ in place[2][1:]))
            attributes[_read_text(name)] = read_array(place, *sides, kind="i8" if place[0] == "i8" else "f4")
        return SkinShape(
            _read_text(entry["name"]), points, faces,
            None if entry["normals"] is None else read_array(entry["normals"], len(points), 3),
            None if entry["uvs"] is None else read_array(entry["uvs"], len(points), 2),
            _read_texts(entry["materials"]),
            None if entry["material"] is None else read_array(entry["material"], len(faces), kind="i4"),
            attributes, read_capture(entry["capture"], len(points)),
            None if entry["blend"] is None else read_blend_targets(*entry["blend"]),
            None
            if entry["between"] is None
            else InBetweens(_read_texts(entry["between"][0]), _read_numbers(entry["between"][1])),
            _read_text(entry["dual_quaternion_blend"]),
        )  # fmt: skip

    def read_blend_targets(shapes: Any, channels: Any, attributes: Any, point_id: Any, primitive_id: Any) -> BlendTargets:
        return BlendTargets(
            _read_texts(shapes), _read_texts(channels), _read_texts(attributes), _read_text(point_id), _read_text(primitive_id)
        )

    def read_capture(entry: Any, points: int) -> SkinWeights | None:
        if entry is None:
            return None
        names = _read_texts(entry[0])
        joints = read_array(entry[1], points, None, kind="i4")
        inverse = read_array(entry[3], len(names), 4, 4, kind="f8")
        return SkinWeights(names, joints, read_array(entry[2], points, joints.shape[1]), inverse)

    def clip(entry: Any) -> Clip:
        joints, channels = _read_texts(entry["joints"]), _read_texts(entry["channels"])
        array_places = entry["arrays"]
        count = _read_integer(array_places[0][2][0])
        moved = [None if place is None else read_array(place, count, len(joints), wide)
                 for place, wide in zip(array_places[:4], (3, 4, 3, 3), strict=True)]  # fmt: skip
        if moved[0] is None or moved[1] is None or moved[2] is None:
            raise ValueError
        rate, stride = _read_number(entry["rate"]), _read_number(entry["stride"])
        marks = {_read_text(name): _read_number(mark_time) for name, mark_time in entry["marks"].items()}
        return Clip(
            _read_text(entry["name"]), rate, joints, moved[0], moved[1], moved[2], moved[3], channels,
            read_array(array_places[4], None, None), bool(entry["loop"]), stride, marks, bool(entry["feet"]),
        )  # fmt: skip

    def read_layer(entry: Any) -> Layer:
        bindings = [
            tuple(Binding(_read_text(b[0]), _read_text(b[1]), _read_three_numbers(b[2]), _read_text(b[3])) for b in part)
            for part in entry[1]
        ]
        return Layer(_read_text(entry[0]), *bindings)

    names, parents, rest, channels = said["rig"]
    rig = Rig(
        _read_texts(names), read_array(parents, len(names), kind="i4"), read_array(rest, len(names), 4, 4, kind="f8"),
        tuple(Channel(_read_text(name), _read_number(default), _read_text(joint)) for name, default, joint in channels),
    )  # fmt: skip
    groups = [
        TransformGroup(
            _read_text(name), tuple((_read_text(joint), _read_number(weight)) for joint, weight in members), _read_texts(moved)
        )
        for name, members, moved in said["groups"]
    ]
    return Definition(
        _read_text(said["name"]), rig,
        {each.name: each for each in map(shape, said["shapes"])}, {each.name: each for each in map(read_layer, said["layers"])},
        {each.name: each for each in map(clip, said["clips"])}, {each.name: each for each in groups}, {},
        {_read_text(name): _read_three_numbers(colour) for name, colour in said["materials"].items()},
        _read_three_numbers(said["front"]), _read_three_numbers(said["up"]), _read_number(said["length"]),
        _read_number(said["unit"]),
        tuple(Leg(*map(_read_text, each)) for each in said["legs"]), tuple(_read_gait(*each) for each in said["gaits"]),
        _read_text(said["idle"]), _read_variation(*said.get("variation", ({}, {}))), _read_capsule(said.get("capsule")),
    )  # fmt: skip


def _read_capsule(sizes: Any) -> tuple[float, float, float, float] | None:
    """Return the collision shape from its four numbers. For None, which stands for a body without one, return None."""
    if sizes is None:
        return None
    length, width, height, ahead = (float(each) for each in sizes)
    if not all(abs(each) <= limits.MAX_NUMBER for each in (length, width, height, ahead)) or min(length, width) <= 0:
        raise BodyError("has a capsule with no length or no width")
    return length, width, height, ahead


def _read_variation(scales: Any, materials: Any) -> Variation:
    """Return the variation with these group scales and material colours. Damaged values raise errors of many types."""
    ranges = {_read_text(name): _read_numbers(ends) for name, ends in scales.items()}
    colours = {_read_text(name): tuple(map(_read_three_numbers, choices)) for name, choices in materials.items()}
    if any(len(ends) != 2 or not 0 < ends[0] <= ends[1] for ends in ranges.values()) or any(len(c) < 2 for c in colours.values()):
        raise ValueError
    return Variation({name: (ends[0], ends[1]) for name, ends in ranges.items()}, colours)


def _read_gait(name: Any, speed: Any, stride: Any, duty: Any, lift: Any, phases: Any) -> Gait:
    """Return the gait from its values. Raises ValueError for values of other types."""
    return Gait(
        _read_text(name), _read_number(speed), _read_number(stride), _read_number(duty), _read_number(lift), _read_numbers(phases)
    )


def _check_bounds(body: Definition) -> None:
    """Check that the numbers of a definition are finite and in their ranges. Raises ValueError if they are not."""
    rig, count = body.rig, len(body.rig.names)
    fits = [
        0 < count <= limits.MAX_RIG_JOINTS,
        len(rig.channels) <= limits.MAX_RIG_CHANNELS,
        bool((rig.parents >= -1).all() and (rig.parents < np.arange(count)).all() and np.isfinite(rig.rest_matrices).all()),
        body.length > 0,
        len(body.legs) <= limits.MAX_BODY_LEGS and len({leg.name for leg in body.legs}) == len(body.legs),
        len(body.gaits) <= limits.MAX_BODY_GAITS and all(_is_valid_gait(gait) for gait in body.gaits),
    ]
    for shape in body.shapes.values():
        fits += [_is_within(shape.faces, len(shape.points)), bool(np.isfinite(shape.points).all())]
        fits += [shape.material is None or _is_within(shape.material, len(shape.materials))]
        if shape.capture is not None:
            fits += [
                _is_within(shape.capture.joints, len(shape.capture.names)),
                shape.capture.joints.shape[1] <= limits.MAX_JOINTS_PER_POINT,
            ]
            fits += [bool(np.isfinite(shape.capture.weights).all() and np.isfinite(shape.capture.inverse_matrices).all())]
    for clip in body.clips.values():
        arrays = [each for each in (clip.translation, clip.rotation, clip.scale, clip.shear, clip.values) if each is not None]
        fits += [clip.rate > 0, 0 < clip.sample_count <= limits.MAX_CLIP_SAMPLES, all(np.isfinite(each).all() for each in arrays)]
        fits += [clip.values.shape[1] == len(clip.channels) or not clip.channels]
        fits += [
            not clip.channels or len(clip.values) == clip.sample_count,
            not clip.joints or len(clip.translation) == clip.sample_count,
        ]
    if not all(fits):
        raise ValueError


def _is_valid_gait(gait: Gait) -> bool:
    """Return whether the numbers of a gait are finite and in their ranges."""
    low, high = limits.DUTY_FACTOR_RANGE
    return gait.speed >= 0 and gait.stride >= limits.MIN_STRIDE and low <= gait.duty <= high and gait.lift >= 0


def _is_within(numbers: NDArray[Any], count: int) -> bool:
    """Return whether all numbers are valid indices: at least 0 and below `count`."""
    return bool(((numbers >= 0) & (numbers < count)).all())


def _read_integer(value: Any) -> int:
    """Return an integer from 0 to below 2**48. Raises ValueError for any other value."""
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 1 << 48:
        raise ValueError
    return value


def _read_number(value: Any) -> float:
    """Return a finite number as float. Raises ValueError for any other value."""
    if not isinstance(value, int | float) or isinstance(value, bool) or not np.isfinite(value):
        raise ValueError
    return float(value)


def _read_numbers(values: Any) -> tuple[float, ...]:
    """Return a list of finite numbers as a tuple. Raises ValueError for any other value."""
    return tuple(_read_number(each) for each in values)


def _read_three_numbers(values: Any) -> tuple[float, float, float]:
    """Return a list of three numbers as a tuple. Raises ValueError for any other value."""
    x, y, z = _read_numbers(values)
    return x, y, z


def _read_text(value: Any) -> str:
    """Return a text. Raises ValueError for any other value."""
    if not isinstance(value, str):
        raise ValueError
    return value


def _read_texts(values: Any) -> tuple[str, ...]:
    """Return a list of texts as a tuple. Raises ValueError for any other value."""
    if not isinstance(values, list):
        raise ValueError
    return tuple(_read_text(each) for each in values)
