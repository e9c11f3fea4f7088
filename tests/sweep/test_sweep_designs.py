"""The command with designs: what it writes, that it stops early, that it resumes with its options. Runs are a formula."""

from __future__ import annotations

import csv
import importlib
import json
import os
import shutil
import signal
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import pytest

from antdsl.cli import _run_without_warnings as run_in_process
from antdsl.sweeps import JobOutcome, SweepJob

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = """ant 1
use steering
world { surface ground }
species walker {
  param pace = 30 mm/s in 5 mm/s .. 100 mm/s "How fast"
  param swing = 0.5 in 0 .. 1 "How far it swings"
  max_speed pace * swing
  start walk
  state walk { steer wander() }
}
"""
SCENE = """antdsl: 1
frames: 1..30
world: {ground: {mesh: ground.ply}}
crowd: [{species: walker, from: walker.ant, count: 12, place: {on: ground, radius: 30 mm}}]
"""
PACE, SWING = ("--vary", "walker.pace=10mm/s..90mm/s"), ("--vary", "walker.swing=0..1")

Sweep = Callable[..., tuple[int, str, str]]


def formula(job: SweepJob) -> dict[str, float | int | None]:
    """Pace counts three times what swing does; seeds add a little."""
    params = dict(job.params)
    pace, swing = float(params.get("walker.pace", "30mm/s").removesuffix("mm/s")), float(params.get("walker.swing", "0.5"))
    value = 3 * (pace - 10) / 80 + swing + job.seed % 3 * 0.01
    return {"frames": 30, "motion.turn": value, "motion.step": 1.0, "empty.food": None if swing > 0.5 else 3}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "walker.ant").write_text(PROGRAM)
    (tmp_path / "scene.yaml").write_text(SCENE)
    shutil.copy(ROOT / "examples" / "minimal" / "ground.ply", tmp_path)
    return tmp_path


