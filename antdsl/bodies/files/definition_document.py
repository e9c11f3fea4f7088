"""A definition file: antdsl's own JSON that names the parts of an agent definition.

Each part is either inline, in the form that Houdini documents, or a reference such as `{"file": "rig.json"}`. The path must be
below the file's folder or a granted root."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from antdsl.bodies.agents.definition import Clip, Definition, Rig, Variation
from antdsl.bodies.files.clip_document import build_clip, check_marks
from antdsl.bodies.files.definition_checks import LocatedDefinition
from antdsl.bodies.files.document_errors import read_form
from antdsl.bodies.files.document_model import BaseForm, BodyForm, ClipForm, ClipReference
from antdsl.bodies.files.documents import (
    build_capsule,
    build_gaits,
    build_group,
    build_layer,
    build_legs,
    build_rig,
    read_metadata,
)
from antdsl.bodies.files.json_text import JsonNode, find_node, find_span, report_unknown_name
from antdsl.bodies.files.named_files import CLIP_ENDINGS, GLTF_ENDINGS, USD_ENDINGS, BodyFiles, get_file_ending
from antdsl.bodies.files.shape_references import read_includes, read_shapes
from antdsl.diagnostics import Label, Report
from antdsl.source import Span

# The keys of parts that may be in separate files, with the kind of the part.
_PART_DESCRIPTIONS = {"rig": "a rig", "metadata": "metadata", "layers": "a layer", "groups": "a transform group"}


def read_document(root: JsonNode, files: BodyFiles, name: str) -> LocatedDefinition | None:
    """Return the definition in a document, or None if it cannot be read. The caller must check the result with
    `definition_checks`. `name`: the name to use if the document states none."""
    report = files.report
    if _report_part_file(root, report):
        return None
    tree = _insert_files(root, files)
    form = read_form(BodyForm, tree, report)
    if form is None or not report.ok:
        return None
    base = None if form.base is None else _read_base(form.base, find_node(root, ("from",)), files, name)
    rig = base.rig if base is not None else None
    if form.rig is not None:
        rig = build_rig(form.rig, find_node(tree, ("rig",)), report)
    if rig is None:
        if form.base is None and form.rig is None:
            words = "this definition has no joints: add a `rig`, or the file of a body under `from`"
            report.error("missing-key", words, root.marked_span, 'add `"rig": {"file": "rig.json"}`')
        return None
    base = replace(base or Definition(name, rig), rig=rig)
    base = replace(base, name=form.name or base.name, unit=form.units or base.unit, **_read_axes(form, root, base, report))
    shapes, materials = dict(base.shapes), {**base.materials, **form.materials}
    read_includes(form, root, files, shapes, materials)
    read_shapes(form, root, files, base.unit, shapes, materials)
    parts = LocatedDefinition(base, root.marked_span, needs_length=not (form.length or (form.base is not None and base.length)))
    layers = {each.name: build_layer(each) for each in form.layers}
    groups = {each.name: build_group(each) for each in form.groups}
    for key, named in (("layers", form.layers), ("groups", form.groups), ("legs", form.legs), ("gaits", form.gaits)):
        _record_part_nodes(parts, key, [each.name for each in named], root, tree, report)
    for kind in ("scale", "materials"):
        varied = find_node(tree, ("variation", kind))
        parts.nodes |= {(kind, each): find_node(varied, (each,)) for each in getattr(form.variation, kind)}
    parts.nodes["idle", ""] = find_node(root, ("idle",))
    definition = replace(
        base, shapes=shapes, materials=materials, layers={**base.layers, **layers}, groups={**base.groups, **groups},
        clips=_read_clips(form, root, files, rig, dict(base.clips)), length=form.length or base.length,
    )  # fmt: skip
    if "metadata" in form.model_fields_set:
        definition = replace(definition, metadata={**base.metadata, **read_metadata(find_node(tree, ("metadata",)), report)})
    if "variation" in form.model_fields_set:
        scales = {group: (min(ends), max(ends)) for group, ends in form.variation.scale.items()}
        definition = replace(definition, variation=Variation(scales, form.variation.materials))
    if "legs" in form.model_fields_set:
        definition = replace(definition, legs=build_legs(form.legs))
    if "gaits" in form.model_fields_set:
        definition = replace(definition, gaits=build_gaits(form.gaits))
    if form.capsule is not None:
        definition = replace(definition, capsule=build_capsule(form.capsule))
    parts.definition = replace(definition, idle=form.idle or definition.idle)
    return parts


def _insert_files(root: JsonNode, files: BodyFiles) -> JsonNode:
    """Return the tree of a definition with references to separate files replaced by the content of these files.

    Files that cannot be read are left out."""

    def insert_part(node: JsonNode, expected_part: str) -> JsonNode | None:
        file = node.get_inner("file")
        if file is None or len(node.keys) != 1 or not isinstance(file.value, str):
            return node
        return files.read_part(file.value, expected_part, file.span)

    if not isinstance(root.value, dict):
        return root
    entries: dict[str, JsonNode | None] = dict(root.value)
    for key, what in _PART_DESCRIPTIONS.items():
        node = root.value.get(key)
        if node is None:
            continue
        if isinstance(node.value, list) and not node.has_plain_numbers and key in ("layers", "groups"):
            items = [insert_part(each, what) for each in node.value if isinstance(each, JsonNode)]
            entries[key] = replace(node, value=[each for each in items if each is not None])
        else:
            entries[key] = insert_part(node, what)
    return replace(root, value={key: node for key, node in entries.items() if node is not None})


def _record_part_nodes(
    parts: LocatedDefinition, key: str, names: list[str], root: JsonNode, tree: JsonNode, report: Report
) -> None:
    """Store the node of each part in `names`, and report names that occur twice."""
    parts.nodes[key, ""] = find_node(root, (key,))
    first: dict[str, int] = {}
    for number, name in enumerate(names):
        if name in first:
            labels = (Label(find_span(root, (key, first[name])), "here first"),)
            words = f"there are two {key} `{name}`"
            report.error("duplicate-name", words, find_span(root, (key, number)), "keep one of them", labels=labels)
        first.setdefault(name, number)
        parts.nodes[key, name] = find_node(tree, (key, number))


# Keys that identify a part in a separate file, with the kind of part and how a definition names it.
_PART_FILE_KEYS = (
    ("rig_version", "a rig", '"rig": {"file": "…"}'),
    ("antdsl_clip", "a clip", '"clips": [{"file": "…"}]'),
    ("static", "a layer", '"layers": [{"file": "…"}]'),
    ("deforming", "a layer", '"layers": [{"file": "…"}]'),
    ("members", "a transform group", '"groups": [{"file": "…"}]'),
    ("asset", "glTF", '"from": "body.gltf"'),
)


def _report_part_file(root: JsonNode, report: Report) -> bool:
    """Return whether a file is only a part of a definition, such as a rig, and report this as an error."""
    if not isinstance(root.value, dict) or "antdsl_body" in root.value:
        return False
    for key, what, line in _PART_FILE_KEYS:
        if key in root.value:
            words = f"this file contains {what}, which is only a part of a body definition"
            report.error(
                "wrong-kind",
                words,
                find_span(root, (key,), key=True),
                f'write a body definition that names this file: `{{"antdsl_body": 1, {line}}}`',
            )
            return True
    return False


def _read_base(base: BaseForm, node: JsonNode, files: BodyFiles, name: str) -> Definition | None:
    """Return the definition in the glTF or USD file that the key `from` names, or None after an error."""
    place = find_span(node, ("file",))
    if files.is_closed_format(base.file, place):
        return None
    if get_file_ending(base.file) not in (*GLTF_ENDINGS, *USD_ENDINGS):
        kinds = ", ".join(f".{kind}" for kind in (*GLTF_ENDINGS, *USD_ENDINGS))
        files.report.error(
            "wrong-kind",
            f"a file of this type cannot hold joints: `{base.file[-80:]}`",
            place,
            f"use a file of one of these types: {kinds}",
        )
        return None
    definition = files.read_body(base.file, place, base.prim or "", base.rate or 0.0)
    return None if definition is None else replace(definition, name=name)


def _read_axes(form: BodyForm, root: JsonNode, base: Definition, report: Report) -> dict[str, Any]:
    """Return the forward and upward axes of a definition, as its fields `front` and `up`."""
    front, up = form.front or base.front, form.up or base.up
    if any(a and b for a, b in zip(front, up, strict=True)):
        node = root.get_inner("up") or root.get_inner("front")
        words = "the front axis and the up axis of the body are parallel"
        report.error("wrong-value", words, node.span if node is not None else None, 'write `"up": "+y"`')
    return {"front": front, "up": up}


# ---- clips


def _read_clips(form: BodyForm, root: JsonNode, files: BodyFiles, rig: Rig, clips: dict[str, Clip]) -> dict[str, Clip]:
    """Return the clips that the document lists, by name.

    An entry is an inline clip, a clip file, a glTF or USD file, or changed settings for a clip of the file under `from`.
    `clips`: the clips of the file under `from`."""
    first: dict[str, Span] = {}
    for number, entry in enumerate(form.clips):
        node = find_node(root, ("clips", number))
        if isinstance(entry, ClipReference):
            new, has_samples = _resolve_clip_reference(entry, node, files, rig, clips), entry.file is not None
        else:
            clip = build_clip(entry, node, files.report, rig)
            new, has_samples = [clip] if clip is not None else [], True
        for clip in new:
            if clip.name in first or (clip.name in clips and has_samples):
                labels = (Label(first.get(clip.name, find_span(root, ("clips",))), "here first"),)
                words = f"there are two clips `{clip.name}`"
                files.report.error("duplicate-name", words, node.span, "keep one of them", labels=labels)
                continue
            clips[clip.name], first[clip.name] = clip, node.marked_span
    return clips


def _resolve_clip_reference(
    entry: ClipReference, node: JsonNode, files: BodyFiles, rig: Rig, base_clips: dict[str, Clip]
) -> list[Clip]:
    """Return the clips that an entry refers to, with the settings of the entry."""
    report = files.report
    clips: Mapping[str, Clip] = base_clips
    if entry.file is not None:
        clips = _read_clip_file(entry, entry.file, find_span(node, ("file",)), files, rig)
    elif entry.clip is None:
        words = f"{f'the clip `{entry.name[:60]}`' if entry.name else 'a clip'} has neither `file` nor `clip`"
        help = 'add `"file": "walk.json"`, or `"clip": "Walk"` for a clip of the file under `from`'
        report.error("missing-key", words, node.marked_span, help)
        return []
    if entry.clip is not None:
        if entry.clip not in clips:
            report_unknown_name(report, find_span(node, ("clip",)), "clip", entry.clip, clips)
            return []
        clips = {entry.clip: clips[entry.clip]}
        if entry.file is None:
            base_clips.pop(entry.clip)
    if entry.name is not None and len(clips) > 1:
        words, help = (
            f"`name` can name only one clip, but the file has {len(clips)} clips",
            f'add `"clip": "{next(iter(clips))}"`',
        )
        report.error("wrong-value", words, find_span(node, ("name",)), help)
        return []
    settings = {key: getattr(entry, key) for key in ("name", "loop", "stride", "marks", "feet") if key in entry.model_fields_set}
    for clip in clips.values():
        check_marks(entry.marks, clip.duration, node, report)
    return [replace(clip, **settings) for clip in clips.values()]


def _read_clip_file(entry: ClipReference, path: str, place: Span, files: BodyFiles, rig: Rig) -> dict[str, Clip]:
    """Return the clips of a file by name, without joints that the rig lacks. A text file has one clip, a glTF or USD file any
    number."""
    if get_file_ending(path) in (*GLTF_ENDINGS, *USD_ENDINGS):
        body = files.read_body(path, place, entry.prim or "", entry.rate or 0.0, rig)
        return {name: _fit_to_rig(files, clip, rig, place) for name, clip in (body.clips if body else {}).items()}
    if get_file_ending(path) not in CLIP_ENDINGS:
        if not files.is_closed_format(path, place):
            kinds = ", ".join(f".{kind}" for kind in (*CLIP_ENDINGS, *GLTF_ENDINGS, *USD_ENDINGS))
            files.report.error(
                "wrong-kind", f"`{path[-80:]}` is not a file of clips", place, f"use a file of one of these types: {kinds}"
            )
        return {}
    root = files.read_part(path, "a clip", place)
    form = None if root is None else read_form(ClipForm, root, files.report)
    clip = None if root is None or form is None else build_clip(form, root, files.report, rig)
    return {} if clip is None else {clip.name: clip}


def _fit_to_rig(files: BodyFiles, clip: Clip, rig: Rig, place: Span) -> Clip:
    """Return a clip of another file without the joints and channels that `rig` lacks. Report what is left out."""
    names, channels = set(rig.names), {each.name for each in rig.channels}
    joints = [number for number, joint in enumerate(clip.joints) if joint in names]
    numbers = [number for number, channel in enumerate(clip.channels) if channel in channels]
    strangers = [joint for joint in clip.joints if joint not in names] + [c for c in clip.channels if c not in channels]
    if not strangers:
        return clip
    stranger_names = ", ".join(f"`{each[:40]}`" for each in strangers[:4]) + (" …" if len(strangers) > 4 else "")
    words = f"the clip `{clip.name}` moves joints or channels that the rig does not have: {stranger_names}"
    files.report.warning("body-left-out", words, place)
    return replace(
        clip, joints=tuple(clip.joints[k] for k in joints), translation=clip.translation[:, joints],
        rotation=clip.rotation[:, joints], scale=clip.scale[:, joints],
        shear=None if clip.shear is None else clip.shear[:, joints],
        channels=tuple(clip.channels[k] for k in numbers), values=clip.values[:, numbers],
    )  # fmt: skip
