"""An index of the names in a scene: names that programs declare, and files that the scene uses."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from antdsl.lsp.names import NameOccurrence
from antdsl.program.names.bindings import NameKey
from antdsl.program.tables.vocabulary import ITEM_ATTRIBUTE_TYPES
from antdsl.safe_read import resolve_path
from antdsl.scene.document import DocumentNode, MappingNode, ScalarNode, SequenceNode, read_document
from antdsl.scene.scene_model import FILE_FORM_KEYS
from antdsl.scene.thing_models import ItemThing
from antdsl.source import Source, Span
from antdsl.syntax.words import FIELD_SETTING_WORDS

_NAME_PATTERN = re.compile(r"[a-z][a-z_0-9]*")
# Keys with values that name a thing or an item, possibly of an extended scene.
_NAMING_KEYS = frozenset(("on", "around", "toward", "away", "border", "solved", "density"))


@dataclass(slots=True)
class SceneIndex:
    """The names in the text of a scene.

    `document`: the parsed text; None if it is not valid YAML. `files`: the files that the scene names. `fps`: the frame rate as
    written in the scene. `items`: the locations of the names of items."""

    path: Path
    document: MappingNode | None
    occurrences: list[NameOccurrence] = field(default_factory=list)
    files: list[Path] = field(default_factory=list)
    fps: str | None = None
    items: dict[str, Span] = field(default_factory=dict)  # names that this scene gives to single items

    def add_occurrence(self, span: Span, key: NameKey, declares: bool = False) -> None:
        """Record that a name occurs at a span. `declares`: whether this is the name's declaration."""
        self.occurrences.append(NameOccurrence(span, key, declares))


def build_scene_index(path: Path, text: str) -> SceneIndex:
    """Return the index of the names in a scene, in text order. The names are not checked."""
    document, _ = read_document(Source(str(path), text))
    index = SceneIndex(path, document)
    if document is None:
        return index
    for key, look in _INDEXERS_BY_KEY.items():
        if key in document.entries:
            look(index, document.entries[key])
    fps = document.entries.get("fps")
    index.fps = fps.text if isinstance(fps, ScalarNode) else None
    index.occurrences.sort(key=lambda occurrence: occurrence.span.start)
    return index


def _list_mapping_entries(node: DocumentNode | None) -> list[tuple[str, Span, DocumentNode]]:
    """Return the entries of a mapping as (key, span, value); [] for any other node."""
    return [(key, node.keys[key], value) for key, value in node.entries.items()] if isinstance(node, MappingNode) else []


def _index_file(index: SceneIndex, node: DocumentNode) -> None:
    """Record a file that the scene names. A value that contains `:` is not a file name."""
    if isinstance(node, ScalarNode) and ":" not in node.text:
        path = resolve_path(index.path.parent.joinpath(node.text))
        index.add_occurrence(node.span, ("file", str(path)))
        if path.suffix in (".ant", ".yaml", ".yml"):
            index.files.append(path)


def _index_world(index: SceneIndex, node: DocumentNode) -> None:
    """Record the names below `world`: things, items, attributes and files."""
    things = {name for name, _, _ in _list_mapping_entries(node)}
    for thing, span, value in _list_mapping_entries(node):
        index.add_occurrence(span, ("thing", thing))
        for word, place, inner in _list_mapping_entries(value):
            if isinstance(inner, MappingNode) and word not in ("keys", "maps", "each"):
                index.items[word] = place
                index.add_occurrence(place, ("scene-item", word), True)
                _index_item(index, thing, inner, things)
            elif word == "each":
                _index_attributes(index, thing, inner)
            elif word in FILE_FORM_KEYS:
                _index_file(index, inner)
            else:
                _index_named_thing(index, word, inner, things)


def _index_item(index: SceneIndex, thing: str, node: DocumentNode, things: set[str]) -> None:
    """Record the attributes of an item, and the thing on which the item is placed."""
    _index_attributes(index, thing, node)
    for word, _, inner in _list_mapping_entries(node):
        if word == "on":
            _index_named_thing(index, word, inner, things)


def _index_attributes(index: SceneIndex, thing: str, node: DocumentNode) -> None:
    """Record the keys of an item that name attributes which the program declares."""
    built_in_names = {*ItemThing.model_fields, *ITEM_ATTRIBUTE_TYPES}
    for word, span, _ in _list_mapping_entries(node):
        if word not in built_in_names:
            index.add_occurrence(span, ("attribute", thing, word))


