"""The nearest of a whole species by a tree: the same agent as where all pairs are measured, to the last bit and the last tie."""

from __future__ import annotations

import numpy as np
import pytest
from meaning import OPTION_SETS, crowd, play
from plan_text import plan_of

from antdsl.passes import optimise_plan
from antdsl.runtime import Options, World, bind, step
from antdsl.runtime.sensing import nearest_pairs, pairs
from antdsl.runtime.sensing.nearest_pairs import find_nearest_agents
from antdsl.runtime.world import AXES, Population
from antdsl.scene.setting import WorldSetting

EVERY_WAY = (*OPTION_SETS, Options(backend="native", wait_for_code=True, chunk=16, shuffle_rows=5))
STILL = "on spawn { velocity = 0 * velocity }"


def standing(positions: np.ndarray, seed: int = 3) -> tuple[World, Population]:
    """A world with agents in these places (n, 3), rows and ids in no order."""
    text = f"species a {{ {STILL}\nstart s\nstate s {{ steer heading }} }}"
    world = bind(
        optimise_plan(plan_of(text)), WorldSetting(crowds=(crowd(len(positions), "a", radius=50.0),)), Options(shuffle_rows=seed)
    )
    population = world.populations["a"]
    for axis, column in zip(AXES, positions.T, strict=True):
        population.start[f"position.{axis}"] = column.astype(np.float32)[population.ids]
    return world, population


def by_pairs(world: World, other: Population, own: tuple[np.ndarray, ...], ids: np.ndarray | None) -> list[int]:
    with np.errstate(all="ignore"):
        every = pairs._make_all_pairs(world, other, own, ids)
        return pairs._find_best_agent(every, None, True, every.distance).tolist()


def by_tree(world: World, other: Population, own: tuple[np.ndarray, ...], ids: np.ndarray | None) -> list[int] | None:
    world.trees.clear()
    with np.errstate(all="ignore"):
        pair_rows = find_nearest_agents(world, other, own, ids)
    if pair_rows is None:
        return None
    result = np.full(len(own[0]), -1)
    result[pair_rows[0]] = other.ids[pair_rows[1]]
    assert (np.diff(pair_rows[0]) > 0).all(), "one pair at most for each, in the order of who asks"
    return result.tolist()


RNG = np.random.Generator(np.random.Philox(8))
LATTICE = np.stack(np.meshgrid(np.arange(9.0), np.arange(3.0), np.arange(9.0)), axis=-1).reshape(-1, 3)
CROWDS = {
    "scattered": RNG.uniform(-300, 300, (400, 3)),
    "on a plane": RNG.uniform(-30, 30, (300, 3)) * (1, 0, 1),
    "a lattice": LATTICE * 7,
    "a lattice of float32 steps": 1000 + LATTICE * 6.1035e-5,
    "all in one place": np.full((200, 3), 12.5),
    "heaps": np.repeat(RNG.uniform(-30, 30, (9, 3)), 30, axis=0),
    "closer than squares can tell": RNG.uniform(-1, 1, (150, 3)) * 1e-22,
    "closer than float32 can tell": np.concatenate([RNG.uniform(-1, 1, (90, 3)) * 1e-18, [[0.0, 0, 1]]]),
    "two": np.array([[0, 0, 0], [3, 0, 4.0]]),
    "one": np.array([[1, 2, 3.0]]),
    "on a sphere about one": np.concatenate([[[0.0, 0, 0]], *(np.eye(3) * s for s in (5, -5))]),
    "far out": RNG.uniform(-300, 300, (100, 3)) + 1e6,
}


@pytest.mark.parametrize("name", CROWDS)
def test_the_nearest_is_the_same_as_where_all_pairs_are_measured(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    world, population = standing(CROWDS[name])
    own = tuple(population.start[f"position.{axis}"] for axis in AXES)
    assert by_tree(world, population, own, population.ids) == by_pairs(world, population, own, population.ids)
    strangers = tuple(RNG.uniform(-40, 40, (50, 3)).astype(np.float32).T)
    assert by_tree(world, population, strangers, None) == by_pairs(world, population, strangers, None)
    monkeypatch.setattr(nearest_pairs, "_MAX_EQUAL_DISTANCES", 1)
    nearest = by_pairs(world, population, own, population.ids)
    assert by_tree(world, population, own, population.ids) == nearest, "all of them measured"
    monkeypatch.setattr(nearest_pairs, "_PAIRS_PER_CHUNK", 50)
    assert by_tree(world, population, own, population.ids) == nearest, "bit by bit"


@pytest.mark.parametrize("odd", [np.nan, np.inf, -np.inf, 1e20, -3e38])
def test_where_a_place_is_no_place_all_pairs_are_measured(odd: float) -> None:
    positions = CROWDS["on a plane"].copy()
    positions[7, 1] = odd
    world, population = standing(positions)
    own = tuple(population.start[f"position.{axis}"] for axis in AXES)
    assert by_tree(world, population, own, population.ids) is None
    world, population = standing(CROWDS["on a plane"])
    assert by_tree(world, population, (np.float32([odd]), np.float32([0]), np.float32([0])), None) is None


NEAREST = f"""species a {{
  {STILL}
  who = none of a; whom = none of b; far = 0 mm
  start s
  state s {{
    steer 0 * heading
    who = nearest(a); whom = nearest(b); far = min(distance(nearest(b)), 99 mm)
    when id == 3 and time > 0.35 s -> t {{ die }}
  }}
  state t {{ when false -> s }}
}}
species b {{
  {STILL}
  start s
  state s {{ steer 0 * heading; when time > 0.55 s -> t {{ die }} }}
  state t {{ when false -> s }}
}}"""


def test_programs_see_the_same_on_all_backends() -> None:
    points = [(0, 0), (4, 0), (-4, 0), (0, 4), (30, 0)]
    history = play(
        NEAREST, crowd(species="a", at=points), crowd(species="b", at=[(31, 0), (-9, 0)], group=1), steps=9, option_sets=EVERY_WAY
    )
    assert history.at("who", 2) == [1, 0, 0, 0, 1] and history.at("whom", 2) == [1, 1, 1, 1, 0]
    assert history.at("far", 2) == [9, 13, 5, pytest.approx(np.hypot(9, 4)), 1]
    assert history["id"] == [0, 1, 2, 4] and history["whom"] == [-1] * 4, "nobody is left of them"


def test_no_full_pairs_are_built_where_only_the_nearest_is_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    measured = []
    monkeypatch.setattr(
        pairs,
        "_make_all_pairs",
        lambda *arguments, every=pairs._make_all_pairs: (measured.append(len(arguments[2][0])), every(*arguments))[1],
    )
    again = WorldSetting(crowds=(crowd(300, "a", radius=200.0), crowd(20, "b", radius=200.0, group=1)))
    for backend in ("numpy", "native"):
        world = bind(optimise_plan(plan_of(NEAREST)), again, Options(backend=backend, wait_for_code=True, chunk=64))
        for _ in range(3):
            step(world)
        assert not measured
    sum_program = NEAREST.replace("far = min(distance(nearest(b)), 99 mm)", "far = sum(n in all(a): distance(n))")
    world = bind(optimise_plan(plan_of(sum_program)), again, Options(backend="numpy"))
    step(world)
    assert sum(measured) == 300, "who asks more than who is nearest measures all"
