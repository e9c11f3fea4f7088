"""Merges a scene with the scenes that it `extends`. The scene's own values override theirs, separately in each mapping.

Every value retains its location in its source file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from antdsl import limits
from antdsl.diagnostics import Report
from antdsl.scene.document import DocumentNode, MappingNode, ScalarNode, decode_source, read_document
from antdsl.scene.paths import PathRefused, Roots
from antdsl.source import Span

EXTENDS_KEY = "extends"
_UNINHERITED_KEYS = frozenset((EXTENDS_KEY, "antdsl"))  # keys that are not inherited


def merge_parents(
    document: MappingNode, name: str, roots: Roots, report: Report, unsaved_texts: Mapping[Path, bytes] | None = None
) -> MappingNode | None:
    """Return the tree of a scene, merged with all scenes that it extends, nearest first. Return None if the report has errors.

    A parent scene is looked up relative to the scene that names it.
    `unsaved_texts`: contents that override files on disk, for scenes that are open in an editor."""
    scene_names = [name.replace("\\", "/").rsplit("/", 1)[-1]]
    behind = document
    while (node := behind.entries.get(EXTENDS_KEY)) is not None:
        other = _read_parent(node, name, scene_names, roots, report, unsaved_texts or {})
        if other is None:
            return None
        document, behind = _merge_mappings(document, other, _UNINHERITED_KEYS), other
    return MappingNode(
        {key: value for key, value in document.entries.items() if key != EXTENDS_KEY},
        {key: span for key, span in document.keys.items() if key != EXTENDS_KEY},
        document.span,
    )


def _read_parent(
    node: DocumentNode, name: str, scene_names: list[str], roots: Roots, report: Report, unsaved_texts: Mapping[Path, bytes]
) -> MappingNode | None:
    text = node.text.strip() if isinstance(node, ScalarNode) else ""
    if not text:
        report.error("wrong-value", "expected the name of a scene here", node.span, f"write `{EXTENDS_KEY}: base.yaml`")
        return None
    if "/" in text or "\\" in text:
        words = f"`{text[:80]}` is not next to this scene"
        report.error("bad-path", words, node.span, "move it into this folder and write only its name")
        return None
    if text in scene_names:
        circle = " → ".join(f"`{each}`" for each in [*scene_names[scene_names.index(text) :], text])
        words = f"these scenes extend each other in a circle: {circle}"
        report.error("circle", words, node.span, "remove the inheritance from one of them")
        return None
    if len(scene_names) > limits.MAX_USE_DEPTH:
        report.error(
            "too-deep", f"`extends` is nested more than {limits.MAX_USE_DEPTH} scenes deep", node.span, "merge some of them"
        )
        return None
    scene_names.append(text)
    try:
        held = unsaved_texts.get(roots.resolve_path(text))
        data = roots.read_file(text, limits.MAX_SCENE_BYTES) if held is None else held
    except PathRefused as error:
        report.error(error.code, str(error), node.span, error.help)
        return None
    head, sign, _ = name.replace("\\", "/").rpartition("/")
    source, findings = decode_source(data, f"{head}{sign}{text}")
    report.extend(findings)
    if not findings.ok:
        return None
    other, findings = read_document(source)
    report.extend(findings)
    return other


def _merge_mappings(child: MappingNode, parent: MappingNode, excluded_keys: frozenset[str] = frozenset()) -> MappingNode:
    """Return two mappings merged key by key. Where both have a key and its values are not both mappings, the value of `child` is
    used.

    Values of keys in `excluded_keys` are never merged, only replaced."""
    entries: dict[str, DocumentNode] = {key: value for key, value in parent.entries.items() if key not in excluded_keys}
    keys: dict[str, Span] = {key: span for key, span in parent.keys.items() if key not in excluded_keys}
    for key, value in child.entries.items():
        other_value = entries.get(key)
        both = isinstance(value, MappingNode) and isinstance(other_value, MappingNode)
        entries[key] = _merge_mappings(value, other_value) if both else value  # type: ignore[arg-type]
        keys[key] = child.keys[key]
    return MappingNode(entries, keys, child.span)
