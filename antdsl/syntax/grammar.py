"""Converts the grammar to parse tables. `python -m antdsl.syntax.grammar` adds the verbs to the grammar and writes the tables to
the JSON file that is distributed. It needs the package `interegular` to find collisions of terminals."""

from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING, Any

from antdsl import resources
from antdsl.syntax.parse_tables import GRAMMAR_FILE, START_RULES, TABLES_FILE, compute_grammar_hash
from antdsl.syntax.verbs import SHAPE_PATTERNS, VERB_BY_WORD

if TYPE_CHECKING:
    from lark import Lark

_VERB_RULES_PATTERN = re.compile(r"(?<=\n)ask: .*?(?=// --- end of the verbs)", re.S)


def make_grammar_text() -> str:
    """Return the text of the grammar, with a rule and a terminal for each verb in the table of verbs."""
    rows = [row for row in VERB_BY_WORD.values() if row.shape != "own"]
    forms = "\n    | ".join(f"{row.word.upper()} {SHAPE_PATTERNS[row.shape]}".rstrip() for row in rows)
    terminals = "\n".join(f"{row.word.upper()}.1: /{row.word}(?![a-z_0-9])/" for row in rows)
    text = resources.grammar_file(GRAMMAR_FILE).read_text(encoding="utf-8")
    return _VERB_RULES_PATTERN.sub(lambda _: f"ask: {forms}\n{terminals}\n", text)


def build_parser(starts: tuple[str, ...] = START_RULES, transformer: object | None = None) -> Lark:
    """Return a parser that is built directly from the grammar. Raises an error if the grammar has a conflict. This takes half a
    second and needs `interegular`."""
    from lark import Lark

    return Lark(make_grammar_text(), parser="lalr", lexer="contextual", strict=True, start=list(starts), transformer=transformer)


def make_tables_text() -> str:
    """Return the tables as JSON text. Every build gives the same text."""
    from lark.grammar import Rule
    from lark.lexer import TerminalDef

    data, memo = build_parser().memo_serialize([TerminalDef, Rule])
    data["options"]["strict"] = False  # collisions were checked above, and users do not have `interegular`
    data["options"].pop("cache_grammar", None)  # lark 1.2 does not know this option, which has its default value
    data["parser"]["parser"] = number_tokens(data["parser"]["parser"])
    tables = {"grammar": compute_grammar_hash(), "data": data, "memo": memo}
    return json.dumps(tables, separators=(",", ":"), ensure_ascii=True) + "\n"


def number_tokens(table: dict[str, Any]) -> dict[str, Any]:
    """Return a parse table in which tokens are numbered by name. States are numbered in breadth-first order from the start
    states, with tokens in the order of their names. Lark's own numbers depend on memory addresses, so they differ between
    builds."""
    names = sorted(table["tokens"].values())
    token = {old: names.index(name) for old, name in table["tokens"].items()}
    states = {
        old: sorted(((token[key], *action) for key, action in actions.items()), key=lambda entry: entry[0])
        for old, actions in table["states"].items()
    }
    order = list(dict.fromkeys(table["start_states"][start] for start in START_RULES))
    seen_states = set(order)
    for state in order:  # the loop appends to this list
        for _, reduces, target in states[state]:
            if not reduces and target not in seen_states:
                seen_states.add(target)
                order.append(target)
    number = {old: new for new, old in enumerate(order)}
    return {
        "tokens": dict(enumerate(names)),
        "states": {
            number[old]: {key: [reduces, target if reduces else number[target]] for key, reduces, target in states[old]}
            for old in order
        },
        "start_states": {start: number[table["start_states"][start]] for start in START_RULES},
        "end_states": {start: number[table["end_states"][start]] for start in START_RULES},
    }


def write_tables() -> None:
    resources.grammar_file(GRAMMAR_FILE).write_text(make_grammar_text(), encoding="utf-8")
    resources.grammar_file(TABLES_FILE).write_text(make_tables_text(), encoding="utf-8")


if __name__ == "__main__":
    write_tables()
