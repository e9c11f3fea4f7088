"""Claims and gifts, events, births and deaths, faults: what agents do to each other and to things."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import plans
import pytest

from antdsl.plan import ir
from antdsl.runtime import FaultStop, Options, bind, restore_checkpoint, set_param, state_hash, step, take_checkpoint
from antdsl.scene.setting import ItemData
from antdsl.source import Source, Span

B, L = ir.ValueKind.BOOL, ir.ValueKind.I64
BACKENDS = ("numpy", "reference")


def total(world) -> float:
    items = sum(float(i.amounts["load"].sum()) for i in world.items.values())
    return items + sum(float(p.now["load"].astype(np.float64).sum()) for p in world.populations.values())


def eaters(amount: float) -> ir.Plan:
    """All agents claim from the one item each step; those who won twice give all back to the other."""
    t = plans.Text()
    first_item, second_item = t("const.i32", attrs=(0,)), t("const.i32", attrs=(1,))
    wish = t("mul", amount, t("add", 0.5, t.draw("wish")))
    decide = plans.block(
        ir.Claim("food", "load", first_item, wish, "won", "load", "a", None),
        plans.when(t("lt", t.draw("again"), 0.3), ir.Claim("food", "load", first_item, wish, "won", "load", "b", None)),
    )
    act = plans.block(
        plans.when(t("load", attrs=("won", 1), kind=B), plans.store("wins", t("add", t.snap("wins"), 1.0))),
        plans.when(
            t("gt", t("load", attrs=("load", 2)), 2.5 * amount),
            ir.Give("food", "load", second_item, t("mul", 0.7, t("load", attrs=("load", 2))), "load", None),
        ),
    )
    return plans.bare(
        act,
        "load",
        "wins",
        decide=decide,
        extra_registers=(ir.Register("won", B, "temp"),),
        items={"food": ir.ItemsPlan("food", {"load": 0.0})},
    )


@pytest.mark.parametrize("amount", [1.0, 0.1, 1 / 3])
def test_nothing_is_lost_or_made(amount):
    items = {"food": (ItemData("a", (0, 0, 0), 1.0, {"load": 40.0}), ItemData("b", (9, 0, 0), 1.0))}
    hashes = []
    for options in (Options(), Options(backend="reference"), Options(shuffle_rows=1, chunk=3)):
        world = bind(eaters(amount), plans.crowd(25, items=items), options)
        for _ in range(12):
            step(world)
            assert total(world) == 40.0
            assert world.items["food"].amounts["load"].min() >= 0
        assert world.populations["ant"].now["wins"].max() > 1 and world.items["food"].amounts["load"][1] > 0
        hashes.append(state_hash(world))
    assert len(set(hashes)) == 1


def test_the_last_crumb_goes_to_one():
    items = {"food": (ItemData("a", (0, 0, 0), 1.0, {"load": 3.0}), ItemData("b", (9, 0, 0), 1.0))}
    t = plans.Text()
    decide = plans.block(ir.Claim("food", "load", t.b.add_row(0), t.b.add_number(1), "won", "load", "a", None))
    plan = plans.bare(
        plans.block(),
        "load",
        decide=decide,
        extra_registers=(ir.Register("won", B, "temp"),),
        items={"food": ir.ItemsPlan("food", {"load": 0.0})},
    )
    winners = set()
    for seed in range(6):
        world = bind(plan, plans.crowd(20, items=items, seed=seed))
        for _ in range(3):
            step(world)
        load = world.populations["ant"].now["load"]
        assert load.sum() == 3 and load.max() == 1 and world.items["food"].amounts["load"][0] == 0
        winners |= set(np.flatnonzero(load).tolist())
    assert len(winners) > 8  # not always the same ids


def test_claims_on_nothing_win_nothing():
    t = plans.Text()
    decide = plans.block(
        ir.Claim("food", "load", t.b.add_row(-1), t.b.add_number(1), "won", "load", "a", None),
        ir.Claim("food", "load", t.b.add_row(7), t.b.add_number(1), "won", "load", "b", None),
        ir.Claim("food", "load", t.b.add_row(0), t.b.add_number(-1), "won", "load", "c", None),
    )
    act = plans.block(ir.Give("food", "load", t.b.add_row(-1), None, "load", None))
    plan = plans.bare(
        act,
        "load",
        decide=decide,
        extra_registers=(ir.Register("won", B, "temp"),),
        items={"food": ir.ItemsPlan("food", {"load": 0.0})},
    )
    for backend in BACKENDS:
        world = bind(
            plan, plans.crowd(4, items={"food": (ItemData("a", (0, 0, 0), 1.0, {"load": 3.0}),)}), Options(backend=backend)
        )
        step(world)
        assert not world.populations["ant"].now["load"].any() and world.items["food"].amounts["load"][0] == 3


def test_an_event_is_seen_once_a_step_later_by_those_in_reach():
    t = plans.Text()
    first = t("and", t("eq", t("step", attrs=("frame",)), 1.0), t("eq", t("id"), t.b.add_agent_id(0)))
    act = plans.block(
        plans.when(
            first, ir.Request("emit", "alarm", (t.b.add_number(20), None), None), ir.Request("emit", "self", (None, None), None)
        ),
        plans.when(t("event", attrs=("alarm",)), plans.store("heard", t("add", t.snap("heard"), 1.0))),
        plans.when(t("event", attrs=("self",)), plans.store("felt", t("add", t.snap("felt"), 1.0))),
    )
    plan = plans.bare(act, "heard", "felt")
    from dataclasses import replace

    plan = replace(plan, species={"ant": replace(plan.species["ant"], event_names=("alarm", "self"))})
    for backend in BACKENDS:
        world = bind(plan, plans.crowd(50), Options(backend=backend, shuffle_rows=4))
        ants = world.populations["ant"]
        away = np.linalg.norm(ants.position - ants.position[ants.find_rows(np.array([0]))], axis=1)
        for k in range(4):
            step(world)
            assert (ants.now["heard"] == ((away <= 20) & (k > 0))).all()
            assert (ants.now["felt"] == ((ants.ids == 0) & (k > 0))).all()
        assert 1 < (away <= 20).sum() < 50


def breeders() -> ir.Plan:
    """Even ids bear two at frame 2, ids that are a multiple of 3 die at frame 3; each has a friend."""
    t = plans.Text()
    from dataclasses import replace

    even = t("eq", t("snap", attrs=("parity",)), 0.0)
    frame = t("step", attrs=("frame",))
    act = plans.block(
        plans.when(
            t("and", even, t("eq", frame, 2.0)), *(ir.Request("spawn", "ant", (), None, site=site) for site in ("one", "two"))
        ),
        plans.when(t("and", t("eq", t.snap("third"), 0.0), t("eq", frame, 3.0)), ir.Request("die", "", (), None)),
        plans.when(t("eq", frame, 1.0), plans.store("friend", t.b.add_agent_id(3))),
        plans.store("sees", t("number", t("agent.alive", t.snap("friend", L), attrs=("ant",)))),
    )
    number = t("number", t("id"))

    def rest(n: float) -> ir.PlanNode:
        return t("sub", number, t("mul", t("floor", t("div", number, n)), n))

    born = plans.block(plans.store("parity", rest(2.0)), plans.store("third", rest(3.0)))
    plan = plans.bare(
        act,
        "parity",
        "third",
        "sees",
        born=born,
        extra_registers=(ir.Register("friend", L, "attribute", -1, referenced_species="ant"),),
    )
    return replace(plan)


@pytest.mark.parametrize("options", [Options(), Options(backend="reference"), Options(shuffle_rows=8, chunk=2)], ids=str)
def test_births_and_deaths(options):
    world = bind(breeders(), plans.crowd(7), options)
    ants = world.populations["ant"]
    step(world)
    step(world)
    assert sorted(ants.ids.tolist()) == list(range(15))  # 0 2 4 6 bear 7 .. 14, in this order
    rows = ants.find_rows(np.array([0, 7, 8, 2, 9, 10]))
    assert np.array_equal(ants.position[rows[:1]], ants.position[rows[1:2]]) and np.array_equal(
        ants.position[rows[3]], ants.position[rows[5]]
    )
    assert ants.born[rows].tolist() == [0, 2, 2, 0, 2, 2] and ants.now["parity"][rows[1]] == 1
    assert (ants.now["friend"][ants.find_rows(np.arange(7))] == 3).all()
    step(world)
    assert sorted(ants.ids.tolist()) == [1, 2, 4, 5, 7, 8, 10, 11, 13, 14]
    assert (ants.now["friend"] == -1).all()
    step(world)
    assert not ants.now["sees"].any() and ants.next_id == 15
    assert state_hash(world) == _bred_hash()


def _bred_hash() -> str:
    world = bind(breeders(), plans.crowd(7))
    for _ in range(4):
        step(world)
    return state_hash(world)


def test_a_checkpoint_of_a_changed_crowd():
    world = bind(breeders(), plans.crowd(7))
    for _ in range(3):
        step(world)
    other = bind(breeders(), plans.crowd(7))
    restore_checkpoint(other, take_checkpoint(world))
    for _ in range(3):
        step(world)
        step(other)
    assert state_hash(world) == state_hash(other)
    with pytest.raises(ValueError, match=r"`species\.ant\.ids` is missing"):
        restore_checkpoint(other, {name: a for name, a in take_checkpoint(world).items() if not name.startswith("species")})


SOURCE = Source("ant.ant", "fear = calm / (luck - 0.5)\n")


def faulty() -> ir.Plan:
    """Divides by zero where the draw is small."""
    t = plans.Text()
    t.b.span = Span(SOURCE, 15, 25)
    below = t("floor", t("mul", t.draw("luck"), 4.0))
    t.b.span = Span(SOURCE, 7, 26)
    value = t("div", t.snap("calm"), below)
    statement = ir.Store("fear", value, Span(SOURCE, 0, 26))
    born = plans.block(plans.store("calm", t.b.add_number(3)), plans.store("fear", t.b.add_number(7)))
    return plans.bare(plans.block(statement), "calm", "fear", born=born)


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_fault_names_place_and_operands(backend):
    world = bind(faulty(), plans.crowd(40), Options(backend=backend, shuffle_rows=2))
    with pytest.raises(FaultStop) as stop:
        step(world)
    assert world.frame == 1  # the step was finished
    fault = stop.value.fault
    assert str(fault.span) == "ant.ant:1:1" and fault.value_name == "fear" and fault.operands[0] == ("calm / (luck - 0.5)", "inf")
    assert ("luck - 0.5", "0") in fault.operands and "is not finite" in str(fault)
    fear = world.populations["ant"].now["fear"]
    assert fault.agent == min(world.populations["ant"].ids[fear == 7])
    assert world.faults.fault_count == int((fear == 7).sum()) > 2 and np.isfinite(fear).all()


@pytest.mark.parametrize("backend", BACKENDS)
def test_the_quarantined_stand_still_and_the_others_go_on(backend):
    from dataclasses import replace

    t = plans.Text()
    plan = faulty()
    ant = plan.species["ant"]
    plan = replace(plan, species={"ant": replace(ant, blend=plans.block(plans.store("push.x", t.b.add_number(1))))})
    world = bind(plan, plans.crowd(30), Options(backend=backend, on_fault="quarantine"))
    for _ in range(3):
        step(world)
    ants = world.populations["ant"]
    old_positions = ants.position.copy()
    out = ants.quarantined.copy()
    assert 0 < out.sum() < 30
    step(world)
    moved = np.linalg.norm(ants.position - old_positions, axis=1)
    assert not moved[out].any() and (moved[~ants.quarantined] > 0).all() and not ants.quarantined.all()


def test_a_param_changes_without_compiling():
    t = plans.Text()
    act = plans.block(plans.store("mood", t("mul", t("param", attrs=("ant.gain",)), 2.0)))
    world = bind(plans.bare(act, "mood", params={"ant.gain": ir.ParamPlan("ant.gain", t.b.add_number(4))}), plans.crowd(3))
    step(world)
    assert world.populations["ant"].now["mood"].tolist() == [8.0] * 3
    set_param(world, "ant.gain", 0.5)
    step(world)
    assert world.populations["ant"].now["mood"].tolist() == [1.0] * 3


def test_the_time_of_a_frame_is_not_added_up():
    t = plans.Text()
    act = plans.block(plans.store("mood", t("step", attrs=("time",))), plans.store("old", t("age")))
    world = bind(plans.bare(act, "mood", "old"), plans.crowd(1, fps=Fraction(25), first_frame=1001))
    for _ in range(4):
        step(world)
    now = world.populations["ant"].now
    assert now["mood"][0] == np.float32(1005 / 25) and now["old"][0] == np.float32(3 / 25)
