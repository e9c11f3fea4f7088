"""Builds rigs, layers, transform groups and metadata from the models of their documents, and writes them as text. The JSON forms
are those of the page Agent Primitives of Houdini 20.5.

Houdini's form has no rest pose for a rig. antdsl stores it in its own key `antdsl_rest`, one matrix per joint.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from antdsl.bodies.agents.definition import Binding, Channel, Gait, Layer, Leg, Rig, TransformGroup
from antdsl.bodies.files.document_model import CapsuleForm, GaitForm, GroupForm, LayerForm, LegForm, RigForm
from antdsl.bodies.files.json_text import JsonNode, find_span, report_unknown_name
from antdsl.diagnostics import Label, Report
from antdsl.diagnostics.suggestion import find_nearest_name
from antdsl.source import Span

_NUMBER_LIST_PATTERN = re.compile(r"\[\n([-+0-9.eE,\s]+)\]")  # strings contain no raw line breaks, so no string can match


# ---- rig


def build_rig(form: RigForm, root: JsonNode, report: Report) -> Rig | None:
    """Return the rig of a document, or None if its joints do not form a tree."""
    tree = _order_joints(form, root, report)
    if tree is None:
        return None
    names, parents = tree
    number = {name: count for count, name in enumerate(names)}
    rest = np.tile(np.eye(4), (len(names), 1, 1))
    for name, matrix in form.antdsl_rest.items():
        if name in number:
            rest[number[name]] = matrix
            continue
        near = find_nearest_name(name, names)
        span = find_span(root, ("antdsl_rest", name), key=True)
        report.error("unknown-key", f"`{name[:60]}` is not a joint of the rig", span, f'write `"{near}"`' if near else None)
    for name, channel in form.channels.items():
        if channel.transform and channel.transform not in number:
            report_unknown_name(report, find_span(root, ("channels", name, "transform")), "joint", channel.transform, names)
    channels = tuple(Channel(name, each.default_value, each.transform) for name, each in form.channels.items())
    return Rig(names, np.array(parents, np.int32), rest, channels)


def _order_joints(form: RigForm, root: JsonNode, report: Report) -> tuple[tuple[str, ...], list[int]] | None:
    """Return the names of the joints, and the number of each joint's parent (-1 for a root). Return None after errors.

    If all parents precede their children in the text, the joints are in the order of the text. Otherwise, they are ordered from
    the roots down."""
    joints = form.transforms
    parent: dict[str, tuple[str, Span]] = {}
    children: dict[str, list[str]] = {name: [] for name in joints}
    sound = True
    for name, own_children in joints.items():
        for number, child in enumerate(own_children):
            place = find_span(root, ("transforms", name, number))
            if child in joints and child not in parent:
                parent[child] = (name, place)
                children[name].append(child)
                continue
            sound = False
            if child not in joints:
                _report_missing_child(report, place, name, child, [other for other in joints if other not in parent])
            elif parent[child][0] == name:
                labels = (Label(parent[child][1], "here first"),)
                words = f"`{child}` is listed twice as a child of `{name}`"
                report.error("duplicate-name", words, place, "keep one of them", labels=labels)
            else:
                words = f"the joint `{child}` has two parents, `{parent[child][0]}` and `{name}`"
                report.error("bad-rig", words, place, f"delete `{child}` below one of them")
    if _report_cycles(report, parent) or not sound:
        return None
    positions = {name: count for count, name in enumerate(joints)}
    if all(positions[each[0]] < positions[name] for name, each in parent.items()):
        return tuple(joints), [positions[parent[name][0]] if name in parent else -1 for name in joints]
    names: list[str] = []
    waiting = [name for name in reversed(joints) if name not in parent]
    while waiting:
        names.append(waiting.pop())
        waiting += reversed(children[names[-1]])
    number_of = {name: count for count, name in enumerate(names)}
    return tuple(names), [number_of[parent[name][0]] if name in parent else -1 for name in names]


def _report_missing_child(report: Report, place: Span, name: str, child: str, free_joints: list[str]) -> None:
    """Report a `child` of the joint `name` that is not a joint of the rig. `free_joints`: possible corrections."""
    near = find_nearest_name(child, free_joints)
    help = f'write `"{near}"`' if near else f'add `"{child}": []` to the transforms'
    report.error("bad-rig", f"`{name}` has the child `{child}`, which is missing from the transforms", place, help)


def _report_cycles(report: Report, parent: Mapping[str, tuple[str, Span]]) -> bool:
    """Report each cycle of joints once, at the entry that closes the cycle. Return whether there is any cycle."""
    visited: set[str] = set()
    has_circle = False
    for start in parent:
        chain: dict[str, None] = {}
        name = start
        while name in parent and name not in visited:
            if name in chain:
                circle = list(chain)[list(chain).index(name) :]
                circle_text = " below ".join(f"`{each}`" for each in [*circle[:4], *(["…"] if len(circle) > 4 else []), name])
                words = f"the joints {circle_text} are children of each other in a circle"
                report.error("bad-rig", words, parent[name][1], f"delete `{name}` here, so that one of them is a root")
                has_circle = True
                break
            chain[name] = None
            name = parent[name][0]
        visited.update(chain)
    return has_circle


def write_rig(rig: Rig) -> str:
    """Return a rig as text in Houdini's form. If it has a rest pose, add this under antdsl's own key."""
    children: dict[str, list[str]] = {name: [] for name in rig.names}
    for name, parent in zip(rig.names, rig.parents, strict=True):
        if parent >= 0:
            children[rig.names[parent]].append(name)
    document: dict[str, Any] = {"rig_version": 1, "transforms": children}
    if rig.channels:
        document["channels"] = {c.name: {"default_value": c.default, "transform": c.transform} for c in rig.channels}
    moved = [joint for joint in range(len(rig.names)) if (rig.rest_matrices[joint] != np.eye(4)).any()]
    if moved:
        document["antdsl_rest"] = {rig.names[joint]: rig.rest_matrices[joint].tolist() for joint in moved}
    return format_json(_convert_whole_floats(document))


# ---- layers and transform groups


def build_layer(form: LayerForm) -> Layer:
    """Return the layer of a document: static and deforming bindings of shapes to joints."""
    static, deforming = (tuple(Binding(**dict(each)) for each in part) for part in (form.static, form.deforming))
    return Layer(form.name, static, deforming)


def write_layer(layer: Layer) -> str:
    """Return a layer as text in Houdini's form."""
    return format_json(_convert_whole_floats({"version": 2, **asdict(layer)}))


