"""A definition file: our own JSON that names the parts of an agent definition. Each part is inline in its documented form, or
`{"file": "rig.json"}`, a path below the file's folder or a granted root."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np

from antdsl import limits
from antdsl.bodies.agents.definition import Clip, Definition, Rig
from antdsl.bodies.files import definition_parts
from antdsl.bodies.files.checked_values import Values
from antdsl.bodies.files.clip_document import read_clip, read_marks
from antdsl.bodies.files.definition_parts import Places, VariationPlaces, read_gaits, read_legs, read_metadata
from antdsl.bodies.files.documents import read_group, read_layer, read_rig
from antdsl.bodies.files.json_text import Node
from antdsl.bodies.files.named_files import GLTF, USD, BodyFiles, file_ending
from antdsl.bodies.files.shape_references import read_includes, read_shapes
from antdsl.scene.model import UNIT_MM
from antdsl.source import Span

KNOWN = (
    "antdsl_body", "name", "from", "front", "up", "units", "length", "rig", "shapes", "shapelib_includes", "layers", "clips",
    "groups", "metadata", "materials", "legs", "gaits", "idle", "variation",
)  # fmt: skip
_UNIT = re.compile(rf"(?:(\d{{1,6}}(?:\.\d{{1,9}})?) )?({'|'.join(UNIT_MM)})")
_AXES = {sign + letter: np.eye(3)[axis] * (1 if sign == "+" else -1) for axis, letter in enumerate("xyz") for sign in "+-"}
_OF_CLIP = ("file", "clip", "name", "loop", "stride", "marks", "feet", "rate", "prim")
T = TypeVar("T")
Axis = tuple[float, float, float]


@dataclass(slots=True)
class Place:
    """The text of one part: the values that read it and the node it was read from."""

    values: Values
    node: Node

    def of(self, *texts: str) -> Span:
        """Return the span of the first of some texts that is in the part; the part's own place if none is."""
        waiting = [self.node]
        while waiting:
            node = waiting.pop(0)
            if isinstance(node.value, str) and node.value in texts:
                return self.values.span(node)
            if isinstance(node.value, dict):
                waiting += node.value.values()
            elif isinstance(node.value, list) and not node.numbers:
                waiting += [each for each in node.value if isinstance(each, Node)]
        return self.values.start_span(self.node)


@dataclass(slots=True)
class Parts:
    """A definition that was read, and the places of its parts; `measured`: whether its length must still be measured."""

    definition: Definition
    layers: dict[str, Place] = field(default_factory=dict)
    groups: dict[str, Place] = field(default_factory=dict)
    walking: Places = field(default_factory=Places)
    varied: VariationPlaces = field(default_factory=dict)
    span: Span | None = None
    measured: bool = True


def read_document(values: Values, node: Node, files: BodyFiles, name: str) -> Parts | None:
    """Read the definition in a file, without the checks that need the complete definition."""
    if _report_part_file(values, node):
        return None
    entries = values.object(node, "a definition", KNOWN, {"antdsl_body": "1"})
    if entries is None or not values.version(entries, "antdsl_body", 1):
        return None
    base = _read_base(values, entries, files, name)
    rig = _read_one(values, entries.get("rig"), "a rig", read_rig, files)[0] if "rig" in entries else base.rig if base else None
    if rig is None:
        if "rig" not in entries and "from" not in entries:
            words = "a definition needs joints: a `rig`, or a file for the whole body under `from`"
            values.report.error("missing-key", words, values.start_span(node), 'add `"rig": {"file": "rig.json"}`')
        return None
    base = base or Definition(name, rig)
    base = replace(base, rig=rig, name=values.text(entries.get("name"), "the name of the body") or base.name)
    unit = _read_unit(values, entries.get("units"), base.unit)
    base = replace(base, unit=unit)
    front, up = _read_axes(values, entries, base)
    base = replace(base, front=front, up=up)
    shapes, materials = dict(base.shapes), dict(base.materials)
    if "materials" in entries:
        materials |= _read_materials(values, entries["materials"])
    if "shapelib_includes" in entries:
        read_includes(values, entries["shapelib_includes"], files, shapes, materials)
    if "shapes" in entries:
        read_shapes(values, entries["shapes"], files, unit, shapes, materials)
    parts = Parts(base, span=values.start_span(node))
    layers = _read_all(values, entries.get("layers"), "a layer", read_layer, files, lambda each: each.name, parts.layers)
    groups = _read_all(
        values, entries.get("groups"), "a transform group", read_group, files, lambda each: each.name, parts.groups
    )
    clips = _read_clips(values, entries.get("clips"), files, rig, dict(base.clips))
    metadata = dict(base.metadata)
    if "metadata" in entries:
        metadata |= _read_one(values, entries["metadata"], "metadata", read_metadata, files)[0] or {}
    length = values.number(entries.get("length"), "a length", 1e-9)
    parts.measured = length is None
    if "variation" in entries:
        base = replace(base, variation=definition_parts.read_variation(values, entries["variation"], parts.varied))
    parts.definition = replace(
        base, shapes=shapes, materials=materials, layers={**base.layers, **layers}, groups={**base.groups, **groups},
        clips=clips, metadata=metadata, length=length or base.length, **_read_walking(values, entries, parts.walking),
    )  # fmt: skip
    return parts


