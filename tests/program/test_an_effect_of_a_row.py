"""A statement is one row: one that only this test has goes from its text to a run, to explanations and to an editor."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from children import child_environment

TESTS = Path(__file__).resolve().parents[1]
pytest.importorskip("interegular", reason="the grammar is made anew")


@pytest.fixture(scope="module")
def row_results() -> Any:
    """What is made of it, in a separate process: the rows have to be there before what is made of them."""
    environment = child_environment(TESTS)
    script = [sys.executable, str(TESTS / "effect_of_a_row.py")]
    process = subprocess.run(script, capture_output=True, text=True, timeout=300, env=environment)
    assert process.returncode == 0, process.stderr
    return json.loads(process.stdout)


@pytest.mark.parametrize(
    ("line", "code", "message", "help"),
    [
        ("scratch", "unfinished-line", "expected the name of a surface", "like `scratch ground(depth: 1 mm)`"),
        ("scratch ground", "unfinished-line", "line ends after `ground`", "like `scratch ground(depth: 1 mm)`"),
        ("scratc ground(depth: 1 mm)", "unknown-line", "`scratc` does not begin a line here", "did you mean `scratch`?"),
        ("scratch ground()", "missing-argument", "`scratch` needs a depth", "write `scratch ground(depth: 1 mm)`"),
        ("scratch floor(depth: 1 mm)", "unknown-name", "no surface `floor` to scratch", "`world { surface floor }`"),
        ("scratch ground(depth: 1 s)", "wrong-unit", "`depth` of `scratch` needs a length", "write a length"),
        ("scratch ground(depht: 1 mm)", "unknown-argument", "has no argument `depht`", "did you mean `depth`?"),
        ("scratch ground(depth: 0 mm)", "out-of-range", "`0 mm` is no depth of a scratch", "write a length above 0"),
        ("scratch ground(depth: 1 mm, into: claw)", "wrong-unit", "`into` of `scratch` needs an area", "write an area"),
        ("scratch ground(depth: 1 mm, into: sand)", "unknown-name", "but `sand` is not one", "`sand = 0 mm^2`"),
        ("misplaced", "misplaced-line", "`scratch` is not allowed here", "in a state"),
    ],
)
def test_what_is_wrong_with_its_line_is_said(row_results: Any, line: str, code: str, message: str, help: str) -> None:
    ((got, said, advice),) = row_results["complaints"][line]
    assert got == code and message in said and help in advice


def test_it_is_lowered_as_its_row_says(row_results: Any) -> None:
    assert "scratch ground claw by 2 -> dust" in row_results["plan"] and "scratch ground 3 by 4 -> dust" in row_results["plan"]


def test_it_is_settled_on_both_backends(row_results: Any) -> None:
    for backend in ("reference", "numpy"):
        assert row_results["dust"][backend] == [[value] * 3 for value in (2, 4, 6, 8, 20)]


def test_explanations_and_costs_tell_of_it(row_results: Any) -> None:
    assert row_results["did"] == [["scratch ground, 1 mm deep"]] * 2 + [["scratch ground, 3 mm deep"]]
    assert row_results["costs"] == ["scratches ground"]


def test_it_is_formatted_and_coloured(row_results: Any) -> None:
    assert row_results["formatted"] and row_results["keyword"] and row_results["colour"] == ["Token.Keyword"]


def test_an_editor_knows_it(row_results: Any) -> None:
    proposals = row_results["proposals"]
    assert "scratch" in proposals["scr"] and proposals["scratch "] == ["ground"]
    assert proposals["scratch ground("][:3] == ["depth:", "width:", "into:"]
    assert proposals["scratch ground(depth: 1 mm, into: "][:2] == ["dust", "claw"]
    assert ["thing", "ground"] in row_results["meanings"] and ["own", "ant", "dust"] in row_results["meanings"]
    assert "scratch ground(depth: 1 mm)" in row_results["about"] and "scratches a surface" in row_results["about"]
