"""Hunters and prey: the mistakes of the document that they come from are not made; what it counts per frame is had per second."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import meshes
import numpy as np
import pytest
from meaning import crowd
from test_program import checked, complaints

from antdsl import passes, plan
from antdsl.runtime import CrowdData, MeshData, Options, World, WorldSetting, bind, step

PROGRAMS = Path(__file__).parents[1] / "programs"
PER_SECOND = (("= 0.1 u/s ", "= 2.4 u/s^2 "), ("* nudge)", "* nudge * dt)"))  # of what is written per step, at 24 steps a second


def arena(*crowds: CrowdData, fps: int = 24, per_second: bool = False, still: bool = False) -> World:
    """The two species on a plane, a unit being a millimetre, far from a rim of 200 mm."""
    texts = [(PROGRAMS / name).read_text(encoding="utf-8") for name in ("hunters.ant", "rabbits.ant")]
    if per_second:
        for old, new in PER_SECOND:
            assert all(old in text for text in texts)
            texts = [text.replace(old, new) for text in texts]
    program, report = checked(*texts)
    assert report.ok, complaints(report)
    angle = np.linspace(0, 2 * np.pi, 65)
    rim = np.stack([200 * np.cos(angle), np.zeros(65), 200 * np.sin(angle)], axis=1)
    ground = {"ground": MeshData(*meshes.grid(600.0, 4))}
    setting = WorldSetting(fps=Fraction(fps), surfaces=ground, curves={"arena": rim}, seed=4, crowds=crowds)
    world = bind(passes.optimise_plan(plan.lower(program)[0]), setting, Options(threads=1))
    if still:
        for population in world.populations.values():
            for axis in "xyz":
                population.start[f"velocity.{axis}"][:] = population.now[f"velocity.{axis}"][:] = 0
    return world


def velocity(world: World, species: str) -> np.ndarray:
    population = world.populations[species]
    rows = population.get_rows_by_id()
    return np.stack([population.now[f"velocity.{axis}"][rows] for axis in "xyz"], axis=1)


def test_the_only_rabbit_in_reach_is_taken() -> None:
    world = arena(crowd(1, "hunter", at=[(0, 0)]), crowd(2, "rabbit", at=[(90, 0), (-20, 0)]))
    rabbits = world.populations["rabbit"]
    nearest_id = rabbits.ids[np.argmin(np.abs(rabbits.position[:, 0] + world.origin[0] + 20))]
    assert world.populations["hunter"].now["prey"].tolist() == [nearest_id]


def test_a_rabbit_without_a_hunter_near_keeps_its_velocity_to_the_bit_without_pushes() -> None:
    world = arena(crowd(1, "hunter", at=[(150, 0)]), crowd(1, "rabbit", at=[(-60, 0)]))
    initial_velocity = velocity(world, "rabbit")
    for _ in range(24):
        step(world)
    assert np.linalg.norm(initial_velocity) > 1 and np.array_equal(velocity(world, "rabbit"), initial_velocity)


def test_a_hunter_alone_goes_straight_to_its_rabbit() -> None:
    world = arena(crowd(1, "hunter", at=[(0, 0)]), crowd(1, "rabbit", at=[(28, 0)]), still=True)
    step(world)
    assert velocity(world, "hunter")[0].tolist() == pytest.approx([4.0, 0.0, 0.0], abs=1e-6)


@pytest.mark.parametrize("species", ["rabbit", "hunter"])
def test_each_kind_pushes_its_own_and_not_the_other(species: str) -> None:
    other = "hunter" if species == "rabbit" else "rabbit"
    at = [(-3.0, 60.0), (3.0, 60.0)]
    world = arena(crowd(2, species, at=at), crowd(1, other, at=[(0, -120)]), still=True)
    step(world)
    velocities = velocity(world, species)
    rabbits_only = species == "rabbit"  # hunters also go to their rabbit
    assert velocities[0, 0] < 0 < velocities[1, 0] if rabbits_only else velocities[1, 0] - velocities[0, 0] > 0
    assert velocity(world, "rabbit")[0, 0] == 0 or rabbits_only


def parted(fps: int, per_second: bool) -> float:
    """How fast two rabbits, at first still, go apart after half a second, mm/s."""
    at = [(-2.0, 60.0), (2.0, 60.0)]
    world = arena(crowd(2, "rabbit", at=at), crowd(1, "hunter", at=[(0, -120)]), fps=fps, per_second=per_second, still=True)
    for _ in range(fps // 2):
        step(world)
    speeds = velocity(world, "rabbit")
    return float(speeds[1, 0] - speeds[0, 0])


def test_what_is_counted_per_frame_is_the_same_per_second_at_24_and_only_that_at_48() -> None:
    assert parted(24, False) == pytest.approx(2 * 12 * 0.1, rel=0.01)
    assert parted(24, True) == pytest.approx(parted(24, False), rel=0.01)
    assert parted(48, True) == pytest.approx(parted(24, True), rel=0.01)
    assert parted(48, False) == pytest.approx(2 * parted(24, False), rel=0.01)