def _read_walking(values: Values, entries: Mapping[str, Node], locations: Places) -> dict[str, Any]:
    """The legs, gaits and idle clip that a file names."""
    settings: dict[str, Any] = {}
    for key, read in (("legs", read_legs), ("gaits", read_gaits)):
        if key in entries:
            settings[key] = read(values, entries[key], locations)
    if "idle" in entries:
        settings["idle"] = values.text(entries["idle"], "the name of a clip") or ""
        locations.spans["idle",] = values.span(entries["idle"])
    return settings


# Keys that identify a part in a separate file, with the kind of part and how a definition names it.
_SIGNS = (
    ("rig_version", "a rig", '"rig": {"file": "…"}'),
    ("antdsl_clip", "a clip", '"clips": [{"file": "…"}]'),
    ("static", "a layer", '"layers": [{"file": "…"}]'),
    ("deforming", "a layer", '"layers": [{"file": "…"}]'),
    ("members", "a transform group", '"groups": [{"file": "…"}]'),
    ("asset", "glTF", '"from": "body.gltf"'),
)


def _report_part_file(values: Values, node: Node) -> bool:
    """Return whether a file is only a part of a definition, and report it if so."""
    if not isinstance(node.value, dict) or "antdsl_body" in node.value:
        return False
    for key, what, line in _SIGNS:
        if key in node.value:
            words = f"this is {what}, not a definition; a definition names it as one of its parts"
            values.report.error("wrong-kind", words, values.key_span(node, key), f'write a file `{{"antdsl_body": 1, {line}}}`')
            return True
    return False


def _read_base(values: Values, entries: Mapping[str, Node], files: BodyFiles, name: str) -> Definition | None:
    """Return the definition of the glTF or USD file that everything else is added to."""
    node = entries.get("from")
    if node is None:
        return None
    inner: Mapping[str, Node] | None = {"file": node}
    if isinstance(node.value, dict):
        inner = values.object(node, "a file to begin from", ("file", "prim", "rate"), {"file": '"body.glb"'})
    path = values.text((inner or {}).get("file"), "the path of a glTF or USD file")
    if inner is None or path is None:
        return None
    place = values.span(inner["file"])
    if files.is_closed_format(path, place):
        return None
    if file_ending(path) not in (*GLTF, *USD):
        kinds = ", ".join(f".{kind}" for kind in (*GLTF, *USD))
        files.report.error("wrong-kind", f"`{path[-80:]}` has no joints", place, f"one of {kinds} is read here")
        return None
    prim = values.text(inner.get("prim"), "the path of a prim") or ""
    rate = values.number(inner.get("rate"), "samples a second", 1.0, 1000.0) or 0.0
    definition = files.body(path, place, prim, rate)
    return None if definition is None else replace(definition, name=name)


def _part_path(values: Values, node: Node) -> tuple[str, Span] | None:
    """Return the path of a part in a separate file (an object with `file` and nothing else), with its span; None for other
    values."""
    if not isinstance(node.value, dict) or set(node.value) != {"file"}:
        return None
    path = values.text(node.value["file"], "the path of a file")
    return None if path is None else (path, values.span(node.value["file"]))


def _read_one(
    values: Values, node: Node | None, what: str, read: Callable[[Values, Node], T], files: BodyFiles
) -> tuple[T | None, Place | None]:
    """Read a part, inside the file or from a separate one. Return it with its place."""
    if node is None:
        return None, None
    named = _part_path(values, node)
    if named is None:
        return read(values, node), Place(values, node)
    top_nodes: list[Node] = []

    def noted(inside: Values, top: Node) -> T:
        top_nodes.append(top)
        return read(inside, top)

    part, inside = files.read_part_file(named[0], what, noted, named[1])
    return part, Place(inside, top_nodes[0]) if inside is not None and top_nodes else None


