"""Both backends, any chunk, any number of threads, any order of rows: the same bits at every frame, for all operations."""

from __future__ import annotations

from typing import get_args, get_type_hints

import numpy as np
import plans
import pytest

from antdsl.cli.commands.run import BackendName
from antdsl.plan import ir
from antdsl.plan.traverse import collect_required_nodes, iterate_with_positions, list_operands
from antdsl.program.tables.effects import EFFECT_BY_OPERATION
from antdsl.runtime import Options, bind, state_hash, step
from antdsl.runtime.backends import BACKENDS

STEPS = 14


def run(plan: ir.Plan, setting, options: Options, steps: int = STEPS) -> list[str]:
    world = bind(plan, setting, options)
    hashes = [state_hash(world)]
    for _ in range(steps):
        step(world)
        hashes.append(state_hash(world))
    return hashes


@pytest.fixture(scope="module")
def reference() -> list[str]:
    return run(plans.rich(), plans.setting(), Options(backend="reference"))


@pytest.mark.parametrize(
    "options",
    [
        Options(backend="numpy"),
        Options(chunk=7, backend="numpy"),
        Options(chunk=1000, shuffle_rows=5, backend="numpy"),
        Options(chunk=9, threads=2, shuffle_rows=1, backend="numpy"),
        Options(backend="reference", shuffle_rows=2),
        *(Options(backend=name, chunk=11) for name in BACKENDS if name not in ("numpy", "reference")),
    ],
    ids=str,
)
def test_the_same_hash_at_every_frame(reference, options):
    assert run(plans.rich(), plans.setting(), options) == reference


def test_a_backend_can_be_chosen_by_its_name():
    names = set(BACKENDS)
    assert {each.value for each in BackendName} == names, "`BackendName` in antdsl/cli/commands/run.py"
    assert set(get_args(get_type_hints(Options)["backend"])) == names, "`Options.backend` in antdsl/runtime/world.py"


def test_hashes_tell_states_apart(reference):
    assert len(set(reference)) == len(reference)
    assert run(plans.rich(), plans.setting(seed=12), Options(backend="numpy"), 3) != reference[:4]


def test_things_happen_in_the_rich_plan():
    world = bind(plans.rich(), plans.setting(), Options(backend="numpy"))
    alarmed = 0
    for _ in range(STEPS):
        step(world)
        alarmed += int(world.populations["ant"].events["alarm"].sum())
    ants = world.populations["ant"]
    assert world.transitions["ant.search->carry"] > 3 and world.transitions["ant.carry->search"] > 0
    assert alarmed > 3 and (ants.now["friend"] >= 0).any() and ants.next_id > 40 and world.faults.fault_count == 0
    assert (world.populations["fly"].now["hops"] > 0).any()


def operations(plan: ir.Plan) -> set[str]:
    names = set()
    for species in plan.species.values():
        for block in (species.born, species.decide, species.act, species.blend):
            for _, statement in iterate_with_positions(block):
                names |= {node.op for node in collect_required_nodes(list_operands(statement))}
                names.add(statement.op if isinstance(statement, ir.Request) else type(statement).__name__)
    return names


def test_every_operation_is_covered():
    from test_runtime_ground import surfaces_plan

    elsewhere = {
        "const.i64",
        "told",
        "noise",
        "agent.age",
        "reduce.nth_agent",
        "reduce.nth_item",
        "clear.velocity",
        "gap.widest",
        "contact",
        "clip.value",
        "flow.reachable",  # tests/fields/test_reachable.py
        "camera.position",  # tests/senses/test_cameras.py
        "camera.in_view",
        "lamp.light",  # tests/senses/test_lamp_light.py
    }  # tests/specs/test_specs.py, tests/numerics/test_noise.py, tests/senses/test_clear_velocity.py,
    required = set(ir.OPERATION_BY_NAME) - elsewhere  # tests/runtime/test_meaning_others.py, tests/runtime/test_collisions.py
    required |= {"If", "Store", "Claim", "Give", *EFFECT_BY_OPERATION} - {"carve"}  # tests/runtime/test_digging.py
    lacking = required - operations(plans.rich()) - operations(surfaces_plan())
    assert not lacking, f"no plan here has {lacking}: put them into tests/plans.py, or name the test that they have above"


def test_a_value_used_before_and_after_a_store_is_read_before_it():
    t = plans.Text()
    old = t.load("mood", 0)
    act = plans.block(
        plans.when(t("lt", t.draw("a"), 0.5), plans.store("first", old)),
        plans.store("mood", t("add", t.snap("mood"), 1.0)),
        plans.when(t("lt", t.draw("b"), 0.5), plans.store("second", old)),
    )
    hashes = {}
    for backend in ("numpy", "reference"):
        world = bind(plans.bare(act, "mood", "first", "second"), plans.crowd(64), Options(backend=backend))
        for _ in range(3):
            step(world)
        now = world.populations["ant"].now
        assert set(now["second"].tolist()) <= {0.0, 1.0, 2.0} and 2.0 in now["second"] and (now["mood"] == 3).all()
        hashes[backend] = state_hash(world)
    assert hashes["numpy"] == hashes["reference"]


def test_uniform_conditions_and_values():
    t = plans.Text()
    late = t("gt", t("step", attrs=("frame",)), 2.0)
    act = plans.block(
        plans.when(
            late,
            plans.store("mood", t("add", t.snap("mood"), t("step", attrs=("frame",)))),
            plans.store("first", t.b.add_number(4)),
        ),
        plans.store("second", t("mul", t("run", attrs=("dt",)), 24.0)),
    )
    for backend in ("numpy", "reference"):
        world = bind(plans.bare(act, "mood", "first", "second"), plans.crowd(5), Options(backend=backend))
        for _ in range(4):
            step(world)
        now = world.populations["ant"].now
        assert now["mood"].tolist() == [7.0] * 5 and now["first"].tolist() == [4.0] * 5 and now["second"].tolist() == [1.0] * 5


def test_a_world_without_agents_runs():
    for backend in ("numpy", "reference"):
        world = bind(plans.rich(), plans.setting(ants=0, flies=0), Options(backend=backend))
        step(world)
        assert len(world) == 0 and world.frame == 1


def test_a_crowd_on_one_spot_has_a_capped_number_of_neighbours():
    t = plans.Text()
    near = t("set.agents", 5.0, -1.0, attrs=("ant", True))
    act = plans.block(
        plans.store("mood", t("reduce.count", near, t.b.true)),
        plans.store("first", t("reduce.max", near, t.b.true, t("number", t("eq", t("other.id"), t.b.add_agent_id(299))))),
    )
    world = bind(plans.bare(act, "mood", "first"), plans.crowd(300, radius=0.0), Options(chunk=50, backend="numpy"))
    step(world)
    now = world.populations["ant"].now
    assert (now["mood"] == 256).all() and np.count_nonzero(now["first"]) == 0  # the lesser ids of those at the same distance


def test_sorting_rows_by_place_changes_nothing(reference, monkeypatch):
    from antdsl.runtime import phases

    monkeypatch.setattr(phases, "_SORT_INTERVAL_FRAMES", 1)
    monkeypatch.setattr(phases, "_MIN_AGENTS_TO_SORT", 2)
    world = bind(plans.rich(), plans.setting(), Options(backend="numpy"))
    old_ids = world.populations["ant"].ids.copy()
    for k in range(STEPS):
        step(world)
        assert state_hash(world) == reference[k + 1]
    assert not np.array_equal(world.populations["ant"].ids[:40], old_ids)
