"""Navigation from a name to its declaration, to all its occurrences, and to a new name in all of them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from antdsl import limits
from antdsl.lsp.features.tokens import keywords
from antdsl.lsp.names import Occurrence
from antdsl.lsp.text import Range
from antdsl.lsp.workspace import Document, Workspace
from antdsl.program.names.bindings import Key
from antdsl.program.names.declared import Declaration
from antdsl.program.tables.vocabulary import BUILTINS, GIVEN, HIT_GIVEN, ITEM_GIVEN, REDUCERS, RESERVED, RUN_NAMES, SENSED_NAMES
from antdsl.program.types.states import STATE_WORDS
from antdsl.source import Source, Span

# Kinds of names that an author gives; the others are words of the language.
GIVEN_BY_AUTHOR = frozenset(
    ("thing", "attribute", "field", "species", "own", "machine", "state", "let", "event", "behaviour", "inner", "element",
     "alias", "scene-item")
)  # fmt: skip
_NAME = re.compile(r"[a-z][a-z_0-9]*")
_TAKEN = frozenset({*RUN_NAMES, *SENSED_NAMES, *RESERVED, *STATE_WORDS, "self", "true", "false", "it"})
_UNKNOWN = {
    "?": ("thing", "field", "species"), "?state": ("state",), "?behaviour": ("behaviour",), "?member": ("own", "attribute"),
    "?scene": ("thing", "scene-item"), "?layer": ("own", "thing", "field", "species", "behaviour", "inner"),
}  # fmt: skip


class Refused(Exception):
    """A rename that would change what a program means; the text says why."""


@dataclass(frozen=True, slots=True)
class Found:
    document: Document
    span: Span

    @property
    def range(self) -> Range:
        return self.document.range(self.span)


def declared(workspace: Workspace, document: Document, key: Key) -> tuple[Document, Declaration] | None:
    """Return where a symbol is declared. The document has priority over other files."""
    if key[0] in ("behaviour", "inner", "alias"):
        paths = [Path(key[1])]
    else:
        paths = [document.path, *(path for path in workspace.family(document.path) if path != document.path)]
    brought = None
    for path in paths:
        other = workspace.document(path)
        if other is None or not other.is_program:
            continue
        for each in _meant(other, key):
            found = other.names.declared.get(each)
            if found is not None and (key[0] != "species" or hasattr(found.node, "members")):
                return other, found
            brought = brought or ((other, found) if found is not None else None)
    return brought


def _meant(document: Document, key: Key) -> Iterator[Key]:
    """The keys that an unknown name may stand for in another file."""
    kinds = _UNKNOWN.get(key[0])
    if kinds is None:
        yield key
        return
    for each in document.names.declared:
        if each[0] in kinds and each[-1] == key[-1] and not (key[0] == "?layer" and each[0] == "own" and each[1] != key[1]):
            yield each


def occurrence_at(document: Document, offset: int) -> Occurrence | None:
    found = document.at(offset)
    return found[0] if found else None


def definition(workspace: Workspace, document: Document, offset: int) -> list[Found]:
    """Return where the name at an offset is declared: in this file, another file or the library. If a file is named, return that
    file."""
    found: dict[tuple[Path, int], Found] = {}
    for occurrence in document.at(offset):
        key = occurrence.key
        if key[0] in ("file", "library"):
            for other in _files(workspace, key):
                return [Found(other, Span(_source(other), 0, 0))]
        elif key[0] == "element":
            return [Found(document, each.span) for each in document.occurrences if each.key == key and each.declares]
        elif key[0] in ("scene-item", "?scene") and (items := list(_items(workspace, document, key[-1]))):
            return items[:1]
        else:
            place = declared(workspace, document, key)
            if place is not None:
                found.setdefault((place[0].path, place[0].start(place[1].name.span)), Found(place[0], place[1].name.span))
        if found and occurrence.span != document.at(offset)[0].span:
            break
    return list(found.values())


def _items(workspace: Workspace, document: Document, name: str) -> Iterator[Found]:
    """Yield where scenes name an item: this scene, and those that it extends or that extend it."""
    for path in workspace.extending(document.path):
        other = workspace.document(path)
        if other is not None and name in other.scene.items:
            yield Found(other, other.scene.items[name])


def _files(workspace: Workspace, key: Key) -> Iterator[Document]:
    from antdsl.resources import library_file

    path = library_file(key[1]) if key[0] == "library" else Path(key[1])
    document = workspace.document(path.resolve()) if path is not None else None
    if document is not None:
        yield document


def _source(document: Document) -> Source:
    return document.parsed[0].source if document.is_program else Source(str(document.path), document.text.text)


def references(workspace: Workspace, document: Document, offset: int, declaration: bool = True) -> list[Found]:
    """Return all references to the same symbol, in all related files."""
    keys = {meant(workspace, document, each.key) for each in _same_place(document, offset)}
    found: dict[tuple[Path, int], Found] = {}
    for other, occurrence in _all(workspace, document, keys):
        if declaration or not occurrence.declares:
            found.setdefault((other.path, other.start(occurrence.span)), Found(other, occurrence.span))
    return sorted(
        found.values(), key=lambda each: (each.document.path != document.path, each.document.path, each.document.start(each.span))
    )


def meant(workspace: Workspace, document: Document, key: Key) -> Key:
    """Return the key of a name that this file alone does not resolve: an item of the base scene, or a declaration of a
    program."""
    if key[0] not in _UNKNOWN:
        return key
    if key[0] == "?scene" and any(_items(workspace, document, key[1])):
        return ("scene-item", key[1])
    found = declared(workspace, document, key)
    return found[1].key if found is not None else key


def _same_place(document: Document, offset: int) -> list[Occurrence]:
    found = document.at(offset)
    return [each for each in found if each.span == found[0].span]


def _all(workspace: Workspace, document: Document, keys: set[Key]) -> Iterator[tuple[Document, Occurrence]]:
    if any(key[0] == "element" for key in keys):
        paths = [document.path]
    elif any(key[0] == "scene-item" for key in keys):
        paths = workspace.extending(document.path)
    else:
        paths = workspace.family(document.path)
        paths += [Path(key[1]) for key in keys if key[0] in ("behaviour", "inner") and Path(key[1]) not in paths]
    known = {key[-1]: key for key in keys}
    for path in paths:
        other = workspace.document(path)
        for occurrence in other.occurrences if other is not None else ():
            key = occurrence.key
            asked = known.get(key[-1]) if key[0] in _UNKNOWN else None
            elsewhere = key[0] == "?layer" and asked is not None and asked[0] == "own" and asked[1] != key[1]
            if key in keys or (asked is not None and asked[0] in _UNKNOWN[key[0]] and not elsewhere):
                assert other is not None
                yield other, occurrence


# --- rename ----------------------------------------------------------------------------------------------------------


def renamable(workspace: Workspace, document: Document, offset: int) -> Occurrence:
    """Return the renamable name at an offset. Raises Refused when there is none."""
    found = occurrence_at(document, offset)
    if found is None:
        raise Refused("there is no name here")
    found = replace(found, key=meant(workspace, document, found.key))
    word = found.span.text.strip('"')
    if found.key[0] not in GIVEN_BY_AUTHOR or (found.key[0] == "event" and found.key[1] in ("spawn", "collision")):
        raise Refused(f"`{word}` is a word of the language, or is declared nowhere")
    return found


def rename(workspace: Workspace, document: Document, offset: int, new: str) -> list[Found]:
    """Return all positions that a new name must be written to. Names that `take` and `give` bind together are renamed
    together."""
    first = renamable(workspace, document, offset)
    if not _NAME.fullmatch(new) or len(new) > limits.NAME_CHARACTERS:
        raise Refused(f"`{new[:80]}` is no name: small letters, digits and `_`, beginning with a letter")
    called = first.key[0] == "behaviour" and (new in BUILTINS or new in REDUCERS)
    if new in _TAKEN or new in keywords() or called or _given(first.key, new):
        raise Refused(f"`{new}` is a word of the language")
    keys = _bound_together(workspace, document, {meant(workspace, document, each.key) for each in _same_place(document, offset)})
    places = {(other.path, other.start(each.span)): (other, each) for other, each in _all(workspace, document, keys)}
    for key in keys:
        place = declared(workspace, document, key)
        if place is not None and not _own(workspace, place[0].path):
            raise Refused(f"`{first.span.text}` belongs to the library, which is not changed from here")
        _refuse_collision(workspace, document, key, new)
    return [Found(other, each.span) for other, each in places.values()]


def _own(workspace: Workspace, path: Path) -> bool:
    from antdsl.resources import behaviours_folder

    inside = path.is_relative_to(behaviours_folder().resolve())
    return not inside or any(path.is_relative_to(root) for root in workspace.roots)


def _given(key: Key, new: str) -> bool:
    if key[0] in ("own", "let", "machine"):
        return new in GIVEN
    return key[0] == "attribute" and (new in ITEM_GIVEN or new in HIT_GIVEN)


def _bound_together(workspace: Workspace, document: Document, keys: set[Key]) -> set[Key]:
    """Return the keys that are renamed together with `keys`. `take 1 load from meal` names the animal's `load` and the food's at
    once: if one is renamed, so is the other."""
    pairs: list[set[Key]] = []
    for path in workspace.family(document.path):
        other = workspace.document(path)
        by_place: dict[int, set[Key]] = {}
        for each in other.occurrences if other is not None else ():
            assert other is not None
            by_place.setdefault(other.start(each.span), set()).add(each.key)
        pairs += [found for found in by_place.values() if len(found) > 1]
    grown = True
    while grown:
        before = len(keys)
        keys = keys.union(*(pair for pair in pairs if pair & keys))
        grown = len(keys) > before
    return keys


def _refuse_collision(workspace: Workspace, document: Document, key: Key, new: str) -> None:
    """Raise Refused for a name that is already in use in the scope of the renamed one, or that would hide it."""
    rivals: set[Key] = {(*key[:-1], new)}
    if key[0] in ("own", "let", "machine"):
        rivals |= {("own", key[1], new), ("machine", key[1], new)}
    if key[0] in ("thing", "field", "species", "event"):
        rivals |= {(kind, new) for kind in ("thing", "field", "species", "event")}
    hiding = key[0] in ("thing", "field", "species", "event", "own", "let", "element", "inner")
    for path in {*workspace.family(document.path), *([Path(key[1])] if key[0] in ("behaviour", "inner") else [])}:
        other = workspace.document(path)
        if other is None:
            continue
        names = other.names.declared if other.is_program else {}
        for rival in rivals:
            if rival in names or (rival[0] == "scene-item" and not other.is_program and new in other.scene.items):
                raise Refused(f"there is a `{new}` already: {other.path.name}")
        if not (hiding and other.is_program):
            continue
        for each in names:
            if each[-1] == new and each[0] in ("own", "let", "inner", "thing", "field", "species", "event") and _meets(key, each):
                raise Refused(f"there is a `{new}` already that would be seen in its place: {other.path.name}")
        if any(each.key[0] == "element" and each.span.text == new for each in other.occurrences):
            raise Refused(f"a local `{new}` in {other.path.name} would hide it")


def _meets(key: Key, other: Key) -> bool:
    """Whether two names can be seen from one place."""
    world = ("thing", "field", "species", "event")
    if key[0] in world or other[0] in world:
        return key[0] in world or key[0] in ("own", "let", "element", "inner")
    if key[0] == "inner" or other[0] == "inner":
        return key[:3] == other[:3] or key[0] == "element"
    return key[0] == "element" or key[1] == other[1]
