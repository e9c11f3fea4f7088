"""Scenes that extend others: what is put together, what is replaced, and that every mistake is shown where it was written."""

from __future__ import annotations

from pathlib import Path

import pytest

from antdsl.cli import _run_without_warnings as run_in_process
from antdsl.diagnostics import Report
from antdsl.pipeline import open_scene
from antdsl.scene import Scene
from antdsl.scene.load import load_scene
from antdsl.scene.thing_models import MeshThing

PROGRAM = """ant 1
use steering
species walker {
  param pace = 0.5 in 0 .. 1 "How fast"
  start stroll
  state stroll { steer wander(pace: pace) }
  layers { state }
}
"""
BASE = """antdsl: 1
fps: 30
frames: 1..4
seed: 3
crowd: [{species: walker, from: walker.ant, count: 5, place: {radius: 60 mm}}]
set: {walker.pace: 0.7}
camera: {at: [1, 2, 3], look_at: [0, 0, 0], focal: 35 mm}
output: {checkpoint: 10}
"""


def read(folder: Path, **scenes: str) -> tuple[Scene | None, Report]:
    for name, text in scenes.items():
        (folder / f"{name}.yaml").write_text(text)
    return load_scene(folder / "scene.yaml")


def test_mappings_are_put_together_and_everything_else_is_replaced(tmp_path: Path) -> None:
    scene, report = read(
        tmp_path,
        base=BASE + "world: {ground: {mesh: a.ply, scale: 2}, food: {apple: {at: [1, 2, 3], load: 4}}}\n",
        middle="antdsl: 1\nextends: base.yaml\nseed: 4\nframes: 1..9\n",
        scene="antdsl: 1\nextends: middle.yaml\nseed: 5\nworld: {ground: {mesh: b.ply}, food: {donut: {at: [0, 0, 9]}}}\n"
        "camera: {focal: 50 mm}\ncrowd: [{species: walker, from: walker.ant, count: 7}]\n",
    )
    assert scene is not None and not report.diagnostics
    model = scene.model
    assert (model.seed, model.frames, model.fps) == (5, (1, 9), 30)
    ground, food = model.world["ground"], model.world["food"]
    assert isinstance(ground, MeshThing) and isinstance(food, dict)
    assert (ground.mesh, ground.scale) == ("b.ply", 2.0) and list(food) == ["apple", "donut"]
    assert [(line.count, line.place.radius) for line in model.crowd] == [(7, None)]
    assert model.camera is not None and model.camera.focal is not None
    assert model.camera.focal.to_millimetres(1.0) == 50 and model.camera.at[2].number == 3
    assert model.output.checkpoint == 10 and model.extends is None


def test_a_mistake_is_shown_in_the_file_where_it_was_written_and_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "walker.ant").write_text(PROGRAM)
    for name in ("one", "two"):
        (tmp_path / f"{name}.yaml").write_text(f"antdsl: 1\nextends: base.yaml\nseed: {name}\n")
    (tmp_path / "base.yaml").write_text(BASE.replace("fps: 30", "fsp: 30"))
    monkeypatch.setattr("sys.argv", ["antdsl", "check", "--format", "concise", str(tmp_path)])
    assert run_in_process() == 1
    stdout_text = capsys.readouterr().out
    assert stdout_text.count("unknown-key") == 1 and "base.yaml:2:1" in stdout_text
    assert "one.yaml:3:7" in stdout_text and "two.yaml:3:7" in stdout_text


def test_what_comes_from_the_base_is_part_of_what_a_result_depends_on(tmp_path: Path) -> None:
    (tmp_path / "walker.ant").write_text(PROGRAM)

    def inputs(base: str) -> tuple[str, str]:
        (tmp_path / "base.yaml").write_text(base)
        (tmp_path / "scene.yaml").write_text("antdsl: 1\nextends: base.yaml\nseed: 8\n")
        shots = [open_scene(tmp_path / name) for name in ("scene.yaml", "base.yaml")]
        assert all(report.ok for _, report in shots)
        return tuple(shot.inputs["scene"] for shot, _ in shots if shot is not None)  # type: ignore[return-value]

    extending, base = inputs(BASE.replace("seed: 3", "seed: 8"))
    assert extending == base, "two files or one, the same scene"
    assert inputs(BASE.replace("walker.pace: 0.7", "walker.pace: 0.6"))[0] != extending


def test_the_edition_is_said_by_each_file(tmp_path: Path) -> None:
    _, report = read(tmp_path, base=BASE, scene="extends: base.yaml\n")
    assert [d.code for d in report.diagnostics] == ["missing-key"]


def test_a_base_is_read_with_the_checks_of_all_files(tmp_path: Path) -> None:
    (tmp_path / "real.yaml").write_text(BASE)
    (tmp_path / "base.yaml").symlink_to(tmp_path / "real.yaml")
    _, report = read(tmp_path, scene="antdsl: 1\nextends: base.yaml\n")
    assert [d.code for d in report.diagnostics] == ["bad-path"]
    long = {f"s{k}": f"antdsl: 1\nextends: s{k + 1}.yaml\n" for k in range(20)}
    _, report = read(tmp_path, **long, s20=BASE, scene="antdsl: 1\nextends: s0.yaml\n")
    assert [d.code for d in report.diagnostics] == ["too-deep"]
