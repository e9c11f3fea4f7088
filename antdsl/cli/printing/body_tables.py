"""Descriptions of agent definitions, as lines of text for users and as JSON for other programs."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from antdsl.bodies.agents.definition import Clip, Definition, Gait, Layer, Leg, SkinShape, map_language_names
from antdsl.bodies.files.document_values import format_axis
from antdsl.bodies.files.documents import to_plain_metadata
from antdsl.diagnostics import Report
from antdsl.diagnostics.render import choose_visible_diagnostics, render
from antdsl.diagnostics.text_positions import escape_line
from antdsl.scene.scene_model import UNIT_MM


def format_body(body: Definition) -> Iterator[str]:
    """Yield the lines that describe a definition."""
    unit = find_length_unit(body)
    yield f"body         {body.name}: {body.length:.4g} {unit} long, front {format_axis(body.front)}, up {format_axis(body.up)}"
    yield f"joints       {len(body.rig.names)}"
    yield from format_joint_tree(body)
    for each in body.rig.channels:
        transform_text = f" of {each.transform}" if each.transform else ""
        yield escape_line(f"channel      {each.name}{transform_text}: {each.default:g} where no clip says otherwise")
    for shape in body.shapes.values():
        yield escape_line(f"shape        {shape.name}: {', '.join(_describe_shape(shape))}")
    for layer in body.layers.values():
        yield escape_line(f"layer        {layer.name}: {_format_bindings(layer)}")
    for clip in body.clips.values():
        yield escape_line(f"clip         {clip.name}: {', '.join(_describe_clip(body, clip))}")
    if body.idle:
        yield escape_line(f"idle         {body.idle}")
    for leg in body.legs:
        yield escape_line(f"leg          {leg.name}: {', '.join(_collect_leg_joints(leg).values())}")
    for gait in body.gaits:
        phases = " ".join(f"{each:.3g}" for each in gait.phases)
        words = f"at {gait.speed:.4g} {unit}/s, stride {gait.stride:.4g} {unit}, duty factor {gait.duty:.3g}"
        yield escape_line(f"gait         {gait.name}: {words}, lift {gait.lift:.4g} {unit}, phases {phases}")
    for group in body.groups.values():
        members = [name if weight == 1 else f"{name} {weight:g}" for name, weight in group.members]
        yield escape_line(f"group        {group.name}: {_shorten_list([*members, *group.channels])}")
    for name, colour in body.materials.items():
        yield escape_line(f"material     {name}: {' '.join(f'{part:.3g}' for part in colour)}")
    for name, (low, high) in body.variation.scales.items():
        yield escape_line(f"varies       {name}: {low:g} to {high:g} times as large")
    for name, colours in body.variation.materials.items():
        yield escape_line(f"varies       {name}: {' to '.join(' '.join(f'{part:.3g}' for part in colour) for colour in colours)}")
    yield from _format_language_names(body)
    for key, value in to_plain_metadata(body.metadata).items():
        yield escape_line(f"metadata     {key}: {_shorten_text(json.dumps(value, ensure_ascii=False))}")


def _format_language_names(body: Definition) -> Iterator[str]:
    """Yield lines about the names of a body that are not valid words of the language, and how programs and scenes write them."""
    names_by_kind: list[tuple[str, Iterable[str]]] = [
        ("clip", body.clips), ("layer", body.layers), ("group", body.groups), ("channel", (c.name for c in body.rig.channels)),
        *((f"mark of {clip.name}", clip.marks) for clip in body.clips.values()),
    ]  # fmt: skip
    for kind, names in names_by_kind:
        for name, language_name in map_language_names(names).items():
            if name != language_name:
                yield escape_line(f"written      {kind} {name}: {language_name}")


def format_joint_tree(body: Definition) -> Iterator[str]:
    """Yield a line for each joint, indented below its parent."""
    depth: list[int] = []
    for name, parent in zip(body.rig.names, body.rig.parents, strict=True):
        depth.append(0 if parent < 0 else depth[parent] + 1)
        yield escape_line(f"  {'  ' * min(depth[-1], 40)}{name}")


def find_length_unit(body: Definition) -> str:
    """Return the unit of a definition's lengths."""
    return next((name for name, mm in UNIT_MM.items() if abs(mm / body.unit - 1) < 1e-6), f"× {body.unit:g} mm")


def _describe_shape(shape: SkinShape) -> list[str]:
    words = [f"{len(shape.points):,} points", f"{len(shape.faces):,} triangles"]
    if shape.capture is not None:
        words.append(f"follows {len(shape.capture.names)} joints")
    if shape.blend is not None:
        words.append(f"blends with {len(shape.blend.shapes)}")
    if shape.in_betweens is not None:
        words.append(f"{len(shape.in_betweens.shapes)} in-between")
    words += [word for word, values in (("no normals", shape.normals), ("no uvs", shape.uvs)) if values is None]
    return words


def _format_bindings(layer: Layer) -> str:
    static = [f"{each.shape} at {each.transform}" for each in layer.static]
    deforming = [f"{each.shape} by {each.deformer}" for each in layer.deforming]
    return _shorten_list([*deforming, *static])


