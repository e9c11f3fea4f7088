"""What the checker resolved names to, read by the language server: where types decide, and where a text has mistakes."""

from __future__ import annotations

from pathlib import Path

import pytest

from antdsl import syntax
from antdsl.lsp.features.navigation import find_definition, find_references
from antdsl.lsp.workspace import Workspace
from antdsl.pipeline import compile_files
from antdsl.source import Source

PROGRAM = """ant 1
use steering
world { surface ground; items food { load = 0 }; items nest { load = 0 } }
behaviour nearer(one: item of food, two: item of food) -> item of food { if distance(one) < distance(two) then one else two }
species ant {
  load = 0
  likes = 0 for each ant, strongest 8
  let meal = nearer(nearest(food), nearest(food, with: load > 9))
  let friend = nearest(ant)
  start search
  state search { steer seek(meal); when meal.load > 0 take 1 load from meal -> carry }
  state bond { likes[m in neighbours(9 mm)] += m.load * 1 /s; when after 1 s -> carry }
  state carry { steer seek(nearest(nest)); when likes[friend] > friend.load -> search }
}
species beetle {
  load = 1
  state rest { when no nearest(food, with: load > 2) -> rest }
}
spec "some carry" on "scene.yaml" { always: share(state == carry) <= 1; finally: total(ant.load) >= total(food.load) }
"""


def keys(text: str, word: str, nth: int = 0) -> list[tuple[str, ...]]:
    """What the `nth` place of `word` in a program stands for: the name that begins there."""
    document = Workspace().put_document(Path("/nowhere/ant.ant"), text)
    place = -1
    for _ in range(nth + 1):
        place = text.index(word, place + 1)
    return [each.key for each in document.occurrences if document.find_start(each.span) == place]


@pytest.mark.parametrize(
    "word, nth, key",
    [
        ("load > 0", 0, ("attribute", "food", "load")),  # of what a behaviour gives
        ("load > 2", 0, ("attribute", "food", "load")),
        ("load from", 0, ("own", "ant", "load")),
        ("load -> search", 0, ("own", "ant", "load")),
        ("load) >=", 0, ("own", "ant", "load")),
        ("load) }", 0, ("attribute", "food", "load")),
        ("carry) <=", 0, ("state", "ant", "main", "carry")),  # the only species with such a state
        ("friend]", 0, ("own", "ant", "friend")),
        ("likes[m", 0, ("own", "ant", "likes")),
        ("load * 1", 0, ("own", "ant", "load")),
        ("one else", 0, ("inner", "/nowhere/ant.ant", "nearer", "one")),
        ("food, two", 0, ("thing", "food")),
    ],
)
def test_names_are_resolved_by_types(word: str, nth: int, key: tuple[str, ...]) -> None:
    assert key in keys(PROGRAM, word, nth), keys(PROGRAM, word, nth)


def test_take_binds_attributes_of_animal_and_item() -> None:
    assert keys(PROGRAM, "load from") == [("own", "ant", "load"), ("attribute", "food", "load")]


def test_the_first_of_two_declarations_counts() -> None:
    text = "ant 1\nspecies a {\n  pace = 1\n  pace = 2\n  state s { when pace > 1 -> s }\n}\n"
    workspace = Workspace()
    document = workspace.put_document(Path("/nowhere/a.ant"), text)
    (target,) = find_definition(workspace, document, text.index("pace > 1"))
    assert document.find_start(target.span) == text.index("pace = 1")


def test_unknown_behaviours_do_not_resolve_to_the_library() -> None:
    text = PROGRAM.replace("seek(meal)", "sek(meal)")
    assert keys(text, "sek(") == [("?behaviour", "sek")]


@pytest.mark.parametrize(
    "right, wrong",
    [
        ("likes = 0", "likes = 0 mm"), ("meal.load > 0", "meal.laod > 0"), ("state rest {", "state rest { steer 1;"),
        ("use steering\n", ""), ("world {", "world { surface ground;"), ("let friend", "let friend = nearest(ant)\n  let friend"),
    ],
)  # fmt: skip
def test_names_are_resolved_in_texts_with_errors(right: str, wrong: str) -> None:
    text = PROGRAM.replace(right, wrong, 1)
    workspace = Workspace()
    document = workspace.put_document(Path("/nowhere/ant.ant"), text)
    checked = workspace.check_document(document.path)
    assert checked is not None and not checked.report.ok
    assert keys(text, "load > 2") == [("attribute", "food", "load")]
    assert keys(text, "friend]") == [("own", "ant", "friend")]
    assert keys(text, "carry) <=") == [("state", "ant", "main", "carry")]


def test_names_in_duplicate_states_resolve_to_the_species() -> None:
    text = PROGRAM.replace("  state carry", "  state search { steer seek(meal); when load > 5 -> carry }\n  state carry")
    assert keys(text, "load > 5") == [("own", "ant", "load")] and keys(text, "carry }\n  state") == [
        ("state", "ant", "main", "carry")
    ]


def test_references_inside_the_library_are_not_listed() -> None:
    workspace = Workspace()
    document = workspace.put_document(Path("/nowhere/ant.ant"), PROGRAM)
    uses = find_references(workspace, document, PROGRAM.index("one: item"))
    assert sorted(document.find_start(each.span) for each in uses) == [
        PROGRAM.index("one: item"), PROGRAM.index("one) <"), PROGRAM.index("one else")
    ]  # fmt: skip


def test_programs_have_bindings() -> None:
    source = Source("/nowhere/ant.ant", PROGRAM)
    program, report = compile_files([Path("/nowhere/ant.ant")], parsed={source.path: syntax.parse(source)})
    assert program is not None and report.ok
    assert {use.span.text for use in program.bindings.uses if use.declaration == ("own", "ant", "friend")} == {"friend"}


def test_sources_of_take_are_resolved() -> None:
    text = PROGRAM.replace("from meal ->", "from nearest(food, within: 3 mm/step * 1 s) ->")
    source = Source("/nowhere/ant.ant", text)
    _, report = compile_files([Path("/nowhere/ant.ant")], strict=True, parsed={source.path: syntax.parse(source)})
    assert any(each.span is not None and "/step" in each.span.text for each in report.diagnostics)


def test_a_name_for_each_of_a_set_is_known_where_the_line_uses_it() -> None:
    assert keys(PROGRAM, "m in neighbours") == keys(PROGRAM, "m.load * 1")
    assert keys(PROGRAM, "m.load * 1") == [("element", str(PROGRAM.index("m in neighbours")), "m")]
