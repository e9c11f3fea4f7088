"""The outline of a file in an editor: nested symbols, and ranges of lines that can be folded."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

from antdsl.lsp.word_help import MEMBER_WORDS
from antdsl.lsp.workspace import PROGRAM_SUFFIX, OpenDocument, Workspace
from antdsl.program.names.file_declarations import find_declaring_node
from antdsl.scene.document import DocumentNode, MappingNode, ScalarNode, SequenceNode
from antdsl.source import Span
from antdsl.syntax import nodes

_MAX_WORKSPACE_SYMBOLS = 500
_PIECE_PATTERN = re.compile(r'"[^"\n]*"?|#[^\n]*|[{}()\[\]]')


@dataclass(slots=True)
class OutlineSymbol:
    """A symbol of the outline. `kind`: species, state, behaviour, param, attribute, value, machine, layers, field, thing, world,
    spec, event, key or file."""

    name: str
    kind: str
    span: Span  # the complete declaration
    name_span: Span
    detail: str = ""
    children: list[OutlineSymbol] = field(default_factory=list)


def list_symbols(document: OpenDocument) -> list[OutlineSymbol]:
    """Return the symbols of a program or a scene, in text order."""
    if not document.is_program:
        return list(_list_key_symbols(document.scene.document)) if document.scene.document is not None else []
    return [symbol for item in document.parsed[0].items if (symbol := _make_item_symbol(item)) is not None]


def find_workspace_symbols(workspace: Workspace, query: str) -> list[tuple[OpenDocument, OutlineSymbol]]:
    """Return the symbols of all programs that match a query, with their documents.

    A name matches if it contains the letters of the query in the same order. Names that begin with the query come first. An
    empty query returns all symbols, up to the limit."""
    letters = re.compile(".*?".join(map(re.escape, query.lower())))
    matches = [
        (document, symbol)
        for path in workspace.list_files()
        if path.suffix == PROGRAM_SUFFIX and (document := workspace.find_document(path)) is not None
        for symbol in _iterate_symbols(list_symbols(document))
        if letters.search(symbol.name.lower())
    ]
    matches.sort(key=lambda match: not match[1].name.lower().startswith(query.lower()))
    return matches[:_MAX_WORKSPACE_SYMBOLS]


def _iterate_symbols(symbols: Iterable[OutlineSymbol]) -> Iterator[OutlineSymbol]:
    """Yield the symbols and all nested symbols, each before those inside it."""
    for symbol in symbols:
        yield symbol
        yield from _iterate_symbols(symbol.children)


def _make_item_symbol(item: Any) -> OutlineSymbol | None:
    """Return the symbol of a top-level item; None if the item is not in the outline."""
    if isinstance(item, nodes.World):
        inner = [OutlineSymbol(each.name.text, "thing", each.span, each.name.span, each.kind.text) for each in item.items]
        return OutlineSymbol("world", "world", item.span, Span(item.span.source, item.span.start, item.span.start + 5), "", inner)
    if isinstance(item, nodes.FieldDecl):
        return OutlineSymbol(item.name.text, "field", item.span, item.name.span, "field")
    if isinstance(item, nodes.Behaviour):
        return OutlineSymbol(item.name.text, "behaviour", item.span, item.name.span, "behaviour")
    if isinstance(item, nodes.Spec):
        return OutlineSymbol(item.name.text or "spec", "spec", item.span, item.name.span, "spec")
    if isinstance(item, nodes.Measure):
        return OutlineSymbol(item.name.text, "value", item.span, item.name.span, "measure")
    if isinstance(item, nodes.Use):
        name = item.library or item.alias
        return OutlineSymbol(name.text, "file", item.span, name.span, "use") if name is not None else None
    if isinstance(item, nodes.Species):
        return OutlineSymbol(
            item.name.text, "species", item.span, item.name.span, "species", list(_list_member_symbols(item.members))
        )
    return None


def _list_member_symbols(members: Any) -> Iterator[OutlineSymbol]:
    """Yield the symbols of the members of a species or machine."""
    for member in members:
        declared = find_declaring_node(member)
        if declared is not None:
            kind = {nodes.ParamDecl: "param", nodes.Declaration: "attribute"}.get(type(member), "value")
            word = MEMBER_WORDS.get(type(member), "")
            yield OutlineSymbol(declared.name.text, kind, member.span, declared.name.span, word)
        elif isinstance(member, nodes.State):
            yield OutlineSymbol(
                member.name.text, "state", member.span, member.name.span, member.label.text if member.label else ""
            )
        elif isinstance(member, nodes.Machine):
            yield OutlineSymbol(
                member.name.text, "machine", member.span, member.name.span, "machine", list(_list_member_symbols(member.members))
            )
        elif isinstance(member, nodes.Layers):
            yield OutlineSymbol(
                "layers", "layers", member.span, Span(member.span.source, member.span.start, member.span.start + 6)
            )
        elif isinstance(member, nodes.On):
            yield OutlineSymbol(f"on {member.event.text}", "event", member.span, member.event.span)
        elif isinstance(member, nodes.AnimalProperty):
            yield OutlineSymbol(member.name.text, "attribute", member.span, member.name.span)


def _list_key_symbols(node: DocumentNode) -> Iterator[OutlineSymbol]:
    """Yield a symbol for each key of a scene's mapping, with nested keys inside it."""
    if isinstance(node, MappingNode):
        for key, value in node.entries.items():
            span = node.keys[key]
            entry_span = Span(span.source, span.start, max(span.end, value.span.end))
            detail = value.text if isinstance(value, ScalarNode) else ""
            yield OutlineSymbol(key, "key", entry_span, span, detail[:60], list(_list_key_symbols(value)))
    elif isinstance(node, SequenceNode):
        for item in node.items:
            if isinstance(item, MappingNode):
                name = next((item.entries[k] for k in ("species",) if k in item.entries), None)
                text = name.text if isinstance(name, ScalarNode) else "…"
                first = Span(item.span.source, item.span.start, item.span.start + 1)
                yield OutlineSymbol(text, "key", item.span, first, "", list(_list_key_symbols(item)))


