"""Sweeps: what is run, that neither processes nor stopping change a result, what a table says about what never happened."""

from __future__ import annotations

import csv
import json
import math
import multiprocessing
import os
import shutil
import signal
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest

from antdsl.cli import _run_without_warnings as run_in_process
from antdsl.executors import ProcessEngine, WorkerContext
from antdsl.pipeline import open_scene
from antdsl.sweeps import FinishedRunStore, SceneVariation, SweepJob, build_jobs, build_rows, make_variations, run_jobs
from antdsl.sweeps.designs import choose_design
from antdsl.sweeps.factors import Factor
from antdsl.sweeps.finished_runs import NotASweepFolderError
from antdsl.sweeps.jobs import compute_job_key, find_start_hashes
from antdsl.sweeps.measuring import measure_job
from antdsl.sweeps.table import MACHINE_DEPENDENT_MEASURES, choose_measures, compute_quantile, format_csv_table, format_table

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = """ant 1
use steering
world { surface ground; items food { load = 0 } }
species walker {
  param smell = 60 mm in 0 mm .. 300 mm "How far it smells food"
  load = 0
  let meal = nearest(food, with: load > 0, within: smell)
  start look
  state look { steer wander(); when meal -> go }
  state go { steer seek(meal); when touching(meal) take 1 load from meal -> look; when no meal -> look }
  layers { state }
}
"""
SCENE = """antdsl: 1
frames: 1..30
world:
  ground: {mesh: ground.ply}
  food: {apple: {at: [15, 0, 0], load: 3}, far: {at: [-190, 0, 20], load: 3}}
crowd: [{species: walker, from: walker.ant, count: 12, place: {on: ground, radius: 30 mm}}]
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "walker.ant").write_text(PROGRAM)
    (tmp_path / "scene.yaml").write_text(SCENE)
    shutil.copy(ROOT / "examples" / "minimal" / "ground.ply", tmp_path)
    return tmp_path


def make_jobs(folder: Path, seeds: range = range(1, 3), until: str | None = None, **vary: tuple[str, ...]) -> list[SweepJob]:
    points = grid(**vary)
    job_list, report = build_jobs(make_variations([folder / "scene.yaml"], points), seeds, frames=None, until=until, grants={})
    assert report.ok, report.errors
    return job_list


def grid(**vary: tuple[str, ...]) -> list[Mapping[str, str]]:
    chosen, _ = choose_design("grid", [Factor(f"walker.{name}", values) for name, values in vary.items()], None, 1)
    assert chosen is not None
    return chosen.unique_points


def same(measures: dict[str, object] | None) -> dict[str, object]:
    assert measures is not None
    return {name: value for name, value in measures.items() if name not in MACHINE_DEPENDENT_MEASURES}


def test_every_combination_with_every_seed_seed_by_seed() -> None:
    chosen = make_variations([Path("a.yaml"), Path("b.yaml")], grid(p=("1", "2"), q=("3",)))
    assert [v.label for v in chosen] == ["a, p 1, q 3", "a, p 2, q 3", "b, p 1, q 3", "b, p 2, q 3"]
    assert make_variations([Path("a.yaml")], grid()) == [SceneVariation(Path("a.yaml"), {}, "a")]


def test_a_key_tells_runs_apart_and_finds_them_again(folder: Path) -> None:
    first = make_jobs(folder, smell=("30mm", "60mm"))
    assert [(job.seed, job.label) for job in first] == [(s, f"smell {v}") for s in (1, 2) for v in ("30mm", "60mm")]
    assert len({job.key for job in first}) == 4
    assert [job.key for job in make_jobs(folder, smell=("30mm", "60mm"))] == [job.key for job in first]
    assert not {job.key for job in make_jobs(folder, until="total(food.load) == 0", smell=("30mm", "60mm"))} & {
        job.key for job in first
    }
    (folder / "walker.ant").write_text(PROGRAM.replace("touching(meal)", "distance(meal) < 14 mm"))
    assert not {job.key for job in make_jobs(folder, smell=("30mm", "60mm"))} & {job.key for job in first}


def test_a_key_is_that_of_the_scene_opened_by_itself(folder: Path) -> None:
    """Where a run is made the scene is opened again, and an error where its key is another."""
    for job in make_jobs(folder, smell=("30mm", "60mm")):
        shot, _ = open_scene(folder / "scene.yaml", job.make_choices())
        assert shot is not None and compute_job_key(shot, job.seed, find_start_hashes(shot)) == job.key


def test_mistakes_are_reported_before_anything_runs(folder: Path) -> None:
    chosen = make_variations([folder / "scene.yaml"], grid(smell=("60mm", "4s", "4m")))
    _, report = build_jobs(chosen, range(1, 3), frames=None, until="total(food.lod) == 0", grants={})
    assert sorted(d.code for d in report.errors) == ["out-of-range", "wrong-argument", "wrong-unit"]


def test_processes_change_no_result_and_a_run_that_fails_stops_no_other(folder: Path) -> None:
    good = make_jobs(folder, until="min(food.load) == 0")
    missing_job = replace(good[0], scene=str(folder / "gone.yaml"), label="gone", key="0")
    outcomes = {outcome.job.key: outcome for outcome in run_jobs([missing_job, *good], ProcessEngine(2, 1))}
    assert outcomes["0"].measures is None and "there is no file" in outcomes["0"].problem
    for job in good:
        assert same(outcomes[job.key].measures) == same(measure_job(job.make_document(), WorkerContext(3)))
    measures = outcomes[good[0].key].measures
    assert measures is not None and measures["frames"] == measures["empty.food.apple.load"] < 30, "ended once it was empty"
    assert measures["empty.food.far.load"] is None and measures["left.food.far.load"] == 3
    assert measures["items.food.load"] == 3 and measures["transitions.walker.look->go"] >= 3


def test_a_job_goes_to_another_process_as_json(folder: Path) -> None:
    for job in make_jobs(folder, smell=("30mm",), until="total(food.load) == 0"):
        assert SweepJob.from_document(json.loads(json.dumps(job.make_document()))) == job


@pytest.mark.slow
def test_a_process_that_is_killed_costs_no_other_run(folder: Path) -> None:
    """Both runs under way are done again, one at a time; the one with a process that is killed each time is given up."""
    long = replace(make_jobs(folder)[0], frames=(1, 900_000), key="long")
    hit: list[int] = []

    def kill(job: SweepJob, frame: int) -> None:
        for child in multiprocessing.active_children() if job.key == "long" else []:
            assert child.pid is not None
            hit.append(child.pid)
            os.kill(child.pid, signal.SIGKILL)

    outcomes = list(run_jobs([long, *make_jobs(folder)], ProcessEngine(2, 1), kill))
    assert {outcome.job.key for outcome in outcomes if outcome.measures is None} == {"long"} and len(outcomes) == 3
    problem = next(outcome.problem for outcome in outcomes if outcome.measures is None)
    assert "SIGKILL" in problem and len(hit) >= 2 and not multiprocessing.active_children()


def test_events_that_never_happened_sort_last() -> None:
    inf = math.inf
    assert compute_quantile([1, 2, 4], 0.5) == 2 and compute_quantile([1, 2, 4, inf], 0.5) == 3
    assert compute_quantile([1, 2, inf, inf], 0.5) == inf and compute_quantile([inf, inf], 0.25) == inf
    assert compute_quantile([1, 3, 5, 6, inf], 0.75) == 6
    job = SweepJob("s.yaml", "a", (), 1, (1, 9), None, (), "k")
    results = [(job, {"empty.food.apple.load": v, "x.y": 2, "fps": 7, "hash": "q"}) for v in (5, None, None)]
    table = build_rows([*results, (job, {"empty.food.apple.load": 7})])
    assert [(r.measure, r.runs, r.happened) for r in table] == [("empty.food.apple.load", 4, 2), ("x.y", 4, 4)]
    assert table[0].least == 5 and table[0].median == inf and table[1].least == 0, "what a run does not tell is 0"
    words = format_table(table, choose_measures(table, ()))
    assert "never (6.5 – never), 2 of 4" in words and "food.apple.load 0 at" in words and "x.y" not in words
    lines = list(csv.DictReader(format_csv_table(table).splitlines()))
    assert lines[0]["median"] == "" and lines[0]["least"] == "5" and lines[1]["median"] == "2"


def test_only_complete_results_of_this_very_run_are_stored(folder: Path) -> None:
    job = make_jobs(folder)[0]
    run_store = FinishedRunStore(folder / "out")
    assert run_store.read_measures(job) is None
    run_store.write_measures(job, {"frames": 3})
    assert run_store.read_measures(job) == {"frames": 3} and FinishedRunStore(folder / "out").read_measures(job) == {"frames": 3}
    run_store.get_run_path(job).write_text(run_store.get_run_path(job).read_text()[:-30])
    assert run_store.read_measures(job) is None
    with pytest.raises(NotASweepFolderError):
        FinishedRunStore(folder)


def test_the_command_continues_a_stopped_sweep(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def sweep(*words: str) -> tuple[int, str, str]:
        monkeypatch.setattr("sys.argv", ["antdsl", "sweep", str(folder / "scene.yaml"), *words])
        code = run_in_process()
        output = capsys.readouterr()
        return code, output.out, output.err

    monkeypatch.setattr("antdsl.sweeps.run_jobs", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    code, _, err = sweep("--seeds", "2")
    assert code == 130 and "0 of 2 runs are finished" in err and "run the same command again" in err
    monkeypatch.undo()
    out = folder / "out" / "sweep"
    (job, _) = make_jobs(folder)
    FinishedRunStore(out).write_measures(job, {"frames": 30, "empty.food.apple.load": 11})
    code, output, _ = sweep("--seeds", "2", "--jobs", "1", "--no-plots")
    assert code == 0 and "1 of 2 runs were finished before" in output and "1 of 1: scene, seed 2, 30 frames" in output
    document = json.loads((out / "sweep.json").read_text())
    assert [run["seed"] for run in document["runs"]] == [1, 2] and document["runs"][0]["measures"]["frames"] == 30
    assert (out / "table.txt").read_text() in output and (out / "runs.csv").read_text().count("\n") == 3
    assert sweep("--seeds", "3..2")[0] == 2 and sweep("--vary", "walker.smell=1mm,,2mm")[0] == 2
    code, _, err = sweep("--seeds", "2", "--show", "nothing", "--quiet")
    assert code == 2 and "no measure begins with `nothing`" in err


def test_a_table_is_drawn(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    from PIL import Image

    from antdsl.sweeps.plots import draw_measures

    job = SweepJob("s.yaml", "a", (), 1, (1, 9), None, (), "k")
    draw_measures(
        [(replace(job, label=label), {"x": v}) for label, v in (("a", 1), ("a", 4), ("b", None))], ["x"], tmp_path / "t.png"
    )
    with Image.open(tmp_path / "t.png") as picture:
        assert picture.width > 600 and len(picture.convert("RGB").getcolors(1 << 20) or ()) > 8
