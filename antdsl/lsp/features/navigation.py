"""Navigation from a name to its declaration and its occurrences, and renaming."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from antdsl import limits
from antdsl.lsp.features.tokens import list_keywords
from antdsl.lsp.names import NameOccurrence
from antdsl.lsp.text import TextRange
from antdsl.lsp.workspace import OpenDocument, Workspace
from antdsl.program.names.bindings import NameKey
from antdsl.program.names.file_declarations import Declaration
from antdsl.program.tables import vocabulary
from antdsl.program.types.states import STATE_WORDS
from antdsl.source import Source, Span

# Kinds of names that authors choose; the others are words of the language.
AUTHOR_NAME_KINDS = frozenset(
    ("thing", "attribute", "field", "species", "own", "machine", "state", "let", "event", "behaviour", "inner", "element",
     "alias", "scene-item", "measure")
)  # fmt: skip
_NAME_PATTERN = re.compile(r"[a-z][a-z_0-9]*")
_RESERVED_NAMES = frozenset(
    {
        *vocabulary.RUN_VALUE_TYPES,
        *vocabulary.SENSE_TYPE_BY_NAME,
        *vocabulary.RESERVED_WORDS,
        *STATE_WORDS,
        "self",
        "true",
        "false",
        "it",
    }
)
_CANDIDATE_KINDS = {
    "?": ("thing", "field", "species", "measure"), "?state": ("state",), "?behaviour": ("behaviour",),
    "?member": ("own", "attribute"),
    "?scene": ("thing", "scene-item"), "?layer": ("own", "thing", "field", "species", "behaviour", "inner"),
}  # fmt: skip


class RenameRejected(Exception):
    """Error for a rename that would change the meaning of a program. The message gives the reason."""


@dataclass(frozen=True, slots=True)
class NameLocation:
    """The location of a name in a document."""

    document: OpenDocument
    span: Span

    @property
    def range(self) -> TextRange:
        """Return the lines and columns of the name."""
        return self.document.find_range(self.span)


def find_declaration(workspace: Workspace, document: OpenDocument, key: NameKey) -> tuple[OpenDocument, Declaration] | None:
    """Return the document that declares a symbol, and the declaration. Return None if there is no declaration. A declaration in
    `document` has priority over those in other files."""
    if key[0] in ("behaviour", "inner", "alias"):
        paths = [Path(key[1])]
    else:
        paths = [document.path, *(path for path in workspace.find_related_files(document.path) if path != document.path)]
    brought = None
    for path in paths:
        other = workspace.find_document(path)
        if other is None or not other.is_program:
            continue
        for each in _list_candidate_keys(other, key):
            entry = other.names.declaration_by_key.get(each)
            if entry is not None and (key[0] != "species" or hasattr(entry.node, "members")):
                return other, entry
            brought = brought or ((other, entry) if entry is not None else None)
    return brought


def _list_candidate_keys(document: OpenDocument, key: NameKey) -> Iterator[NameKey]:
    """Yield the keys under which another file may declare a name that has no known meaning in this file."""
    kinds = _CANDIDATE_KINDS.get(key[0])
    if kinds is None:
        yield key
        return
    for each in document.names.declaration_by_key:
        if each[0] in kinds and each[-1] == key[-1] and not (key[0] == "?layer" and each[0] == "own" and each[1] != key[1]):
            yield each


def find_occurrence_at(document: OpenDocument, offset: int) -> NameOccurrence | None:
    """Return the occurrence of a name at an offset, or None."""
    occurrences = document.find_occurrences(offset)
    return occurrences[0] if occurrences else None


def find_definition(workspace: Workspace, document: OpenDocument, offset: int) -> list[NameLocation]:
    """Return where the name at an offset is declared: in this file, another file or a library.

    If the offset is in the path of a file, return the start of that file."""
    locations: dict[tuple[Path, int], NameLocation] = {}
    for occurrence in document.find_occurrences(offset):
        key = occurrence.key
        if key[0] in ("file", "library"):
            for other in _find_related_documents(workspace, key):
                return [NameLocation(other, Span(_make_source(other), 0, 0))]
        elif key[0] == "element":
            return [NameLocation(document, each.span) for each in document.occurrences if each.key == key and each.is_declaration]
        elif key[0] in ("scene-item", "?scene") and (items := list(_find_item_locations(workspace, document, key[-1]))):
            return items[:1]
        else:
            place = find_declaration(workspace, document, key)
            if place is not None:
                locations.setdefault(
                    (place[0].path, place[0].find_start(place[1].name.span)), NameLocation(place[0], place[1].name.span)
                )
        if locations and occurrence.span != document.find_occurrences(offset)[0].span:
            break
    return list(locations.values())


def _find_item_locations(workspace: Workspace, document: OpenDocument, name: str) -> Iterator[NameLocation]:
    """Yield the locations of an item's name in this scene and in scenes related by `extends`."""
    for path in workspace.find_extending_scenes(document.path):
        other = workspace.find_document(path)
        if other is not None and name in other.scene.items:
            yield NameLocation(other, other.scene.items[name])