def _describe_clip(body: Definition, clip: Clip) -> list[str]:
    words = [f"{clip.duration:.3g} s", f"{clip.rate:.4g} samples a second", f"{len(clip.joints)} joints"]
    if clip.channels:
        words.append(f"{len(clip.channels)} channels")
    words.append("loops" if clip.loop else "plays once")
    words.append(f"stride {clip.stride:.4g} {find_length_unit(body)}" if clip.stride else "stays in place")
    words += [] if clip.feet else ["feet free"]
    words += [f"{name} at {mark_time:.3g} s" for name, mark_time in clip.marks.items()]
    return [*words, "does not close"] if clip.loop and not _is_clip_closed(body, clip) else words


def _is_clip_closed(body: Definition, clip: Clip) -> bool:
    """Return whether a clip ends in its first pose, apart from the displacement of its stride. The tolerance is 1/1000 of the
    body length for translations, and 0.001 for the values of rotations and scales."""
    ends = ((part[0], part[-1]) for part in (clip.translation, clip.rotation, clip.scale) if len(part))
    near = [1e-3 * body.length + clip.stride, 1e-3, 1e-3]
    gaps = [np.abs(a - b).max(initial=0.0) for a, b in ends]
    if len(gaps) == 3:
        gaps[1] = min(gaps[1], np.abs(clip.rotation[0] + clip.rotation[-1]).max(initial=0.0))
    values = np.abs(clip.values[0] - clip.values[-1]).max(initial=0.0) if len(clip.values) else 0.0
    return bool(values <= 1e-3 and all(a <= tolerance for a, tolerance in zip(gaps, near, strict=False)))


def _collect_leg_joints(leg: Leg) -> dict[str, str]:
    """Return the joints of a leg from hip to foot, by their keys in a definition file."""
    return {key: joint for key, joint in leg.to_entry().items() if key != "name"}


def _shorten_list(words: list[str]) -> str:
    return ", ".join(words[:8]) + (f" and {len(words) - 8} more" if len(words) > 8 else "") if words else "empty"


def _shorten_text(text: str) -> str:
    return text if len(text) <= 100 else text[:99] + "…"


def format_body_json(body: Definition | None, report: Report) -> str:
    """Return the description of a body as JSON. Its value `body` is null if there is no body. Its value `findings` has the form
    of `antdsl check --format json`."""
    findings = json.loads(render(report, "json")) if choose_visible_diagnostics(report) else None
    content: dict[str, Any] = {"format_version": "1.0", "valid": report.ok, "body": None, "findings": findings}
    if body is not None:
        content["body"] = {
            "name": body.name, "length": body.length, "unit_mm": body.unit, "front": format_axis(body.front),
            "up": format_axis(body.up),
            "joints": {
                name: None if parent < 0 else body.rig.names[parent]
                for name, parent in zip(body.rig.names, body.rig.parents, strict=True)
            },
            "channels": {each.name: {"default": each.default, "transform": each.transform} for each in body.rig.channels},
            "shapes": {name: _make_shape_document(shape) for name, shape in body.shapes.items()},
            "layers": {name: _make_layer_document(layer) for name, layer in body.layers.items()},
            "clips": {name: _make_clip_document(clip) for name, clip in body.clips.items()},
            "idle": body.idle,
            "legs": {leg.name: _collect_leg_joints(leg) for leg in body.legs},
            "gaits": {gait.name: _make_gait_document(gait) for gait in body.gaits},
            "groups": {
                name: {"members": dict(group.members), "channels": list(group.channels)} for name, group in body.groups.items()
            },
            "variation": {
                "scale": {name: list(ends) for name, ends in body.variation.scales.items()},
                "materials": {name: [list(colour) for colour in colours] for name, colours in body.variation.materials.items()},
            },
            "materials": {name: list(colour) for name, colour in body.materials.items()},
            "metadata": to_plain_metadata(body.metadata),
        }  # fmt: skip
    return json.dumps(content, indent=2, ensure_ascii=True) + "\n"


def _make_shape_document(shape: SkinShape) -> dict[str, Any]:
    return {
        "points": len(shape.points),
        "triangles": len(shape.faces),
        "joints": list(shape.capture.names) if shape.capture is not None else [],
        "blends_with": list(shape.blend.shapes) if shape.blend is not None else [],
        "in_between": dict(zip(shape.in_betweens.shapes, shape.in_betweens.weights, strict=True))
        if shape.in_betweens is not None
        else {},
        "materials": list(shape.materials),
        "normals": shape.normals is not None,
        "uvs": shape.uvs is not None,
    }


def _make_layer_document(layer: Layer) -> list[dict[str, Any]]:
    return [
        {"shape": each.shape, "transform": each.transform, "deformer": each.deformer, "bounds_scale": list(each.bounds_scale)}
        for each in (*layer.static, *layer.deforming)
    ]


def _make_clip_document(clip: Clip) -> dict[str, Any]:
    return {
        "seconds": clip.duration,
        "rate": clip.rate,
        "joints": len(clip.joints),
        "channels": list(clip.channels),
        "loop": clip.loop,
        "stride": clip.stride,
        "marks": dict(clip.marks),
        "feet": clip.feet,
    }


def _make_gait_document(gait: Gait) -> dict[str, Any]:
    values = {"speed": gait.speed, "stride": gait.stride, "duty": gait.duty, "lift": gait.lift}
    return values | {"phases": list(gait.phases)}
