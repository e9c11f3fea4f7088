"""Each sense, set and effect has its row, and each room a function for it: none without the other."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import plans
import pytest
from plan_text import plan_of

from antdsl.plan import ir, verify
from antdsl.plan.builder import PlanError
from antdsl.plan.lowering.actions import OPERANDS
from antdsl.plan.lowering.rules import OPERATIONS
from antdsl.plan.show import show
from antdsl.plan.traverse import statements
from antdsl.plan.verify import names_by_kind
from antdsl.program.declarations.asks import argument_type
from antdsl.program.model import Kind
from antdsl.program.names.scope import type_from_words
from antdsl.program.tables import effects
from antdsl.program.tables.effects import EFFECTS, Effect
from antdsl.program.tables.rows import Arg, Builtin
from antdsl.program.tables.senses import SENSES, WORDS, find_words
from antdsl.program.tables.set_senses import SET_SENSES
from antdsl.program.tables.things import KINDS_OF_THINGS
from antdsl.program.tables.vocabulary import BUILTINS, COSTS, INTERVALS, SENSED_NAMES
from antdsl.program.types import sets
from antdsl.runtime import Options, bind, phases, sensing, step
from antdsl.runtime.world import World
from antdsl.scene.kinds import KINDS
from antdsl.syntax.verbs import VERBS
from antdsl.syntax.words import WORLD_KINDS

OF_THE_AGENT = {"id", "age", "draw", "draw.agent", "event", "surface.touching"}  # what a step knows of it already
OF_OTHERS = {"agent.get", "agent.age", "agent.alive", "item.get", "item.alive"}  # references, queried in passing


def test_every_sense_has_an_operation_and_a_function() -> None:
    assert set(sensing.SENSES) == {*SENSES, *OF_THE_AGENT, *OF_OTHERS}
    for op, row in SENSES.items():
        operation = ir.OPS[op]
        assert op == row.op and op in ir.SENSES and operation.rate is ir.Rate.AGENT
        assert operation.args == row.operands and operation.attrs == ((row.of,) if row.of else ()) + row.attrs
        assert operation.kind is (ir.Kind.TUPLE if op in ir.TUPLES else ir.LETTERS[row.kinds])
        assert not row.nothing or row.results[0].kind == "b"
        assert not row.of or row.of in names_by_kind(plan_of("species ant {}\n"))


def test_every_word_of_a_sense_has_a_rule_and_a_name_in_the_vocabulary() -> None:
    words: list[Builtin] = [*WORDS, *(word for row in SENSES.values() for word in row.words)]
    assert len({word.op for word in words}) == len(words)
    for word in words:
        assert word.op in OPERATIONS
        assert word.help and (word.sample or word.called or word.form == "value")
        assert type_from_words(word.result) is not None or word.result.startswith("vector ") or word.result == "hit"
        if word.form == "call":
            assert word in BUILTINS[word.name]
        elif word.form == "name":
            assert SENSED_NAMES[word.name] == word.result and not word.args
        assert (word.interval is None) == (word.op not in INTERVALS) and (word.cost is None) == (word.op not in COSTS)
    for row in SENSES.values():
        for word in row.words:
            assert word.result == "hit" or row.place(word.part)[1] in (1, 3)
    assert {word.args[0].type for word in find_words("value")} == {"field", "flow", "map"}


def test_every_set_has_a_rule_and_operations() -> None:
    assert set(sets.SETS) == set(SET_SENSES) <= set(BUILTINS)
    for row in SET_SENSES.values():
        assert set(row.sets) <= set(ir.OPS) and (row.cost is None) == (not row.sets)
    set_operations = {op for row in SET_SENSES.values() for op in row.sets}
    assert {op for op in ir.OPS if op.startswith("set.")} <= set_operations


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
        for _, s in statements(b)
        if isinstance(s, ir.Request)
    }
    assert request_ops == set(EFFECTS), f"{request_ops ^ set(EFFECTS)}: each has to stand in EVERYTHING above"
    assert set(EFFECTS) == set(phases.SETTLES), f"{set(EFFECTS) ^ set(phases.SETTLES)}: each has a function that settles it"
    assert set(VERBS) - set(EFFECTS) == {"give", "play", "wear", "channel", "look"}  # settled between all who ask; what is shown
    names = {name for name, _ in phases.PHASES}
    for op, row in EFFECTS.items():
        assert op == row.op and row.phase in names and row.optional <= set(row.operands)
        arguments = {**dict.fromkeys(row.operands, "1"), "of": "it", "own": "soil", "receiver": "ant"}
        assert "{" not in effects.fill_template(row.plan_text, arguments) + effects.fill_template(row.trace, arguments)
        assert not row.above_0 or row.refused
        assert bool(row.computed) == (op in OPERANDS) and len(row.args) - len(row.numbers) <= 1
        assert row.computed or all(argument_type(arg).kind in (Kind.NUMBER, Kind.AGENT) for arg in row.numbers)
        assert [VERBS[op].shape == "amount"][: len(row.args)] == [arg.type.startswith("added ") for arg in row.args[:1]]
        assert (VERBS[op].shape == "alone") == (not row.target)


def marked(world: World) -> None:
    """Add up what the ants ask to be marked, in their register `marks`."""
    for population in world.populations.values():
        for entry in population.effects.drain("mark"):
            population.now["marks"][entry.rows] += entry.arg(0)


def test_an_effect_is_a_row_and_a_function(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that only this test has is shown, verified, recorded and settled on both backends."""
    row = Effect(
        "mark", "", (Arg("amount", "number"),), "effects", "", "", "mark {amount}", "mark {amount}", refused="mark", above_0=True
    )
    monkeypatch.setitem(EFFECTS, "mark", row)
    monkeypatch.setitem(phases.SETTLES, "mark", marked)
    t = plans.Text()
    amount = t("sub", t("number", t("id")), 2.0)
    plan = plans.bare(plans.block(ir.Request("mark", "", (amount,), None, own="marks")), "marks")
    plan = replace(plan, nodes=tuple(t.b.nodes))
    verify(plan)
    assert "mark number(id) - 2" in show(plan)
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
        (ir.Request("carve", "hill", (None,) * 4, None), "Carve of hill, which is not there"),
        (ir.Request("carve", "hill", (None,) * 4, None), "Carve without radius"),
        (ir.Request("emit", "alarm", (), None), "Emit takes"),
        (ir.Request("die", "", (), None, own="soil"), "Die for soil, which is not there"),
    ],
)
def test_a_request_that_is_not_as_its_row_says_is_refused(request_: ir.Request, words: str) -> None:
    with pytest.raises(PlanError, match=words):
        verify(plans.bare(plans.block(request_)))


