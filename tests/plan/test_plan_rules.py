"""Operations of the language as nodes: every word has a rule, places and sets become senses, what cannot run says so."""

from __future__ import annotations

import math

import pytest
from plan_agent import Agent
from plan_text import codes, lowered, plan_of

from antdsl.plan.lowering import expressions
from antdsl.plan.lowering.rules import OPERATION_RULES
from antdsl.plan.lowering.sets import choose_quantum_exponent
from antdsl.plan.traverse import collect_required_nodes, iterate_statements, list_operands
from antdsl.program import model
from antdsl.program.model import Dimension
from antdsl.program.tables import vocabulary
from antdsl.program.tables.set_senses import SET_SENSE_BY_OPERATION


def test_every_operation_of_the_vocabulary_has_a_rule():
    words = {row.op for rows in vocabulary.BUILTINS_BY_NAME.values() for row in rows} - set(
        SET_SENSE_BY_OPERATION
    )  # sets come as SetOf
    words |= set(vocabulary.OPERATION_BY_SIGN.values()) | set(vocabulary.OTHER_OPERATIONS)
    assert words - set(OPERATION_RULES) == set()


def one(expression: str, **senses) -> Agent:
    """An agent with the expression as its attribute `x`, after one step."""
    return Agent(plan_of(f"species a {{\nx = 0\nstart s\nstate s {{ x = {expression} }}\n}}\n"), "a", **senses).step()


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("1 + 2 * 3 - 4 / 8", 6.5),
        ("-2 ^ 2", -4),
        ("2 ^ -1", 0.5),
        ("9 ^ 0.5", 3),
        ("abs(-3) + floor(2.7) + sqrt(16)", 9),
        ("clamp(7, 1 .. 5) + min(1, 2) + max(1, 2)", 8),
        ("ramp(15 mm, from: 10 mm .. 20 mm, to: 4 .. 8)", 6),
        ("ramp(5, from: 10 .. 20)", 0),
        ("ramp(25, from: 10 .. 20, to: 0.01 .. 1)", 1),
        ("ramp(4, from: size / 1 mm .. size / 1 mm)", 1),
        ("rising(2, 1 .. 3) + falling(1.5, 1 .. 3) * 100 + around(2.5, 1 .. 3) * 10000", 0.5 + 75 + 5000),
        ("mix(2, 4, 0.25)", 2.5),
        ("if 1 > 2 then 3 else 4", 4),
        ("length(vector(1 mm, 2 mm, 2 mm)) / 1 mm", 3),
        ("dot(vector(1, 2, 3), vector(4, 5, 6))", 32),
        ("dot(cross(heading, up), vector(0, 0, 1))", 1),
        ("angle(heading, up) / 1 deg", 90),
        ("dot(rotate(heading, about: up, by: 90 deg), vector(0, 0, 1))", -1),
        ("dot(project(vector(3, 4, 5), onto: up), vector(1, 1, 1))", 4),
        ("length(limit(vector(3, 4, 0), 2.5))", 2.5),
        ("length(unit(vector(0, 0, 0)))", 0),
        ("sin(30 deg) + cos(60 deg)", 1),
        ("exp(1) + log(1)", math.e),
        ("1 cm / 1 mm + 1 min / 1 s", 70),
        ("dt * 24 / 1 step", 24),
    ],
)
def test_expressions_have_their_value(expression, expected):
    assert one(expression)["x"] == pytest.approx(expected, rel=1e-5, abs=1e-6)


def test_chance_follows_its_draw():
    assert one("uniform(10, 20)", draw=0.25)["x"] == pytest.approx(12.5)
    assert one("pick(1, 2, 3, 4)", draw=0.74)["x"] == 3
    assert one("pick(1, 2, 3, 4)", draw=0.76)["x"] == 4
    u1, u2 = 0.3, 0.6
    expected = 5 + 2 * math.sqrt(-2 * math.log(1 - u1)) * math.cos(2 * math.pi * u2)
    plan = plan_of("species a { x = 0\nstart s\nstate s { x = normal(5, 2) } }")
    sites = [n.attrs for n in plan.nodes if n.op == "draw"]
    assert len({site for site, _ in sites}) == 1 and {index for _, index in sites} == {0, 1}
    senses = {("draw", *attrs): (u1, u2)[attrs[1]] for attrs in sites}
    agent = Agent(plan, "a")
    agent.senses |= senses
    assert agent.step()["x"] == pytest.approx(expected, rel=1e-5)