def _read_all(
    values: Values, node: Node | None, what: str, read: Callable[[Values, Node], T | None], files: BodyFiles,
    name: Callable[[T], str], locations: dict[str, Place],
) -> dict[str, T]:  # fmt: skip
    """Return the parts of a list by name. Each may be in a separate file."""
    parts: dict[str, T] = {}
    for each in _limited_items(values, node, f"{what.partition(' ')[2]}s"):
        part, place = _read_one(values, each, what, read, files)
        if part is None or place is None:
            continue
        own = name(part)
        if own in parts:
            values.report_repeated(
                each, f"there are two {what.partition(' ')[2]}s `{own}`", locations[own].values.start_span(locations[own].node)
            )
            continue
        parts[own], locations[own] = part, place
    return parts


def _limited_items(values: Values, node: Node | None, what: str) -> list[Node]:
    items = [] if node is None else values.items(node, what)
    if node is not None and len(items) > limits.BODY_PARTS:
        values.report.error("too-large", f"there are more than {limits.BODY_PARTS:,} {what}", values.start_span(node), None)
        return []
    return items


# ---- clips


def _read_clips(values: Values, node: Node | None, files: BodyFiles, rig: Rig, clips: dict[str, Clip]) -> dict[str, Clip]:
    """Return the clips of a list: inline, from clip files, from glTF or USD files, or those of `from` with other settings."""
    first: dict[str, Span] = {}
    for each in _limited_items(values, node, "clips"):
        if isinstance(each.value, dict) and "antdsl_clip" not in each.value:
            entries = values.object(each, "a clip", _OF_CLIP)
            new = _read_referenced_clips(values, each, entries, files, rig, clips) if entries is not None else []
        else:
            clip = read_clip(values, each, rig)
            new = [clip] if clip is not None else []
        for clip in new:
            if clip.name in first or (clip.name in clips and _has_own_samples(each)):
                labelled = first.get(clip.name, values.start_span(node)) if node is not None else values.start_span(each)
                values.report_repeated(each, f"there are two clips `{clip.name}`", labelled)
                continue
            clips[clip.name], first[clip.name] = clip, values.start_span(each)
    return clips


def _has_own_samples(node: Node) -> bool:
    return isinstance(node.value, dict) and ("file" in node.value or "antdsl_clip" in node.value)


def _read_referenced_clips(
    values: Values, node: Node, entries: Mapping[str, Node], files: BodyFiles, rig: Rig, own: dict[str, Clip]
) -> list[Clip]:
    clip_name = values.text(entries.get("clip"), "the name of a clip")
    place = values.start_span(node)
    if "file" in entries:
        path = values.text(entries["file"], "the path of a file")
        if path is None:
            return []
        place = values.span(entries["file"])
        clips = _read_clip_file(values, entries, path, place, files, rig)
    elif clip_name is None:
        values.report.error("missing-key", "a clip has no `file`", place, 'add `"file": "walk.json"`, or `"clip": "Walk"`')
        return []
    else:
        clips = own
    if clip_name is not None:
        if clip_name not in clips:
            values.report_unknown(values.span(entries["clip"]), "clip", clip_name, clips)
            return []
        clips = {clip_name: clips[clip_name]}
    if "file" not in entries and clip_name is not None:
        own.pop(clip_name)
    name = values.text(entries.get("name"), "the name of a clip")
    if name is not None and len(clips) > 1:
        words = f"`name` is given, but the file has {len(clips)} clips"
        values.report.error("wrong-value", words, values.span(entries["name"]), f'add `"clip": "{next(iter(clips))}"`')
        return []
    new_clips = []
    for clip in clips.values():
        stride = values.number(entries.get("stride"), "a stride", 0.0)
        new_clips.append(
            replace(
                clip,
                name=name or clip.name,
                loop=values.boolean(entries.get("loop"), "whether the clip loops", clip.loop),
                stride=clip.stride if stride is None else stride,
                marks=read_marks(values, entries["marks"], clip.duration) if "marks" in entries else clip.marks,
                feet=values.boolean(entries.get("feet"), "whether feet stand while it plays", clip.feet),
            )
        )
    return new_clips


