"""Each sense, set and effect has its row, and each room a function for it: none without the other."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import plans
import pytest
from plan_text import plan_of

from antdsl.plan import ir, verify_plan
from antdsl.plan.builder import PlanError
from antdsl.plan.lowering.actions import OPERAND_LOWERERS
from antdsl.plan.lowering.rules import OPERATION_RULES
from antdsl.plan.show import format_plan
from antdsl.plan.traverse import iterate_statements
from antdsl.plan.verify import collect_names_by_kind
from antdsl.program.declarations.effect_requests import find_argument_type
from antdsl.program.model import TypeKind
from antdsl.program.names.scope import parse_type_words
from antdsl.program.tables import effects
from antdsl.program.tables.effects import EFFECT_BY_OPERATION, EffectRow
from antdsl.program.tables.rows import ArgumentRow, BuiltinRow
from antdsl.program.tables.senses import GENERIC_WORDS, SENSE_BY_OPERATION, find_words
from antdsl.program.tables.set_senses import SET_SENSE_BY_OPERATION
from antdsl.program.tables.things import KIND_BY_WORD
from antdsl.program.tables.vocabulary import BUILTINS_BY_NAME, COST_BY_OPERATION, INTERVAL_BY_OPERATION, SENSE_TYPE_BY_NAME
from antdsl.program.types import sets
from antdsl.runtime import Options, bind, phases, step
from antdsl.runtime.sensing import world_senses as sensing
from antdsl.runtime.world import World
from antdsl.scene.scene_kinds import SCENE_KINDS
from antdsl.syntax.verbs import VERB_BY_WORD
from antdsl.syntax.words import WORLD_KIND_WORDS

OF_THE_AGENT = {"id", "age", "draw", "draw.agent", "event", "surface.touching"}  # what a step knows of it already
OF_OTHERS = {"agent.get", "agent.age", "agent.alive", "item.get", "item.alive"}  # references, queried in passing


def test_every_sense_has_an_operation_and_a_function() -> None:
    assert set(sensing.SENSE_FUNCTIONS) == {*SENSE_BY_OPERATION, *OF_THE_AGENT, *OF_OTHERS}
    for op, row in SENSE_BY_OPERATION.items():
        operation = ir.OPERATION_BY_NAME[op]
        assert op == row.op and op in ir.SENSE_OPERATIONS and operation.rate is ir.UpdateRate.AGENT
        assert operation.args == row.operands and operation.attrs == ((row.thing_kind,) if row.thing_kind else ()) + row.attrs
        assert operation.kind is (ir.ValueKind.TUPLE if op in ir.TUPLE_KINDS_BY_OPERATION else ir.KIND_BY_LETTER[row.kinds])
        assert not row.empty_trace or row.results[0].kind == "b"
        assert not row.thing_kind or row.thing_kind in collect_names_by_kind(plan_of("species ant {}\n"))


def test_every_word_of_a_sense_has_a_rule_and_a_name_in_the_vocabulary() -> None:
    words: list[BuiltinRow] = [*GENERIC_WORDS, *(word for row in SENSE_BY_OPERATION.values() for word in row.words)]
    assert len({word.op for word in words}) == len(words)
    for word in words:
        assert word.op in OPERATION_RULES
        assert word.help and (word.sample or word.word or word.form == "value")
        assert parse_type_words(word.result) is not None or word.result.startswith("vector ") or word.result == "hit"
        if word.form == "call":
            assert word in BUILTINS_BY_NAME[word.name]
        elif word.form == "name":
            assert SENSE_TYPE_BY_NAME[word.name] == word.result and not word.args
        assert (word.interval is None) == (word.op not in INTERVAL_BY_OPERATION) and (word.cost is None) == (
            word.op not in COST_BY_OPERATION
        )
    for row in SENSE_BY_OPERATION.values():
        for word in row.words:
            assert word.result == "hit" or row.find_result_index(word.part)[1] in (1, 3)
    assert {word.args[0].type for word in find_words("value")} == {"field", "flow", "map"}


def test_every_set_has_a_rule_and_operations() -> None:
    assert set(sets.SET_CHECKERS) == set(SET_SENSE_BY_OPERATION) <= set(BUILTINS_BY_NAME)
    for row in SET_SENSE_BY_OPERATION.values():
        assert set(row.plan_operations) <= set(ir.OPERATION_BY_NAME) and (row.cost is None) == (not row.plan_operations)
    set_operations = {op for row in SET_SENSE_BY_OPERATION.values() for op in row.plan_operations}
    assert {op for op in ir.OPERATION_BY_NAME if op.startswith("set.")} <= set_operations


WORLD = """ant 1
world { surface ground; solid hill }
field trail on ground { cell 4 mm; half_life 8 s }
"""
EVERYTHING = """species ant {
  soil = 0 mm^3
  start go
  state go { deposit trail 1 /s; carve hill(radius: 2 mm, into: soil); when after 1 s -> go { emit alarm; spawn ant } }
  on alarm { die }
}
"""


def test_every_effect_is_lowered_and_settled() -> None:
    plan = plan_of(EVERYTHING, WORLD)
    request_ops = {
        s.op
        for each in plan.species.values()
        for b in (each.decide, each.act)
        for _, s in iterate_statements(b)
        if isinstance(s, ir.Request)
    }
    assert request_ops == set(EFFECT_BY_OPERATION), (
        f"{request_ops ^ set(EFFECT_BY_OPERATION)}: each has to stand in EVERYTHING above"
    )
    assert set(EFFECT_BY_OPERATION) == set(phases.RESOLVER_BY_EFFECT), (
        f"{set(EFFECT_BY_OPERATION) ^ set(phases.RESOLVER_BY_EFFECT)}: each has a function that settles it"
    )
    assert set(VERB_BY_WORD) - set(EFFECT_BY_OPERATION) == {
        "give",
        "play",
        "wear",
        "channel",
        "look",
    }  # settled between all who ask; what is shown
    names = {name for name, _ in phases.PHASES}
    for op, row in EFFECT_BY_OPERATION.items():
        assert op == row.op and row.phase in names and row.optional_operands <= set(row.operand_names)
        arguments = {**dict.fromkeys(row.operand_names, "1"), "of": "it", "own": "soil", "receiver": "ant"}
        assert "{" not in effects.fill_template(row.plan_template, arguments) + effects.fill_template(
            row.trace_template, arguments
        )
        assert not row.needs_positive_operand or row.fault_name
        assert bool(row.computed_operands) == (op in OPERAND_LOWERERS) and len(row.args) - len(row.computed_arguments) <= 1
        assert row.computed_operands or all(
            find_argument_type(arg).kind in (TypeKind.NUMBER, TypeKind.AGENT) for arg in row.computed_arguments
        )
        assert [VERB_BY_WORD[op].shape == "amount"][: len(row.args)] == [arg.type.startswith("added ") for arg in row.args[:1]]
        assert (VERB_BY_WORD[op].shape == "alone") == (not row.target)


def marked(world: World) -> None:
    """Add up what the ants ask to be marked, in their register `marks`."""
    for population in world.populations.values():
        for entry in population.effects.pop_requests("mark"):
            population.now["marks"][entry.rows] += entry.get_required_operand(0)


def test_an_effect_is_a_row_and_a_function(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that only this test has is shown, verified, recorded and settled on both backends."""
    row = EffectRow(
        "mark",
        "",
        (ArgumentRow("amount", "number"),),
        "effects",
        "",
        "",
        "mark {amount}",
        "mark {amount}",
        fault_name="mark",
        needs_positive_operand=True,
    )
    monkeypatch.setitem(EFFECT_BY_OPERATION, "mark", row)
    monkeypatch.setitem(phases.RESOLVER_BY_EFFECT, "mark", marked)
    t = plans.Text()
    amount = t("sub", t("number", t("id")), 2.0)
    plan = plans.bare(plans.block(ir.Request("mark", "", (amount,), None, register="marks")), "marks")
    plan = replace(plan, nodes=tuple(t.b.nodes))
    verify_plan(plan)
    assert "mark number(id) - 2" in format_plan(plan)
    for backend in ("reference", "numpy"):
        world = bind(plan, plans.crowd(6), Options(backend=backend))
        step(world)
        step(world)
        ants = world.populations["ant"]
        assert ants.now["marks"][np.argsort(ants.ids)].tolist() == [0, 0, 0, 2, 4, 6]
        assert not ants.effects.requests


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        (ir.Request("mark", "", (), None), "no effect mark"),
        (ir.Request("carve", "hill", (None,) * 4, None), "Carve of hill, which does not exist"),
        (ir.Request("carve", "hill", (None,) * 4, None), "Carve without radius"),
        (ir.Request("emit", "alarm", (), None), "Emit takes"),
        (ir.Request("die", "", (), None, register="soil"), "Die for soil, which does not exist"),
    ],
)
def test_a_request_that_is_not_as_its_row_says_is_refused(request_: ir.Request, words: str) -> None:
    with pytest.raises(PlanError, match=words):
        verify_plan(plans.bare(plans.block(request_)))