@pytest.fixture
def sweep(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Sweep:
    def ran(*words: str, ends_after: int | None = None, by: int = signal.SIGTERM) -> tuple[int, str, str]:
        def run_all(jobs: Iterable[SweepJob], *options: object) -> Iterator[JobOutcome]:
            for count, job in enumerate(jobs):
                if count == ends_after:
                    signal.raise_signal(by)
                yield JobOutcome(job, formula(job))

        monkeypatch.setattr("antdsl.sweeps.run_jobs", run_all)
        monkeypatch.chdir(folder)
        monkeypatch.setattr("sys.argv", ["antdsl", "sweep", *words, "--no-plots"])
        code = run_in_process()
        output = capsys.readouterr()
        return code, output.out, output.err

    return ran


def lines(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(path.read_text().splitlines()))


def test_a_latin_hypercube_is_run_point_by_point_and_its_values_are_columns(sweep: Sweep, folder: Path) -> None:
    code, output, _ = sweep(
        "scene.yaml", *PACE, *SWING, "--design", "latin", "--points", "62", "--seeds", "1", "--show", "motion.turn"
    )
    assert code == 0 and "62 of 62" in output and "… and 2 more lines, in table.txt" in output
    runs = lines(folder / "out" / "sweep" / "runs.csv")
    assert len(runs) == 62 == len({run["walker.pace (mm/s)"] for run in runs})
    assert all(10 <= float(run["walker.pace (mm/s)"]) <= 90 and 0 <= float(run["walker.swing"]) <= 1 for run in runs)


def test_saltellis_sample_tells_which_share_of_the_variance_each_param_makes(sweep: Sweep, folder: Path) -> None:
    pytest.importorskip("SALib")
    words = (*PACE, *SWING, "--design", "saltelli", "--points", "16", "--seeds", "1", "--show", "motion", "--show", "empty")
    code, output, err = sweep("scene.yaml", *words)
    assert code == 0 and "Sobol indices" in output
    line_by_factor = {line["factor"]: line for line in lines(folder / "out" / "sweep" / "sensitivity.csv")}
    assert float(line_by_factor["walker.pace"]["total"]) == pytest.approx(0.9, abs=0.15)
    assert float(line_by_factor["walker.swing"]["total"]) == pytest.approx(0.1, abs=0.15)
    assert "motion.step is 1 at all points" in err and "empty.food never happened at" in err
    document = json.loads((folder / "out" / "sweep" / "sweep.json").read_text())
    assert [effect["factor"] for effect in document["sensitivity"]] == ["walker.pace", "walker.swing"]


def test_a_sweep_stops_once_medians_are_known(sweep: Sweep, folder: Path) -> None:
    code, output, _ = sweep(
        "scene.yaml", "--vary", "walker.pace=10mm/s,90mm/s", "--seeds", "60", "--until-known", "motion.turn=0.1"
    )
    assert code == 0 and "of at most 120" in output and "Medians, with 95 % between" in output
    document = json.loads((folder / "out" / "sweep" / "sweep.json").read_text())
    assert len(document["runs"]) < 30 and [known["met"] for known in document["medians"]] == [True, True]
    for known in document["medians"]:
        assert known["low"] <= known["median"] <= known["high"] <= known["low"] + 0.1
    code, output, err = sweep("scene.yaml", "--seeds", "60", "--until-known", "motion.turn=0.001%")
    assert code == 0 and "not as close as requested" in output
    code, _, err = sweep("scene.yaml", "--seeds", "9", "--again", "--until-known", "moton=1")
    assert code == 2 and "no measure begins with `moton`" in err and "motion" in err


def test_a_stopped_sweep_continues_its_request(sweep: Sweep, folder: Path) -> None:
    words = ("scene.yaml", *PACE, "--design", "sobol", "--points", "8", "--seeds", "2", "--out", "kept/swept")
    assert sweep(*words, "--out", "whole")[0] == 0
    code, _, err = sweep(*words, ends_after=5)
    assert code == 75 and "5 of 16 runs are finished" in err and "--resume" in err
    assert sweep(*words, ends_after=5, by=signal.SIGINT)[0] == 130
    os.rename(folder / "kept", folder / "moved")
    for name in ("scene.yaml", "walker.ant", "ground.ply"):
        assert (folder / name).is_file()
    code, output, _ = sweep("--resume", "--out", "moved/swept")
    assert code == 0 and "10 of 16 runs were finished before" in output
    assert (folder / "moved" / "swept" / "runs.csv").read_text() == (folder / "whole" / "runs.csv").read_text()
    (folder / "walker.ant").write_text(PROGRAM + "\n# another\n")
    code, output, err = sweep("--resume", "--out", "moved/swept")
    assert code == 0 and "16 runs in moved/swept used different files, values or versions of antdsl" in err


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        ((), 2, "name a scene"),
        (("--resume",), 2, "name the sweep to continue"),
        (("--resume", "--out", "out", "scene.yaml"), 2, "omit the scenes"),
        (("--resume", "--out", "out", "--vary", "a=1"), 2, "omit `--vary`"),
        (("--resume", "--out", "out"), 3, "has no sweep to continue"),
        (("scene.yaml", *PACE), 2, "--design latin --points 20"),
        (("scene.yaml", *PACE, "--design", "latin"), 2, "--design latin --points 20"),
        (("scene.yaml", "--vary", "walker.pace=3..2", "--design", "latin", "--points", "9"), 2, "walker.pace=2..3"),
        (("scene.yaml", "--vary", "walker.pace=1mm/s..9mm/s", "--design", "latin", "--points", "9"), 1, "outside 5 mm/s"),
        (("scene.yaml", "--vary", "walker.pace=1..9", "--design", "latin", "--points", "9"), 1, "mm/s"),
        (("scene.yaml", "--vary", "walker.pac=1..9", "--design", "latin", "--points", "9"), 1, "did you mean `walker.pace`?"),
        (("scene.yaml", "--until-known", "motion=0"), 2, "motion=10%"),
        (("scene.yaml", "--until-known", "motion=1"), 2, "--seeds 50"),
    ],
)
def test_options_that_do_not_fit_are_reported_before_anything_runs(
    sweep: Sweep, words: tuple[str, ...], code: int, says: str
) -> None:
    exit_code, _, err = sweep(*words, ends_after=0)
    assert exit_code == code and says in err, err


