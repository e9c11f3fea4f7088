"""Values that a command sets for keys of a scene, such as `crowd.walker.count` or `world.ground.mesh`.

They replace values of the file before the scene is checked, so they cause the same errors as values in the file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from antdsl.diagnostics import Report
from antdsl.diagnostics.suggestion import find_nearest_name
from antdsl.scene.document import DocumentNode, MappingNode, ScalarNode, SequenceNode, decode_source, read_document
from antdsl.source import Span

# Keys of a scene that a name can begin with. Seeds and frames have options, and params have names of their own.
_SETTABLE_KEYS = (
    "units", "up", "fps", "preroll", "substeps", "stick", "orient", "contacts", "from", "world", "crowd", "fields", "layers",
    "lod", "camera", "cameras", "light",
)  # fmt: skip
_LINE_NAME_KEYS = ("name", "species")  # keys of a line of the crowd that identify it


def is_scene_value(name: str) -> bool:
    """Return whether a name is a key of a scene rather than a param of a program."""
    return name.partition(".")[0] in _SETTABLE_KEYS


def select_params(values: Mapping[str, str]) -> dict[str, str]:
    """Return those values that are values of params, not of keys of the scene."""
    return {name: text for name, text in values.items() if not is_scene_value(name)}


def replace_entries(document: MappingNode, values: Mapping[str, str], report: Report) -> MappingNode | None:
    """Return the tree of a scene with new values for some keys. Return None after errors, which are added to the report.

    `values`: the new values as text. Their keys are the scene keys on the path, joined with `.`. A crowd line is identified by
    its `name`, its species or its index. Names of params are ignored."""
    for name, text in values.items():
        if is_scene_value(name):
            source, findings = decode_source(f"value: {text}".encode("utf-8", "replace"), f"<{name}>", "a value")
            value = None
            if findings.ok:
                value, findings = read_document(source, "the value", f"write `{name}=50`")
            report.extend(findings)
            if value is not None:
                document = _replace_entry(document, name.split("."), name, value.entries["value"], report)
    return document if report.ok else None


def _replace_entry(node: MappingNode, path: list[str], name: str, value: DocumentNode, report: Report) -> MappingNode:
    """Return a copy of a mapping in which the value at a path of keys is replaced. `path`: the keys, relative to the mapping.
    `name`: the complete name, for messages."""
    key, *rest = path
    if not rest:
        span: Span = node.keys.get(key, node.span)
        return replace(node, entries={**node.entries, key: value}, keys={**node.keys, key: span})
    inner = node.entries.get(key)
    if isinstance(inner, MappingNode):
        inner = _replace_entry(inner, rest, name, value, report)
    elif isinstance(inner, SequenceNode) and len(rest) > 1:
        number = _find_line(inner, rest[0], name, report)
        line = None if number is None else inner.items[number]
        if number is None or not isinstance(line, MappingNode):
            return node
        changed = _replace_entry(line, rest[1:], name, value, report)
        inner = replace(inner, items=(*inner.items[:number], changed, *inner.items[number + 1 :]))
    else:
        near = find_nearest_name(key, node.entries)
        advice = f"did you mean `{near}`?" if near else "name a key that the scene has"
        report.error("unknown-key", f"`{name}`: the scene has no mapping `{key}`", node.span, advice)
        return node
    return replace(node, entries={**node.entries, key: inner})


def _find_line(lines: SequenceNode, word: str, name: str, report: Report) -> int | None:
    """Return the index of the crowd line that a word identifies, or None after an error."""
    if word.isdecimal() and int(word) < len(lines.items):
        return int(word)
    names = [
        {each.text for key in _LINE_NAME_KEYS if isinstance(each := line.entries.get(key), ScalarNode)}
        if isinstance(line, MappingNode)
        else set()
        for line in lines.items
    ]
    numbers = [number for number, each in enumerate(names) if word in each]
    if len(numbers) == 1:
        return numbers[0]
    known = ", ".join(f"`{each}`" for each in dict.fromkeys(word for each in names for word in sorted(each)))
    message = f"`{name}`: {'several lines' if numbers else 'no line'} of the crowd {'are' if numbers else 'is'} called `{word}`"
    advice = f"write its number from 0: `crowd.{numbers[0]}.count`" if numbers else f"write one of {known}, or a number from 0"
    report.error("unknown-key", message, lines.span, advice)
    return None
