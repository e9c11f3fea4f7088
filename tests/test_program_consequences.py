"""One cause, one complaint: an artist's single slip is one placed error, with nothing said about what follows from it."""

from __future__ import annotations

import pytest

from antdsl.diagnostics import Diagnostic
from antdsl.program import check
from antdsl.resources import library_file
from antdsl.source import Source
from antdsl.syntax import nodes, parse

GOOD = """ant 1
use steering
world {
  surface  ground
  obstacle stones
  items    food { load = 0 }
  items    nest { load = 0 }
}
field trail on ground { cell 6 mm; half_life 12 s }
species forager {
  param smell = 40 mm in 0 mm .. 200 mm
  param faint = 0.05 in 0 .. 1
  response 0.15 s
  max_turn 400 deg/s
  load = 0
  let meal  = nearest(food, with: load > 0, within: smell)
  let scent = max(trail, nearest: 16)
  start search
  state search amber {
    steer wander(swing: 40 deg)
    when meal -> approach
    when scent > faint -> turn_home
  }
  state approach {
    steer seek(meal) * 0.8
    when touching(meal) take 1 load from meal -> turn_home
    when no meal held 0.5 s -> search
  }
  state turn_home {
    steer seek(nearest(nest))
    deposit trail 2 /s
    when touching(nest) -> search { give all load to nest }
  }
  layers { avoid(stones, spread: 35 deg); state }
}
"""
SLIPS = [  # what is written, what the slip makes of it, code, text at the place, a part of the help
    ("swing: 40 deg", "swing = 40 deg", "unexpected-text", "=", "swing: …"),
    ("seek(meal) * 0.8", "seek(meal * 0.8", "unclosed-bracket", "(", "missing `)`"),
    ("seek(meal) * 0.8", "seek[meal] * 0.8", "call-without-brackets", "seek", "seek(…)"),
    ("let scent = max", "let scent == max", "unexpected-text", "==", "write `=`"),
    ("let scent = max", "let scent: max", "unexpected-text", ":", "let meal ="),
    ("let scent = max", "lt scent = max", "unknown-line", "lt", "`let`"),
    ("param faint", "parm faint", "unknown-line", "parm", "`param`"),
    ("with: load > 0", "with load > 0", "unexpected-text", "load", "arguments"),
    ("35 deg", "35\u00b0", "unknown-sign", "\u00b0", "`deg`"),
    ("0.15 s", "0,15 s", "unexpected-text", ",", "0.15 s"),
    ("state turn_home {", "state turn-home {", "bad-name", "turn-home", "turn_home"),
    ("state approach {", "state approach (", "missing-brace", "(", "`{`"),
    ("give all load to nest", "give all load too nest", "unexpected-text", "too", "give all load to"),
    ("held 0.5 s", "heldfast 0.5 s", "unexpected-text", "heldfast", "held"),
    ("use steering", "use stearing", "unknown-library", "stearing", "`steering`"),
    ("use steering", "import steering", "unknown-line", "import", "`use`"),
    ("    when meal -> approach", "    if meal -> approach", "unknown-line", "if", "`when`"),
    ("  surface  ground", "  surfce  ground", "unknown-kind", "surfce", "`surface`"),
    ("  surface  ground", "  ground  ground", "unknown-kind", "ground", "surface"),
    ("when meal -> approach", "when meal -> aproach", "unknown-state", "aproach", "`approach`"),
    ("touching(nest) -> search", "touching(nest) -> serach", "unknown-state", "serach", "`search`"),
    ("scent > faint", "scent > fiant", "unknown-name", "fiant", "`faint`"),
    ("touching(nest)", "touching(nset)", "unknown-name", "nset", "`nest`"),
    ("start search", "start search\n  please", "unfinished-line", "", "max_speed"),
    ("max_turn 400 deg/s", "max_turn 400 deg / s", "unknown-name", "s", "30 mm/s"),
]


def complaints(text: str) -> list[Diagnostic]:
    def library(name: str) -> nodes.File | None:
        path = library_file(name)
        return None if path is None else parse(Source("<steering>", path.read_text()))[0]

    file, report = parse(Source("forager.ant", text))
    return [*report.diagnostics, *check(file, library)[1].diagnostics]


def test_the_program_without_a_slip_is_clean() -> None:
    assert complaints(GOOD) == []


@pytest.mark.parametrize(("right", "wrong", "code", "place", "help"), SLIPS, ids=[slip[1] for slip in SLIPS])
def test_one_slip_is_one_complaint(right: str, wrong: str, code: str, place: str, help: str) -> None:
    assert right in GOOD
    found = complaints(GOOD.replace(right, wrong, 1))
    assert [d.code for d in found] == [code], [f"{d.span}: {d.message}" for d in found]
    assert found[0].span is not None and found[0].span.text == place
    line = GOOD[: GOOD.index(right)].count("\n") + 1
    assert found[0].span.source.line_column(found[0].span.start)[0] - line == wrong.count("\n", 0, wrong.find("please") + 1)
    assert help in (found[0].help or "")


def test_mistakes_apart_from_a_broken_line_are_still_told() -> None:
    text = GOOD.replace("swing: 40 deg", "swing = 40 deg").replace("0.15 s", "0.15").replace("from meal ->", "from meel ->")
    assert sorted(d.code for d in complaints(text)) == ["missing-unit", "unexpected-text", "unknown-name"]


def test_a_state_without_a_way_out_is_still_a_trap() -> None:
    assert [d.code for d in complaints(GOOD.replace("    when no meal held 0.5 s -> search\n", ""))] == []
    lost = GOOD.replace("    when touching(nest) -> search { give all load to nest }\n", "")
    assert [d.code for d in complaints(lost)] == ["trap"]


def test_choose_without_states_has_no_target() -> None:
    found = complaints(GOOD.replace("when meal -> approach", "when meal -> choose { }"))
    assert [d.code for d in found] == ["missing-target", "unreachable-state"]
