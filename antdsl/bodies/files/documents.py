"""The documented JSON forms of an agent definition's parts, read and written: rig (`rig_version` 1), layer and transform group
(`version` 2), metadata (`definition_parts.py`). The forms are those of the page Agent Primitives of Houdini 20.5.

The rest pose of a rig has no documented form: `antdsl_rest`, a matrix a joint, is our own."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.bodies.agents.definition import Binding, Channel, Layer, Rig, TransformGroup
from antdsl.bodies.files.checked_values import Values
from antdsl.bodies.files.definition_parts import plain_metadata
from antdsl.bodies.files.json_text import Node, read_json
from antdsl.diagnostics import Report
from antdsl.scene.document import decode
from antdsl.source import Span

REST = "antdsl_rest"
DEFORMERS = ("linearskinning", "dualquatskinning", "dualquatblendskinning")
DOCUMENTED_DEFORMERS = ("blendshape", *DEFORMERS, *(f"blendshape+{name}" for name in DEFORMERS))
T = TypeVar("T")
_ROWS = re.compile(r"\[\n([-+0-9.eE,\s]+)\]")  # strings contain no raw line breaks, so that none can look like this


def read_part(data: bytes, name: str, what: str, read: Callable[[Values, Node], T]) -> tuple[T | None, Report]:
    """Read a part from a file's bytes with a reader of this package: `read_part(data, "rig.json", "a rig", read_rig)`. `what`
    names the expected part in findings. Returns None if one of them is an error."""
    source, report = decode(data, name, what)
    if not report.ok:
        return None, report
    node, report = read_json(source, what)
    if node is None:
        return None, report
    values = Values(source, report)
    part = read(values, node)
    return (part if report.ok else None), report


# ---- rig


def read_rig(values: Values, node: Node) -> Rig | None:
    """A rig: `transforms` maps each joint to the list of its children, in any order; `channels` are optional."""
    known = ("rig_version", "transforms", "channels", REST)
    entries = values.object(node, "a rig", known, {"rig_version": "1", "transforms": "{}"}, strict=False)
    if entries is None or "transforms" not in entries:
        return None
    values.version(entries, "rig_version", 1)
    tree = _read_tree(values, entries["transforms"])
    if tree is None:
        return None
    names, parents = tree
    rest = np.tile(np.eye(4), (len(names), 1, 1))
    if REST in entries:
        _read_rest(values, entries[REST], names, rest)
    channels = _read_channels(values, entries["channels"], names) if "channels" in entries else ()
    return Rig(names, np.array(parents, np.int32), rest, channels)


def _read_tree(values: Values, node: Node) -> tuple[tuple[str, ...], list[int]] | None:
    """Return joints and the number of each one's parent, in the order of the text. If parents do not come first there, the order
    goes from the roots down."""
    if not isinstance(node.value, dict):
        values.report_wrong(node, "an object of joints, each with a list of its children,", 'write `{"root": []}`')
        return None
    joints = node.value
    if not joints or len(joints) > limits.JOINTS:
        words = "a rig has at least one joint" if not joints else f"a rig has at most {limits.JOINTS:,} joints"
        code = "too-large" if joints else "bad-rig"
        values.report.error(code, words, values.start_span(node), None if joints else 'write `{"root": []}`')
        return None
    parent: dict[str, tuple[str, Span]] = {}
    children: dict[str, list[str]] = {name: [] for name in joints}
    for name, inner in joints.items():
        values.text(Node(name, *node.keys[name]), "the name of a joint")
        for each in values.items(inner, "names of joints"):
            child = values.text(each, "the name of a joint")
            if child is None:
                continue
            place = values.span(each)
            if child not in joints:
                free = [other for other in joints if other not in parent]
                _report_missing_child(values, place, name, child, free)
            elif child in parent:
                other, first = parent[child]
                if other == name:
                    values.report_repeated(each, f"`{child}` is listed twice as a child of `{name}`", first)
                else:
                    words = f"the joint `{child}` has two parents, `{other}` and `{name}`"
                    values.report.error("bad-rig", words, place, f"delete `{child}` below one of them")
            else:
                parent[child] = (name, place)
                children[name].append(child)
    _refuse_circles(values, parent)
    if not values.report.ok:
        return None
    positions = {name: count for count, name in enumerate(joints)}
    if all(positions[each[0]] < positions[name] for name, each in parent.items()):
        return tuple(joints), [positions[parent[name][0]] if name in parent else -1 for name in joints]
    names: list[str] = []
    waiting = [name for name in reversed(joints) if name not in parent]
    while waiting:
        names.append(waiting.pop())
        waiting += reversed(children[names[-1]])
    number = {name: count for count, name in enumerate(names)}
    return tuple(names), [number[parent[name][0]] if name in parent else -1 for name in names]


def _report_missing_child(values: Values, place: Span, name: str, child: str, free: list[str]) -> None:
    from antdsl.diagnostics.suggestion import nearest_name

    near = nearest_name(child, free)
    help = f'write `"{near}"`' if near else f'add `"{child}": []` to the transforms'
    values.report.error("bad-rig", f"`{name}` has a child `{child}` that is not among the transforms", place, help)


def _refuse_circles(values: Values, parent: Mapping[str, tuple[str, Span]]) -> None:
    """Report each cycle once, at the line that closes it."""
    visited: set[str] = set()
    for start in parent:
        chain: dict[str, None] = {}
        name = start
        while name in parent and name not in visited:
            if name in chain:
                circle = list(chain)[list(chain).index(name) :]
                circle_text = " below ".join(f"`{each}`" for each in [*circle[:4], *(["…"] if len(circle) > 4 else []), name])
                words = f"the joints {circle_text} hang below each other in a circle"
                values.report.error("bad-rig", words, parent[name][1], f"delete `{name}` here, so that one of them is a root")
                break
            chain[name] = None
            name = parent[name][0]
        visited.update(chain)


def _read_rest(values: Values, node: Node, names: tuple[str, ...], rest: NDArray[np.float64]) -> None:
    entries = values.object(node, "a rest pose", names, strict=True)
    number = {name: count for count, name in enumerate(names)}
    for name, each in (entries or {}).items():
        rows = [values.numbers(row, "a row of a matrix", 4) for row in values.items(each, "rows of a matrix")]
        if not rows:
            continue
        if len(rows) != 4:
            values.report.error(
                "wrong-value", f"a matrix must have 4 rows, but this one has {len(rows)}", values.start_span(each), None
            )
        if len(rows) != 4 or name not in number or any(row is None for row in rows):
            continue
        matrix = np.array(rows)
        if (matrix[3] != (0, 0, 0, 1)).any():
            words = f"the last row of the rest pose of `{name}` is not `[0, 0, 0, 1]`"
            help = "write the translation into the last column" if (matrix[:3, 3] == 0).all() else "write `[0, 0, 0, 1]`"
            values.report.error("wrong-value", words, values.start_span(each), help)
            continue
        rest[number[name]] = matrix


def _read_channels(values: Values, node: Node, names: tuple[str, ...]) -> tuple[Channel, ...]:
    if not isinstance(node.value, dict):
        values.report_wrong(node, "an object of channels", 'write `{"NAME": {"default_value": 0, "transform": ""}}`')
        return ()
    if len(node.value) > limits.CHANNELS:
        values.report.error("too-large", f"a rig has at most {limits.CHANNELS:,} channels", values.start_span(node), None)
        return ()
    channels = []
    for name, each in node.value.items():
        values.text(Node(name, *node.keys[name]), "the name of a channel")
        entries = values.object(each, "a channel", ("default_value", "transform"), strict=False)
        if entries is None:
            continue
        default = values.number(entries.get("default_value"), "the default of a channel")
        joint = values.text(entries.get("transform"), "the name of a joint", empty=True) or ""
        if joint and joint not in names:
            values.report_unknown(values.span(entries["transform"]), "joint", joint, names)
        channels.append(Channel(name, default or 0.0, joint))
    return tuple(channels)


def write_rig(rig: Rig) -> str:
    """A rig as text in the documented form, with our own rest pose where there is one."""
    children: dict[str, list[str]] = {name: [] for name in rig.names}
    for name, parent in zip(rig.names, rig.parents, strict=True):
        if parent >= 0:
            children[rig.names[parent]].append(name)
    document: dict[str, Any] = {"rig_version": 1, "transforms": children}
    if rig.channels:
        document["channels"] = {c.name: {"default_value": _integral(c.default), "transform": c.transform} for c in rig.channels}
    moved = [joint for joint in range(len(rig.names)) if (rig.rest[joint] != np.eye(4)).any()]
    if moved:
        document[REST] = {rig.names[j]: [[_integral(float(v)) for v in row] for row in rig.rest[j]] for j in moved}
    return json_text(document)


# ---- layers and transform groups


def read_layer(values: Values, node: Node) -> Layer | None:
    """A layer: a name, and lists of static and of deforming bindings of shapes to joints."""
    known = ("version", "name", "static", "deforming")
    entries = values.object(node, "a layer", known, {"version": "2", "name": '"…"'}, strict=False)
    if entries is None:
        return None
    values.version(entries, "version", 2)
    name = values.text(entries.get("name"), "the name of a layer")
    static, deforming = (
        tuple(
            filter(None, (_read_binding(values, each, kind == "deforming") for each in values.items(entries[kind], "bindings")))
        )
        if kind in entries
        else ()
        for kind in ("static", "deforming")
    )
    return Layer(name, static, deforming) if name is not None else None


def _read_binding(values: Values, node: Node, deforming: bool) -> Binding | None:
    known = ("transform", "shape", "bounds_scale", "deformer")
    needed = {"shape": '"…"'} | ({"deformer": '"linearskinning"'} if deforming else {"transform": '"…"'})
    entries = values.object(node, "a binding", known, needed, strict=False)
    if entries is None:
        return None
    joint = values.text(entries.get("transform"), "the name of a joint", empty=deforming)
    shape = values.text(entries.get("shape"), "the name of a shape")
    deformer = values.text(entries.get("deformer"), "the name of a deformer", empty=not deforming) or ""
    if deformer and not deforming:
        words = f"a static shape cannot have a deformer, but this one has `{deformer[:60]}`"
        values.report.error("wrong-value", words, values.span(entries["deformer"]), 'move it to `deforming`, or write `""`')
    scale = values.numbers(entries.get("bounds_scale"), "a scale of bounds", 3, least=0.0)
    bounds = (1.0, 1.0, 1.0) if scale is None else (float(scale[0]), float(scale[1]), float(scale[2]))
    if shape is None or (joint is None and not deforming):
        return None
    return Binding(joint or "", shape, bounds, deformer)


def write_layer(layer: Layer) -> str:
    """A layer as text in the documented form."""

    def bindings(layer_bindings: tuple[Binding, ...]) -> list[dict[str, Any]]:
        return [
            {
                "transform": each.transform,
                "shape": each.shape,
                "bounds_scale": [_integral(part) for part in each.bounds_scale],
                "deformer": each.deformer,
            }
            for each in layer_bindings
        ]

    return json_text({"version": 2, "name": layer.name, "static": bindings(layer.static), "deforming": bindings(layer.deforming)})


def read_group(values: Values, node: Node) -> TransformGroup | None:
    """A transform group: a name, joints with weights from 0 to 1 (1 where none is given), and channels."""
    known = ("version", "name", "members", "channels")
    entries = values.object(node, "a transform group", known, {"version": "2", "name": '"…"'}, strict=False)
    if entries is None:
        return None
    values.version(entries, "version", 2)
    name = values.text(entries.get("name"), "the name of a transform group")
    members = []
    for member, inner in _named_objects(values, entries.get("members"), "a member", ("name", "weight")):
        weight = values.number(inner.get("weight"), "a weight", 0.0, 1.0)
        members.append((member, 1.0 if weight is None else weight))
    channels = tuple(channel for channel, _ in _named_objects(values, entries.get("channels"), "a channel", ("name",)))
    return TransformGroup(name, tuple(members), channels) if name is not None else None


def _named_objects(values: Values, node: Node | None, what: str, known: tuple[str, ...]) -> list[tuple[str, Mapping[str, Node]]]:
    """Return the objects of a list, each with a unique name."""
    objects: dict[str, tuple[Span, Mapping[str, Node]]] = {}
    for each in values.items(node, "objects with a `name`") if node is not None else ():
        entries = values.object(each, what, known, {"name": '"…"'}, strict=False)
        name = values.text(entries.get("name"), f"the name of {what}") if entries is not None else None
        if entries is None or name is None:
            continue
        if name in objects:
            values.report_repeated(entries["name"], f"`{name}` is given twice", objects[name][0])
        else:
            objects[name] = (values.span(entries["name"]), entries)
    return [(name, entries) for name, (_, entries) in objects.items()]


def write_group(group: TransformGroup) -> str:
    """A transform group as text in the documented form."""
    members = [{"name": name, "weight": _integral(weight)} for name, weight in group.members]
    channels = [{"name": name} for name in group.channels]
    return json_text({"version": 2, "name": group.name, "members": members, "channels": channels})


def write_metadata(metadata: Mapping[str, Any]) -> str:
    """Metadata as text in the documented form, typed values with their type."""
    return json_text(plain_metadata(metadata))


def json_text(value: Any) -> str:
    """Return JSON in our file style: two spaces per level, lists of numbers on one line, a final line end."""
    text = json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False)
    return _ROWS.sub(lambda match: f"[{', '.join(match[1].replace(',', ' ').split())}]", text) + "\n"


def _integral(number: float) -> int | float:
    """A whole number without its fraction, as the documented forms write it."""
    return int(number) if float(number).is_integer() and abs(number) < 2**53 else float(number)
