"""From push to place on the plane: response, limits of speed and turn, kinematic animals, headings, and the same at any fps."""

from __future__ import annotations

from fractions import Fraction

import meshes
import numpy as np
import plans
import pytest

from antdsl.plan import ir
from antdsl.runtime import Options, bind, step
from antdsl.scene.setting import MeshData


def world_of(plan: ir.Plan, count: int = 1, **setting):
    return bind(plan, plans.crowd(count, radius=0.0, **setting), Options())


def store_plan(push: tuple[float, float, float], **registers: float) -> ir.Plan:
    t = plans.Text()
    blend = plans.block(*(plans.store(f"push.{a}", t.b.add_number(p)) for a, p in zip("xyz", push, strict=True)))
    born = plans.block(*(plans.store(name, t.b.add_number(v), infinite=True) for name, v in registers.items()))
    return plans.bare(plans.block(), blend=blend, born=born)


STILL = {"velocity.x": 1e-6, "heading.x": 1.0, "heading.z": 0.0}


def read(world, name: str) -> np.ndarray:
    return world.populations["ant"].read_vector(name)


def test_a_push_accelerates_to_full_speed_and_not_beyond():
    world = world_of(store_plan((1.0, 0.0, 0.0), **STILL))
    step(world)
    assert read(world, "velocity")[0, 0] == pytest.approx(200 / 24, rel=1e-5)  # max_force 200, mass 1
    for _ in range(10):
        step(world)
    assert read(world, "velocity")[0] == pytest.approx([30, 0, 0], abs=1e-4)


def test_a_push_above_one_or_off_the_ground_gives_no_more():
    strong = world_of(store_plan((3.0, 0.0, 4.0), **STILL))
    upward = world_of(store_plan((1.0, 5.0, 0.0), **STILL))
    step(strong)
    step(upward)
    assert np.linalg.norm(read(strong, "velocity")) == pytest.approx(200 / 24, rel=1e-4)
    assert read(upward, "velocity")[0] == pytest.approx([200 / 24, 0, 0], rel=1e-4) and read(upward, "position")[0, 1] == 0


@pytest.mark.parametrize("substeps", [1, 3])
def test_a_kinematic_animal_reaches_its_velocity_in_one_step(substeps):
    dt = 1 / 24
    plan = store_plan((0.5, 0.0, 0.0), response=0.0, max_force=2 * 30 / dt, **STILL)
    world = world_of(plan, substeps=substeps)
    step(world)
    assert read(world, "velocity")[0, 0] == pytest.approx(30, rel=1e-4)
    assert read(world, "position")[0, 0] == pytest.approx(30 * dt, rel=1e-3)


def test_a_turn_takes_its_time():
    plan = store_plan((0.0, 0.0, 1.0), max_turn=2.0, **{**STILL, "velocity.x": 30.0})
    world = world_of(plan)
    previous_velocity = read(world, "velocity")[0]
    for _ in range(6):
        step(world)
        velocity = read(world, "velocity")[0]
        turned = np.arccos(
            np.clip(previous_velocity @ velocity / np.linalg.norm(previous_velocity) / np.linalg.norm(velocity), -1, 1)
        )
        assert turned == pytest.approx(2 / 24, rel=1e-3)
        previous_velocity = velocity


