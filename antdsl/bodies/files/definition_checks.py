"""Checks that need the complete definition: that named parts exist, that deformers have what they need, and how long the body
is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from antdsl import limits
from antdsl.bodies.agents.boxes import rest_box
from antdsl.bodies.agents.definition import Binding, Definition, Shape
from antdsl.bodies.files.definition_document import Parts, Place
from antdsl.bodies.files.definition_parts import check_legs, find_misnamed
from antdsl.bodies.files.documents import DEFORMERS, DOCUMENTED_DEFORMERS
from antdsl.diagnostics import Report
from antdsl.diagnostics.suggestion import nearest_name
from antdsl.source import Span


def check_definition(parts: Parts, report: Report) -> Definition | None:
    """Return the definition, with its length measured if none is given; None if one of the findings is an error."""
    definition = parts.definition
    sound = report.ok  # else a shape may be missing only because its file could not be read
    _check_sizes(definition, parts.span, report)
    for name, layer in definition.layers.items():
        for binding in (*layer.static, *layer.deforming):
            _check_binding(definition, binding, parts.layers.get(name), report, sound)
    for name, group in definition.groups.items():
        place = parts.groups.get(name)
        for joint, _ in group.members:
            if joint not in definition.rig.names:
                _report_unknown(report, place, "joint", joint, definition.rig.names)
        channels = [each.name for each in definition.rig.channels]
        for channel in group.channels:
            if channel not in channels:
                _report_unknown(report, place, "channel", channel, channels, warn=True)
    for shape in definition.shapes.values():
        _check_shape(definition, shape, parts.span, report)
    for what, name, span, known in find_misnamed(definition.variation, definition.groups, definition.materials, parts.varied):
        near = nearest_name(name, known)
        report.error("unknown-name", f"there is no {what} `{name[:60]}`", span, f'write `"{near}"`' if near else None)
    check_legs(definition, parts.walking, report)
    if not report.ok:
        return None
    return _measure_length(definition, parts, report)


def _check_sizes(definition: Definition, place: Span | None, report: Report) -> None:
    points = sum(len(shape.points) for shape in definition.shapes.values())
    if points > limits.BODY_POINTS:
        words = f"together, the shapes have {points:,} points, more than {limits.BODY_POINTS:,}"
        report.error("too-large", words, place, "use lighter meshes")
    size = sum(c.translation.nbytes + c.rotation.nbytes + c.scale.nbytes + c.values.nbytes for c in definition.clips.values())
    if size > limits.CLIP_BYTES:
        report.error("too-large", f"the clips take more than {limits.CLIP_BYTES:,} bytes", place, "give fewer samples a second")
    for what, named in (("shapes", definition.shapes), ("layers", definition.layers), ("clips", definition.clips)):
        if len(named) > limits.BODY_PARTS:
            report.error("too-large", f"there are more than {limits.BODY_PARTS:,} {what}", place, None)


def _report_unknown(report: Report, place: Place | None, what: str, name: str, known: object, *, warn: bool = False) -> None:
    near = nearest_name(name, known)  # type: ignore[arg-type]
    say = report.warning if warn else report.error
    span = place.of(name) if place else None
    say("unknown-name", f"there is no {what} `{name[:60]}`", span, f'write `"{near}"`' if near else None)


def _check_binding(definition: Definition, binding: Binding, place: Place | None, report: Report, sound: bool) -> None:
    if binding.transform and binding.transform not in definition.rig.names:
        _report_unknown(report, place, "joint", binding.transform, definition.rig.names)
    shape = definition.shapes.get(binding.shape)
    if shape is None and sound:
        _report_unknown(report, place, "shape", binding.shape, definition.shapes)
    if binding.deformer and binding.deformer not in DOCUMENTED_DEFORMERS:
        near = nearest_name(binding.deformer, DOCUMENTED_DEFORMERS)
        words = f"no deformer `{binding.deformer[:60]}` comes with antdsl"
        span = place.of(binding.deformer) if place else None
        report.warning("unknown-name", words, span, f'write `"{near}"`' if near else "a deformer of your own must be registered")
    elif shape is not None and binding.deformer:
        span = place.of(binding.deformer) if place else None
        if binding.deformer.rpartition("+")[2] in DEFORMERS and shape.capture is None:
            words = f"no point of `{shape.name}` follows a joint, and `{binding.deformer}` needs that"
            report.error("bad-body", words, span, "take the shape from a glTF or USD file with a skin, or bind it under `static`")
        if binding.deformer.startswith("blendshape") and shape.blend is None:
            words = f"`{shape.name}` has no shapes to blend, and `{binding.deformer}` needs them"
            help = "take it from a file with morph targets, or add `blendshape_shapenames` and `blendshape_channels`"
            report.error("bad-body", words, span, help)


def _check_shape(definition: Definition, shape: Shape, place: Span | None, report: Report) -> None:
    if shape.capture is not None:
        missing = [name for name in shape.capture.names if name not in definition.rig.names]
        if missing:
            near = nearest_name(missing[0], definition.rig.names)
            words = f"points of `{shape.name}` follow the joint `{missing[0][:60]}`, which the rig does not have"
            report.error(
                "unknown-name", words, place, f"did you mean `{near}`?" if near else "give the rig the joints of the skin"
            )
    channels = [each.name for each in definition.rig.channels]
    blended = shape.blend.shapes if shape.blend else shape.between.shapes if shape.between else ()
    for name in blended:
        if name not in definition.shapes:
            near = nearest_name(name, definition.shapes)
            words = f"`{shape.name}` blends with the shape `{name[:60]}`, which is not there"
            report.error("unknown-name", words, place, f"did you mean `{near}`?" if near else None)
    for name in shape.blend.channels if shape.blend else ():
        if name not in channels:
            near = nearest_name(name, channels)
            words = f"`{shape.name}` blends by the channel `{name[:60]}`, which the rig does not have"
            report.error("unknown-name", words, place, f"did you mean `{near}`?" if near else "add it to the rig's `channels`")


def _measure_length(definition: Definition, parts: Parts, report: Report) -> Definition | None:
    if not parts.measured:
        return definition
    with np.errstate(all="ignore"):
        least, most = rest_box(definition)
        length = float((np.abs(most - least) * np.abs(np.array(definition.front))).sum())
    if not np.isfinite(length) or length <= 1e-9:
        words = "the length of the body along its front cannot be measured"
        report.warning("missing-key", words, parts.span, 'add `"length": 1` to its definition')
        return replace(definition, length=1.0)
    return replace(definition, length=length)
