"""`antdsl bench`: what it prints, what it writes, and how it says that it cannot."""

from __future__ import annotations

import json
from pathlib import Path

import commands
import pytest

from antdsl.bench import BENCH_CASES
from antdsl.runtime.backends import BACKENDS


def test_cases_are_listed(tmp_path: Path) -> None:
    process = commands.run("bench", "--list", cwd=tmp_path)
    assert process.returncode == 0
    assert [line.split()[0] for line in process.stdout.splitlines()] == list(BENCH_CASES)
    assert "125, 1,000, 15,000, 100,000, 1,000,000" in process.stdout


@pytest.mark.slow
def test_backends_are_measured_separately_and_alternately(tmp_path: Path) -> None:
    words = ["node", "--agents", "40", "--backend", "numpy", "--backend", "reference", "--pairs", "2", "--steps", "1"]
    process = commands.run("bench", *words, "--json", "found.json", cwd=tmp_path, env={"COLUMNS": "100"})
    assert process.returncode == 0, process.stderr
    lines = process.stdout.splitlines()
    assert lines[0].startswith("node, 40 agents; 500 points that wander and keep apart")
    assert next(line for line in lines if line.startswith("backend")).split() == ["backend", "numpy", "reference"]
    for head in (
        "run, CPU ms",
        "bare step, CPU ms",
        "wall ms",
        "µs per agent",
        "bytes per agent",
        "start",
        "compile",
        "bind",
        "first step",
    ):
        assert any(line.startswith(head) for line in lines), head
    assert any(line.startswith("reference: ") and "(2 turns) of the CPU time of numpy" in line for line in lines)
    assert any(line.startswith("blend") and len(line.split()) == 5 for line in lines)
    document = json.loads((tmp_path / "found.json").read_text())
    (result,) = document["results"]
    assert [each["job"]["backends"] for each in result["alone"]] == [["numpy"], ["reference"]]
    assert list(result["together"]["costs"]) == ["numpy", "reference"] and document["machine"]["numpy"]
    slow = result["together"]["costs"]
    assert min(slow["reference"]["cpu"]) > min(slow["numpy"]["cpu"]), "one agent at a time takes longer"


def test_a_full_run_of_a_scene_is_measured(tmp_path: Path) -> None:
    assert commands.run("new", "walkers", cwd=tmp_path).returncode == 0
    words = ["walkers/scene.yaml", "--backend", "numpy", "--pairs", "2", "--steps", "2", "--threads", "2"]
    process = commands.run("bench", *words, "--json", "-", cwd=tmp_path)
    assert process.returncode == 0, process.stderr
    (measurement,) = json.loads(process.stdout)["results"][0]["alone"]
    assert (
        measurement["agents"] == 200
        and measurement["full_run"]["cpu"] > 0
        and measurement["job"]["threads"] == 2
        and measurement["steps"] == 2
    )
    assert "run, CPU ms" in process.stderr and "walkers/scene.yaml, 200 agents" in process.stderr
    assert not (tmp_path / "walkers" / "out").exists()


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["none"], 2, "`none` is neither a case nor a file; cases: foraging, "),
        (["node", "--backend", "fortran"], 2, f"unknown backend `fortran`; backends: {', '.join(BACKENDS)}"),
        (["walkers/walker.ant"], 2, "is a program"),
        (["tunnel", "--agents", "7"], 1, "tunnel: `scene.yaml` cannot have 7 agents"),
        (["bad.yaml"], 1, "no-crowd"),
        (["bad.yaml", "--json", "bad.yaml"], 2, "would be lost"),
        (["node", "--pairs", "0"], 2, "--pairs"),
    ],
)
def test_unmeasurable_cases_are_errors(tmp_path: Path, words: list[str], code: int, said: str) -> None:
    assert commands.run("new", "walkers", cwd=tmp_path).returncode == 0
    (tmp_path / "bad.yaml").write_text("antdsl: 1\n")
    process = commands.run("bench", *words, cwd=tmp_path, env={"COLUMNS": "250"})
    assert process.returncode == code and said in " ".join((process.stdout + process.stderr).split()), (
        process.stdout + process.stderr
    )