ITEM = {
    ("item.get", "food", "x"): 3.0, ("item.get", "food", "y"): 4.0, ("item.get", "food", "z"): 0.0,
    ("item.get", "food", "radius"): 1.0, ("item.get", "food", "load"): 7.0,
}  # fmt: skip


def item(expression: str, row: int = 0, members: str = "") -> float:
    plan = plan_of(f"species a {{ x = 0\n{members}\nlet f = nearest(food)\nstart s\nstate s {{ x = {expression} }} }}")
    agent = Agent(plan, "a", **{"reduce.item": row})
    agent.senses |= ITEM if row >= 0 else {"item.get": 0.0}
    return agent.step()["x"]


@pytest.mark.parametrize(
    ("expression", "present", "none"),
    [
        ("if distance(f) > 4.9 mm then min(distance(f) / 1 mm, 100) else 0", 5, 100),
        ("dot(direction(f), heading)", 0.6, 0),
        ("dot(direction(f, to: self), heading)", -0.6, 0),
        ("dot(position(f), heading) / 1 mm", 3, 0),
        ("f.load", 7, 0),
        ("if f is none then 1 else 2", 2, 1),
        ("if no f then 1 else 2", 2, 1),
        ("falloff(f, floor: 1 mm)", 0.2, 0),
        ("length(velocity(f)) / 1 mm/s", 0, 0),
    ],
)
def test_places_are_there_or_none(expression, present, none):
    assert item(expression) == pytest.approx(present)
    assert item(expression, -1) == pytest.approx(none)


def test_touching_counts_both_radii():
    assert item("if touching(f) then 1 else 0", members="radius 3.9 mm") == 0
    assert item("if touching(f) then 1 else 0", members="radius 4.1 mm") == 1
    assert item("if touching(f) then 1 else 0", -1, members="radius 4.1 mm") == 0


def test_feelers_are_written_out_from_side_to_side():
    text = "species a {{ x = 0\nstart s\nstate s {{ x = {} }} }}"
    rays = []

    def ray(dx, dy, dz, reach):
        rays.append((round(math.degrees(math.atan2(-dz, dx))), reach))
        return (dx < 0.9, 2.0 if dz > 0 else 1.0, 0.0, 0.0, 1.0)

    feelers = "feelers(stones, count: 3, spread: 30 deg, reach: 5 mm)"
    agent = Agent(plan_of(text.format(f"sum(h in {feelers}: h.distance / 1 mm)")), "a", ray=ray).step()
    assert agent["x"] == 3
    assert sorted(set(rays)) == [(-30, 5), (0, 5), (30, 5)]
    for how, expected in [
        (f"count({feelers})", 2),
        (f"min(h in {feelers}: h.distance) / 1 mm", 1),
        (f"mean(h in {feelers}: h.distance) / 1 mm", 1.5),
        (f"if any(h in {feelers}: h.distance > 3 mm) then 1 else 0", 0),
        (f"if every(h in {feelers}: h.distance < 3 mm) then 1 else 0", 1),
        (f"nearest({feelers}).distance / 1 mm", 1),
        (f"best(h in {feelers}: h.distance / 1 mm).distance / 1 mm", 2),
    ]:
        assert Agent(plan_of(text.format(how)), "a", ray=ray).step()["x"] == pytest.approx(expected), how


def ops_of(text: str) -> dict[str, list[tuple]]:
    plan = plan_of(text)
    operations: dict[str, list[tuple]] = {}
    for species in plan.species.values():
        for phase in (species.born, species.decide, species.act, species.blend):
            for node in collect_required_nodes(n for _, s in iterate_statements(phase) for n in list_operands(s)):
                operations.setdefault(node.op, []).append(node.attrs)
    return operations


