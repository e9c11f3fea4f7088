"""What agents take from a field: settled as claims on items are, gone in the same step, conserved to the last bit."""

from __future__ import annotations

from pathlib import Path

import meshes
import numpy as np
import pytest
from meaning import OPTION_SETS, crowd
from plan_text import plan_of
from test_program import checked, complaints

from antdsl import passes, plan
from antdsl.fields.pheromone import DEPOSIT_QUANTUM
from antdsl.machine_code import llvm_compiler
from antdsl.plan.registers import number_statements
from antdsl.runtime import FieldStartData, MeshData, Options, World, WorldSetting, bind, state_hash, step
from antdsl.runtime.backends.reference import AgentRun, apply_claim_results
from antdsl.runtime.requests import EffectRequests

SHEEP = Path(__file__).parents[1] / "programs" / "sheep.ant"
NATIVE = Options(backend="native", chunk=8, threads=2, shuffle_rows=5, wait_for_code=True)
EVERY = (*OPTION_SETS, NATIVE) if llvm_compiler.is_available() else OPTION_SETS
WORLD = "ant 1\nworld { surface ground; items food { load = 10 } }\nfield grass on ground { cell 10 mm }\n"


def pasture(sheep: int, tufts: int = 0, growth: float = 0.0, seed: int = 1) -> tuple[object, WorldSetting]:
    """The test program, on a meadow of 15 by 15 cells with 3 in each."""
    program, report = checked(SHEEP.read_text(encoding="utf-8"))
    assert report.ok, complaints(report)
    lowered, report = plan.lower(program)
    assert report.ok
    setting = WorldSetting(
        seed=seed,
        surfaces={"meadow": MeshData(*meshes.grid(290.0, 6))},
        crowds=(crowd(sheep, "sheep", radius=60), crowd(tufts, "tuft", radius=120)),
        field_start={"grass": (FieldStartData(3.0, None, None),)},
        params={"tuft.growth": growth},
    )
    return passes.optimise_plan(lowered), setting


def units(values: np.ndarray) -> int:
    """Their sum in units of a deposit, each of which has to be whole."""
    deposit_units = np.asarray(values, np.float64) / DEPOSIT_QUANTUM
    assert np.array_equal(deposit_units, np.rint(deposit_units))
    return int(deposit_units.astype(np.int64).sum())


def mass(world: World) -> int:
    return units(world.fields["grass"].amounts) + units(world.populations["sheep"].now["load"])


def shared(world: World) -> int:
    """The most sheep that stand on one cell."""
    return int(np.bincount(world.populations["sheep"].cells["grass"]).max())


@pytest.mark.parametrize("frames", [100, pytest.param(1000, marks=pytest.mark.slow)])
def test_grass_and_what_was_eaten_are_together_what_was_there(frames: int) -> None:
    world = bind(*pasture(60))  # type: ignore[arg-type]
    start_mass, crowded, lost = mass(world), 0, 0
    states = next(m.states for m in world.plan.species["sheep"].machines)
    graze = states.index("graze")
    for _ in range(frames):
        waiting = world.populations["sheep"].now["main.state"] == graze
        step(world)
        sheep = world.populations["sheep"]
        assert mass(world) == start_mass
        crowded += shared(world) > 1
        lost += int(np.count_nonzero(waiting & (sheep.now["main.state"] == graze)))
    eaten = units(world.populations["sheep"].now["load"]) * DEPOSIT_QUANTUM
    assert crowded == frames and lost > 5, "several stood on one cell, and some came too late"
    assert start_mass * DEPOSIT_QUANTUM > 600 and eaten > 60
    assert world.fields["grass"].amounts.min() == 0.0


def test_grass_that_grows_is_what_was_laid_and_nothing_else() -> None:
    """24 steps a second, and 0.75 a second: each of 30 tufts lays exactly 1/32 in each step."""
    world = bind(*pasture(40, tufts=30, growth=0.75))  # type: ignore[arg-type]
    start_mass = mass(world)
    for frame in range(1, 101):
        step(world)
        assert mass(world) == start_mass + frame * 30 * round(1 / 32 / DEPOSIT_QUANTUM)


def test_all_backends_graze_alike() -> None:
    optimised_plan, setting = pasture(40, tufts=5, growth=0.5)
    hash_lists = []
    for options in EVERY:
        world = bind(optimised_plan, setting, options)  # type: ignore[arg-type]
        frames = 24 if options.backend == "reference" else 60
        hashes = []
        for _ in range(frames):
            step(world)
            hashes.append(state_hash(world))
        hash_lists.append(hashes)
    assert all(each == hash_lists[0][: len(each)] for each in hash_lists)


def play(lines: str, at: list[tuple[float, float]], steps: int, start: float, declared: str = "load = 0") -> World:
    """Agents with those changes at places, on cells that hold `start`, the same in every way."""
    text = f"species a {{ {declared}\nstart p\nstate p {{ {lines} }}\nstate q {{ when false -> p }} }}"
    optimised_plan = passes.optimise_plan(plan_of(text, WORLD))
    ground = {"ground": MeshData(*meshes.grid(60.0, 4))}
    setting = WorldSetting(seed=7, surfaces=ground, crowds=(crowd(at=at),),
                      field_start={"grass": (FieldStartData(start, None, None),)}, items={"food": ()})  # fmt: skip
    hashes, world = set(), None
    for options in OPTION_SETS:
        world = bind(optimised_plan, setting, options)
        for _ in range(steps):
            step(world)
        hashes.add(state_hash(world))
    assert len(hashes) == 1 and world is not None
    return world


def loads(world: World, name: str = "load") -> list[float]:
    return sorted(world.populations["a"].now[name].tolist())


