"""Agents that the scene leads: straight on over the ground at one speed for a length, sensing and deciding nothing."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import meshes
import numpy as np
import pytest
from meaning import FAST, OPTION_SETS, RunHistory, crowd, play
from typer.testing import CliRunner

from antdsl.cli import app
from antdsl.pipeline import open_scene
from antdsl.runtime import MeshData, Options
from antdsl.scene.setting import ScriptedWalkData

TEXT = """use steering
species a {
  max_speed 20 mm/s
  steps = 0
  start go
  state go { steer vector(0, 0, -1); when true -> gone }
  state gone { steer wander(); emit cry(within: 900 mm) }
  on cry { steps += 100 }
  layers { state }
}"""
EAST = ScriptedWalkData((1.0, 0.0, 0.0), 30.0, 40.0)


def vectors(history: RunHistory, name: str, number: int = 0) -> np.ndarray:
    return np.array([history.every(f"{name}.{axis}", number) for axis in "xyz"], np.float64).T


def test_it_goes_its_length_at_its_speed_and_stands_and_senses_nothing() -> None:
    walker_crowd, free = replace(crowd(at=[(0, 0)]), walk=EAST), crowd(at=[(0, 60)], group=1)
    history = play(TEXT, walker_crowd, free, steps=20, option_sets=(*OPTION_SETS, Options(backend="native", wait_for_code=True)))
    place = vectors(history, "position") + history.world.origin
    distances = np.linalg.norm(np.diff(place, axis=0), axis=1)
    assert distances[:13] == pytest.approx(np.full(13, 3.0), abs=1e-4)  # faster than its max_speed: the scene says so
    assert distances[13] == pytest.approx(1, abs=1e-4) and (distances[14:] == 0).all()
    assert place[-1] == pytest.approx((40, 0, 0), abs=1e-3)
    assert history.states(0)[-1] == "go" and history.every("steps", 0)[-1] == 0  # no change, no handler
    assert history.states(1)[-1] == "gone" and history.every("steps", 1)[-1] > 100
    assert vectors(history, "heading")[-1] == pytest.approx((1, 0, 0), abs=1e-5)


def test_the_direction_is_carried_along_the_surface_over_edges() -> None:
    block = {"ground": MeshData(*meshes.box((-10.0, -20.0, -50.0), (10.0, 0.0, 50.0)))}
    walker_crowd = replace(
        crowd(at=[(0, 0)]), walk=ScriptedWalkData((1.0, 5.0, 0.0), 30.0, 26.0)
    )  # what leads off the ground does not count
    history = play("species a { size 2 mm; max_speed 20 mm/s }", walker_crowd, steps=12, surfaces=block, option_sets=FAST)
    place = vectors(history, "position") + history.world.origin
    assert place[-1] == pytest.approx((10, -16, 0), abs=1e-3)  # ten along the top, over the edge, sixteen down
    assert vectors(history, "heading")[-1] == pytest.approx((0, -1, 0), abs=1e-3)


@pytest.mark.parametrize("substeps", [1, 3])
def test_slow_bodies_least_speeds_and_substeps_change_nothing_of_the_length(substeps: int) -> None:
    walker_crowd = replace(crowd(at=[(0, 0)]), walk=EAST)
    text = "species a { response 1 step; min_speed 8 mm/s; max_turn 10 deg/s; max_speed 50 mm/s }"
    history = play(text, walker_crowd, steps=20, substeps=substeps, option_sets=FAST)
    assert (vectors(history, "position") + history.world.origin)[-1] == pytest.approx((40, 0, 0), abs=1e-3)


PROGRAM = "ant 1\nuse steering\nworld { surface s; obstacle rock }\nspecies a { max_speed 20 mm/s; state w { steer wander() } }\n"
SCENE = """antdsl: 1
units: cm
frames: 1..30
world: {s: {mesh: s.obj}, rock: {mesh: rock.obj}}
crowd:
  - {species: a, from: a.ant, count: 2, place: {on: s}, walk: {direction: [0, 0, 2], speed: 3 u/s, length: 2}}
  - {species: a, from: a.ant, count: 3, place: {on: s}}
"""


def write(folder: Path, scene: str) -> Path:
    (folder / "a.ant").write_text(PROGRAM)
    for name, (vertices, faces) in {"s": meshes.grid(40.0, 2), "rock": meshes.box((15, -1, 15), (16, 1, 16))}.items():
        lines = [*("v {} {} {}".format(*v) for v in vertices), *("f {} {} {}".format(*(f + 1)) for f in faces)]
        (folder / f"{name}.obj").write_text("\n".join(lines))
    (folder / "scene.yaml").write_text(scene)
    return folder / "scene.yaml"


def test_a_scene_leads_a_line_of_its_crowd_and_explain_says_so(tmp_path: Path) -> None:
    shot, report = open_scene(write(tmp_path, SCENE))
    assert shot is not None, report.sort_by_place()
    walk = shot.setting.crowds[0].walk
    assert walk is not None and walk.direction == (0, 0, 1) and (walk.speed, walk.length) == (30, 20)
    assert shot.setting.crowds[1].walk is None
    run = CliRunner()
    run_result = run.invoke(app, ["run", str(tmp_path / "scene.yaml"), "--out", str(tmp_path / "c"), "--backend", "numpy", "-q"])
    assert run_result.exit_code == 0, run_result.output
    walker_result = run.invoke(app, ["explain", str(tmp_path / "c"), "--agent", "1", "--frame", "9"])
    assert "it follows the `walk` of its crowd line" in str(getattr(walker_result.exception, "message", walker_result.output))
    free = run.invoke(app, ["explain", str(tmp_path / "c"), "--agent", "3", "--frame", "9"])
    assert free.exit_code == 0 and "wander" in free.output


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[0, 0, 2]", "[0, 0, 0]", "leads nowhere"),
        ("speed: 3 u/s", "speed: 3 mm", "`3 mm` is not a speed"),
        ("length: 2", "length: 0", "not above zero"),
        (", length: 2", "", "length"),
    ],
)
def test_what_is_no_walk_is_reported_at_its_place(tmp_path: Path, old: str, new: str, words: str) -> None:
    shot, report = open_scene(write(tmp_path, SCENE.replace(old, new)))
    assert shot is None and words in " ".join(f"{d.message} {d.help}" for d in report.sort_by_place())
