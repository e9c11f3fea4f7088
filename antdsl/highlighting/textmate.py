"""A TextMate grammar made from the patterns. `python -m antdsl.highlighting.textmate` writes the grammar files that antdsl
distributes."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from antdsl import resources
from antdsl.highlighting.patterns import SCOPE_AND_TOKEN_BY_CLASS, TOKEN_PATTERNS, TokenPattern

SCOPE_NAME = "source.antdsl"
# The second is the copy that is packed with the extension for VS Code, the third the one that the preview's page is built with.
GRAMMAR_FILES = (
    "antdsl.tmLanguage.json",
    "vscode/syntaxes/antdsl.tmLanguage.json",
    "../antdsl/preview/web/src/panels/text/antdsl.tmLanguage.json",
)


def find_scope(name: str) -> str:
    """Return the TextMate scope for a class of text, such as keywords."""
    return f"{SCOPE_AND_TOKEN_BY_CLASS[name][0]}.antdsl"


def _make_rule(pattern: TokenPattern) -> dict[str, Any]:
    if not re.compile(pattern.regex).groups:
        return {"match": pattern.regex, "name": find_scope(pattern.group_classes[0])}
    captures = {str(number): {"name": find_scope(name)} for number, name in enumerate(pattern.group_classes, 1)}
    return {"match": pattern.regex, "captures": captures}


def build_grammar_text() -> str:
    """Return the grammar as JSON text."""
    grammar = {
        "comment": "Made from the tables of the language by `python -m antdsl.highlighting.textmate`: change it there.",
        "name": "antdsl",
        "scopeName": SCOPE_NAME,
        "fileTypes": ["ant"],
        "patterns": [_make_rule(pattern) for pattern in TOKEN_PATTERNS],
    }
    return json.dumps(grammar, indent=2) + "\n"


def write_grammar_files(folder: Path) -> None:
    """Write the grammar to each of its files below a folder."""
    for name in GRAMMAR_FILES:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(build_grammar_text(), encoding="utf-8")


if __name__ == "__main__":
    write_grammar_files(resources.grammar_folder())
