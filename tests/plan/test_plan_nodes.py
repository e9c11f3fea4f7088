"""The builder: one node for one operation, constants to the bit of float32, safe algebra; and what `verify_plan` refuses."""

from __future__ import annotations

import math
import struct
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from plan_text import plan_of

from antdsl.plan import PlanError, verify_plan
from antdsl.plan.builder import PlanBuilder
from antdsl.plan.ir import Block, If, Store, UpdateRate, ValueKind
from antdsl.plan.simplify import round_to_f32

numbers = st.floats(width=32)


def bits(x: float) -> bytes:
    return struct.pack("<f", x)


@given(numbers, numbers)
def test_constants_are_computed_as_float32(a, b):
    import numpy as np

    with np.errstate(all="ignore"):
        x, y = np.float32(a), np.float32(b)
        expected = {"add": x + y, "sub": x - y, "mul": x * y, "div": x / y, "sqrt": np.sqrt(x), "floor": np.floor(x), "neg": -x}
    build = PlanBuilder()
    for op, value in expected.items():
        args = (build.add_number(a),) if op in ("sqrt", "floor", "neg") else (build.add_number(a), build.add_number(b))
        node = build(op, *args)
        if node.op != "const" or (value == 0 and node.attrs[0] == 0):
            continue  # the sign of a zero is free
        assert (math.isnan(node.attrs[0]) and math.isnan(value)) or bits(node.attrs[0]) == bits(float(value)), op


def test_f32_ends_in_infinity():
    assert (round_to_f32(1e39), round_to_f32(-1e39), round_to_f32(0.1)) == (math.inf, -math.inf, 0.10000000149011612)


def test_the_same_operation_is_the_same_node():
    b = PlanBuilder()
    x, y = (b("snap", attrs=(name,), kind=ValueKind.F32) for name in "xy")
    assert b("add", x, y) is b("add", x, y)
    assert b("add", x, y) is not b("add", y, x)
    assert b("const", attrs=(0.0,)) is not b("const", attrs=(-0.0,))
    assert b("snap", attrs=("x",), kind=ValueKind.BOOL) is not x


def test_algebra_leaves_out_what_changes_nothing():
    b = PlanBuilder()
    x = b("snap", attrs=("x",), kind=ValueKind.F32)
    c = b("lt", x, b.add_number(3))
    one, zero = b.add_number(1), b.add_number(0)
    assert b("mul", x, one) is x and b("add", zero, x) is x and b("div", x, one) is x
    assert b("neg", b("neg", x)) is x
    assert b("mul", x, zero).op == "mul"  # nothing times infinity is NaN
    assert b("sub", x, x).op == "sub"
    assert b("and", c, b.true) is c and b("or", c, b.true) is b.true and b("not", b("not", c)) is c
    assert b("where", c, x, x) is x
    assert b("where", b("not", c), x, zero) is b("where", c, zero, x)
    assert b("not", c).op == "not"  # not x < 3 is no x >= 3 for NaN


def test_operands_are_held_to_the_table():
    b = PlanBuilder()
    for op, args, attrs in [("add", (b.true, b.true), ()), ("add", (b.add_number(1),), ()), ("nonsense", (), ()),
                            ("snap", (), ()), ("eq", (b.add_row(1), b.add_number(1)), ()),
                            ("where", (b.true, b.add_row(1), b.add_number(1)), ())]:  # fmt: skip
        with pytest.raises(PlanError):
            b(op, *args, attrs=attrs)


def test_rates_are_the_greatest_and_a_reduction_is_the_agents():
    b = PlanBuilder()
    dt, x = b("run", attrs=("dt",)), b("snap", attrs=("x",), kind=ValueKind.F32)
    pair = b("mul", b("pair.distance"), x)
    every = b("set.every", attrs=("a",))
    assert [n.rate for n in (b("add", dt, dt), b("add", x, dt), pair)] == [UpdateRate.RUN, UpdateRate.AGENT, UpdateRate.PAIR]
    assert b("reduce.sum", every, b.true, pair, attrs=(-24,)).rate is UpdateRate.AGENT


# --- what verify refuses ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def plan():
    return plan_of("species a { n = 0\nstart s\nstate s { n = n + 1\nsteer heading * n } }")


def changed(plan, **phases):
    return replace(plan, species={"a": replace(plan.species["a"], **phases)})


def test_a_plan_as_lowered_is_legal(plan):
    verify_plan(plan)


def test_verify_sees_a_store_to_nowhere_and_of_the_wrong_kind(plan):
    node = plan.nodes[0]
    with pytest.raises(PlanError, match="does not exist"):
        verify_plan(changed(plan, act=Block((Store("nowhere", node, None),))))
    with pytest.raises(PlanError, match="a f32"):
        verify_plan(changed(plan, act=Block((Store("n", node, None),))))


def test_verify_sees_a_condition_that_is_none(plan):
    number = next(n for n in plan.nodes if n.kind is ValueKind.F32)
    with pytest.raises(PlanError, match="the condition of If is"):
        verify_plan(changed(plan, act=Block((If(number, Block(()), None),))))


def test_verify_sees_loads_in_the_wrong_order(plan):
    load = next(n for n in plan.nodes if n.op == "load" and n.attrs[0] == "n")
    store = Store("n", load, None)
    with pytest.raises(PlanError, match="before and after a store"):
        verify_plan(changed(plan, act=Block((store, store)), blend=Block(())))


def test_verify_sees_nodes_out_of_place(plan):
    with pytest.raises(PlanError, match="has the number"):
        verify_plan(replace(plan, nodes=(*plan.nodes[1:], plan.nodes[0])))
    with pytest.raises(PlanError, match="not in the plan's list"):
        verify_plan(replace(plan, nodes=plan.nodes[:-1]))
    wrong = replace(plan.nodes[-1], rate=UpdateRate.CONST)
    with pytest.raises(PlanError, match="is declared to change"):
        verify_plan(replace(plan, nodes=(*plan.nodes[:-1], wrong)))


def test_verify_sees_a_missing_register(plan):
    registers = {name: r for name, r in plan.species["a"].registers.items() if name != "n"}
    with pytest.raises(PlanError, match="no register n"):
        verify_plan(changed(plan, registers=registers))
