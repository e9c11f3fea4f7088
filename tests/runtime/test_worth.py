"""Places that learn what they are worth: `combine max`, deposits that say a level, and the example that finds home by it."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import meshes
import numpy as np
import pytest
from meaning import crowd, item, play

from antdsl.pipeline import open_scene, simulate
from antdsl.scene.setting import MeshData

SCENE = Path(__file__).resolve().parents[2] / "examples" / "worth" / "scene.yaml"
WORLD = "ant 1\nworld { surface ground; items food }\nfield worth on ground { cell 10 mm; combine max }\n"
GROUND = {"ground": MeshData(*meshes.grid(200, 10))}
STILL = "response 1 step\non spawn { velocity = vector(0 mm/s, 0 mm/s, 0 mm/s) }\n"


def test_worth_is_learned_as_the_formula_says() -> None:
    """U(s') = R(s') + γ · max U(s''), a sweep a step, against the same sum over a plain array."""
    points = [(10.0 * i + 5, 10.0 * j + 5) for i in range(-3, 4) for j in range(-3, 4)]
    text = f"""species a {{ {STILL}x = 0
start s
state s {{
  x = worth
  deposit worth (if touching(food) then 1 else 0) + 0.8 * max(worth, nearest: 9)
  when false -> s }} }}"""
    food = {"food": (item("f", 5, 15),)}  # on the place (5, 15) alone
    history = play(text, crowd(at=points), steps=9, world=WORLD, surfaces=GROUND, items=food)
    worth = np.zeros((9, 9))
    reward = np.zeros((7, 7))
    reward[3, 4] = 1
    for step in range(1, 10):
        assert history.at("x", step) == pytest.approx(worth[1:-1, 1:-1].ravel(), rel=1e-5, abs=1e-6)
        best = np.max([worth[1 + i : 8 + i, 1 + j : 8 + j] for i in (-1, 0, 1) for j in (-1, 0, 1)], axis=0)
        worth[1:-1, 1:-1] = np.maximum(worth[1:-1, 1:-1], reward + 0.8 * best)
    assert worth[4, 5] == pytest.approx(sum(0.8**k for k in range(9))) and worth.max() < 1 / (1 - 0.8)


def test_a_level_and_a_rate_into_a_field_that_keeps_the_greatest() -> None:
    lines = "x = worth; deposit worth 4 + id; deposit worth 20 /s; when false -> s"
    text = f"species a {{ {STILL}x = 0\nstart s\nstate s {{ {lines} }} }}"
    assert play(text, crowd(3), steps=3, world=WORLD, surfaces=GROUND)["x"] == [6, 6, 6]  # the greatest, however often


@pytest.mark.slow
def test_ants_find_home_and_food_by_worth_alone() -> None:
    shot, report = open_scene(SCENE)
    assert shot is not None, report.sort_by_place()
    world = next(islice(simulate(shot), 480, None))
    assert world.items["nest"].amounts["load"].sum() >= 5
    total = sum(float(i.amounts["load"].sum()) for i in world.items.values())
    assert total + float(world.populations["learner"].now["load"].sum()) == 500
    home = world.fields["to_nest"]
    away = np.linalg.norm(home.cells.position - world.items["nest"].position[0], axis=1)
    held = home.amounts > 1e-6
    by_distance = [np.median(home.amounts[held & (away > low) & (away <= low + 20)]) for low in (0, 20, 40, 60, 80)]
    assert (np.diff(by_distance) < 0).all() and by_distance[0] > 3 * by_distance[-1]
    assert home.amounts.max() <= 10.001  # reward / (1 - gamma)