def _read_clip_file(
    values: Values, entries: Mapping[str, Node], path: str, place: Span, files: BodyFiles, rig: Rig
) -> dict[str, Clip]:
    """Return the clips of a file: one from a text, all of a glTF or USD file, without joints that the rig lacks."""
    if file_ending(path) not in (*GLTF, *USD):
        if file_ending(path) != "json" and not files.is_closed_format(path, place):
            kinds = ", ".join(f".{kind}" for kind in ("json", *GLTF, *USD))
            files.report.error("wrong-kind", f"`{path[-80:]}` is not a file of clips", place, f"one of {kinds} is read")
        if file_ending(path) != "json":
            return {}
        clip, _ = files.read_part_file(path, "a clip", lambda inside, node: read_clip(inside, node, rig), place)
        return {} if clip is None else {clip.name: clip}
    prim = values.text(entries.get("prim"), "the path of a prim") or ""
    rate = values.number(entries.get("rate"), "samples a second", 1.0, 1000.0) or 0.0
    body = files.body(path, place, prim, rate, rig)
    clips = {}
    for name, clip in (body.clips if body else {}).items():
        clips[name] = _fit_to_rig(files, clip, rig, place)
    return clips


def _fit_to_rig(files: BodyFiles, clip: Clip, rig: Rig, place: Span) -> Clip:
    """Return a clip of another file for this rig. Joints and channels that the rig does not have are reported and left out."""
    names, channels = set(rig.names), {each.name for each in rig.channels}
    joints = [number for number, joint in enumerate(clip.joints) if joint in names]
    numbers = [number for number, channel in enumerate(clip.channels) if channel in channels]
    strangers = [joint for joint in clip.joints if joint not in names] + [c for c in clip.channels if c not in channels]
    if not strangers:
        return clip
    stranger_names = ", ".join(f"`{each[:40]}`" for each in strangers[:4]) + (" …" if len(strangers) > 4 else "")
    words = f"the clip `{clip.name}` moves what the rig does not have: {stranger_names}"
    files.report.warning("body-left-out", words, place)
    return replace(
        clip, joints=tuple(clip.joints[k] for k in joints), translation=clip.translation[:, joints],
        rotation=clip.rotation[:, joints], scale=clip.scale[:, joints],
        shear=None if clip.shear is None else clip.shear[:, joints],
        channels=tuple(clip.channels[k] for k in numbers), values=clip.values[:, numbers],
    )  # fmt: skip


# ---- axes, units, colours


def unit_mm(text: object) -> float:
    """Return the millimetres of a length unit such as `mm` or `6 mm`; 0 if the text is not one."""
    match = _UNIT.fullmatch(text) if isinstance(text, str) else None
    return float(match[1] or 1) * UNIT_MM[match[2]] if match else 0.0


def _read_unit(values: Values, node: Node | None, otherwise: float) -> float:
    if node is None:
        return otherwise
    unit = unit_mm(node.value)
    if not unit:
        known = ", ".join(f"`{unit}`" for unit in UNIT_MM)
        words = f"the unit of length must be one of {known}, or a multiple of one"
        values.report.error("wrong-value", words, values.span(node), 'write `"mm"`, or `"6 mm"`')
        return otherwise
    return unit


def _read_axes(values: Values, entries: Mapping[str, Node], base: Definition) -> tuple[Axis, Axis]:
    """Return the forward and upward axes of a body."""
    axes = {"front": base.front, "up": base.up}
    for key in axes:
        node = entries.get(key)
        if node is None:
            continue
        if not isinstance(node.value, str) or node.value not in _AXES:
            letter = node.value if isinstance(node.value, str) and f"+{node.value}" in _AXES else "z" if key == "front" else "y"
            words = f"`{key}` must be one of the axes `+x` `-x` `+y` `-y` `+z` `-z`"
            values.report.error("wrong-value", words, values.span(node), f'write `"+{letter}"`')
            continue
        x, y, z = _AXES[node.value].tolist()
        axes[key] = (x, y, z)
    if any(a and b for a, b in zip(axes["front"], axes["up"], strict=True)):
        node = entries.get("up", entries.get("front"))
        place = values.span(node) if node is not None else None
        values.report.error("wrong-value", "the front and the up axis of the body are parallel", place, 'write `"up": "+y"`')
    return axes["front"], axes["up"]


def _read_materials(values: Values, node: Node) -> dict[str, tuple[float, float, float]]:
    if not isinstance(node.value, dict):
        values.report_wrong(node, "an object of base colours", 'write `{"NAME": [0.5, 0.4, 0.3]}`')
        return {}
    colours = {}
    for name, each in node.value.items():
        colour = values.numbers(each, "a colour", 3, 0.0, 1.0)
        if colour is not None:
            colours[name] = (float(colour[0]), float(colour[1]), float(colour[2]))
    return colours
