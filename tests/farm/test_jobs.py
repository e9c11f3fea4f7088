"""Jobs for render farms: templates that the reference implementation of Open Job Description takes, and lines that can be run."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from typing import Any

import commands
import pytest
import yaml
from children import child_environment

from antdsl.farm import split_frames
from antdsl.outputs.cache.cache_reader import open_cache

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = """ant 1
use steering
world { surface ground }
species walker {
  param pace = 30 mm/s in 5 mm/s .. 100 mm/s "How fast"
  max_speed pace
  start walk
  state walk { steer wander() }
}
"""
SCENE = """antdsl: 1
frames: 1..30
world: {ground: {mesh: ground.ply}}
crowd: [{species: walker, from: walker.ant, count: 12, place: {on: ground, radius: 30 mm}}]
"""
SMALL = "--width 96 --height 54 --threads 1"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "walker.ant").write_text(PROGRAM)
    (tmp_path / "scene.yaml").write_text(SCENE)
    shutil.copy(ROOT / "examples" / "minimal" / "ground.ply", tmp_path)
    return tmp_path


def run_jobs(folder: Path, *words: str, code: int = 0) -> str:
    result = commands.run("jobs", "scene.yaml", *words, cwd=folder)
    assert result.returncode == code, result.stderr
    return result.stdout + result.stderr


def step(document: dict[str, Any], name: str) -> dict[str, Any]:
    return next(each for each in document["steps"] if each["name"] == name)


def test_chunks_begin_with_a_picture_and_leave_none_out() -> None:
    assert split_frames(1, 10, 1, 4) == ("1..4", "5..8", "9..10")
    assert split_frames(1, 10, 3, 2) == ("1..6", "7..10")
    assert split_frames(5, 5, 1, 10) == ("5..5",)


def test_a_template_has_the_steps_of_a_shot_in_their_order(folder: Path) -> None:
    output = run_jobs(
        folder, "--to", "job.yaml", "--frames", "1..25", "--seed", "4", "--set", "walker.pace=20mm/s", "--render", SMALL
    )
    assert output == "job.yaml: simulation, frames (3 tasks), film\n"
    document = yaml.safe_load((folder / "job.yaml").read_text())
    assert document["specificationVersion"] == "jobtemplate-2023-09" and "extensions" not in document
    parameters = {each["name"]: (each["type"], each["dataFlow"], each["default"]) for each in document["parameterDefinitions"]}
    assert parameters == {
        "Project": ("PATH", "IN", "."),
        "Cache": ("PATH", "INOUT", "out/scene"),
        "Pictures": ("PATH", "INOUT", "out/scene/pictures"),
    }
    simulation, frames, film = (step(document, name) for name in ("simulation", "frames", "film"))
    action = simulation["script"]["actions"]["onRun"]
    assert " ".join([action["command"], *action["args"]]) == (
        "antdsl run {{Param.Project}}/scene.yaml --frames 1..25 --out {{Param.Cache}} --seed 4 --set walker.pace=20mm/s --resume"
    )
    assert action["cancelation"]["mode"] == "NOTIFY_THEN_TERMINATE"
    assert frames["parameterSpace"]["taskParameterDefinitions"] == [
        {"name": "Frames", "type": "STRING", "range": ["1..10", "11..20", "21..25"]}
    ]
    look = f"{SMALL} --resume".split()
    drawn = ["render", "{{Param.Cache}}", "--out", "{{Param.Pictures}}"]
    assert frames["script"]["actions"]["onRun"]["args"] == [
        *drawn, "--frames", "{{Task.Param.Frames}}", "--shot", "1..25", *look,
    ]  # fmt: skip
    assert film["script"]["actions"]["onRun"]["args"] == [*drawn, "--film", "--frames", "1..25", *look]
    assert [each.get("dependencies") for each in (simulation, frames, film)] == [
        None,
        [{"dependsOn": "simulation"}],
        [{"dependsOn": "frames"}],
    ]
    run_jobs(folder, "--to", "job.json", "--frames", "1..25", "--seed", "4", "--set", "walker.pace=20mm/s", "--render", SMALL)
    assert json.loads((folder / "job.json").read_text()) == document


def test_places_that_a_template_may_not_name_are_reported(folder: Path) -> None:
    (folder / "jobs").mkdir()
    (folder / "assets").mkdir()
    output = run_jobs(folder, "--to", "jobs/job.yaml", "--root", "kit=assets", "--pictures", "jobs/drawn")
    assert f"name them when you submit the job:\n  Project={folder}\n  Root_kit={folder / 'assets'}\n  Cache={folder}" in output
    document = yaml.safe_load((folder / "jobs" / "job.yaml").read_text())
    assert [each.get("default") for each in document["parameterDefinitions"]] == [None, None, None, "drawn"]
    words = step(document, "simulation")["script"]["actions"]["onRun"]["args"]
    assert words[words.index("--root") + 1] == "kit={{Param.Root_kit}}"


@pytest.mark.parametrize("words", [(), ("--every", "3", "--chunk", "2", "--no-film"), ("--root", "kit=.", "--seed", "3")])
def test_the_reference_implementation_takes_the_template(folder: Path, words: tuple[str, ...]) -> None:
    model = pytest.importorskip("openjd.model")
    run_jobs(folder, "--to", "job.yaml", *words)
    document = yaml.safe_load((folder / "job.yaml").read_text())
    template = model.decode_job_template(template=document)
    values = model.preprocess_job_parameters(
        job_template=template, job_parameter_values={}, job_template_dir=folder, current_working_dir=folder
    )
    job = model.create_job(job_template=template, job_parameter_values=values)
    frames = next(each for each in job.steps if each.name == "frames")
    tasks = [task["Frames"].value for task in model.StepParameterSpaceIterator(space=frames.parameterSpace)]
    assert tasks == step(document, "frames")["parameterSpace"]["taskParameterDefinitions"][0]["range"]


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        (("--to", "job.txt"), 2, "none of .yaml"),
        (("--to", "scene.yaml"), 2, "is an input and would be lost"),
        (("--to", "job.yaml", "--frames", "1..5000", "--chunk", "1"), 2, "--chunk 5"),
        (("--to", "job.yaml", "--set", "walker.pace=3"), 1, "walker.pace"),
        (("--to", "job.yaml", "--render", "--widt 3"), 2, "--widt"),
        (("--to", "job.yaml", "--render", "--width 3"), 2, "16"),
        (("--to", "job.yaml", "--render", "--frames 1..3"), 2, "antdsl jobs … --frames A..B"),
        (("--to", "job.yaml", "--render", "--film"), 2, "the job makes a film"),
        (("--to", "job.yaml", "--render", "'a"), 2, "not closed"),
        (("--to", "job.yaml", "--render", "--help"), 2, "draws nothing"),
        (("--to", "job.yaml", "--render", "--cut '{{x}} > 0'"), 2, "job.jsonl"),
    ],
)
def test_what_makes_no_job_is_reported(folder: Path, words: tuple[str, ...], code: int, says: str) -> None:
    scene = (folder / "scene.yaml").read_text()
    output = " ".join(run_jobs(folder, *words, code=code).replace("│", " ").split())
    assert says in output and (folder / "scene.yaml").read_text() == scene and not (folder / "job.yaml").exists()


def test_lines_can_be_run_one_after_the_other_and_again(folder: Path) -> None:
    run_jobs(folder, "--to", "job.jsonl", "--frames", "1..5", "--every", "2", "--chunk", "2", "--no-film", "--render", SMALL)
    lines = [json.loads(line) for line in (folder / "job.jsonl").read_text().splitlines()]
    assert [(line["name"], line["needs"]) for line in lines] == [
        ("simulation", []),
        ("frames 1..4", ["simulation"]),
        ("frames 5..5", ["simulation"]),
    ]
    for attempt in range(2):
        for line in lines:
            result = commands.run(*line["command"][1:], cwd=folder.parent)
            assert line["command"][0] == "antdsl" and result.returncode == 0, result.stderr
            assert not attempt or line["step"] == "simulation" or result.stdout.endswith("there already\n")
    cache = folder / "out" / "scene"
    assert open_cache(cache).frames() == [1, 2, 3, 4, 5]
    assert sorted(path.name for path in (cache / "pictures").iterdir()) == [f"picture.000{k}.png" for k in (1, 3, 5)]


@pytest.mark.slow
def test_the_reference_runner_makes_the_shot_with_its_paths_mapped(folder: Path, tmp_path: Path) -> None:
    """The job is submitted with paths of another machine, which rules map to those of this one."""
    import subprocess

    pytest.importorskip("openjd.cli")
    bin = tmp_path / "bin"
    bin.mkdir()
    (bin / "antdsl").write_text(f'#!/bin/sh\nexec "{sys.executable}" -m antdsl "$@"\n')
    (bin / "antdsl").chmod(0o755)
    run_jobs(folder, "--to", "job.yaml", "--frames", "1..4", "--chunk", "2", "--no-film", "--render", SMALL)
    rules = {
        "version": "pathmapping-1.0",
        "path_mapping_rules": [{"source_path_format": "POSIX", "source_path": "/mnt/show", "destination_path": str(folder)}],
    }
    environment = child_environment()
    environment["PATH"] = f"{bin}:{environment['PATH']}"
    command = [sys.executable, "-m", "openjd", "run", "job.yaml", "--step", "frames", "--run-dependencies"]
    command += ["--path-mapping-rules", json.dumps(rules)]
    for name, path in (("Project", ""), ("Cache", "/made/cache"), ("Pictures", "/made/pictures")):
        command += ["-p", f"{name}=/mnt/show{path}"]
    result = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=300)
    assert result.returncode == 0, result.stdout[-3000:] + result.stderr[-2000:]
    assert sorted(path.name for path in (folder / "made" / "pictures").iterdir()) == [f"picture.000{k}.png" for k in range(1, 5)]
