"""Settings of fields that a scene or the command line gives another value: they act, and impossible values are reported at their
place."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from antdsl.pipeline import RunChoices, Shot, open_scene
from antdsl.runtime import bind, step

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = """ant 1
use steering
world { surface ground }
field trail on ground { cell 20 mm; half_life 4 s }
species walker {
  param pace = 0.5 in 0 .. 1 "How fast"
  start on
  state on { steer wander(pace: pace) * (1 + trail); deposit trail 0 /s }
  layers { state }
}
"""
SCENE = """antdsl: 1
world: {ground: {mesh: ground.ply}}
crowd: [{species: walker, from: walker.ant, count: 2, place: {on: ground, radius: 30 mm}}]
fields: {trail: {start: 8}}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "walker.ant").write_text(PROGRAM)
    shutil.copy(ROOT / "examples" / "minimal" / "ground.ply", tmp_path)
    return tmp_path


def opened(folder: Path, scene_lines: str = "", **values: str) -> tuple[Shot | None, list[tuple[str, str]]]:
    (folder / "scene.yaml").write_text(SCENE + scene_lines)
    params = {name.replace("__", "."): value for name, value in values.items()}
    shot, report = open_scene(folder / "scene.yaml", RunChoices(params=params))
    return shot, [(d.code, "" if d.span is None else d.span.text) for d in report.diagnostics]


@pytest.mark.parametrize(
    ("setting", "left"),
    [("half_life: 1 s", 4.0), ("evaporate: 0 %/s", 8.0), ("keeps: 100 %/step", 8.0), ("keeps: 50 %/step", 8.0 / 2**24)],
)
def test_a_scene_says_how_a_field_fades(folder: Path, setting: str, left: float) -> None:
    shot, diagnostics = opened(folder, f"set: {{trail.{setting}}}\n")
    assert shot is not None and not diagnostics
    world = bind(shot.plan, shot.setting)
    for _ in range(24):
        step(world)
    assert world.fields["trail"].amounts == pytest.approx(left, rel=1e-4)


def test_the_person_goes_before_the_scene_and_is_part_of_what_the_result_depends_on(folder: Path) -> None:
    scene, _ = opened(folder, "set: {trail.half_life: 1 s}\n")
    both, diagnostics = opened(folder, "set: {trail.half_life: 1 s}\n", trail__half_life="2s", walker__pace="0.3")
    assert scene is not None and both is not None and not diagnostics
    world = bind(both.plan, both.setting)
    for _ in range(48):
        step(world)
    assert world.fields["trail"].amounts == pytest.approx(4.0, rel=1e-4)
    assert dict(both.inputs) != dict(scene.inputs) and dict(both.setting.params) == {"walker.pace": 0.3}


@pytest.mark.parametrize(
    ("setting", "code", "at"),
    [
        ("trail.half_life: 3 mm", "wrong-unit", "3 mm"),
        ("trail.half_life: 3", "missing-unit", "3"),
        ("trail.half_life: 0 s", "out-of-range", "0 s"),
        ("trail.evaporate: -1 /s", "out-of-range", "-1 /s"),
        ("trail.keeps: 110 %/step", "out-of-range", "110 %/step"),
        ("trail.keeps: 90 %/s", "out-of-range", "90 %/s"),
        ("trail.half_live: 3 s", "unknown-thing", "trail.half_live"),
        ("trial.half_life: 3 s", "unknown-thing", "trial.half_life"),
    ],
)
def test_what_cannot_be_is_reported_where_it_stands(folder: Path, setting: str, code: str, at: str) -> None:
    shot, diagnostics = opened(folder, f"set: {{{setting}}}\n")
    assert shot is None and diagnostics == [(code, at)]