def test_a_damaged_or_foreign_request_file_is_reported(sweep: Sweep, folder: Path) -> None:
    assert sweep("scene.yaml", "--seeds", "1", "--out", "swept")[0] == 0
    request_path = folder / "swept" / "asked.json"
    for text in (
        "{",
        "[]",
        '{"scenes": []}',
        request_path.read_text().replace('"grid"', "3"),
        request_path.read_text().replace("{", '{"more": 1,', 1),
        request_path.read_text().replace('"grid"', '"gird"'),
        request_path.read_text().replace('"grid"', '"latin"').replace("null", "-4", 1),
        request_path.read_text().replace('"design_seed": 1', '"design_seed": -1'),
        request_path.read_text().replace("scene.yaml", "scene\\u0000.yaml"),
    ):
        request_path.write_text(text)
        code, _, err = sweep("--resume", "--out", "swept")
        assert code == 3 and "asked.json` is damaged" in err


def test_the_table_is_parquet_too_with_numbers_as_numbers(sweep: Sweep, folder: Path) -> None:
    pytest.importorskip("pyarrow")
    from pyarrow import parquet

    words = (*PACE, "--vary", "walker.swing=0.2,0.8", "--design", "latin", "--points", "6", "--seeds", "2")
    assert sweep("scene.yaml", *words, "--show", "motion.turn")[0] == 0
    table = parquet.read_table(folder / "out" / "sweep" / "runs.parquet")
    written = lines(folder / "out" / "sweep" / "runs.csv")
    assert table.column_names == list(written[0]) and table.num_rows == len(written) == 12
    kinds = {name: str(table.schema.field(name).type) for name in table.column_names}
    assert (kinds["label"], kinds["walker.swing"]) == ("string", "string")
    assert (kinds["seed"], kinds["frames"], kinds["empty.food"]) == ("int64", "int64", "int64")
    assert (kinds["walker.pace (mm/s)"], kinds["motion.turn"]) == ("double", "double")
    for row, line in zip(table.to_pylist(), written, strict=True):
        for name, value in row.items():
            said = line[name]
            assert (value is None) if said == "" else value == type(value)(said), name
    assert {row["empty.food"] for row in table.to_pylist()} == {None, 3}


def test_runs_of_other_sources_do_not_count(sweep: Sweep, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert sweep("scene.yaml", "--seeds", "3", "--out", "swept")[0] == 0
    monkeypatch.setattr(importlib.import_module("antdsl.sweeps.jobs"), "hash_sources", lambda: "0" * 24)
    code, output, err = sweep("--resume", "--out", "swept")
    assert code == 0 and "finished before" not in output and "3 of 3" in output
    assert "3 runs in swept used different files, values or versions of antdsl" in err


def test_factors_are_drawn(sweep: Sweep, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib")
    from PIL import Image

    words = (*PACE, *SWING, "--design", "sobol", "--points", "16", "--seeds", "3", "--show", "motion.turn", "--show", "empty")
    assert sweep("scene.yaml", *words)[0] == 0
    monkeypatch.setattr(
        "sys.argv", ["antdsl", "sweep", "--resume", "--out", "out/sweep", "--show", "motion.turn", "--show", "empty"]
    )
    assert run_in_process() == 0 and not (folder / "out" / "sweep" / "table.png").exists()
    with Image.open(folder / "out" / "sweep" / "factors.png") as picture:
        assert picture.width > 800 and picture.height > 500 and len(picture.convert("RGB").getcolors(1 << 20) or ()) > 8