def build_legs(forms: Iterable[LegForm]) -> tuple[Leg, ...]:
    """Return the legs of a document."""
    return tuple(Leg(**{**dict(form), "ankle": form.ankle or ""}) for form in forms)


def build_gaits(forms: Iterable[GaitForm]) -> tuple[Gait, ...]:
    """Return the gaits of a document, the slowest first."""
    return tuple(sorted((Gait(**dict(form)) for form in forms), key=lambda gait: gait.speed))


def build_capsule(form: CapsuleForm) -> tuple[float, float, float, float]:
    """Return the collision capsule of a document, as `Definition.capsule` describes it."""
    return form.length, form.width, form.height, form.ahead


def build_group(form: GroupForm) -> TransformGroup:
    """Return the transform group of a document: joints with weights from 0 to 1, and channels."""
    return TransformGroup(
        form.name, tuple((each.name, each.weight) for each in form.members), tuple(c.name for c in form.channels)
    )


def write_group(group: TransformGroup) -> str:
    """Return a transform group as text in Houdini's form."""
    members = [{"name": name, "weight": weight} for name, weight in group.members]
    channels = [{"name": name} for name in group.channels]
    return format_json(_convert_whole_floats({"version": 2, "name": group.name, "members": members, "channels": channels}))


def _convert_whole_floats(value: Any) -> Any:
    """Return a value with floats such as 1.0 converted to integers, as in Houdini's forms."""
    if isinstance(value, dict):
        return {key: _convert_whole_floats(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_convert_whole_floats(each) for each in value]
    return int(value) if isinstance(value, float) and value.is_integer() and abs(value) < 2**53 else value


# ---- metadata


@dataclass(frozen=True, slots=True)
class TypedValue:
    """A metadata value with an explicit type: an object with exactly the keys `type` and `value`."""

    type: str
    value: Any


# Number of components of each type; 0 for a value that is not a list of numbers.
_COMPONENTS_BY_TYPE = {
    "int": 0, "float": 0, "string": 0, "dict": 0, "array": 0, "vector2": 2, "vector": 3, "vector3": 3, "vector4": 4,
    "quaternion": 4, "matrix2": 4, "matrix3": 9, "matrix": 16, "matrix4": 16,
}  # fmt: skip


def read_metadata(root: JsonNode, report: Report) -> dict[str, Any]:
    """Return the entries of a metadata document. Report wrong entries and omit them."""
    if not isinstance(root.value, dict):
        report.error(
            "wrong-value",
            f"metadata must consist of names with values, not of {root.kind}",
            root.marked_span,
            'write `{"name": 1}`',
        )
        return {}
    return {key: _read_value(each, report) for key, each in root.value.items()}


def _read_value(node: JsonNode, report: Report) -> Any:
    """Return a metadata value; None after an error."""
    if isinstance(node.value, bool) or node.value is None:
        help = f"write `{int(node.value)}`" if node.value is not None else "delete the key"
        words = f"expected a text, a number, a list or `{{ … }}` here, not {node.kind}"
        report.error("wrong-value", words, node.marked_span, help)
        return 0
    if isinstance(node.value, list):
        return [_read_value(each, report) if isinstance(each, JsonNode) else each for each in node.value]
    if isinstance(node.value, dict):
        if set(node.value) == {"type", "value"}:
            return _read_typed_value(node.value["type"], node.value["value"], report)
        return read_metadata(node, report)
    return node.value


def _read_typed_value(kind: JsonNode, inner: JsonNode, report: Report) -> TypedValue | None:
    """Return a metadata value with an explicit type; None after an error."""
    name, value = kind.value, _read_value(inner, report)
    if not isinstance(name, str) or not name:
        report.error(
            "wrong-value",
            f"the name of a type must be a text, not {kind.kind}",
            kind.marked_span,
            'write it in quotes, such as `"float"`',
        )
        return None
    if name not in _COMPONENTS_BY_TYPE:
        report_unknown_name(report, kind.span, "type of metadata", name, _COMPONENTS_BY_TYPE, is_warning=True)
    elif not _matches_type(name, value):
        count = _COMPONENTS_BY_TYPE[name]
        expectation = f"a list of {count} numbers" if count else f"a value of the type `{name}`"
        help = (
            f"write the whole number `{round(value)}`, or change the type to `float`"
            if isinstance(value, float) and name == "int"
            else None
        )
        report.error("wrong-value", f"expected {expectation} here", inner.marked_span, help)
    return TypedValue(name, value)


def _matches_type(name: str, value: Any) -> bool:
    """Return whether a value matches a metadata type."""
    count = _COMPONENTS_BY_TYPE[name]
    if count:
        numbers = isinstance(value, list) and all(isinstance(each, int | float) for each in value)
        return numbers and len(value) == count
    expected_type = {"int": int, "float": int | float, "string": str, "dict": dict, "array": list}[name]
    return isinstance(value, expected_type)


def to_plain_metadata(metadata: Mapping[str, Any]) -> dict[str, Any]:
    """Return metadata as plain JSON values. A typed value becomes an object with `type` and `value`."""
    return {key: _to_plain_value(value) for key, value in metadata.items()}


def _to_plain_value(value: Any) -> Any:
    """Return a metadata value as a plain JSON value."""
    if isinstance(value, TypedValue):
        return {"type": value.type, "value": _to_plain_value(value.value)}
    if isinstance(value, Mapping):
        return to_plain_metadata(value)
    return [_to_plain_value(each) for each in value] if isinstance(value, list | tuple) else value


def write_metadata(metadata: Mapping[str, Any]) -> str:
    """Return metadata as text in Houdini's form. Typed values are written with their type."""
    return format_json(to_plain_metadata(metadata))


def format_json(value: Any) -> str:
    """Return JSON in antdsl's file style: two spaces per level, lists of numbers on one line, a final line end."""
    text = json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False)
    return _NUMBER_LIST_PATTERN.sub(lambda match: f"[{', '.join(match[1].replace(',', ' ').split())}]", text) + "\n"
