"""Grammar → tables: `python -m antdsl.syntax.grammar` writes the JSON that ships. Needs `interegular` to find collisions."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from antdsl import resources
from antdsl.syntax.tables import STARTS, TABLES_FILE, grammar_hash

if TYPE_CHECKING:
    from lark import Lark


def build_parser(starts: tuple[str, ...] = STARTS, transformer: object | None = None) -> Lark:
    """A parser straight from the grammar, refusing every conflict. Takes half a second and needs `interegular`."""
    from lark import Lark

    grammar = resources.grammar_file("antdsl.lark").read_text(encoding="utf-8")
    return Lark(grammar, parser="lalr", lexer="contextual", strict=True, start=list(starts), transformer=transformer)


def tables_text() -> str:
    """The tables as JSON text. The numbers of states and rules vary from build to build; what they accept does not."""
    from lark.grammar import Rule
    from lark.lexer import TerminalDef

    data, memo = build_parser().memo_serialize([TerminalDef, Rule])
    data["options"]["strict"] = False  # collisions were looked for just now, and `interegular` is not where antdsl is used
    data["options"].pop("cache_grammar", None)  # not known to lark 1.2, and at its default
    tables = {"grammar": grammar_hash(), "data": data, "memo": memo}
    return json.dumps(tables, separators=(",", ":"), ensure_ascii=True) + "\n"


if __name__ == "__main__":
    resources.grammar_file(TABLES_FILE).write_text(tables_text(), encoding="utf-8")
