"""The parser's tables: made from the grammar by `python -m antdsl.syntax.tables`, kept as JSON, read back without building anything."""

from __future__ import annotations

import hashlib
import json
from typing import TYPE_CHECKING, Any

from antdsl import resources

if TYPE_CHECKING:
    from lark import Lark

# The rules with which a line of a file can begin, by what it stands in.
STARTS = (
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
_FILE = "tables.json"


def build_parser(starts: tuple[str, ...] = STARTS, transformer: object | None = None) -> Lark:
    """A parser straight from the grammar, refusing every conflict. Takes half a second and needs `interegular`."""
    from lark import Lark

    grammar = resources.grammar_file("antdsl.lark").read_text(encoding="utf-8")
    return Lark(grammar, parser="lalr", lexer="contextual", strict=True, start=list(starts), transformer=transformer)  # type: ignore[arg-type]


def tables_text() -> str:
    """The tables as JSON text. The numbers of states and rules vary from build to build; what they accept does not."""
    from lark.grammar import Rule
    from lark.lexer import TerminalDef

    data, memo = build_parser().memo_serialize([TerminalDef, Rule])
    data["options"]["strict"] = False  # collisions were looked for just now; looking again needs `interegular` where antdsl is used
    tables = {"grammar": grammar_hash(), "data": data, "memo": memo}
    return json.dumps(tables, separators=(",", ":"), ensure_ascii=True) + "\n"


def grammar_hash() -> str:
    """SHA-256 of the grammar's text, kept in the tables to tell whether they are fresh."""
    return hashlib.sha256(resources.grammar_file("antdsl.lark").read_bytes()).hexdigest()


def load_parser(transformer: object) -> Lark:
    """The parser that ships, with `transformer`'s methods called as rules are recognised."""
    from lark import Lark

    stored = json.loads(resources.grammar_file(_FILE).read_text(encoding="utf-8"))
    data, memo = stored["data"], _whole_keys(stored["memo"])
    table = data["parser"]["parser"]
    table["tokens"] = _whole_keys(table["tokens"])
    table["states"] = {int(state): _whole_keys(actions) for state, actions in table["states"].items()}
    parser: Lark = Lark._load_from_dict(data, memo, transformer=transformer)
    return parser


def _whole_keys(table: dict[str, Any]) -> dict[int, Any]:
    """JSON has only text as keys; lark counts its states, tokens and rules."""
    return {int(key): value for key, value in table.items()}


if __name__ == "__main__":
    resources.grammar_file(_FILE).write_text(tables_text(), encoding="utf-8")
