"""Values that commands set for keys of a scene: counts, meshes and other keys, by `--set` and `--vary`."""

from __future__ import annotations

from pathlib import Path

import pytest

from antdsl.diagnostics import Report
from antdsl.scene.load import load_scene
from antdsl.scene.scene_values import is_scene_value, select_params

SCENE = """antdsl: 1
world: {ground: {mesh: a.ply}, food: {apple: {at: [1, 2, 3], load: 3}}}
crowd:
  - {species: walker, from: w.ant, count: 3, place: {on: ground}}
  - {species: walker, name: guards, from: w.ant, count: 4, place: {on: ground}}
  - {species: bird, from: w.ant, count: 5, place: {on: ground}}
"""


def read_report(folder: Path, **values: str) -> Report:
    (folder / "s.yaml").write_text(SCENE)
    return load_scene(folder / "s.yaml", values={name.replace("__", "."): text for name, text in values.items()})[1]


def test_values_replace_those_of_the_file(tmp_path: Path) -> None:
    (tmp_path / "s.yaml").write_text(SCENE)
    values = {
        "crowd.bird.count": "50", "crowd.guards.count": "6", "crowd.0.place.radius": "30 mm", "world.ground.mesh": "b.ply",
        "world.food.apple.load": "7", "fps": "12", "walker.pace": "30mm/s",
    }  # fmt: skip
    scene, report = load_scene(tmp_path / "s.yaml", values=values)
    assert scene is not None and report.ok
    assert [line.count for line in scene.model.crowd] == [3, 6, 50] and scene.model.fps == 12
    assert scene.model.crowd[0].place.radius is not None
    assert getattr(scene.model.world["ground"], "mesh", "") == "b.ply"
    plain, _ = load_scene(tmp_path / "s.yaml")
    assert plain is not None and plain.compute_digest() != scene.compute_digest(), "runs with other values have other keys"


def test_params_are_no_keys_of_scenes() -> None:
    assert select_params({"walker.pace": "1", "crowd.0.count": "2", "fps": "3"}) == {"walker.pace": "1"}
    assert not is_scene_value("seed") and not is_scene_value("set.walker.pace")


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"crowd__brd__count": "1"}, "no line of the crowd is called `brd`"),
        ({"crowd__walker__count": "1"}, "several lines of the crowd are called `walker`"),
        ({"crowd__0__count": "many"}, "`many` is not a whole number"),
        ({"world__ground__mesh__x": "1"}, "no mapping `mesh`"),
        ({"world__flor__mesh": "1"}, "no mapping `flor`"),
        ({"fps": "[1"}, ""),
        ({"crowd": "3"}, ""),
        ({"crowd__0__cuont": "3"}, "cuont"),
    ],
)
def test_a_wrong_name_or_value_is_an_error(tmp_path: Path, values: dict[str, str], words: str) -> None:
    report = read_report(tmp_path, **values)
    assert not report.ok and words in " ".join(error.message for error in report.errors)
