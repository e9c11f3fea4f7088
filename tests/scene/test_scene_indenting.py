"""A line of a scene that is indented wrongly is marked itself, with what to write; the suggestion mends it."""

from __future__ import annotations

from pathlib import Path

import pytest

from antdsl.diagnostics import Diagnostic
from antdsl.scene.load import load_scene_text
from antdsl.scene.paths import Roots

GOOD = """antdsl: 1
fps: 24
world:
  ground: {mesh: ground.ply}
  food:
    apple: {at: [0, 0, 0]}
    pear:
      at: [1 cm, 0, 0]  # a comment
      radius: 4 mm
crowd:
  - species: ant
    from: ant.ant
    count: 5
  - {species: bug, from: bug.ant, count: 2,
     place: {on: ground}}
set:
  ant.smell: 4 mm
"""


def errors(text: str) -> list[Diagnostic]:
    return load_scene_text(text.encode(), "scene.yaml", Roots(Path("."), {}))[1].errors


def test_the_scene_is_good() -> None:
    assert errors(GOOD) == []


# line, how many blanks it begins with, how many are suggested where it is other than those it had
SHIFTED = [(2, 1, 0), (3, 2, 0), (4, 3, 2), (5, 4, 2), (6, 3, 4), (6, 5, 4), (8, 7, 6), (9, 5, 6), (9, 8, 6)]
SHIFTED += [(11, 3, 2), (12, 2, 4), (12, 3, 4), (12, 5, 4), (13, 6, 4), (14, 3, 2), (17, 1, 2)]


@pytest.mark.parametrize(("number", "blanks", "expected"), SHIFTED)
def test_a_line_that_is_shifted_is_marked_and_put_back(number: int, blanks: int, expected: int) -> None:
    lines = GOOD.splitlines()
    lines[number - 1] = " " * blanks + lines[number - 1].lstrip()
    text = "\n".join(lines) + "\n"
    syntax_errors = errors(text)
    if not syntax_errors:  # a block that is set in more as a whole
        assert (number, blanks) in ((4, 3), (6, 5), (6, 3), (17, 1), (8, 7))
        return
    (error,) = syntax_errors
    assert error.code == "scene-syntax" and error.span is not None and error.fix is not None and error.help
    place = error.span.source.find_line_column(error.span.start)
    near = number + 1 if (number, blanks) in ((4, 3), (8, 7), (11, 3), (6, 3), (6, 5)) else number
    assert place[0] in (number, near), error
    mended = text[: error.fix.span.start] + error.fix.text + text[error.fix.span.end :]
    assert errors(mended) == [], mended


@pytest.mark.parametrize(
    ("wrong", "mark", "help"),
    [
        (GOOD.replace("fps: 24", "fps:24"), "fps:24", "write `fps: 24`"),
        (GOOD.replace("fps: 24", "fps 24"), "fps 24", "write `fps: 24`"),
        (GOOD.replace("fps: 24", "fps = 24"), "fps = 24", "write `fps: 24`"),
        (GOOD.replace("    count: 5", "    count 5"), "count 5", "write `count: 5`"),
        (GOOD.replace("\n  ground:", "\nground:").replace("  food:\n", "food: {}\n").replace("    apple: {at: [0, 0, 0]}\n", "")
         .replace("    pear:\n      at: [1 cm, 0, 0]  # a comment\n      radius: 4 mm\n", ""), "ground", "2 spaces"),
    ],
)  # fmt: skip
def test_other_slips_of_lines_are_marked_and_mended(wrong: str, mark: str, help: str) -> None:
    (error,) = errors(wrong)
    assert error.code == "scene-syntax" and error.span is not None and error.span.text == mark and help in (error.help or "")
    assert error.fix is not None
    assert errors(wrong[: error.fix.span.start] + error.fix.text + wrong[error.fix.span.end :]) == []


def test_blocks_of_text_and_quotes_are_no_lines() -> None:
    text = 'antdsl: 1\nset:\n  a.b: "x\n y: z"\n   c.d: 1\n'
    (error,) = errors(text)
    assert error.span is not None and error.span.text == "c.d: 1"
