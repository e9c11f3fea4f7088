"""A run that needs more memory than there is ends before it begins, at a place in the scene."""

from __future__ import annotations

from pathlib import Path

import commands
import pytest

import antdsl.numerics.processor.host as available
from antdsl.cli.exits import CommandError, ExitCode
from antdsl.cli.memory_demand import estimate_shot_work, require_available_memory
from antdsl.pipeline import Shot, open_scene

SCENES = {"species walker": ("count: 200", "count: 4000000"), "surface ground": ("count: 200", "count: 1")}


def shot_of(folder: Path, *change: str) -> Shot:
    if not folder.exists():
        assert commands.run("new", str(folder), cwd=folder.parent).returncode == 0
    scene = folder / "scene.yaml"
    scene.write_text(scene.read_text().replace(*change))
    shot, report = open_scene(scene)
    assert shot is not None, report
    return shot


@pytest.mark.parametrize("thing", SCENES)
def test_the_largest_demand_is_named_with_its_location(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, thing: str) -> None:
    shot = shot_of(tmp_path / "project", *SCENES[thing])
    needed = sum(work.bytes for work in estimate_shot_work(shot))
    monkeypatch.setattr(available, "measure_available_memory", lambda: int(needed / 0.8) + 1)
    require_available_memory([shot])
    monkeypatch.setattr(available, "measure_available_memory", lambda: None)
    require_available_memory([shot])
    monkeypatch.setattr(available, "measure_available_memory", lambda: int(needed / 0.8) - 1)
    with pytest.raises(CommandError) as stop:
        require_available_memory([shot])
    assert stop.value.code == ExitCode.INPUT_OUTPUT and "--any-memory" in stop.value.hint
    place, _, words = stop.value.message.removeprefix("error: ").partition(": this needs at least ")
    assert place.rsplit(":", 2)[0].endswith("scene.yaml") and words.partition(": ")[2].startswith(thing)


def test_memory_of_parallel_scenes_is_added(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shot = shot_of(tmp_path / "project", "", "")
    needed = sum(work.bytes for work in estimate_shot_work(shot))
    monkeypatch.setattr(available, "measure_available_memory", lambda: int(needed / 0.8) + 1)
    require_available_memory([shot, shot, shot], 1)
    with pytest.raises(CommandError):
        require_available_memory([shot, shot, shot], 2)
    require_available_memory([shot], 2)
    with pytest.raises(CommandError, match="at least") as stop:
        require_available_memory([shot], 2, runs_per_shot=5)
    assert "--jobs" in stop.value.hint


def test_any_memory_ignores_the_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shot_of(tmp_path / "project", "count: 200", "count: 2")
    monkeypatch.setattr(available, "measure_available_memory", lambda: 1)
    words = ("run", "project/scene.yaml", "--frames", "1..1", "--backend", "numpy")
    result = commands.run(*words, cwd=tmp_path)
    assert result.returncode == 3 and "scene.yaml:" in result.stderr and not (tmp_path / "project" / "out").exists()
    assert commands.run(*words, "--any-memory", cwd=tmp_path).returncode == 0
    words = ("sweep", "project/scene.yaml", "--frames", "1..1", "--seeds", "1", "--no-plots")
    result = commands.run(*words, cwd=tmp_path)
    assert result.returncode == 3 and "scene.yaml:" in result.stderr and "--any-memory" in result.stderr