def test_sets_become_what_the_runtime_has():
    text = "species a {{ x = 0\nstart s\nstate s {{ x = {} }} }}"
    assert ops_of(text.format("count(neighbours(9 mm))"))["set.agents"] == [("a", True)]
    assert ops_of(text.format("count(neighbours(9 mm, fov: 90 deg))"))["set.agents"] == [("a", False)]
    assert ops_of(text.format("if no nearest(food, within: 5 mm) then 1 else 0"))["set.items"] == [("food",)]
    every = ops_of(text.format("if every(f in all(food): f.load > 1) then 1 else 0"))
    assert "reduce.any" in every and "not" in every
    assert ops_of(text.format("best(f in all(food): f.load).load"))["reduce.item"]
    assert ops_of(text.format("mean(n in neighbours(9 mm): n.speed) / 1 mm/s"))["reduce.count"] == [()]


def test_terms_of_sums_are_rounded_by_their_dimension():
    assert [
        choose_quantum_exponent(d)
        for d in (Dimension(), Dimension(length=1), Dimension(length=1, time=-1), Dimension(length=2), Dimension(length=-1))
    ] == [-24, -20, -20, -10, -30]


def test_chains_of_lets_do_not_go_deep_or_grow():
    lets = "\n".join(f"let v{i} = v{i + 1} + v{i + 1} * size / 1 mm" for i in range(200))
    plan = plan_of(f"species a {{ x = 0\n{lets}\nlet v200 = size / 1 mm\nstart s\nstate s {{ x = v0 * 0 }} }}")
    assert len(plan.nodes) < 3000


# --- not yet ---------------------------------------------------------------------------------------------------------


def test_what_cannot_run_is_refused_at_its_place():
    world = "ant 1\nworld {\n  surface ground\n  obstacle stones\n}\nfield trail on stones { cell 4 mm; half_life 4 s }\n"
    _, report = lowered("species a {\n  start s\n  state s { steer heading * trail }\n}", world)
    assert set(codes(report)) == {"not-yet"}
    lines = [d.span.source.find_line_column(d.span.start)[0] for d in report.diagnostics if d.span]
    assert lines == [6]
    assert all(d.help for d in report.diagnostics)


# --- order from the scene --------------------------------------------------------------------------------------------

LAYERS = "species a { start s\nstate s { steer heading }\nlayers { up * 0.5; state; heading * 0.25 when state == s } }"


def test_a_scene_may_order_the_layers_by_their_text_or_first_word():
    plan = plan_of(LAYERS, orders={"a": ["heading * 0.25", "state", "up * 0.5"]})
    assert [layer.text.split()[0] for layer in plan.species["a"].layers] == ["heading", "state", "up"]
    assert Agent(plan, "a").step().push == pytest.approx((1, 0, 0))
    assert Agent(plan_of(LAYERS), "a").step().push == pytest.approx((0.5, 0.5, 0))


@pytest.mark.parametrize(("order", "word"), [(["state"], "omits"), (["state", "nonsense", "up * 0.5"], "nonsense")])
def test_an_order_that_does_not_fit_is_refused(order, word):
    _, report = lowered(LAYERS, orders={"a": order})
    assert codes(report) == ["layer-order"]
    assert word in report.diagnostics[0].message


@pytest.mark.parametrize("sign", ["+", "*", "/", "-"])
def test_what_stands_deep_in_an_expression_is_lowered_once(sign: str, monkeypatch: pytest.MonkeyPatch) -> None:
    nodes = []
    plain = expressions._lower_param
    monkeypatch.setitem(expressions._LOWERER_BY_EXPRESSION, model.ParamRef, lambda w, e: nodes.append(e) or plain(w, e))
    plan_of(f"species a {{\nparam deep = 2\nx = 0\nstart s\nstate s {{ x = {f' {sign} '.join(['deep'] * 24)} }}\n}}\n")
    assert len(nodes) == 24