def test_every_kind_of_thing_has_its_word_its_kind_and_its_list() -> None:
    assert tuple(KINDS_OF_THINGS) == WORLD_KINDS
    plan = plan_of("species ant {}\n")
    assert set(plan.things) == set(KINDS) - {"items"} == set(KINDS_OF_THINGS) - {"items", "species"}
    for row in KINDS_OF_THINGS.values():
        assert Kind(row.word) and row.help and row.word in row.sample
        assert set(row.replaces) <= set(KINDS_OF_THINGS)
        assert bool(row.scene_form) == bool(row.scene) == bool(row.snippet) == (row.word in KINDS)
        assert {row.nearest, row.touching} <= {"", *ir.OPS}
        assert row.snippet.partition(":")[0].strip("{}$1:") == row.scene.partition(":")[0].strip("{") or row.word == "items"


def test_the_reference_tells_of_every_sense_and_set() -> None:
    text = (Path(__file__).resolve().parents[2] / "grammar" / "README.md").read_text(encoding="utf-8")
    part = text.split("## 10. Senses")[1].split("## 11. ")[0]
    documented_words = {
        word for line in part.splitlines() if line.startswith("| `") for word in re.findall(r"`(\w+)", line.split(" | ")[0])
    }
    words = {word.name for how in ("call", "name") for word in find_words(how)} | set(SET_SENSES)
    assert words - documented_words == {"match"}  # in the section about numbers: it asks nothing of the place
