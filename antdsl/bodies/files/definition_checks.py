"""Checks that need the complete definition: whether named parts exist, and deformers, legs and gaits have all their inputs.

Also measures the length of the body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from antdsl import limits
from antdsl.bodies.agents.boxes import compute_rest_box
from antdsl.bodies.agents.definition import Binding, Definition, Leg, SkinShape
from antdsl.bodies.files.json_text import JsonNode, find_span, find_text, report_unknown_name
from antdsl.diagnostics import Label, Report
from antdsl.diagnostics.suggestion import find_nearest_name
from antdsl.scene.document import PathKey
from antdsl.source import Span

SKINNING_DEFORMER_NAMES = ("linearskinning", "dualquatskinning", "dualquatblendskinning")
DOCUMENTED_DEFORMERS = ("blendshape", *SKINNING_DEFORMER_NAMES, *(f"blendshape+{name}" for name in SKINNING_DEFORMER_NAMES))


@dataclass(slots=True)
class LocatedDefinition:
    """A definition that was read from a file, and the locations in this file for findings about it.

    `span`: the location at which a scene names the file, if any.
    `nodes`: the nodes of the document's parts. The key of a part is the key of the list that contains it, and its name; for the
    list itself, the name is "". Parts from glTF, USD or a cache have no nodes.
    `needs_length`: whether the length must still be measured."""

    definition: Definition
    span: Span | None = None
    nodes: dict[tuple[str, str], JsonNode] = field(default_factory=dict)
    needs_length: bool = True

    def find_part_span(self, key: str, name: str = "", path: Sequence[PathKey] = ()) -> Span | None:
        """Return the location of a part, or of the value at `path` inside the part; None if the part has no node."""
        node = self.nodes.get((key, name))
        return None if node is None else find_span(node, path)

    def find_text_span(self, key: str, name: str, text: str) -> Span | None:
        """Return the location of a text inside a part; None if the part has no node."""
        node = self.nodes.get((key, name))
        return None if node is None else find_text(node, text)


def check_definition(parts: LocatedDefinition, report: Report) -> Definition | None:
    """Check a definition and report findings. Return it with its length, measured if necessary, or None if there is an error."""
    definition = parts.definition
    sound = report.ok  # otherwise a shape may be missing because its file could not be read
    _check_sizes(definition, parts.span, report)
    for name, layer in definition.layers.items():
        for binding in (*layer.static, *layer.deforming):
            _check_binding(parts, name, binding, report, sound)
    channels = [each.name for each in definition.rig.channels]
    for name, group in definition.groups.items():
        for joint, _ in group.members:
            if joint not in definition.rig.names:
                report_unknown_name(report, parts.find_text_span("groups", name, joint), "joint", joint, definition.rig.names)
        for channel in group.channels:
            if channel not in channels:
                report_unknown_name(
                    report, parts.find_text_span("groups", name, channel), "channel", channel, channels, is_warning=True
                )
    for shape in definition.shapes.values():
        _check_shape(definition, shape, parts.span, report)
    for key, what, varied, known in (
        ("scale", "transform group", definition.variation.scales, definition.groups),
        ("materials", "material", definition.variation.materials, definition.materials),
    ):
        for name in varied:
            if name not in known:
                node = parts.nodes.get((key, name))
                report_unknown_name(report, node.span if node is not None else None, what, name, known)
    _check_legs(parts, report)
    if not report.ok:
        return None
    return _measure_length(definition, parts, report)


def _check_sizes(definition: Definition, place: Span | None, report: Report) -> None:
    """Report too many points, shapes, layers or clips of a definition, or too many bytes of clip samples."""
    points = sum(len(shape.points) for shape in definition.shapes.values())
    if points > limits.MAX_BODY_POINTS:
        words = f"together, the shapes have {points:,} points, more than {limits.MAX_BODY_POINTS:,}"
        report.error("too-large", words, place, "use lighter meshes")
    size = sum(c.translation.nbytes + c.rotation.nbytes + c.scale.nbytes + c.values.nbytes for c in definition.clips.values())
    if size > limits.MAX_CLIP_BYTES:
        report.error(
            "too-large", f"the clips take more than {limits.MAX_CLIP_BYTES:,} bytes", place, "use fewer samples per second"
        )
    for what, named in (("shapes", definition.shapes), ("layers", definition.layers), ("clips", definition.clips)):
        if len(named) > limits.MAX_BODY_PARTS:
            report.error("too-large", f"there are more than {limits.MAX_BODY_PARTS:,} {what}", place, None)


def _check_binding(parts: LocatedDefinition, layer: str, binding: Binding, report: Report, shapes_are_valid: bool) -> None:
    """Report joints, shapes and deformers that a binding names but that do not exist. Also report inputs that the deformers need
    but that the shape lacks."""
    definition = parts.definition
    if binding.transform and binding.transform not in definition.rig.names:
        place = parts.find_text_span("layers", layer, binding.transform)
        report_unknown_name(report, place, "joint", binding.transform, definition.rig.names)
    shape = definition.shapes.get(binding.shape)
    if shape is None and shapes_are_valid:
        report_unknown_name(
            report, parts.find_text_span("layers", layer, binding.shape), "shape", binding.shape, definition.shapes
        )
    if not binding.deformer:
        return
    span = parts.find_text_span("layers", layer, binding.deformer)
    if binding.deformer not in DOCUMENTED_DEFORMERS:
        near = find_nearest_name(binding.deformer, DOCUMENTED_DEFORMERS)
        words = f"antdsl has no deformer `{binding.deformer[:60]}`"
        report.warning(
            "unknown-name",
            words,
            span,
            f'write `"{near}"`'
            if near
            else "write one of antdsl's deformers, or register your own deformer before you load the body",
        )
    elif shape is not None:
        if binding.deformer.rpartition("+")[2] in SKINNING_DEFORMER_NAMES and shape.capture is None:
            words = f"no point of `{shape.name}` follows a joint, but `{binding.deformer}` needs joints"
            report.error("bad-body", words, span, "take the shape from a glTF or USD file with a skin, or bind it under `static`")
        if binding.deformer.startswith("blendshape") and shape.blend is None:
            words = f"`{shape.name}` has no blend shapes, but `{binding.deformer}` needs them"
            help = "use a shape from a file with morph targets, or add `blendshape_shapenames` and `blendshape_channels`"
            report.error("bad-body", words, span, help)


def _check_shape(definition: Definition, shape: SkinShape, place: Span | None, report: Report) -> None:
    """Report joints, blend shapes and channels that a shape names but the definition lacks."""
    if shape.capture is not None:
        missing = [name for name in shape.capture.names if name not in definition.rig.names]
        if missing:
            near = find_nearest_name(missing[0], definition.rig.names)
            words = f"points of `{shape.name}` follow the joint `{missing[0][:60]}`, which the rig does not have"
            report.error(
                "unknown-name",
                words,
                place,
                f"did you mean `{near}`?" if near else "add the missing joint to the rig, or export rig and skin together",
            )
    channels = [each.name for each in definition.rig.channels]
    blended = shape.blend.shapes if shape.blend else shape.in_betweens.shapes if shape.in_betweens else ()
    for name in blended:
        if name not in definition.shapes:
            near = find_nearest_name(name, definition.shapes)
            words = f"`{shape.name}` blends with the missing shape `{name[:60]}`"
            report.error("unknown-name", words, place, f"did you mean `{near}`?" if near else None)
    for name in shape.blend.channels if shape.blend else ():
        if name not in channels:
            near = find_nearest_name(name, channels)
            words = f"`{shape.name}` takes its blend weight from the channel `{name[:60]}`, which the rig does not have"
            report.error("unknown-name", words, place, f"did you mean `{near}`?" if near else "add it to the rig's `channels`")


def _check_legs(parts: LocatedDefinition, report: Report) -> None:
    """Report legs with missing or unconnected joints, gaits that do not match the legs, and a missing idle clip."""
    definition = parts.definition
    for leg in definition.legs:
        _check_leg(parts, leg, report)
    for gait in definition.gaits:
        if len(gait.phases) != len(definition.legs):
            count = len(definition.legs)
            words = f"`{gait.name}` has {len(gait.phases)} phases, but the body has {count} leg{'' if count == 1 else 's'}"
            help = "write one phase for each leg, in the order of `legs`" if count else 'add `"legs": […]`'
            report.error("wrong-value", words, parts.find_part_span("gaits", gait.name, ("phases",)), help)
    for slow, fast in pairwise(definition.gaits):
        if not slow.speed < fast.speed:
            words = f"the gaits `{slow.name}` and `{fast.name}` have the same speed"
            labels = [
                Label(place, "here first")
                for place in (parts.find_part_span("gaits", slow.name, ("speed",)),)
                if place is not None
            ]
            place = parts.find_part_span("gaits", fast.name, ("speed",))
            report.error(
                "wrong-value", words, place, "write a different speed for one of the gaits, or delete it", labels=tuple(labels)
            )
    if definition.legs and not definition.gaits:
        line = 'add `"gaits": [{"name": "walk", "speed": …, "stride": …, "duty": 0.6, "lift": …, "phases": […]}]`'
        report.warning(
            "missing-key", "the body has legs but no gait, so only clips move the legs", parts.find_part_span("legs"), line
        )
    if definition.idle and definition.idle not in definition.clips:
        report_unknown_name(report, parts.find_part_span("idle"), "clip", definition.idle, definition.clips)


def _check_leg(parts: LocatedDefinition, leg: Leg, report: Report) -> None:
    """Report joints of a leg that are missing or not below each other."""
    definition, known = parts.definition, True
    names = definition.rig.names
    joints = {"upper": leg.upper, "lower": leg.lower, "ankle": leg.ankle, "foot": leg.foot}
    chain = [(key, joint) for key, joint in joints.items() if joint or key != "ankle"]
    for key, joint in chain:
        if joint not in names:
            report_unknown_name(report, parts.find_part_span("legs", leg.name, (key,)), "joint", joint, names)
            known = False
    if not known:
        return
    for (_, above), (key, below) in pairwise(chain):
        descendants = definition.rig.find_descendants(definition.rig.find_joint(above))
        can_be_equal = (above, key) == (leg.ankle, "foot")
        if definition.rig.find_joint(below) not in descendants[0 if can_be_equal else 1 :]:
            words, place = (
                f"`{below[:60]}` is not below `{above[:60]}` in the rig",
                parts.find_part_span("legs", leg.name, (key,)),
            )
            report.error("bad-rig", words, place, "name the joints of the leg from the hip down: upper, lower, ankle, foot")


def _measure_length(definition: Definition, parts: LocatedDefinition, report: Report) -> Definition | None:
    """Return the definition with its length, which is measured. If the body has no extent along `front`, report this and use the
    length 1."""
    if not parts.needs_length:
        return definition
    with np.errstate(all="ignore"):
        least, most = compute_rest_box(definition)
        length = float((np.abs(most - least) * np.abs(np.array(definition.front))).sum())
    if not np.isfinite(length) or length <= 1e-9:
        words = "the length of the body along its front cannot be measured"
        report.warning("missing-key", words, parts.span, 'add `"length": 1` to the definition of the body')
        return replace(definition, length=1.0)
    return replace(definition, length=length)