def _index_named_thing(index: SceneIndex, key: str, node: DocumentNode, things: set[str]) -> None:
    """Record a value that may name a thing of the world or an item. The kind of the name is `?scene` if only the base scene
    could declare it."""
    if isinstance(node, ScalarNode):
        if node.text in things:
            index.add_occurrence(node.span, ("thing", node.text))
        elif node.text in index.items:
            index.add_occurrence(node.span, ("scene-item", node.text))
        elif key in _NAMING_KEYS and _NAME_PATTERN.fullmatch(node.text) and not node.is_quoted:
            index.add_occurrence(node.span, ("?scene", node.text))


def _index_crowd(index: SceneIndex, node: DocumentNode) -> None:
    """Record the species, files and things that crowd lines name."""
    world = index.document.entries.get("world") if index.document is not None else None
    things = {name for name, _, _ in _list_mapping_entries(world)}
    for line in node.items if isinstance(node, SequenceNode) else ():
        for word, _, value in _list_mapping_entries(line):
            if word == "species" and isinstance(value, ScalarNode):
                index.add_occurrence(value.span, ("species", value.text))
            elif word == "from":
                _index_file(index, value)
            elif word == "place":
                for key, _, inner in _list_mapping_entries(value):
                    if key == "points":
                        _index_file(index, inner)
                    elif key in ("on", "around", "density", "along", "edge", "facing"):
                        _index_named_thing(index, key, inner, things)
                    elif key == "in":
                        for name, _, part in _list_mapping_entries(inner):
                            _index_named_thing(index, name, part, things)
            elif word == "each":
                for _, _, draw in _list_mapping_entries(value):
                    for name, _, part in _list_mapping_entries(draw):
                        _index_named_thing(index, name, part, things if name == "painted" else set())


def _index_changed_values(index: SceneIndex, node: DocumentNode) -> None:
    """Record the params and field settings that `set` changes."""
    for name, span, _ in _list_mapping_entries(node):
        owner, dot, word = name.partition(".")
        if not dot or span.end - span.start != len(name):
            continue
        first = Span(span.source, span.start, span.start + len(owner))
        second = Span(span.source, span.start + len(owner) + 1, span.end)
        field = word in FIELD_SETTING_WORDS
        index.add_occurrence(first, ("field" if field else "species", owner))
        index.add_occurrence(second, ("setting", word) if field else ("own", owner, word))


def _index_fields(index: SceneIndex, node: DocumentNode) -> None:
    """Record the names of fields in the scene, and the things and files that their starting values name."""
    world = index.document.entries.get("world") if index.document is not None else None
    things = {name for name, _, _ in _list_mapping_entries(world)}
    for name, span, value in _list_mapping_entries(node):
        index.add_occurrence(span, ("field", name))
        for part in value.items if isinstance(value, SequenceNode) else (value,):
            for key, _, inner in _list_mapping_entries(part):
                if key == "values":
                    _index_file(index, inner)
                elif key in ("around", "on"):
                    _index_named_thing(index, key, inner, things if key == "on" else set())


def _index_layers(index: SceneIndex, node: DocumentNode) -> None:
    """Record the behaviours and layers in a list of layers. A layer is identified by its text, or by the first word of its
    text."""
    for species, span, value in _list_mapping_entries(node):
        index.add_occurrence(span, ("species", species))
        for item in value.items if isinstance(value, SequenceNode) else ():
            if not isinstance(item, ScalarNode) or item.text.strip() == "state":
                continue
            begin = item.span.start + item.is_quoted
            plain = item.span.source.text[begin : begin + len(item.text)] == item.text  # no `\\` in it
            for number, word in enumerate(_NAME_PATTERN.finditer(item.text) if plain else ()):
                place = Span(item.span.source, begin + word.start(), begin + word.end())
                index.add_occurrence(place, ("?layer", species, word[0]) if number else ("?behaviour", word[0]))


def _index_extends(index: SceneIndex, node: DocumentNode) -> None:
    _index_file(index, node)


def _index_camera(index: SceneIndex, node: DocumentNode) -> None:
    for word, _, value in _list_mapping_entries(node):
        if word == "usd":
            _index_file(index, value)


def _index_cameras(index: SceneIndex, node: DocumentNode) -> None:
    """Record the names below `cameras`, which programs may use, and the files of the cameras."""
    for name, span, value in _list_mapping_entries(node):
        index.add_occurrence(span, ("thing", name))
        _index_camera(index, value)


_INDEXERS_BY_KEY: dict[str, Any] = {
    "world": _index_world, "extends": _index_extends, "crowd": _index_crowd, "set": _index_changed_values,
    "fields": _index_fields, "layers": _index_layers, "camera": _index_camera,
    "cameras": _index_cameras,
}  # fmt: skip
