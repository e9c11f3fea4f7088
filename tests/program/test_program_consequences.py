"""One cause, one complaint: an artist's single slip is one placed error, with nothing said about what follows from it."""

from __future__ import annotations

import re

import pytest

from antdsl.diagnostics import Diagnostic
from antdsl.loading import find_library
from antdsl.program import check
from antdsl.source import Source
from antdsl.syntax import parse

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
    ("0.15 s", "0,15 s", "bad-number", "0,15", "`0.15`"),
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
    file, report = parse(Source("forager.ant", text))
    return [*report.diagnostics, *check(file, find_library)[1].diagnostics]


def test_the_program_without_a_slip_is_clean() -> None:
    assert complaints(GOOD) == []


@pytest.mark.parametrize(("right", "wrong", "code", "place", "help"), SLIPS, ids=[slip[1] for slip in SLIPS])
def test_one_slip_is_one_complaint(right: str, wrong: str, code: str, place: str, help: str) -> None:
    assert right in GOOD
    diagnostics = complaints(GOOD.replace(right, wrong, 1))
    assert [d.code for d in diagnostics] == [code], [f"{d.span}: {d.message}" for d in diagnostics]
    assert diagnostics[0].span is not None and diagnostics[0].span.text == place
    line = GOOD[: GOOD.index(right)].count("\n") + 1
    assert diagnostics[0].span.source.find_line_column(diagnostics[0].span.start)[0] - line == wrong.count(
        "\n", 0, wrong.find("please") + 1
    )
    assert help in (diagnostics[0].help or "")


def test_mistakes_beside_a_broken_line_are_reported() -> None:
    text = GOOD.replace("swing: 40 deg", "swing = 40 deg").replace("0.15 s", "0.15").replace("from meal ->", "from meel ->")
    assert sorted(d.code for d in complaints(text)) == ["missing-unit", "unexpected-text", "unknown-name"]


def test_a_state_without_a_way_out_is_still_a_trap() -> None:
    assert [d.code for d in complaints(GOOD.replace("    when no meal held 0.5 s -> search\n", ""))] == []
    lost = GOOD.replace("    when touching(nest) -> search { give all load to nest }\n", "")
    assert [d.code for d in complaints(lost)] == ["trap"]


def test_choose_without_states_has_no_target() -> None:
    diagnostics = complaints(GOOD.replace("when meal -> approach", "when meal -> choose { }"))
    assert [d.code for d in diagnostics] == ["missing-target"]


BESIDE = [  # what seems idle beside a mistake, and may be what was meant there
    ("within: smell", "within: 110 s", "wrong-unit"),
    ("scent > faint", "scent > 110 s", "units-differ"),
    ("scent > faint", "scent > 0.05 mm", "units-differ"),
    ("when meal -> approach", "when meal approach", "unexpected-text"),
    ("when meal -> approach", "when meal", "unfinished-line"),
    ("when meal -> approach", "when food -> approach", "wrong-kind"),
    ("when scent > faint -> turn_home", "when nest -> turn_home", "wrong-kind"),
    ("when meal -> approach\n    when scent > faint", "when nest -> approach\n    when scent > faint", "wrong-kind"),
    ("deposit trail 2 /s", "deposit 2 /s", "unexpected-text"),
    ("steer seek(meal) * 0.8", "steer seek(meal, meal) * 0.8", "wrong-arity"),
    ("max(trail, nearest: 16)", "max(1.001 x trail, nearest: 16)", "unknown-unit"),
    ("swing: 40 deg", "swing: 40 deg, 3", "argument-order"),
]


@pytest.mark.parametrize(("right", "wrong", "code"), BESIDE, ids=[case[1].splitlines()[0] for case in BESIDE])
def test_idle_parts_beside_a_mistake_are_not_reported(right: str, wrong: str, code: str) -> None:
    assert right in GOOD
    diagnostics = complaints(GOOD.replace(right, wrong, 1))
    assert [d.code for d in diagnostics] == [code], [f"{d.span}: {d.message}" for d in diagnostics]


def test_uses_of_a_state_that_was_taken_out_are_one_complaint_with_all_places() -> None:
    text = GOOD.replace("state approach {", "state approach_it {").replace("when scent > faint", "when time_in_state > 9 s")
    text = text.replace("approach_it", "nearer").replace("deposit trail 2 /s", "deposit trail 2 /s; when no meal -> approach")
    anywhere = "from any except approach when load > 9 -> choose { search: 1; approach: 2 }"
    text = text.replace("  layers {", f"  {anywhere}\n  layers {{ heading when state == approach; ")
    text += 'spec "x" on "scene.yaml" { always: share(state == approach) < 1; each forager { never: previous == approach } }\n'
    (diagnostic,) = [d for d in complaints(text) if d.severity == "error"]
    assert diagnostic.code == "unknown-state" and diagnostic.span is not None
    spans = [diagnostic.span, *(label.span for label in diagnostic.labels)]
    assert {span.text for span in spans} == {"approach"} and len({span.start for span in spans}) == len(spans)
    assert len(spans) == len([1 for _ in re.finditer(r"\bapproach\b", text)]) == 7


def test_of_very_many_places_some_are_shown() -> None:
    text = GOOD.replace("deposit trail 2 /s\n", "".join(f"when age > {n} s -> gone\n" for n in range(30)))
    (diagnostic,) = [d for d in complaints(text) if d.severity == "error"]
    assert len(diagnostic.labels) == 12 and diagnostic.labels[-1].text == "and here, and at 17 more places"
