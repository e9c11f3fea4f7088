"""Measures of programs: their values frame by frame, what they depend on, and the files of runs and sweeps."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import antdsl
from antdsl.cli import app
from antdsl.measures.run_measures import RunMeasures
from antdsl.pipeline import open_scene, simulate
from antdsl.program import check
from antdsl.source import Source
from antdsl.syntax import parse

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = """ant 1
use steering
world { surface ground; items food { load = 3 } }
field trail on ground { cell 8 mm; half_life 4 s }
species walker {
  max_speed 30 mm/s
  start stroll
  state stroll { steer wander(); deposit trail 1 /s; when after 0.3 s -> rest }
  state rest { }
  layers { state }
}
measure order   = length(mean(w in walker: w.heading)) "1 if all walk the same way"
measure drift   = length(sum(w in walker: w.velocity))
measure resting = share(walker.state == rest)
measure calm    = resting == 1
measure late    = time_of(resting > 50 %)
measure gone    = total(food.load) - at_start(total(food.load))
measure scent   = total(trail)
measure number  = count(walker)
spec "they rest" on "scene.yaml" { for 1 s; finally: calm and late < 0.5 s; always: number == 12 and order >= 0 }
"""
SCENE = """antdsl: 1
frames: 1..12
world:
  ground: {mesh: ground.ply}
  food: {apple: {at: [15, 0, 0], load: 3}}
