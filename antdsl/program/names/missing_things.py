"""Suggests how to fix an unknown name where a thing of the world is expected: a similar name, or the `world` line that declares
it."""

from __future__ import annotations

from antdsl.diagnostics import Fix
from antdsl.diagnostics.suggestion import find_nearest_name
from antdsl.program.model import TypeKind, ValueType
from antdsl.program.names.scope import NameScope
from antdsl.program.tables.things import KIND_BY_WORD, list_replacements
from antdsl.source import Span
from antdsl.syntax import nodes

# The first word of the declaring line and the allowed kinds of things, by the expected kind.
_DECLARATION_LINES: dict[TypeKind, tuple[str, tuple[str, ...]]] = {
    **{TypeKind(row.word): (row.word, list_replacements(row.word)) for row in KIND_BY_WORD.values() if row.scene},
    TypeKind.PLACE: ("items", tuple(row.word for row in KIND_BY_WORD.values() if row.scene and row.nearest_op)),
}


def suggest_missing_thing(scope: NameScope, name: str, expected_type: ValueType | None) -> tuple[str, Fix | None] | None:
    """Return help and a fix for an unknown name: a similar declared name, or the line that declares the name.

    `expected_type`: the type that a value needs at this position. The result is None if it is not a thing of the world."""
    if expected_type is None or expected_type.kind not in _DECLARATION_LINES:
        return None
    word, kinds = _DECLARATION_LINES[expected_type.kind]
    known = [thing.name for thing in scope.declarations.things.values() if thing.kind in kinds]
    if expected_type.kind is TypeKind.PLACE:  # values with a position are allowed too
        own = scope.species if scope.behaviour is None else None
        known += [
            *scope.declarations.species,
            *scope.local_names,
            *(own.bindings if own else ()),
            *(own.attributes if own else ()),
        ]
    near = find_nearest_name(name, known)
    if near:
        return f"did you mean `{near}`?", None
    line = f"{word} {name}"
    world = next((item for item in scope.file.node.items if isinstance(item, nodes.World)), None)
    if world is None:
        return f"declare it: `world {{ {line} }}`, and define it in the scene", None
    return f"declare it in `world`: `{line}`, and define it in the scene", _make_append_fix(world.span, line)


def _make_append_fix(world: Span, line: str) -> Fix | None:
    """Return a fix that adds a line at the end of a `world` block, or None if the block has no closing bracket."""
    text, source = world.text, world.source
    if not text.endswith("}"):
        return None
    last = len(text[:-1].rstrip())
    if "\n" in text[last:]:
        indent = " " * (source.find_line_column(world.start)[1] + 1)
        comment = text.find("\n", last)  # after a comment at the end of the line
        at, new = world.start + comment, f"\n{indent}{line}"
    else:
        at, new = world.start + last, f"{' ' if text[:last].endswith('{') else '; '}{line}"
    return Fix(Span(source, at, at), new)
