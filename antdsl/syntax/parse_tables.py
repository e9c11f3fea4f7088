"""Loads the parser from JSON tables that were made from the grammar, so that no tables are built at run time."""

from __future__ import annotations

import hashlib
import json
from typing import TYPE_CHECKING, Any

from antdsl import resources

if TYPE_CHECKING:
    from lark import Lark

# Start rules of the grammar, one for each context of a line.
START_RULES = (
    "header",
    "top",
    "world_item",
    "declaration",
    "setting",
    "member",
    "machine_member",
    "statement",
    "action",
    "layer",
    "rule",
    "weight",
    "behaviour_line",
    "spec_line",
)
GRAMMAR_FILE = "antdsl.lark"
TABLES_FILE = "tables.json"


def compute_grammar_hash() -> str:
    """Return the SHA-256 digest of the grammar's text. The tables contain this digest, so that outdated tables are detected."""
    return hashlib.sha256(resources.grammar_file(GRAMMAR_FILE).read_bytes()).hexdigest()


def load_parser(transformer: object) -> Lark:
    """Return the parser that is distributed with antdsl. When it recognises a rule, it calls the method of `transformer` with
    the rule's name."""
    from lark import Lark

    tables = json.loads(resources.grammar_file(TABLES_FILE).read_text(encoding="utf-8"))
    data, memo = tables["data"], _convert_keys_to_int(tables["memo"])
    table = data["parser"]["parser"]
    table["tokens"] = _convert_keys_to_int(table["tokens"])
    table["states"] = {int(state): _convert_keys_to_int(actions) for state, actions in table["states"].items()}
    parser: Lark = Lark._load_from_dict(data, memo, transformer=transformer)  # type: ignore[no-untyped-call]
    return parser


def _convert_keys_to_int(table: dict[str, Any]) -> dict[int, Any]:
    """Return a table with integer keys. JSON keys are texts, but lark numbers its states, tokens and rules."""
    return {int(key): value for key, value in table.items()}