def _find_related_documents(workspace: Workspace, key: NameKey) -> Iterator[OpenDocument]:
    from antdsl.resources import find_library_file

    path = find_library_file(key[1]) if key[0] == "library" else Path(key[1])
    document = workspace.find_document(path.resolve()) if path is not None else None
    if document is not None:
        yield document


def _make_source(document: OpenDocument) -> Source:
    return document.parsed[0].source if document.is_program else Source(str(document.path), document.text.text)


def find_references(
    workspace: Workspace, document: OpenDocument, offset: int, include_declaration: bool = True
) -> list[NameLocation]:
    """Return all references to the symbol at an offset, in all related files."""
    keys = {resolve_key(workspace, document, each.key) for each in _find_occurrences_at(document, offset)}
    locations: dict[tuple[Path, int], NameLocation] = {}
    for other, occurrence in _find_all_occurrences(workspace, document, keys):
        if include_declaration or not occurrence.is_declaration:
            locations.setdefault((other.path, other.find_start(occurrence.span)), NameLocation(other, occurrence.span))
    return sorted(
        locations.values(),
        key=lambda occurrence: (
            occurrence.document.path != document.path,
            occurrence.document.path,
            occurrence.document.find_start(occurrence.span),
        ),
    )


def resolve_key(workspace: Workspace, document: OpenDocument, key: NameKey) -> NameKey:
    """Return the key under which another file declares a name.

    The other file is the base scene (for items) or a program. A key that this file declares is returned unchanged."""
    if key[0] not in _CANDIDATE_KINDS:
        return key
    if key[0] == "?scene" and any(_find_item_locations(workspace, document, key[1])):
        return ("scene-item", key[1])
    target = find_declaration(workspace, document, key)
    return target[1].key if target is not None else key


def _find_occurrences_at(document: OpenDocument, offset: int) -> list[NameOccurrence]:
    occurrences = document.find_occurrences(offset)
    return [each for each in occurrences if each.span == occurrences[0].span]


def _find_all_occurrences(
    workspace: Workspace, document: OpenDocument, keys: set[NameKey]
) -> Iterator[tuple[OpenDocument, NameOccurrence]]:
    if any(key[0] == "element" for key in keys):
        paths = [document.path]
    elif any(key[0] == "scene-item" for key in keys):
        paths = workspace.find_extending_scenes(document.path)
    else:
        paths = workspace.find_related_files(document.path)
        paths += [Path(key[1]) for key in keys if key[0] in ("behaviour", "inner") and Path(key[1]) not in paths]
    key_by_name = {key[-1]: key for key in keys}
    for path in paths:
        other = workspace.find_document(path)
        for occurrence in other.occurrences if other is not None else ():
            key = occurrence.key
            known_key = key_by_name.get(key[-1]) if key[0] in _CANDIDATE_KINDS else None
            elsewhere = key[0] == "?layer" and known_key is not None and known_key[0] == "own" and known_key[1] != key[1]
            if key in keys or (known_key is not None and known_key[0] in _CANDIDATE_KINDS[key[0]] and not elsewhere):
                assert other is not None
                yield other, occurrence


# --- rename ----------------------------------------------------------------------------------------------------------


def find_renamable_name(workspace: Workspace, document: OpenDocument, offset: int) -> NameOccurrence:
    """Return the name at an offset if it can be renamed. Raises RenameRejected if there is no such name."""
    occurrence = find_occurrence_at(document, offset)
    if occurrence is None:
        raise RenameRejected("no name at this position")
    occurrence = replace(occurrence, key=resolve_key(workspace, document, occurrence.key))
    word = occurrence.span.text.strip('"')
    if occurrence.key[0] not in AUTHOR_NAME_KINDS or (
        occurrence.key[0] == "event" and occurrence.key[1] in ("spawn", "collision")
    ):
        raise RenameRejected(f"`{word}` is a word of the language, or is declared nowhere")
    return occurrence


