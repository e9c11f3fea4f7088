"""Mistakes in programs and what is said about them, from tests/cases/check/*.ant.

A file is cut at lines of `---`. A part that begins with `ant` is a whole program; any other stands in the species of `AROUND`.
A comment `# error[code]: words` names a message about its line (or about a line that many `above`) and words that the message
or its help has. Nothing else may be reported, save for warnings about parts that stand in a species."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from antdsl.diagnostics import Report
from antdsl.diagnostics.codes import CODE_DESCRIPTIONS
from antdsl.loading import find_library
from antdsl.program import check
from antdsl.source import Source
from antdsl.syntax import parse

CASES = Path(__file__).parents[1] / "cases" / "check"
AROUND = """ant 1
use steering
world { surface ground; solid hill; items food { load = 0 }; items nest { load = 0 } }
field trail on ground { cell 4 mm; half_life 8 s }
species rabbit { energy = 1; state run { deposit trail energy * 1 /s } }
species forager {
"""
EXPECTATION = re.compile(r"# (error|warning)\[([a-z-]+)\](?: (?:(\d+) )?above)?(?:: (.*))?$")


@dataclass(frozen=True)
class Part:
    file: Path
    line: int
    text: str

    def __str__(self) -> str:
        return f"{self.file.stem}:{self.line}"


def parts() -> Iterator[Part]:
    for file in sorted(CASES.glob("*.ant")):
        line = 1
        for text in file.read_text(encoding="utf-8").split("---\n"):
            yield Part(file, line, text)
            line += text.count("\n") + 1


def check_text(text: str, name: str = "case.ant") -> Report:
    file, report = parse(Source(name, text))
    report.extend(check(file, find_library)[1])
    return report


def complete_text(part: Part) -> tuple[str, int]:
    """The part as a program, and how many lines stand above it."""
    if part.text.startswith("ant "):
        return part.text, 0
    rest = "" if re.search(r"^[^#]*\bstate \w+ *[{\"]", part.text, re.MULTILINE) else "  state idle { steer wander() }\n"
    return AROUND + part.text + rest + "}\n", AROUND.count("\n")


@pytest.mark.parametrize("part", list(parts()), ids=str)
def test_reports_match_the_comments_of_a_case(part: Part) -> None:
    text, above = complete_text(part)
    expected: dict[tuple[int, str, str], str] = {}
    for number, line in enumerate(part.text.splitlines(), 1):
        for severity, code, back, words in EXPECTATION.findall(line):
            up = (int(back) if back else 1) if "above" in line else 0
            expected[(number - up, severity, code)] = words
    messages = {}
    for each in check_text(text).sort_by_place():
        assert each.span is not None, each
        place = (each.span.source.find_line_column(each.span.start)[0] - above, each.severity, each.code)
        if place in expected or each.severity == "error" or above == 0:
            messages[place] = f"{each.message} | {each.help}"
        assert each.help, each
        assert not each.message[0].isupper() and "\n" not in each.message, each
    assert set(messages) == set(expected), messages
    for place, words in expected.items():
        assert words in messages[place], messages[place]


@pytest.mark.parametrize("part", [part for part in parts() if part.file.stem == "ranges"], ids=str)
def test_what_is_to_be_written_for_a_param_and_its_range_goes_together(part: Part) -> None:
    text, _ = complete_text(part)
    fixes = [each.fix for each in check_text(text).errors if each.fix is not None]
    for fix in sorted(fixes, key=lambda fix: -fix.span.start):
        text = text[: fix.span.start] + fix.text + text[fix.span.end :]
    assert not fixes or check_text(text).ok, text


def test_every_code_of_the_checker_has_a_case() -> None:
    text = (Path(check.__code__.co_filename).parents[1] / "diagnostics" / "codes.py").read_text(encoding="utf-8")
    mine = text[text.index("# --- names ---") : text.index("# --- scenes ---")]
    codes = set(re.findall(r'^    "([a-z-]+)":', mine, flags=re.MULTILINE))
    assert codes <= set(CODE_DESCRIPTIONS)
    tested_codes = {code for part in parts() for line in part.text.splitlines() for _, code, _, _ in EXPECTATION.findall(line)}
    elsewhere = {"per-step", "too-deep", "too-many", "missing-target"}  # tests of their own in test_program.py
    assert codes - tested_codes == elsewhere, "each code of the checker has a case in tests/cases/check/*.ant"
