"""Fits: goals of specs, losses of points, and a search that recovers the constants of a model."""

from __future__ import annotations

import csv
import json
import math
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from antdsl.cli import app
from antdsl.fitting.evaluation import GoalResult, PointResult

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = """ant 1
world { surface ground }
species pot {
  param fill  = 2 /s in 0 /s .. 10 /s
  param leak  = 0.5 /s in 0 /s .. 10 /s
  param first = 1 in 0 .. 10
  level  = first
  volume = 0
  early  = 0
  start run
  state run {
    level += fill - level * leak
    volume += level * 1 /s
    early = if age < 0.5 s then volume else early
    when age > 100 s -> run
  }
}
measure early = mean(pot.volume)
spec "levels" on "scene.yaml" {
  for 3 s
  always: max(pot.level) < 6
  goal 1 %: mean(pot.level) == LEVEL
  goal 1 %: mean(pot.volume) == VOLUME
  goal 1 %: mean(pot.early) == EARLY
}
"""
SCENE = """antdsl: 1
fps: 24
frames: 1..73
world: {ground: {mesh: ground.ply}}
crowd: [{species: pot, from: pot.ant, count: 2, place: {on: ground, radius: 30 mm}}]
"""


def simulate_pot(fill: float, leak: float, first: float) -> tuple[float, float, float]:
    """Return the level and the volume after 3 s, and the volume after 0.5 s, by the same Euler steps.

    A time at which something happens would be a whole number of frames: many values of the params would fit it."""
    level, volume, early, dt = first, 0.0, 0.0, 1 / 24
    for step in range(1, 73):
        level += (fill - level * leak) * dt
        volume += level * dt
        early = volume if step <= 12 else early
    return level, volume, early


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    texts = dict(zip(("LEVEL", "VOLUME", "EARLY"), (f"{value:.4f}" for value in simulate_pot(2, 0.5, 1)), strict=True))
    program = PROGRAM
    for word, text in texts.items():
        program = program.replace(word, text)
    (tmp_path / "pot.ant").write_text(program)
    (tmp_path / "scene.yaml").write_text(SCENE)
    shutil.copy(ROOT / "examples" / "minimal" / "ground.ply", tmp_path)
    return tmp_path


def run(*words: object, code: int = 0) -> str:
    result = CliRunner().invoke(app, [str(word) for word in words])
    assert result.exit_code == code, result.output
    return result.output


def test_goals_are_judged_at_the_end(folder: Path) -> None:
    assert "1 passed" in run("test", folder / "pot.ant", "--no-keep")
    text = (folder / "pot.ant").read_text()
    (folder / "pot.ant").write_text(text.replace("fill  = 2 /s", "fill  = 3 /s"))
    assert "goal 1 %: mean(pot.level)" in run("test", folder / "pot.ant", "--no-keep", code=1)


@pytest.mark.parametrize(
    ("goal", "code"),
    [
        ("goal 5 %: mean(pot.level) > 1", "wrong-argument"),
        ("goal 0 %: mean(pot.level) == 1", "out-of-range"),
        ("goal 5 %: mean(pot.level) == 1 s", "units-differ"),
        ("goal 5 %: pot.level == 1", "wrong-rate"),
        ("each pot { goal 5 %: level == 1 }", "misplaced-line"),
    ],
)
def test_mistakes_in_goals(folder: Path, goal: str, code: str) -> None:
    (folder / "pot.ant").write_text((folder / "pot.ant").read_text() + f'spec "x" on "scene.yaml" {{ {goal} }}\n')
    assert f"[{code}]" in run("check", folder / "pot.ant", code=1)


def make_point(*values: float, failed: tuple[int, ...] = (0, 0), pass_share: float = 1.0) -> PointResult:
    return PointResult({}, (GoalResult("goal", values, (10.0,) * len(values), 0.05),), failed, pass_share)


def test_losses_count_tolerances_and_failed_lines() -> None:
    assert (
        make_point(10, 10).weighted_loss == 0
        and make_point(10.5, 10.5).weighted_loss == pytest.approx(1) == make_point(9, 10).weighted_loss
    )
    assert make_point(10, 10, failed=(1, 2)).weighted_loss == 1.5 and not make_point(10, 10, failed=(1, 0)).holds
    assert make_point(10, 10, failed=(1, 0), pass_share=0.5).holds
    assert 1e5 < make_point(math.inf, math.inf).weighted_loss < math.inf, (
        "an event that never happens is worse than any other value"
    )
    assert PointResult({}, (), (), 1.0, "no result").weighted_loss == math.inf


def test_a_fit_reports_the_share_of_the_prior_and_the_best_point(folder: Path) -> None:
    words = ("--vary", "pot.fill=1/s..3/s", "--points", 8, "--generations", 0, "--seeds", 1, "--check-seeds", 1, "--jobs", 2)
    output = run("fit", folder / "scene.yaml", "--to", "levels", *words)
    result = json.loads((folder / "out" / "fit" / "fit.json").read_text())
    assert result["prior"]["points"] == 8 and f"{result['prior']['passed']} of 8" in output
    with (folder / "out" / "fit" / "points.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    best = min(rows, key=lambda row: float(row["loss"]))
    assert len(rows) == 8 and abs(float(best["pot.fill (/s)"]) - 2) < 0.3
    assert result["best"]["values"]["pot.fill"] == best["pot.fill (/s)"] + "/s"
    passed = [float(row["pot.fill (/s)"]) for row in rows if row["passed_share"] == "1.0"]
    assert len(passed) == result["prior"]["passed"]


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("--vary", "pot.fill=1/s,3/s", "--to", "levels"), "a fit needs ranges"),
        (("--vary", "pot.fill=1/s..30/s", "--to", "levels"), "outside"),
        (("--vary", "pot.fill=1/s..3/s", "--to", "level"), "no spec `level`"),
        (("--vary", "pot.fil=1/s..3/s", "--to", "levels"), "no program has a param"),
        (("--vary", "pot.fill=1/s..3/s", "--to", "levels", "--points", "9"), "powers of 2"),
    ],
)
def test_wrong_requests_end_before_any_run(folder: Path, words: tuple[str, ...], text: str) -> None:
    result = CliRunner().invoke(app, ["fit", str(folder / "scene.yaml"), *words])
    assert result.exit_code in (1, 2) and text in result.output


@pytest.mark.slow
def test_a_fit_recovers_three_constants(folder: Path) -> None:
    ranges = ("--vary", "pot.fill=0.5/s..4/s", "--vary", "pot.leak=0.1/s..2/s", "--vary", "pot.first=0.2..3")
    run("fit", folder / "scene.yaml", "--to", "levels", *ranges, "--points", 64, "--seeds", 1, "--check-seeds", 0, "-q")
    values = json.loads((folder / "out" / "fit" / "fit.json").read_text())["best"]["values"]
    for name, unit, expected in (("pot.fill", "/s", 2.0), ("pot.leak", "/s", 0.5), ("pot.first", "", 1.0)):
        assert float(values[name].removesuffix(unit)) == pytest.approx(expected, rel=0.05)
