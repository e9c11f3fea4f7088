"""Results follow no link that the user did not name: a project may bring an `out` that leads anywhere."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from commands import run

from antdsl.atomic_write import find_first_link
from antdsl.sweeps.finished_runs import FinishedRunStore, NotASweepFolderError

MINIMAL = Path(__file__).resolve().parents[2] / "examples" / "minimal"
pytestmark = pytest.mark.skipif(os.name == "nt", reason="links need a right there")


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A scene next to a folder that is none of its business; no step is simulated."""
    folder = tmp_path / "project"
    folder.mkdir()
    (tmp_path / "victim").mkdir()
    for name in ("walker.ant", "ground.ply", "scene.yaml"):
        shutil.copy(MINIMAL / name, folder)
    shutil.copy(folder / "scene.yaml", folder / "other.yaml")

    def begin(*_: object, **__: object) -> None:
        raise AssertionError("a run began")

    for place in ("antdsl.outputs.recording.bind", "antdsl.sweeps.run_jobs"):
        monkeypatch.setattr(place, begin)
    return folder


RUN, SWEEP, TWO = ("run", "scene.yaml"), ("sweep", "scene.yaml", "--seeds", "1"), ("run", "scene.yaml", "other.yaml")
JOBS = ("jobs", "scene.yaml", "--to", "job.json")


@pytest.mark.parametrize(
    ("words", "link"),
    [
        (RUN, "out"),
        (RUN, "out/scene"),
        (SWEEP, "out"),
        (SWEEP, "out/sweep"),
        (TWO, "out/other"),
        ((*TWO, "--out", "caches"), "caches/scene"),
        (JOBS, "out"),
        (JOBS, "out/scene/pictures"),
        (("graph", "walker.ant"), "walker.svg"),
    ],
)
@pytest.mark.parametrize("leads_to", ["folder", "nowhere", "itself", "file", "device"])
def test_no_command_follows_a_link_by_default(project: Path, words: tuple[str, ...], link: str, leads_to: str) -> None:
    victim, path = project.parent / "victim", project / link
    path.parent.mkdir(parents=True, exist_ok=True)
    (victim / "file").write_text("mine")
    targets = {"folder": victim, "nowhere": victim / "new", "itself": path, "file": victim / "file", "device": Path(os.devnull)}
    path.symlink_to(targets[leads_to])
    process = run(*words, cwd=project)
    assert process.returncode == 3, process.stderr
    assert f"{link}` is a link" in process.stderr and "`--" in process.stderr and "Traceback" not in process.stderr
    assert [each.name for each in victim.iterdir()] == ["file"] and (victim / "file").read_text() == "mine"
    assert path.is_symlink() and not (project / "job.json").exists()


def test_pictures_and_edited_caches_follow_no_link(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    assert run("run", "scene.yaml", "--frames", "0..1", "-q", cwd=project).returncode == 0
    victim, cache = project.parent / "victim", project / "out" / "scene"
    (cache / "pictures").symlink_to(victim)
    (project / "out" / "scene_edited").symlink_to(victim)
    for words in (("render", "out/scene"), ("edit", "out/scene", "--smooth", "orient:3")):
        process = run(*words, cwd=project)
        assert process.returncode == 3 and "is a link" in process.stderr and "`--out`" in process.stderr, process.stderr
    assert not list(victim.iterdir())
    process = run("edit", "out/scene", "--smooth", "orient:3", "--out", "out/scene_edited", cwd=project)
    assert process.returncode == 0 and (victim / "manifest.json").is_file(), "what the user names may be a link"
    (cache / "frames").rename(victim / "moved")
    (cache / "frames").symlink_to(victim / "moved")
    initial_names = sorted(each.name for each in (victim / "moved").iterdir())
    process = run("run", "scene.yaml", "--frames", "0..3", cwd=project)
    assert process.returncode == 3 and "frames` is a link" in process.stderr
    assert sorted(each.name for each in (victim / "moved").iterdir()) == initial_names


@pytest.mark.parametrize("name", ["manifest.json", "static.npz", "hashes.jsonl", "frames/frame.0000.npz"])
def test_links_in_a_cache_are_replaced_and_not_written_through(project: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    monkeypatch.undo()
    words = ("run", "scene.yaml", "--frames", "0..0", "-q")
    assert run(*words, cwd=project).returncode == 0
    path, victim = project / "out" / "scene" / name, project.parent / "victim" / "file"
    assert path.is_file()
    victim.write_text("mine")
    path.unlink()
    path.symlink_to(victim)
    assert run("info", "out/scene", "--verify", cwd=project).returncode != 0
    process = run(*words, cwd=project)
    assert process.returncode == 0, process.stderr
    assert victim.read_text() == "mine" and not path.is_symlink()


@pytest.mark.parametrize("kind", ["file", "pipe"])
def test_what_is_no_folder_is_no_place_for_results(project: Path, kind: str) -> None:
    make: Callable[[Path], object] = os.mkfifo if kind == "pipe" else Path.touch
    make(project / "out")
    for words in (RUN, SWEEP):
        process = run(*words, cwd=project)
        assert process.returncode == 3 and "out` is a file" in process.stderr, process.stderr


def test_runs_of_a_sweep_follow_no_link(project: Path) -> None:
    (project / "out" / "sweep").mkdir(parents=True)
    (project / "out" / "sweep" / "runs").symlink_to(project.parent / "victim")
    with pytest.raises(NotASweepFolderError, match="is a link"):
        FinishedRunStore(project / "out" / "sweep")


def test_only_links_below_the_base_count(project: Path, tmp_path: Path) -> None:
    (tmp_path / "way").symlink_to(project)
    (project / "out").mkdir()
    assert find_first_link(tmp_path / "way", "out", "scene") is None
    (project / "out" / "scene").symlink_to("missing")
    assert find_first_link(tmp_path / "way", "out", "scene", "pictures") == tmp_path / "way" / "out" / "scene"


def test_fmt_writes_through_no_link_that_it_finds(project: Path) -> None:
    """A program that is named is laid out, a link that a folder has is not, unless it leads into that folder."""
    outside = project.parent / "victim" / "outside.ant"
    text = "ant 1\nspecies   walker {\n}\n"
    outside.write_text(text)
    (project / "linked.ant").symlink_to(outside)
    process = run("fmt", ".", cwd=project)
    assert process.returncode == 3 and "`linked.ant` is a link" in process.stderr, process.stderr
    assert outside.read_text() == text
    assert run("fmt", "linked.ant", cwd=project).returncode == 0
    assert outside.read_text() != text and (project / "linked.ant").is_symlink()