@pytest.mark.parametrize("direction", [(-1.0, 0.0, 0.0), (-0.6, 0.0, 0.8), (0.0, 0.0, 1.0)])
def test_the_heading_follows_smoothly_whatever_the_fps(direction):
    end_headings = []
    for fps in (24, 48, 96):
        world = world_of(store_plan(direction, max_force=60.0 * fps, **STILL), fps=Fraction(fps))
        most, previous_heading = 0.0, np.array([1.0, 0.0, 0.0])
        for _ in range(fps // 4):
            step(world)
            heading = read(world, "heading")[0]
            assert np.linalg.norm(heading) == pytest.approx(1, abs=1e-5)
            most, previous_heading = max(most, float(np.linalg.norm(heading - previous_heading))), heading
        assert most < 0.55 * 24 / fps
        end_headings.append(previous_heading)
    assert end_headings[0] @ end_headings[2] > 0.97 and end_headings[0] @ np.array(direction) > 0.5


@pytest.mark.parametrize("substeps", [1, 2])
@pytest.mark.parametrize("direction", [(-1.0, 0.0, 0.0), (-0.6, 0.0, 0.8), (0.96, 0.0, 0.28), (0.02, 0.0, 0.02)])
def test_a_kinematic_animal_faces_at_once_where_it_goes(direction, substeps):
    plan = store_plan(direction, response=1 / 24, max_force=60.0 * 24, **STILL)
    world = world_of(plan, substeps=substeps)
    for _ in range(2):
        step(world)
        assert read(world, "heading")[0] == pytest.approx(np.array(direction) / np.linalg.norm(direction), abs=1e-5)


def test_a_kinematic_animal_turns_no_faster_than_it_may_and_its_heading_goes_with_it():
    turned = np.radians(16.3)
    start = {**STILL, "velocity.x": 10.0}
    plan = store_plan((0.0, 0.0, 1.0), response=1 / 24, max_force=60.0 * 24, max_turn=turned * 24, **start)
    world = world_of(plan)
    for number in range(1, 5):
        step(world)
        for name in ("velocity", "heading"):
            x, _, z = read(world, name)[0]
            assert np.arctan2(z, x) == pytest.approx(number * turned, abs=1e-4)


def test_who_hardly_moves_does_not_turn():
    world = world_of(store_plan((0.0, 0.0, 0.0), **{**STILL, "velocity.x": 0.0, "velocity.z": 1e-4}))
    for _ in range(24):
        step(world)
    assert read(world, "heading")[0] == pytest.approx([1, 0, 0], abs=1e-3)


@pytest.mark.parametrize("fps, substeps", [(25, 1), (48, 1), (24, 2), (96, 1)])
def test_a_way_does_not_depend_on_the_rate(fps, substeps):
    def end_position(fps: int, substeps: int) -> np.ndarray:
        world = world_of(store_plan((0.6, 0.0, 0.3), **STILL), fps=Fraction(fps), substeps=substeps)
        for _ in range(2 * fps):
            step(world)
        return read(world, "position")[0]

    assert np.linalg.norm(end_position(fps, substeps) - end_position(24, 1)) < 0.6  # of 57 mm: first-order steps


def test_hills_neither_slow_nor_turn_an_agent_that_coasts_at_any_rate():
    ground, ends = MeshData(*meshes.terrain(400.0, 24)), []  # faces are up to 10 degrees off the smooth normals
    for fps in (24, 240):
        plan = store_plan((0.0, 0.0, 0.0), **{**STILL, "velocity.x": 20.0})
        world = bind(plan, plans.crowd(60, radius=80.0, surfaces={"ground": ground}, fps=Fraction(fps)), Options())
        speed = None
        for _ in range(2 * fps):
            step(world)
            speed = np.linalg.norm(read(world, "velocity"), axis=1) if speed is None else speed
        assert np.linalg.norm(read(world, "velocity"), axis=1) == pytest.approx(speed, rel=1e-5)
        ends.append(world.populations["ant"].position.copy())
    assert np.linalg.norm(ends[0] - ends[1], axis=1).max() < 0.05  # of 40 mm


@pytest.mark.parametrize("fps", [24, 96])
@pytest.mark.parametrize("speed", [0.5, 3.0, 12.0])
def test_a_push_against_the_motion_brakes_until_the_agent_has_turned(fps, speed):
    plan = store_plan((-1.0, 0.0, 0.0), max_turn=5.0, **{**STILL, "velocity.x": speed})
    world, against = world_of(plan, fps=Fraction(fps)), 0
    for _ in range(2 * fps):
        step(world)
        velocity = read(world, "velocity")[0]
        if velocity[0] > 1e-3:
            against += 1
            assert np.linalg.norm(velocity) <= max(speed, 3.0) + 1e-4  # a tenth of max_speed while it turns round
    assert 0.2 * fps < against < 0.8 * fps  # half of a half turn takes 0.31 s, and 0.6 s where braking interrupts it
    assert velocity == pytest.approx([-30, 0, 0], abs=0.3)


def test_no_speed_limit_means_none_and_bad_mass_means_none_moves():
    fast = world_of(store_plan((1.0, 0.0, 0.0), max_speed=float("inf"), **STILL))
    light = world_of(store_plan((1.0, 0.0, 0.0), mass=0.0, **STILL))
    for _ in range(48):
        step(fast)
        step(light)
    assert read(fast, "velocity")[0, 0] == pytest.approx(400, rel=1e-3)
    assert np.isfinite(read(light, "position")).all()