crowd: [{species: walker, from: walker.ant, count: 12, place: {on: ground, radius: 30 mm}}]
output: {checkpoint: 4}
"""
NAMES = ("order", "drift", "resting", "calm", "late", "gone", "scent", "number")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "walker.ant").write_text(PROGRAM)
    (tmp_path / "scene.yaml").write_text(SCENE)
    shutil.copy(ROOT / "examples" / "minimal" / "ground.ply", tmp_path)
    return tmp_path


def run(*words: object, code: int = 0) -> str:
    result = CliRunner().invoke(app, [str(word) for word in words])
    assert result.exit_code == code, result.output
    return result.output


def read_rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_measures_have_the_values_of_each_frame(folder: Path) -> None:
    shot, report = open_scene(folder / "scene.yaml")
    assert shot is not None and report.ok and shot.measure_names == NAMES
    measures = None
    for world in simulate(shot):
        measures = measures or RunMeasures(shot.measures, shot.until, world)
        measures.record_frame(world)
        walkers = world.populations["walker"]
        heading = np.stack([walkers.now[f"heading.{axis}"] for axis in "xyz"], 1).astype(np.float64)
        velocity = np.stack([walkers.now[f"velocity.{axis}"] for axis in "xyz"], 1).astype(np.float64)
        assert measures.values["order"] == pytest.approx(np.linalg.norm(heading.mean(0)), rel=1e-5)
        assert measures.values["drift"] == pytest.approx(np.linalg.norm(velocity.sum(0)), rel=1e-4, abs=1e-3)
        assert measures.values["scent"] == pytest.approx(float(world.fields["trail"].amounts.sum()), rel=1e-5)
        assert measures.values["number"] == 12 and measures.values["gone"] == 0
        resting = float((walkers.now["main.state"] == 1).mean())
        assert measures.values["resting"] == resting and measures.values["calm"] == int(resting == 1)
        assert (measures.values["late"] is None) == (resting <= 0.5 and not measures.values["calm"])
    assert measures is not None and measures.values["late"] == pytest.approx(9 / 24)


def test_python_reads_measures_and_ends_a_run_by_a_condition(folder: Path) -> None:
    (folder / "scene.yaml").write_text(SCENE + "until: late < 10 s\n")
    simulation = antdsl.open_scene(folder / "scene.yaml")
    assert simulation.measures["late"] is None
    assert simulation.run().frame == 10 and simulation.measures["late"] == pytest.approx(9 / 24)


def test_run_writes_the_same_lines_when_it_is_continued(folder: Path) -> None:
    run("run", folder / "scene.yaml", "--out", folder / "all", "--summary", folder / "s.json", "-q")
    rows = read_rows(folder / "all" / "measures.csv")
    assert [int(row["frame"]) for row in rows] == list(range(1, 13)) and list(rows[0]) == ["frame", "time", *NAMES]
    assert [row["late"] for row in rows] == [""] * 9 + ["0.375"] * 3
    assert json.loads((folder / "s.json").read_text())["measures"]["late"] == 0.375
    run("run", folder / "scene.yaml", "--out", folder / "parts", "--frames", "1..8", "-q")
    run("run", folder / "scene.yaml", "--out", folder / "parts", "--resume", "-q")
    assert (folder / "parts" / "measures.csv").read_bytes() == (folder / "all" / "measures.csv").read_bytes()


def test_until_ends_a_run_which_is_then_complete(folder: Path) -> None:
    words = ("run", folder / "scene.yaml", "--out", folder / "c", "--until", "late < 10 s", "-q")
    run(*words)
    assert len(read_rows(folder / "c" / "measures.csv")) == 10
    run(*words, "--resume")
    assert len(read_rows(folder / "c" / "measures.csv")) == 10
    assert "differs from agent to agent" in run("run", folder / "scene.yaml", "--until", "speed > 1 mm/s", code=1)


@pytest.mark.parametrize(
    ("until", "words"),
    [
        ("total(foot.load) == 0", "no `foot` is known here"),
        ("each walker: speed > 1 mm/s", "about each agent"),
        ("late > 3", "must match"),
        ("3 +", "value"),
    ],
)
def test_a_wrong_until_is_reported_at_its_place(folder: Path, until: str, words: str) -> None:
    (folder / "scene.yaml").write_text(SCENE + f'until: "{until}"\n')
    output = run("check", folder / "scene.yaml", code=1)
    assert words in output and "scene.yaml:8:8" in output


def test_a_sweep_has_measures_per_run_and_per_frame(folder: Path) -> None:
    run(
        "sweep",
        folder / "scene.yaml",
        "--seeds",
        2,
        "--jobs",
        1,
        "--until",
        "late < 10 s",
        "--no-plots",
        "--show",
        "measures.late",
    )
    out = folder / "out" / "sweep"
    assert "late" in (out / "table.txt").read_text()
    runs, series = read_rows(out / "runs.csv"), read_rows(out / "series.csv")
    assert [row["scene"] for row in runs] == ["scene"] * 2 and {row["measures.late"] for row in runs} == {"0.375"}
    assert [(row["seed"], int(row["frame"])) for row in series] == [(seed, k) for seed in "12" for k in range(1, 11)]
    (out / "table.txt").unlink()
    assert "late" in run("sweep", "--resume", "--out", out, "--no-plots", "-q"), "the continued sweep shows what was asked for"


@pytest.mark.parametrize(
    ("line", "code"),
    [
        ("measure a = b\nmeasure b = a", "circle"),
        ("measure a = walker.speed", "wrong-rate"),
        ("measure a = mean(w in walker: w.heading)", "wrong-kind"),
        ("measure a = uniform(0, 1)", "draw-in-spec"),
        ("measure walker = 1", "duplicate-name"),
        ("measure order = 1", "duplicate-name"),
        ("measure seed = count(walker)", "reserved-name"),
        ("measure a = time_of(speed > 1 mm/s)", "wrong-rate"),
        ("measure a = time_of(1, 2)", "wrong-argument"),
        ("measure a = other", "unknown-name"),
    ],
)
def test_mistakes_in_measures(line: str, code: str) -> None:
    file, report = parse(Source("w.ant", PROGRAM + line + "\n"))
    assert report.ok
    library = parse(Source("<steering>", (ROOT / "behaviours" / "steering.ant").read_text()))[0]
    _, report = check(file, lambda name: library)
    assert {error.code for error in report.errors} == {code}


def test_a_spec_can_name_measures(folder: Path) -> None:
    assert "1 passed" in run("test", folder / "walker.ant", "--no-keep")


def test_lines_that_hold_from_the_start_are_reported(folder: Path) -> None:
    lines = """
      within 0.2 s: number == 12
      eventually: order < 2
      within 0.2 s: resting > 2
      each walker { eventually: age >= 0 s; within 0.1 s: age > 0.05 s }
    """
    (folder / "walker.ant").write_text(PROGRAM + f'spec "vacuous" on "scene.yaml" {{ for 0.5 s {lines} }}\n')
    output = run("test", folder / "walker.ant", "--no-keep", "-k", "vacuous", code=1)
    reported = [line for line in output.splitlines() if "already holds in the first frame" in line]
    assert ["within 0.2 s: number == 12" in reported[0], "eventually: order < 2" in reported[1], len(reported)] == [True, True, 3]


def test_a_sweep_varies_counts_and_other_keys_of_a_scene(folder: Path) -> None:
    values = ("--vary", "crowd.walker.count=3,5", "--vary", "fps=12,24")
    run("sweep", folder / "scene.yaml", "--frames", "1..2", "--seeds", 1, "--jobs", 1, *values, "--no-plots")
    rows = read_rows(folder / "out" / "sweep" / "runs.csv")
    cells = [(row["crowd.walker.count"], row["fps"], float(row["measures.number"])) for row in rows]
    assert cells == [("3", "12", 3), ("3", "24", 3), ("5", "12", 5), ("5", "24", 5)]
