"""A mistake costs no more than its line: what is left of a broken text, and any text at all."""

from __future__ import annotations

import random
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_syntax_parse import CARD, shape, walk

from antdsl.diagnostics.codes import CODE_DESCRIPTIONS
from antdsl.diagnostics.model import Report
from antdsl.diagnostics.render import FORMATTERS, render
from antdsl.source import Source
from antdsl.syntax import nodes as n
from antdsl.syntax import parse
from antdsl.syntax.scan import scan_tokens

ROOT = Path(__file__).parents[2]


def read(text: str) -> tuple[Any, Report]:
    return parse(Source("t.ant", text))


def check(text: str) -> Report:
    """What holds for any text: known codes, places inside it, a tree that can be walked."""
    source = Source("t.ant", text)
    file, report = parse(source)
    for diagnostic in report.diagnostics:
        assert diagnostic.code in CODE_DESCRIPTIONS and diagnostic.span is not None
        assert 0 <= diagnostic.span.start <= diagnostic.span.end <= len(text)
        assert "\n" not in diagnostic.message and diagnostic.message[:1] == diagnostic.message[:1].lower()
    for node in walk(file.items):
        assert 0 <= node.span.start <= node.span.end <= len(text)
    if report.ok:
        assert not any(isinstance(node, n.BadExpr) for node in walk(file.items))
    return report


@pytest.mark.parametrize("times", [40, pytest.param(400, marks=pytest.mark.slow)])
def test_deleting_any_token_gives_few_errors(times: int) -> None:
    text = CARD.read_text(encoding="utf-8")
    tokens = scan_tokens(Source("t.ant", text), Report()).tokens
    counts: Counter[int] = Counter()
    for token in random.Random(4).sample(tokens, times):
        counts[len(check(text[: token.start] + text[token.end :]).errors)] += 1
    assert sum(errors * each for errors, each in counts.items()) <= 1.1 * counts.total()
    assert max(counts) <= 4, counts
    assert counts[0] < counts.total() / 3


@pytest.mark.parametrize("times", [15, pytest.param(150, marks=pytest.mark.slow)])
def test_swapping_and_doubling_tokens_never_fails(times: int) -> None:
    text = CARD.read_text(encoding="utf-8")
    tokens = scan_tokens(Source("t.ant", text), Report()).tokens
    draw = random.Random(7)
    for _ in range(times):
        one, other = sorted(draw.sample(tokens, 2), key=lambda token: token.start)
        first, second = text[one.start : one.end], text[other.start : other.end]
        check(text[: one.start] + second + text[one.end : other.start] + first + text[other.end :])
        check(text[: one.start] + f"{second} {first}" + text[one.end :])


_PIECES = st.sampled_from(
    [
        "ant 1",
        "\n",
        "species",
        "a",
        "{",
        "}",
        "(",
        ")",
        "[",
        "]",
        "state",
        "s",
        "when",
        "->",
        "steer",
        "seek",
        "layers",
        "let",
        "=",
        "==",
        "+",
        "-",
        "3",
        "4 mm",
        "0.5 s",
        '"x"',
        '"',
        ";",
        "choose",
        ":",
        ",",
        "..",
        ".",
        "from any",
        "# c",
        "é",
        "“",
        "\t",
        "in",
    ]
)


@given(st.lists(_PIECES, max_size=60), st.sampled_from(["", " "]))
def test_any_sequence_of_words_is_read(pieces: list[str], between: str) -> None:
    report = check(between.join(pieces))
    for format in FORMATTERS:
        render(report, format)


@given(st.text(max_size=200))
def test_any_text_is_read(text: str) -> None:
    check(text)


@pytest.mark.slow
@settings(max_examples=1500)
@given(st.text(max_size=400), st.lists(_PIECES, max_size=90))
def test_any_of_many_texts_is_read(text: str, pieces: list[str]) -> None:
    check(text)
    check(" ".join(pieces))


BROKEN = """ant 1
species a {
  size 4 metr
  let meal = nearest(food, with: > 0)
  param reach = 3 mm in 2
  start s
  stat s "Go" amber {
    steer seek(meal
    when meal > -> t
    when meal = 3 held 0.5 s -> t { x = = 3; die }
    steer up when up -> t
  }
  state t two many words {
    steer up
  }
}
"""


def test_partially_readable_lines_are_recovered() -> None:
    file, report = read(BROKEN)
    assert len(report.errors) == 10
    (species,) = file.items
    names = {(type(m).__name__, m.name.text) for m in species.members if hasattr(m, "name")}
    assert names == {("AnimalProperty", "size"), ("Let", "meal"), ("State", "s"), ("State", "t")}
    assert [m.declaration.name.text for m in species.members if isinstance(m, n.ParamDecl)] == ["reach"]
    first, second = [m for m in species.members if isinstance(m, n.State)]
    assert [type(part).__name__ for part in first.body] == ["Steer", "Change", "Change", "Steer", "Change"]
    assert [part.target.name.text for part in first.body if isinstance(part, n.Change)] == ["t", "t", "t"]
    assert [type(action).__name__ for action in first.body[2].actions] == ["Assign", "VerbLine"]
    assert [type(part).__name__ for part in second.body] == ["Steer"]


def test_a_lost_brace_leaves_the_blocks_after_it() -> None:
    text = CARD.read_text(encoding="utf-8")
    complete_tree = shape(parse(Source("t.ant", text))[0].items)
    lines = text.split("\n")
    for number, line in enumerate(lines):
        if line.rstrip().endswith("{") or line.strip() == "}":
            line_start = line.rstrip()[:-1]
            file, report = read("\n".join([*lines[:number], line_start, *lines[number + 1 :]]))
            assert len(report.errors) == 1, (line, render(report, "concise"))
            same = [item for item in complete_tree if item in shape(file.items)]
            assert len(same) >= len(complete_tree) - 1, line
