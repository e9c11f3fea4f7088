"""Signature help: the signatures of the call around a position, and the parameter at the position."""

from __future__ import annotations

import re
from typing import NamedTuple

from antdsl.lsp.features.context import find_context
from antdsl.lsp.features.expression_completion import CompletionRequest, find_behaviour
from antdsl.lsp.word_help import find_help_text, format_builtin, format_signature
from antdsl.lsp.workspace import OpenDocument, Workspace
from antdsl.program.tables import vocabulary

_OPENING_BRACKETS, _CLOSING_BRACKETS = "([{", ")]}"


class Signature(NamedTuple):
    """The signature of a function, as text. `label`: the complete text. `parameters`: the part of the text for each parameter.
    `active_parameter`: the index of the parameter at the cursor, or None."""

    label: str
    help: str
    parameters: tuple[str, ...]
    active_parameter: int | None


def find_signatures(workspace: Workspace, document: OpenDocument, offset: int) -> list[Signature]:
    """Return the signatures of the innermost open call before an offset; [] outside of calls."""
    context = find_context(document.text.text, offset)
    if not context.called_function or context.is_in_text_or_comment:
        return []
    request = CompletionRequest(workspace, document, document.names, context)
    behaviour = find_behaviour(request, context.called_function)
    if behaviour is not None:
        texts = [(format_signature(behaviour), find_help_text(behaviour))]
    else:
        name = context.called_function
        texts = [(format_builtin(name, row), row.help) for row in vocabulary.BUILTINS_BY_NAME.get(name, ())]
    return [_make_signature(label, help, context.arguments) for label, help in texts]


def _make_signature(label: str, help: str, arguments: str) -> Signature:
    """Return a signature with the active parameter. `arguments`: the text between the opening bracket and the cursor."""
    inner = label[label.index("(") + 1 : label.rindex(") ->")]
    parameters = tuple(_split_arguments(inner)) if inner else ()
    parts = _split_arguments(arguments)
    named = re.match(r"\s*([a-z_][a-z_0-9]*)\s*:", parts[-1])
    if named is not None:
        active = next((index for index, each in enumerate(parameters) if re.match(rf"{named[1]}\b", each)), None)
    else:
        active = len(parts) - 1
        if active >= len(parameters):
            active = len(parameters) - 1 if parameters and "…" in parameters[-1] else None
    return Signature(label, help, parameters, active)


def _split_arguments(text: str) -> list[str]:
    """Return the parts of a text that are separated by commas. Commas inside brackets do not separate."""
    parts, depth, begin = [], 0, 0
    for offset, character in enumerate(text):
        if character in _OPENING_BRACKETS:
            depth += 1
        elif character in _CLOSING_BRACKETS:
            depth -= 1
        elif character == "," and depth == 0:
            parts.append(text[begin:offset].strip())
            begin = offset + 1
    return [*parts, text[begin:].strip()]