def test_who_asks_for_so_much_gets_it_or_nothing_while_it_lasts() -> None:
    world = play("when true take 2 load from grass -> q", [(0, 0)] * 5 + [(20, 0)], 1, 7.0)
    assert loads(world) == [0, 0, 2, 2, 2, 2] and sorted(world.fields["grass"].amounts)[:3] == [1.0, 5.0, 7.0]
    again = play("when true take 2 load from grass -> q", [(0, 0)] * 5 + [(20, 0)], 3, 7.0)
    assert loads(again) == loads(world), "one is too little for the two who are left"


def test_all_goes_to_the_first_and_nothing_to_those_who_come_after() -> None:
    world = play("when true take all load from grass -> q", [(0, 0)] * 4 + [(20, 0)], 2, 3.25)
    assert loads(world) == [0, 0, 0, 3.25, 3.25]
    assert sorted(world.fields["grass"].amounts)[:3] == [0, 0, 3.25]


def test_who_takes_what_is_left_and_who_a_part_are_served_in_one_order() -> None:
    """Whatever the draw: those before the one who takes all get 1 each, it gets the rest, those after it nothing."""
    lines = "when id == 2 take all load from grass -> q; when id != 2 take 1 load from grass -> q"
    world = play(lines, [(0, 0)] * 5, 1, 8.0)
    got = world.populations["a"].now["load"][world.populations["a"].get_rows_by_id()]
    assert got.sum() == 8.0 and got[2] == 8.0 - np.count_nonzero(np.delete(got, 2)) >= 4
    assert world.fields["grass"].amounts.min() == 0.0


def test_what_is_taken_into_nothing_is_gone_and_off_all_cells_there_is_nothing() -> None:
    world = play("when true take 0.5 from grass -> q", [(0, 0), (0, 0)], 1, 2.0)
    assert world.fields["grass"].amounts.min() == 1.0
    world = play("when true take all from grass -> q", [(0, 0)], 1, 2.0)
    assert world.fields["grass"].amounts.min() == 0.0


def test_a_register_of_any_bits_and_a_cell_of_any_bits_lose_and_gain_the_same() -> None:
    """0.1 and 2.7 in float32 are no multiples of a unit, nor is 1.3: the field loses to the last bit what the register gained."""
    for amount in ("0.7", "all"):
        for had in (0.1, 2.7, 1e5):
            world = play(f"when true take {amount} load from grass -> q", [(0, 0)], 1, 1.3, f"load = {had}")
            gained = float(world.populations["a"].now["load"][0]) - float(np.float32(had))
            assert 0.6 < gained <= 1.3 and 1.3 - world.fields["grass"].amounts.min() == gained


def test_all_that_an_item_has_can_be_taken_too() -> None:
    from meaning import item

    text = "species a { load = 0\nstart p\nstate p { when true take all load from nearest(food) -> q }\n"
    text += "state q { when false -> p } }"
    optimised_plan = passes.optimise_plan(plan_of(text, WORLD))
    setting = WorldSetting(seed=7, surfaces={"ground": MeshData(*meshes.grid(60.0, 4))}, crowds=(crowd(at=[(0, 0)] * 3),),
                      items={"food": (item("f", 0, 0, load=6.5),)})  # fmt: skip
    for options in OPTION_SETS:
        world = bind(optimised_plan, setting, options)
        step(world)
        assert loads(world) == [0, 0, 6.5] and world.items["food"].amounts["load"].tolist() == [0]


@pytest.mark.parametrize(
    ("line", "code"),
    [
        ("when true take 1 from food -> q", "missing-argument"),
        ("when true take 1 g weight from grass -> q", "units-differ"),
        ("when true take load from grass -> q", "missing-argument"),
        ("when true take 1 lod from grass -> q", "unknown-name"),
        ("when true take 1 mm load from grass -> q", "wrong-unit"),
    ],
)
def test_what_cannot_be_taken_is_reported(line: str, code: str) -> None:
    _, report = checked(
        f"{WORLD}species a {{ load = 0; weight = 1 g\nstart p\nstate p {{ {line} }}\nstate q {{ when false -> p }} }}"
    )
    assert code in [d.code for d in report.errors], complaints(report)


def test_an_agent_that_is_run_again_gets_all_that_it_was_given() -> None:
    """As `explain` does: the reference takes one agent through the step, with what the world has settled."""
    text = "species a { load = 0.1; seen = 0\nstart p\nstate p { when true take all load from grass -> q { seen = load } }\n"
    optimised_plan = passes.optimise_plan(plan_of(text + "state q { when false -> p } }", WORLD))
    setting = WorldSetting(seed=7, surfaces={"ground": MeshData(*meshes.grid(60.0, 4))}, crowds=(crowd(at=[(0, 0)] * 2),),
                      field_start={"grass": (FieldStartData(1.3, None, None),)}, items={"food": ()})  # fmt: skip
    world, again = bind(optimised_plan, setting), []

    def watch(world: World) -> None:
        ants = world.populations["a"]
        for row in range(len(ants)):
            now = {name: array[row : row + 1].copy() for name, array in ants.start.items()}
            agent = AgentRun(world, ants, row, now, 0, EffectRequests(), number_statements(ants.plan))
            agent.run("decide")
            apply_claim_results(agent, ants)
            agent.run("act")
            again.append((float(now["load"][0]), float(now["seen"][0])))

    world.watchers.append(watch)
    step(world)
    ants = world.populations["a"]
    assert again == list(zip(ants.now["load"].tolist(), ants.now["seen"].tolist(), strict=True))
    assert sorted(ants.now["load"].tolist()) == pytest.approx([0.1, 1.4], abs=1e-6)
