"""Broken texts: what is complained about, where, and in which words; and that nothing else is."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import pytest

from antdsl import limits
from antdsl.diagnostics.codes import CODE_DESCRIPTIONS
from antdsl.diagnostics.render import render
from antdsl.source import Source
from antdsl.syntax import parse

CASES = Path(__file__).parents[1] / "cases" / "syntax" / "errors.txt"
_EXPECTED = re.compile(r"# (error|warning)\[([a-z0-9-]+)\]: (.*?)(?: \| (.*?))?\s*$", re.MULTILINE)


@dataclass(frozen=True)
class Expected:
    line: int
    severity: str
    code: str
    message: str
    help: str


def _chunks() -> dict[str, str]:
    parts = re.split(r"^--- (.+)\n", CASES.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def _expected(text: str) -> list[Expected]:
    complaints = []
    for number, line in enumerate(text.split("\n"), 1):
        match = _EXPECTED.search(line)
        if match:
            complaints.append(Expected(number, match[1], match[2], match[3], match[4] or ""))
    return complaints


@pytest.mark.parametrize("name", _chunks())
def test_error_cases_give_the_expected_messages(name: str) -> None:
    text = _chunks()[name].rstrip("\n") + "\n"
    _, report = parse(Source(name, text))
    expected = _expected(text)
    assert expected, "a chunk without an expected complaint tests nothing"
    complaints = []
    for diagnostic in report.sort_by_place():
        assert diagnostic.span is not None
        complaints.append(
            (diagnostic.span.source.find_line_column(diagnostic.span.start)[0], diagnostic.severity, diagnostic.code)
        )
    assert complaints == [(e.line, e.severity, e.code) for e in expected], render(report)
    for diagnostic, want in zip(report.sort_by_place(), expected, strict=True):
        assert want.message in diagnostic.message, diagnostic.message
        assert want.help in (diagnostic.help or ""), diagnostic.help


def test_every_syntax_code_has_a_case() -> None:
    source = Path(__file__).parents[2] / "antdsl" / "diagnostics" / "codes.py"
    sections = source.read_text(encoding="utf-8").split("# --- ")
    mine = [part for part in sections if part.startswith(("characters and words", "lines and blocks"))]
    assert len(mine) == 2
    codes = {code for part in mine for code in re.findall(r'^    "([a-z0-9-]+)":', part, re.MULTILINE)}
    case_codes = {expected.code for chunk in _chunks().values() for expected in _expected(chunk)}
    python_cases = {"hidden-direction", "odd-blank", "line-too-long", "nesting-too-deep", "expression-too-deep"}
    assert codes - case_codes == python_cases and case_codes <= set(CODE_DESCRIPTIONS)


def _codes(text: str) -> list[str]:
    return [d.code for d in parse(Source("t.ant", text))[1].sort_by_place()]


PROGRAM = "ant 1\nspecies a {{ start s; state s {{ steer {} }} }}\n"


@pytest.mark.parametrize("character", ["\0", "\x1b", "\x07", "\x7f", "\x85", "\u2028"])
@pytest.mark.parametrize("place", ["seek({}x)", "seek(x)\n# {}\n"])
def test_control_characters_are_refused_everywhere(character: str, place: str) -> None:
    assert _codes(PROGRAM.format(place.format(character))) == ["control-character"]
    assert _codes(f'ant 1\n"a{character}b"\nspecies a {{ load = 0 }}\n') == ["control-character"]


@pytest.mark.parametrize("character", ["\u202e", "\u2066", "\u202a"])
def test_hidden_direction_is_refused_in_comments(character: str) -> None:
    assert _codes(f"ant 1\nspecies a {{ load = 0 }} # {character}x\n") == ["hidden-direction"]


def test_unusual_blanks_are_reported_once() -> None:
    file, report = parse(Source("t.ant", "ant\u00a01\nspecies\u00a0a\u2003{ load = 0 }\n"))
    assert [d.code for d in report.diagnostics] == ["odd-blank"] and len(file.items) == 1


def test_full_width_digits_are_look_alikes() -> None:
    file, report = parse(Source("t.ant", "ant 1\nspecies a { load = \uff19; pack = \u0663 mm }\n"))
    assert [d.code for d in report.diagnostics] == ["look-alike", "look-alike"]
    assert len(file.items[0].members) == 2  # type: ignore[union-attr]


def test_long_line() -> None:
    assert _codes("ant 1\nspecies a { load = 0 } # " + "x" * limits.MAX_LINE_CHARACTERS) == ["line-too-long"]


@pytest.mark.parametrize(("opening", "closing"), ["()", "[]"])
def test_nesting_is_capped(opening: str, closing: str) -> None:
    inner = "x" if opening == "(" else "likes"
    head = "" if opening == "(" else "likes"
    fine = limits.MAX_BRACKET_DEPTH - 2
    deepest_program = PROGRAM.format(head + opening * fine + inner + closing * fine)
    assert "nesting-too-deep" not in _codes(deepest_program)
    assert _codes(PROGRAM.format(head + opening * (fine + 1) + inner + closing * (fine + 1))) == ["nesting-too-deep"]


@pytest.mark.parametrize("part", ["1+", "-", "not ", "if a then b else ", "a^", "a or "])
def test_deep_expressions_are_refused_without_recursion(part: str) -> None:
    assert _codes(PROGRAM.format("x + 1")) == []
    codes = _codes(PROGRAM.format(part * 3000 + "1"))
    assert set(codes) - {"line-too-long"} == {"expression-too-deep"}


def test_a_sum_of_ten_thousand_terms_is_refused() -> None:
    assert "expression-too-deep" in _codes(PROGRAM.format("+".join(["1"] * 10_000)))


def test_flat_sums_within_the_cap_are_fine() -> None:
    assert _codes(PROGRAM.format("+".join(["1"] * (limits.MAX_EXPRESSION_DEPTH - 20)))) == []


@pytest.mark.parametrize(
    "line", ["  size 4 metr\n", "  state ) }\n", "}\n", "a\u202eb\n", '" \n', "stata x { }\n", "“", "foo( {\n"]
)
def test_thousands_of_mistakes_are_fast_and_limited(line: str) -> None:
    from time import process_time

    start_time = process_time()
    _, report = parse(Source("t.ant", "ant 1\nspecies a {\n" + line * 3000))
    output_lines = render(report, "concise").splitlines()
    assert process_time() - start_time < 2
    assert len(output_lines) <= limits.MAX_SHOWN_DIAGNOSTICS + 1
    if len(report.diagnostics) > limits.MAX_SHOWN_DIAGNOSTICS:
        assert output_lines[-1] == f"… and {len(report.diagnostics) - limits.MAX_SHOWN_DIAGNOSTICS:,} more"


def test_braces_of_a_format_string_are_shown_as_they_are() -> None:
    _, report = parse(Source("%s.ant", "ant 1\nspecies a { %s {0.__class__} }\n"))
    assert "%s {0.__class__}" in render(report)
