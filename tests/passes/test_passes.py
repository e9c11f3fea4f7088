"""Passes: less work, the same effects; each does what it says and the whole leaves printed plans as they are in `cases/plan`."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from plan_text import plan_of

from antdsl.passes import PASSES, optimise_plan
from antdsl.passes.drop_unused import drop_unused_stores
from antdsl.passes.fold import fold_regions
from antdsl.passes.hoist import hoist_factors
from antdsl.passes.memoise_senses import memoise_senses
from antdsl.passes.merge_regions import merge_regions
from antdsl.passes.split_conditions import split_conditions
from antdsl.pipeline import compile_files
from antdsl.plan import format_plan, lower, verify_plan
from antdsl.plan.ir import SENSE_OPERATIONS, If, Store, UpdateRate
from antdsl.plan.traverse import collect_required_nodes, iterate_statements, list_operands, list_root_nodes

ROOT = Path(__file__).parents[2]
CASES = sorted((ROOT / "tests" / "cases" / "plan").glob("*.ant"))


def count(plan, op: str) -> int:
    return sum(node.op == op for node in collect_required_nodes(list_root_nodes(plan)))


def all_of(plan, kind: type, phase: str | None = None) -> list:
    phases = [phase] if phase else ["born", "decide", "act", "blend"]
    return [s for p in phases for _, s in iterate_statements(getattr(plan.species["a"], p)) if isinstance(s, kind)]


def test_fold_removes_empty_regions_and_opens_those_of_all_agents():
    plan = plan_of("species a { start s\nstate s { steer heading\nwhen 1 > 2 -> t }\nstate t { when true -> s } }")
    folded = fold_regions(plan)
    verify_plan(folded)
    assert not [s for s in all_of(folded, Store, "decide") if s.register == "~main.pending" and "#1" in str(s.value)]
    assert len(all_of(folded, If)) <= len(all_of(plan, If))
    assert len(folded.nodes) <= len(plan.nodes)
    assert {n for n in list_root_nodes(folded)} <= set(folded.nodes)


def test_drop_unused_leaves_the_state_of_the_world_and_takes_the_rest():
    plan = plan_of(
        "species a { n = 0\nstart s\nstate s { n += 1 /s\nsteer heading * 0.5\nwhen n > 1 -> t }\n"
        "state t { when n > 2 -> s }\nlayers { up * 1; state when 1 > 2 } }"
    )
    new_plan = drop_unused_stores(fold_regions(plan))
    verify_plan(new_plan)
    registers = new_plan.species["a"].registers
    assert {"n", "main.time_in_state", "push.x"} <= set(registers)
    assert "~steer.x" in plan.species["a"].registers and "~steer.x" not in registers
    assert not [s for s in all_of(new_plan, Store) if s.register.startswith("~steer")]


def test_merge_joins_neighbours_with_one_condition_unless_the_first_changes_it():
    text = (
        "species a {{ n = 0\nm = 0\non alarm {{ n += 1 }}\non alarm {{ m += {} }}\nstart s\n"
        "state s {{ steer heading * n * m\nwhen n > 1 -> t {{ emit alarm }} }}\n"
        "state t {{ when n > 2 -> s }} }}"
    )
    plan = plan_of(text.format("2"))
    merged = merge_regions(plan)
    verify_plan(merged)
    events = [s for s in all_of(plan, If, "decide") if s.condition.op == "event"]
    joined = [s for s in all_of(merged, If, "decide") if s.condition.op == "event"]
    assert (len(events), len(joined)) == (2, 1)
    assert [s.register for s in joined[0].body.statements] == ["n", "m"]


def test_hoist_takes_what_all_pairs_share_out_of_them():
    plan = plan_of(
        "species a { start s\n"
        "state s { steer sum(n in neighbours(2 * size): direction(n, to: self) * (distance(n) / size) * mass / 1 g * 0.5) } }"
    )
    new_plan = hoist_factors(plan)
    verify_plan(new_plan)

    def pairs(p) -> int:
        return sum(n.rate is UpdateRate.PAIR and n.op in ("mul", "div") for n in collect_required_nodes(list_root_nodes(p)))

    assert pairs(new_plan) < pairs(plan)
    assert not [
        n
        for n in collect_required_nodes(list_root_nodes(new_plan))
        if n.op == "div" and n.rate is UpdateRate.PAIR and n.args[1].rate < UpdateRate.PAIR
    ]


def test_hoist_shares_among_components_what_is_the_same_for_all():
    plan = plan_of(
        "species a { start s\nstate s { steer sum(n in neighbours(2 * size): "
        "direction(n, to: self) * (1 - distance(n) / size)) } }"
    )
    new_plan = hoist_factors(plan)
    verify_plan(new_plan)

    def products(p) -> int:
        return sum(
            n.rate is UpdateRate.PAIR and n.op in ("mul", "neg", "div") for n in collect_required_nodes(list_root_nodes(p))
        )

    # 1 / distance, its product with the weight, distance * (1 / size), and one product for each of x, y and z
    assert products(new_plan) == 6
    assert products(plan) == 11
    sums = [n for n in collect_required_nodes(list_root_nodes(new_plan)) if n.op == "reduce.sum"]
    assert [n.args[2].args[0].op for n in sums] == ["pair.x", "pair.y", "pair.z"]


def test_narrow_asks_the_cheap_half_first():
    plan = plan_of(
        "species a { n = 0\nstart s\nstate s { n += 1 /s\nsteer heading }\n"
        "layers { up * 0.5 when nearest(food, within: 9 mm) is not none and n > 3; state } }"
    )
    new_plan = split_conditions(plan)
    verify_plan(new_plan)
    outer = next(s for s in new_plan.species["a"].blend.statements if isinstance(s, If))
    inner = outer.body.statements[0]
    assert isinstance(inner, If)
    assert not [n for n in collect_required_nodes(list_operands(outer)) if n.op in SENSE_OPERATIONS]
    assert [n for n in collect_required_nodes(list_operands(inner)) if n.op == "reduce.item"]


def test_keep_notes_senses_that_several_regions_ask_for():
    plan = memoise_senses(plan_of(
        
            "species a { let f = nearest(food)\nlet g = nearest(nest)\nstart s\n"
            "state s { steer direction(f)\nwhen touching(f) -> t }\nstate t { steer direction(g)\n"
            "when false -> s } }"
        
    ))  # fmt: skip
    assert [n.args[0].attrs for n in plan.species["a"].memoised_senses] == [("food",)]


def test_passes_are_idempotent_together():
    for case in CASES:
        first_result = optimise_plan(plan_of(case.read_text(), world=""))
        assert format_plan(optimise_plan(first_result)) == format_plan(first_result), case.name


def test_every_pass_says_what_it_does_and_stands_in_the_docs_in_order():
    section = (ROOT / "docs" / "implementation.md").read_text(encoding="utf-8").split("## Passes\n")[1].split("\n## ")[0]
    assert [p.__name__ for p in PASSES] == re.findall(r"^\| `(\w+)` \|", section, re.M), "its row in docs/implementation.md"
    assert all(p.__doc__ for p in PASSES)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.stem)
def test_printed_plans(case, request):
    """`pytest --update` writes them again; read the difference."""
    text = format_plan(optimise_plan(plan_of(case.read_text(), world="")))
    golden = case.with_suffix(".plan")
    if request.config.getoption("--update", default=False):
        golden.write_text(text)
    assert golden.read_text() == text


EXAMPLES = sorted((Path(__file__).parents[2] / "examples").glob("*/*.ant"))


@pytest.mark.parametrize("path", CASES + EXAMPLES, ids=lambda path: path.stem)
def test_in_a_hurry_the_same_plan_comes_out(path):
    def nodes(plan):
        return [(n.op, n.attrs, n.number, n.rate, n.span and str(n.span)) for n in plan.nodes]

    program, report = compile_files([path])
    assert program is not None and report.ok
    lowered, report = lower(program)
    assert report.ok
    slow, quick = optimise_plan(lowered), optimise_plan(lower(program)[0], thorough=False)
    assert format_plan(slow) == format_plan(quick)
    assert nodes(slow) == nodes(quick)