@dataclass(frozen=True, slots=True)
class FoldedRange:
    """A range of lines that the editor can fold. Line numbers start at 0; both ends are included."""

    first: int
    last: int
    is_comment: bool = False


def find_folding_ranges(document: OpenDocument) -> list[FoldedRange]:
    """Return the ranges that can be folded. In a program, these are brackets over several lines and runs of comment lines. In a
    scene, they are the values below keys."""
    if not document.is_program:
        return _find_scene_folds(document)
    text, all_folds, stack = document.text, [], []
    comments: list[int] = []
    for piece in _PIECE_PATTERN.finditer(text.text):
        sign = piece.group()
        if sign[0] == "#":
            line = text.find_line_column(piece.start())[0]
            if not text.get_line(line)[: piece.start() - text.line_starts[line]].strip():
                comments.append(line)
        elif sign in "{([":
            stack.append(piece.start())
        elif sign in "})]" and stack:
            first, last = text.find_line_column(stack.pop())[0], text.find_line_column(piece.start())[0]
            if last > first + 1:
                all_folds.append(FoldedRange(first, last - 1))
    return sorted([*all_folds, *_fold_line_runs(comments)], key=lambda fold: (fold.first, -fold.last))


def _fold_line_runs(lines: list[int]) -> Iterator[FoldedRange]:
    """Yield a range for each run of at least two consecutive comment lines."""
    first = None
    for number, line in enumerate(lines):
        first = line if first is None else first
        if number + 1 == len(lines) or lines[number + 1] != line + 1:
            if line > first:
                yield FoldedRange(first, line, True)
            first = None


def _find_scene_folds(document: OpenDocument) -> list[FoldedRange]:
    folds_by_line: dict[int, FoldedRange] = {}
    stack = list(list_symbols(document))
    while stack:
        symbol = stack.pop()
        (first, _), (last, _) = document.find_range(symbol.span)
        if last > first:
            folds_by_line.setdefault(first, FoldedRange(first, last))
        stack += symbol.children
    return [folds_by_line[line] for line in sorted(folds_by_line)]
