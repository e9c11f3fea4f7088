"""Whole programs really run: hunters chase rabbits, people leave a building, foragers bring home; on both backends."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import meshes
import numpy as np
import pytest
from meaning import FAST, OPTION_SETS, crowd, item, played

from antdsl import plan
from antdsl.passes import optimise_plan
from antdsl.pipeline import compile_files
from antdsl.plan import ir
from antdsl.runtime import MeshData, World, WorldSetting

PROGRAMS = Path(__file__).parents[1] / "programs"


def planned(*names: str) -> ir.Plan:
    program, report = compile_files([PROGRAMS / f"{name}.ant" for name in names])
    assert program is not None and report.ok
    lowered, report = plan.lower(program)
    assert report.ok, report.errors
    return optimise_plan(lowered)


def ring(radius: float) -> np.ndarray:
    angle = np.linspace(0, 2 * np.pi, 65)
    return np.stack([radius * np.cos(angle), np.zeros(65), radius * np.sin(angle)], axis=1)


def test_hunters_chase_rabbits_and_rabbits_run() -> None:
    ground = MeshData(*meshes.grid(260.0, 10))
    setting = WorldSetting(
        fps=Fraction(24), surfaces={"ground": ground}, curves={"arena": ring(100.0)}, seed=4,
        crowds=(crowd(4, "hunter", radius=60), crowd(12, "rabbit", radius=60)),
    )  # fmt: skip
    hunting = planned("hunters", "rabbits")
    played(hunting, setting, 8, "hunter", OPTION_SETS)
    gaps: list[np.ndarray] = []

    def each(world: World) -> None:
        hunters, rabbits = world.populations["hunter"], world.populations["rabbit"]
        prey = hunters.now["prey"]
        assert (prey >= 0).all()
        gaps.append(np.linalg.norm(hunters.position - rabbits.position[rabbits.find_rows(prey)], axis=1))

    history = played(hunting, setting, 240, "hunter", FAST[:1], each)
    assert set(history["main.state"]) == {0} and gaps[-1].mean() < gaps[0].mean() - 3
    assert np.sort(gaps[-1])[2] < 8 and np.min(gaps[48:]) > 2  # three are close behind, none has caught another
    rabbits = history.world.populations["rabbit"]
    assert history.world.transitions["rabbit.run->flee"] > 3
    assert np.linalg.norm(rabbits.position, axis=1).max() < 101
    assert len(set(history["prey"])) > 1


@pytest.mark.slow
def test_all_people_leave_the_building_by_an_open_exit() -> None:
    """Two rooms' worth of walls, one exit open, one shut."""
    walls = [meshes.box((-4000, -100, 1500), (4000, 2500, 1700)), meshes.box((-4000, -100, -1700), (4000, 2500, -1500))]
    vertices = np.concatenate([w[0] for w in walls])
    faces = np.concatenate([w[1] + 8 * k for k, w in enumerate(walls)])
    exits = (item("east", 5000, 0, 600, open=1), item("west", -2000, 0, 600, open=0))
    setting = WorldSetting(
        fps=Fraction(12), seed=2, surfaces={"floor": MeshData(*meshes.grid(14000.0, 6))},
        obstacles={"walls": MeshData(vertices, faces)}, items={"exits": exits}, crowds=(crowd(16, "person", radius=1300),),
    )  # fmt: skip
    people: list[float] = []

    def each(world: World) -> None:
        population = world.populations["person"]
        out = sum(float(amount.sum()) for name, amount in world.items["exits"].amounts.items() if name == "passed")
        people.append(float(population.now["passed"].sum()) + out)
        assert population.now["fear"].max(initial=0) <= 5

    leaving = planned("evacuation")
    played(leaving, setting, 40, "person", (OPTION_SETS[0], OPTION_SETS[1]))
    history = played(leaving, setting, 600, "person", OPTION_SETS[:1], each)
    assert set(people) == {16.0}
    assert history.world.items["exits"].amounts["passed"].tolist() == [16.0, 0.0] and history["id"] == []
