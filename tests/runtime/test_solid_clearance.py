"""Bodies stay outside solids, and outside the meshes and obstacles beside them: in a slot hardly wider than they are long, and
at the foot of a block on a floor."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from fractions import Fraction
from typing import Any

import meshes
import numpy as np
import pytest
from meaning import crowd
from plan_text import plan_of

from antdsl.passes import optimise_plan
from antdsl.runtime import MeshData, Options, World, WorldSetting, bind, state_hash, step
from antdsl.runtime.body_positions import compute_body_positions
from antdsl.runtime.moving.clearance.bodies_inside import find_bodies_inside
from antdsl.runtime.moving.clearance.solid_clearance import _find_free_shares, _find_shifts
from antdsl.scene.setting import SolidData

WALKER = """ant 2
use steering
world { solid soil }
species a {
  size 4 mm
  max_speed 30 mm/s
  SWITCH
  on spawn { heading = vector(1, 0, 0) }
  start go
  state go { steer wander(swing: 60 deg) }
  layers { separate(radius: 1.2 * size) * 0.5; state }
}"""


def slot() -> MeshData:
    """A floor of 40 by 40 mm with two walls, 5 mm apart and 8 mm high."""
    boxes = [meshes.box(*corners) for corners in (
        ((-20, -6, -20), (20, 0, 20)), ((-20, -1, -20), (20, 8, -2.5)), ((-20, -1, 2.5), (20, 8, 20)),
    )]  # fmt: skip
    faces = [faces + 8 * k for k, (_, faces) in enumerate(boxes)]
    return MeshData(np.concatenate([vertices for vertices, _ in boxes]), np.concatenate(faces))


FLOOR_WALKER = WALKER.replace("world { solid soil }", "world { surface floor; solid soil; obstacle post }")


def block_on_floor() -> dict[str, Any]:
    """Return a floor, a steep block of soil on it, and a post, as fields of a setting."""
    floor, post = meshes.grid(60, 20), meshes.box((-12, -1, -12), (-8, 10, -8))
    soil = meshes.box((-3, -4, -3), (3, 6, 3))
    return {
        "surfaces": {"floor": MeshData(*floor)}, "obstacles": {"post": MeshData(*post)},
        "solids": {"soil": SolidData(MeshData(*soil), 0.5)},
    }  # fmt: skip


def walking_at_block(count: int, clears: bool = True, options: Options | None = None, **fields: Any) -> World:
    text = FLOOR_WALKER.replace("SWITCH", "" if clears else "body_clearance false")
    setting = WorldSetting(fps=Fraction(24), crowds=(crowd(count, radius=16),), seed=4, **block_on_floor(), **fields)
    return bind(optimise_plan(plan_of(text, "")), setting, options or Options(backend="numpy"))


def walking(count: int, clears: bool = True, options: Options | None = None, **fields: Any) -> World:
    text = WALKER.replace("SWITCH", "" if clears else "body_clearance false")
    setting = WorldSetting(
        fps=Fraction(24), crowds=(crowd(count, radius=6),), solids={"soil": SolidData(slot(), 0.5)}, seed=4, **fields
    )
    return bind(optimise_plan(plan_of(text, "")), setting, options or Options(backend="numpy"))


def test_bodies_stay_outside_the_walls_of_a_slot_and_as_fast() -> None:
    inside, paths = [], []
    for clears in (False, True):
        world = walking(24, clears)
        population, shares, path = world.populations["a"], [], 0.0
        for frame in range(120):
            previous = population.position.copy()
            step(world)
            path += float(np.linalg.norm(population.position - previous, axis=1).mean())
            if frame > 12:  # bodies begin where they are placed, and leave from there
                shares.append(float(find_bodies_inside(world, population, np.arange(24)).mean()))
        inside.append(np.mean(shares))
        paths.append(path)
    assert inside[0] > 0.01 and inside[1] < 0.001, inside
    assert paths[1] > 0.95 * paths[0]


def test_bodies_stay_outside_the_floor_and_a_post_beside_a_solid() -> None:
    inside = []
    for clears in (False, True):
        world, shares = walking_at_block(60, clears), []
        for frame in range(120):
            step(world)
            if frame > 12:
                shares.append(float(find_bodies_inside(world, world.populations["a"], np.arange(60)).mean()))
        inside.append(np.mean(shares))
    assert inside[0] > 0.008 and inside[1] < 0.1 * inside[0], inside


def test_a_body_that_is_deep_at_one_end_leaves_with_its_middle() -> None:
    world = walking_at_block(1)
    population = world.populations["a"]
    population.position[0] = -4.2, 0.0, 0.0  # the wall is at x = -3, and the field is flat 1 mm behind it
    for name, values in (("heading", (1, 0, 0)), ("up", (0, 1, 0))):
        for axis, value in zip("xyz", values, strict=True):
            population.now[f"{name}.{axis}"][:] = value
    shift = _find_shifts(world, population)[0]
    assert find_bodies_inside(world, population, np.arange(1)).all()
    assert -1.2 < shift[0] < -0.5 and np.abs(shift[1:]).max() < 0.1
    for axis, value in zip("xyz", shift, strict=True):
        population.now[f"~lift.{axis}"][:] = value
    assert not find_bodies_inside(world, population, np.arange(1)).any()


def test_step_and_shift_together_are_no_longer_than_a_step() -> None:
    world = walking(24)
    population, farthest = world.populations["a"], 0.0
    longest = float((population.now["max_speed"] * np.float32(world.dt)).max())
    for _ in range(60):
        previous = compute_body_positions(population).copy()
        step(world)
        farthest = max(farthest, float(np.linalg.norm(compute_body_positions(population) - previous, axis=1).max()))
    assert farthest < 1.031 * longest


def test_results_do_not_depend_on_threads_rows_or_backends() -> None:
    for make in (walking, walking_at_block):
        assert len({state_hash(world) for world in _run_in_all_ways(make)}) == 1


def _run_in_all_ways(make: Callable[..., World]) -> Iterator[World]:
    for options in (
        Options(backend="numpy"), Options(backend="numpy", threads=2), Options(backend="native", wait_for_code=True),
        Options(backend="numpy", shuffle_rows=7), Options(backend="reference"),
    ):  # fmt: skip
        world = make(16, options=options, contacts="hard")
        for _ in range(10):
            step(world)
        yield world


def test_no_agents_change_nothing() -> None:
    world = walking(0)
    step(world)
    assert len(world.populations["a"]) == 0


def test_a_share_of_a_shift_fills_the_step() -> None:
    draw = np.random.default_rng(3)
    walked, change = draw.normal(size=(2, 500, 3))
    longest = draw.random(500) * 3
    share = _find_free_shares(walked, change, longest)
    moved = np.linalg.norm(walked + share[:, None] * change, axis=1)
    limit = np.maximum(longest, np.linalg.norm(walked, axis=1))
    is_part = (share > 0) & (share < 1)
    assert moved[is_part] == pytest.approx(limit[is_part], rel=1e-9) and is_part.sum() > 100
    assert (moved <= limit * (1 + 1e-9)).all() and (share == 1).any() and (share == 0).any()
    assert _find_free_shares(walked, np.zeros_like(change), longest).tolist() == [0.0] * 500
