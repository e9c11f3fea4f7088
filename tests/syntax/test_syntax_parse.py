"""Texts that are right: the tree, its names and its places."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import pytest

from antdsl.program.tables.vocabulary import UNIT_BY_NAME
from antdsl.source import Source, Span
from antdsl.syntax import nodes as n
from antdsl.syntax import parse
from antdsl.syntax.words import UNIT_NAMES

ROOT = Path(__file__).parents[2]
CARD = ROOT / "tests" / "cases" / "syntax" / "card.ant"
TEXTS = sorted([*ROOT.glob("tests/cases/syntax/*.ant"), *ROOT.glob("examples/*/*.ant"), *ROOT.glob("behaviours/*.ant")])


def right(text: str) -> n.File:
    file, report = parse(Source("t.ant", text))
    assert report.diagnostics == []
    return file


def member(text: str) -> Any:
    (species,) = right(f"ant 1\nspecies a {{ {text} }}\n").items
    assert isinstance(species, n.Species)
    return species.members[0]


def line(text: str) -> Any:
    state = member(f"state s {{ {text} }}")
    return state.body[0]


def expression(text: str) -> Any:
    return line(f"steer {text}").push


def shape(node: Any) -> Any:
    """A tree without places, as nested tuples: what two ways of reading a text must agree on."""
    if isinstance(node, tuple):
        return tuple(shape(part) for part in node)
    if is_dataclass(node) and not isinstance(node, (Span, Source)):
        parts = [(each.name, shape(getattr(node, each.name))) for each in fields(node)]
        return (
            type(node).__name__,
            *[part for part in parts if part[0] not in ("span", "source", "unit_span", "op_span", "comments")],
        )
    return node


def walk(node: Any) -> list[Any]:
    tree_nodes, stack = [], [node]
    while stack:
        part = stack.pop()
        if isinstance(part, tuple):
            stack.extend(part)
        elif is_dataclass(part) and not isinstance(part, (Span, Source)):
            tree_nodes.append(part)
            stack.extend(getattr(part, each.name) for each in fields(part))
    return tree_nodes


@pytest.mark.parametrize("path", TEXTS, ids=lambda path: path.name)
def test_shipped_programs_parse_without_errors(path: Path) -> None:
    right(path.read_text(encoding="utf-8"))


def test_card_holds_every_node() -> None:
    node_types = {type(node) for node in walk(right(CARD.read_text(encoding="utf-8")))}
    every = {
        value for value in vars(n).values() if isinstance(value, type) and is_dataclass(value) and value.__module__ == n.__name__
    }
    assert every - node_types == {n.BadExpr}


def test_spans_hold_the_text_of_their_node() -> None:
    file = right(CARD.read_text(encoding="utf-8"))
    for node in walk(file):
        if isinstance(node, n.File):
            continue
        text = node.span.text
        assert text and text == text.strip() and text.count("(") == text.count(")") and text.count("{") == text.count("}")
        if isinstance(node, n.Name):
            assert text == node.text
        elif isinstance(node, n.Text):
            assert text == f'"{node.text}"'
        elif isinstance(node, n.Quantity):
            assert node.unit_span.text == node.unit and text.endswith(node.unit)
        elif isinstance(node, (n.Unary, n.Binary)):
            assert node.op_span.text == node.op
        for each in fields(node):
            for child in walk(getattr(node, each.name)):
                assert node.span.start <= child.span.start and child.span.end <= node.span.end


def test_comments_stay_in_order() -> None:
    file = right("# one\nant 1 # two\nspecies a { load = 0 # three\n }\n# four")
    assert [comment.text for comment in file.comments] == ["# one", "# two", "# three", "# four"]
    assert all(comment.span.text == comment.text for comment in file.comments)


def test_head_of_a_file() -> None:
    file = right('ant 1\n"What it is"\nuse steering; use "./mine.ant" as mine\nspecies a { }')
    assert file.edition is not None and file.edition.value == 1
    assert file.help is not None and file.help.text == "What it is"
    library, other = file.items[:2]
    assert isinstance(library, n.Use) and library.library is not None and library.library.text == "steering"
    assert isinstance(other, n.Use) and other.path is not None and other.alias is not None
    assert (other.path.text, other.alias.text) == ("./mine.ant", "mine")


@pytest.mark.parametrize(
    ("text", "same"),
    [
        ("a + b * c", "a + (b * c)"),
        ("a - b - c", "(a - b) - c"),
        ("a / b * c", "(a / b) * c"),
        ("a ^ b ^ c", "a ^ (b ^ c)"),
        ("-a ^ b", "-(a ^ b)"),
        ("a ^ -b", "a ^ (-b)"),
        ("-a * b", "(-a) * b"),
        ("a or b and c", "a or (b and c)"),
        ("not a == b", "not (a == b)"),
        ("no a and b", "(no a) and b"),
        ("a + b < c", "(a + b) < c"),
        ("chance 20 %/s and a", "(chance 20 %/s) and a"),
        ("a is none or b", "(a is none) or b"),
        ("if a then b else if c then d else e", "if a then b else (if c then d else e)"),
        ("a.b(c)[d].e", "(((a.b)(c))[d]).e"),
        ("if a or b then c + d else e", "if (a or b) then (c + d) else e"),
    ],
)
def test_precedence(text: str, same: str) -> None:
    assert shape(expression(text)) == shape(expression(same))


@pytest.mark.parametrize(
    ("text", "value", "unit"),
    [
        ("30 mm/s", 30, "mm/s"),
        ("30mm/s", 30, "mm/s"),
        ("20 /s", 20, "/s"),
        ("20 %/s", 20, "%/s"),
        ("90 %/step", 90, "%/step"),
        ("1 step", 1, "step"),
        ("2 mm^2/s", 2, "mm^2/s"),
        ("3 kg*m/s", 3, "kg*m/s"),
        ("1.5e-3 uN", 1.5e-3, "uN"),
        ("20 %", 20, "%"),
    ],
)
def test_quantities(text: str, value: float, unit: str) -> None:
    node = expression(text)
    assert isinstance(node, n.Quantity) and (node.value, node.unit) == (value, unit)


@pytest.mark.parametrize("text", ["30 mm * size", "30 mm*size", "2 m - s", "5 m / step_length"])
def test_a_name_that_begins_like_a_unit_is_a_name(text: str) -> None:
    node = expression(text)
    assert isinstance(node, n.Binary) and isinstance(node.left, n.Quantity) and isinstance(node.right, n.NameRef)


def test_units_are_one_list_in_grammar_scanner_and_vocabulary() -> None:
    assert set(UNIT_BY_NAME) == {*UNIT_NAMES, "%"}
    for unit in UNIT_NAMES:
        assert isinstance(expression(f"1 {unit}"), n.Quantity)


def test_words_of_the_language_are_names_where_they_can_be() -> None:
    call = expression("ramp(x, from: 1 .. 2, to: 3 .. 4, when: 1, state: 2)")
    assert [a.name.text if a.name else None for a in call.arguments] == [None, "from", "to", "when", "state"]
    assert isinstance(line("speed = 3").target, n.NameRef)
    assert isinstance(expression("state").name, n.Name)
    change = line("when state == carry -> steer")
    assert change.target.name.text == "steer"


def test_transition_has_all_its_parts() -> None:
    change = line("interrupt when a > 1 held 0.5 s take 2 load from meal -> choose { x: 1; y: 2 } { b = 1; die }")
    assert isinstance(change, n.Change) and change.interrupt and change.any_except is None and change.delay is None
    assert isinstance(change.condition, n.Binary) and isinstance(change.held, n.Quantity)
    assert change.take is not None and change.take.attribute.text == "load"
    assert [(w.target.text, w.weight.value) for w in change.target.choices] == [("x", 1), ("y", 2)]  # type: ignore[union-attr]
    assert [type(action) for action in change.actions] == [n.Assign, n.VerbLine]
    assert line("when after 2 s -> previous").target.is_previous


def test_from_any() -> None:
    change = member("from any except a, b when c -> d")
    assert isinstance(change, n.Change) and [name.text for name in change.any_except or ()] == ["a", "b"]
    assert member("from any when c -> d").any_except == ()


def test_state_has_all_its_parts() -> None:
    state = member('state s "Label" amber for at least 1 s { enter { a = 1 }; steer x; exit { b = 1; die }; when c -> s }')
    assert isinstance(state, n.State)
    assert state.label is not None and state.label.text == "Label" and state.colour is not None and state.colour.text == "amber"
    assert isinstance(state.at_least, n.Quantity) and len(state.enter) == 1 and len(state.exit) == 2
    assert [type(part) for part in state.body] == [n.Steer, n.Change]
    bare = member("state s { }")
    assert bare.label is None and bare.colour is None and bare.at_least is None and bare.body == ()


def test_give_all_and_some() -> None:
    assert line("give all load to nest").amount is None
    assert line("give 2 load to nest").amount.value == 2


def test_comprehension_and_range_arguments() -> None:
    call = expression("sum(n in neighbours(3 mm): direction(n) * 2)")
    (only,) = call.arguments
    assert isinstance(only, n.Comprehension) and only.variable.text == "n"
    assert isinstance(expression("clamp(x, 0 .. 1)").arguments[1].value, n.RangeExpr)


def test_windows_line_ends_give_the_same_tree() -> None:
    text = CARD.read_text(encoding="utf-8")
    assert shape(right(text).items) == shape(right(text.replace("\n", "\r\n")).items)


def test_layout_does_not_matter() -> None:
    one = right("ant 1\nspecies a { load = 0; start s; state s { steer seek(x); when y -> s { z = 1 } } }")
    other = right(
        "ant 1\n\n\nspecies a {\n\n\tload = 0\n start s;\n\n state s {;\n steer seek(\n\n x\n) ; when y -> s {\n z = 1\n}\n}\n}\n"
    )
    assert shape(one.items) == shape(other.items)
