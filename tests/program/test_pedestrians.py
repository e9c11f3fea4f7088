"""People of the library `pedestrians`: their headway, sides for oncoming people, and the published tables."""

from __future__ import annotations

from pathlib import Path

import meshes
import numpy as np
import pytest
import trimesh
from typer.testing import CliRunner

import antdsl
from antdsl.cli import app

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "pedestrians"
PROGRAM = """ant 2
use steering
use pedestrians
world { surface floor }
species person {
  height    1.7 m
  radius    0.2 m
  max_speed 1.2 m/s
  response  1 step
  max_turn  none
  start walk
  state walk { steer STEER }
}
"""
SCENE = "antdsl: 1\nunits: m\nfps: 24\nframes: 0..480\ncontacts: off\nworld: {floor: {mesh: floor.ply}}\ncrowd:\n"


def open_people(folder: Path, steer: str, *positions: tuple[float, float]) -> antdsl.Simulation:
    """People on a floor of 40 m at these positions (x, z in metres). Each is a group."""
    trimesh.Trimesh(*meshes.grid(40.0, 8)).export(folder / "floor.ply")
    (folder / "person.ant").write_text(PROGRAM.replace("STEER", steer))
    row = "  - {{species: person, from: person.ant, count: 1, place: {{on: floor, around: [{}, 0, {}], radius: 1 mm}}}}\n"
    (folder / "scene.yaml").write_text(SCENE + "".join(row.format(*position) for position in positions))
    return antdsl.open_scene(folder / "scene.yaml")


def test_a_person_behind_another_is_as_fast_as_the_gap_allows(tmp_path: Path) -> None:
    steer = "collision_free(vector(if group == 0 then 0 else 1, 0, 0), time_gap: 2 s)"
    world, rows = open_people(tmp_path, steer, (0, 0), (-6, 0)), []
    for _ in range(240):
        positions = world["person"]["position"] / 1000
        world.step()
        step = world["person"]["position"][1] / 1000 - positions[1]
        rows.append((float(np.linalg.norm(positions[0] - positions[1])) - 0.4, float(np.linalg.norm(step)) * 24))
    gaps, speeds = np.array(rows[24:]).T
    assert gaps.min() > 0, "people do not overlap"
    ahead = gaps > 0.4  # nearer, the other pushes aside
    assert np.abs(speeds - np.minimum(1.2, gaps / 2))[ahead].max() < 0.03 and speeds.max() > 1.1 and speeds[ahead].min() < 0.3


def test_headway_is_counts_people_of_the_same_direction(tmp_path: Path) -> None:
    steer = "keep_headway(vector(1, 0, 0) * (if group == 0 then 0.2 else 1), time_gap: 1 s)"
    world, least = open_people(tmp_path, steer, (0, 0), (-4, 0.05), (-2, 3)), np.inf
    for _ in range(240):
        world.step()
        positions = world["person"]["position"] / 1000
        least = min(least, float(np.linalg.norm(positions[0] - positions[1])))
    assert least > 0.39, "people do not overlap"
    assert positions[1, 0] - positions[0, 0] > 0.5, "the faster person overtakes"
    assert positions[2, 0] > 9, "the way of the third is free"


def test_oncoming_people_pass_on_the_right(tmp_path: Path) -> None:
    steer = "keep_headway(vector(if group == 0 then 1 else -1, 0, 0))"
    world, least = open_people(tmp_path, steer, (-4, 0), (4, 0)), np.inf
    for _ in range(160):
        world.step()
        positions = world["person"]["position"] / 1000
        least = min(least, float(np.linalg.norm(positions[0] - positions[1])))
        if abs(positions[0, 0] - positions[1, 0]) < 0.1:
            assert positions[0, 2] > positions[1, 2], "seen from above, +z is to the right of a person who goes along +x"
    assert least > 0.39 and positions[0, 0] > 2 and positions[1, 0] < -2


def test_alone_a_person_walks_at_full_speed(tmp_path: Path) -> None:
    for behaviour in ("collision_free", "keep_headway"):
        world = open_people(tmp_path, f"{behaviour}(vector(0.5, 0, 0))", (0, 0))
        world.run(until=lambda each: each.frame == 48)
        assert np.linalg.norm(world["person"]["velocity"][0]) == pytest.approx(600, rel=1e-3), "half of `max_speed`, in mm/s"


@pytest.mark.parametrize(
    "program", [pytest.param("passage", marks=pytest.mark.slow), pytest.param("corridor", marks=pytest.mark.slow)]
)
def test_flows_are_those_of_the_published_tables(program: str) -> None:
    result = CliRunner().invoke(app, ["test", str(EXAMPLE / f"{program}.ant"), "--no-keep"])
    assert result.exit_code == 0, result.output


def test_a_wide_passage_has_the_published_flow() -> None:
    world = antdsl.open_scene(EXAMPLE / "passage_240.yaml", seed=2)
    while world.measures["inside"] > 40 and world.frame < 1200:
        world.step()
    assert world.measures["flow"] == pytest.approx(1.22 * 2.4, rel=0.15)