def rename_symbol(workspace: Workspace, document: OpenDocument, offset: int, new_name: str) -> list[NameLocation]:
    """Return all locations at which the new name must be written. Names that `take` and `give` link with each other are renamed
    together. Raises RenameRejected if the meaning would change."""
    first = find_renamable_name(workspace, document, offset)
    if not _NAME_PATTERN.fullmatch(new_name) or len(new_name) > limits.MAX_NAME_CHARACTERS:
        raise RenameRejected(f"`{new_name[:80]}` is not a name: write small letters, digits and `_`, beginning with a letter")
    is_function = first.key[0] == "behaviour" and (new_name in vocabulary.BUILTINS_BY_NAME or new_name in vocabulary.REDUCER_HELP)
    if new_name in _RESERVED_NAMES or new_name in list_keywords() or is_function or _is_built_in(first.key, new_name):
        raise RenameRejected(f"`{new_name}` is a word of the language")
    keys = _find_jointly_bound_keys(
        workspace, document, {resolve_key(workspace, document, each.key) for each in _find_occurrences_at(document, offset)}
    )
    occurrences = {
        (other.path, other.find_start(each.span)): (other, each)
        for other, each in _find_all_occurrences(workspace, document, keys)
    }
    for key in keys:
        place = find_declaration(workspace, document, key)
        if place is not None and not _is_own_file(workspace, place[0].path):
            raise RenameRejected(f"`{first.span.text}` belongs to the library, which cannot be changed here")
        _reject_collision(workspace, document, key, new_name)
    return [NameLocation(other, each.span) for other, each in occurrences.values()]


def _is_own_file(workspace: Workspace, path: Path) -> bool:
    from antdsl.resources import behaviours_folder

    inside = path.is_relative_to(behaviours_folder().resolve())
    return not inside or any(path.is_relative_to(root) for root in workspace.roots)


def _is_built_in(key: NameKey, new_name: str) -> bool:
    if key[0] in ("own", "let", "machine"):
        return new_name in vocabulary.BUILTIN_ATTRIBUTE_BY_NAME
    return key[0] == "attribute" and (new_name in vocabulary.ITEM_ATTRIBUTE_TYPES or new_name in vocabulary.HIT_ATTRIBUTE_TYPES)


def _find_jointly_bound_keys(workspace: Workspace, document: OpenDocument, keys: set[NameKey]) -> set[NameKey]:
    """Return `keys` and the keys of all names that must be renamed together with them.

    For example, the word `load` in `take 1 load from meal` names an attribute of the animal and one of the food. If one is
    renamed, the other must be renamed too."""
    pairs: list[set[NameKey]] = []
    for path in workspace.find_related_files(document.path):
        other = workspace.find_document(path)
        by_place: dict[int, set[NameKey]] = {}
        for each in other.occurrences if other is not None else ():
            assert other is not None
            by_place.setdefault(other.find_start(each.span), set()).add(each.key)
        pairs += [key_set for key_set in by_place.values() if len(key_set) > 1]
    has_grown = True
    while has_grown:
        old_count = len(keys)
        keys = keys.union(*(pair for pair in pairs if pair & keys))
        has_grown = len(keys) > old_count
    return keys


def _reject_collision(workspace: Workspace, document: OpenDocument, key: NameKey, new_name: str) -> None:
    """Raise RenameRejected if the new name is already used in the same scope, or if another name would hide it."""
    rivals: set[NameKey] = {(*key[:-1], new_name)}
    if key[0] in ("own", "let", "machine"):
        rivals |= {("own", key[1], new_name), ("machine", key[1], new_name)}
    if key[0] in ("thing", "field", "species", "event"):
        rivals |= {(kind, new_name) for kind in ("thing", "field", "species", "event")}
    hiding = key[0] in ("thing", "field", "species", "event", "own", "let", "element", "inner")
    for path in {*workspace.find_related_files(document.path), *([Path(key[1])] if key[0] in ("behaviour", "inner") else [])}:
        other = workspace.find_document(path)
        if other is None:
            continue
        names = other.names.declaration_by_key if other.is_program else {}
        for rival_key in rivals:
            if rival_key in names or (rival_key[0] == "scene-item" and not other.is_program and new_name in other.scene.items):
                raise RenameRejected(f"`{new_name}` already exists: {other.path.name}")
        if not (hiding and other.is_program):
            continue
        for each in names:
            if (
                each[-1] == new_name
                and each[0] in ("own", "let", "inner", "thing", "field", "species", "event")
                and _is_scope_shared(key, each)
            ):
                raise RenameRejected(f"`{other.path.name}` already declares a `{new_name}`, which would be used instead")
        if any(each.key[0] == "element" and each.span.text == new_name for each in other.occurrences):
            raise RenameRejected(f"a local `{new_name}` in {other.path.name} would hide it")


def _is_scope_shared(key: NameKey, other: NameKey) -> bool:
    """Return whether there is a position in a program at which both names are visible."""
    world = ("thing", "field", "species", "event")
    if key[0] in world or other[0] in world:
        return key[0] in world or key[0] in ("own", "let", "element", "inner")
    if key[0] == "inner" or other[0] == "inner":
        return key[:3] == other[:3] or key[0] == "element"
    return key[0] == "element" or key[1] == other[1]