def test_every_kind_of_thing_has_its_word_its_kind_and_its_list() -> None:
    assert tuple(KIND_BY_WORD) == WORLD_KIND_WORDS
    plan = plan_of("species ant {}\n")
    assert set(plan.thing_names_by_kind) == set(SCENE_KINDS) - {"items"} == set(KIND_BY_WORD) - {"items", "species"}
    for row in KIND_BY_WORD.values():
        assert TypeKind(row.word) and row.help and row.word in row.sample
        assert set(row.replaced_kinds) <= set(KIND_BY_WORD)
        assert bool(row.scene_form) == bool(row.scene) == bool(row.snippet) == (row.word in SCENE_KINDS)
        assert {row.nearest_op, row.touching_op} <= {"", *ir.OPERATION_BY_NAME}
        assert row.snippet.partition(":")[0].strip("{}$1:") == row.scene.partition(":")[0].strip("{") or row.word == "items"


def test_the_reference_tells_of_every_sense_and_set() -> None:
    text = (Path(__file__).resolve().parents[2] / "docs" / "language_senses.md").read_text(encoding="utf-8")
    part = text.split("\n## Senses\n")[1].split("\n## Sets\n")[0]
    documented_words = {
        word for line in part.splitlines() if line.startswith("| `") for word in re.findall(r"`(\w+)", line.split(" | ")[0])
    }
    words = {word.name for how in ("call", "name") for word in find_words(how)} | set(SET_SENSE_BY_OPERATION)
    assert words - documented_words == {"match"}  # in the section about numbers: it asks nothing of the place
