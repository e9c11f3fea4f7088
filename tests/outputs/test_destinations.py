"""A name that cannot be written is reported before the work begins, with its flag and an exit code, and never as a traceback."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from antdsl.atomic_write import atomic_path, create_sibling_file, write_atomically
from antdsl.cli import app
from antdsl.cli.destinations import require_writable_file, require_writable_folder
from antdsl.cli.exits import CommandError, ExitCode
from antdsl.outputs.pictures.image_files import write_still

MINIMAL = Path(__file__).resolve().parents[2] / "examples" / "minimal"


@pytest.fixture
def shot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A scene, a file and a folder; a simulated step fails the test."""
    for name in ("walker.ant", "ground.ply", "scene.yaml"):
        shutil.copy(MINIMAL / name, tmp_path)
    program = (tmp_path / "walker.ant").read_text(encoding="utf-8")
    spec = 'spec "they are there" on "scene.yaml" { for 1 s; always: count(walker) == 50 }'
    (tmp_path / "walker.ant").write_text(f"{program}\n{spec}\n", encoding="utf-8")
    (tmp_path / "taken").write_text("mine")
    (tmp_path / "folder").mkdir()
    monkeypatch.chdir(tmp_path)

    def fail(*_: object) -> None:
        raise AssertionError("a run began")

    for place in ("antdsl.outputs.recording.bind", "antdsl.specs.running.bind", "antdsl.sweeps.run_jobs"):
        monkeypatch.setattr(place, fail)
    return tmp_path


def invoke(*words: str) -> Result:
    return CliRunner().invoke(app, list(words))


@pytest.mark.parametrize(
    ("words", "flag", "why"),
    [
        (("run", "scene.yaml", "--summary", "."), "--summary", "`.` is a folder; name a file"),
        (("run", "scene.yaml", "--summary", "folder"), "--summary", "is a folder"),
        (("run", "scene.yaml", "--summary", "none/x.json"), "--summary", "there is no folder `none`"),
        (("run", "scene.yaml", "--summary", "taken/x.json"), "--summary", "there is no folder `taken`"),
        (("run", "scene.yaml", "--summary", "pipe"), "--summary", "is not a regular file"),
        (("test", ".", "--json", "-", "--junit", "/dev/stdout"), "--junit", "is named by `--json` too"),
        (("test", ".", "--junit", "."), "--junit", "is a folder"),
        (("test", ".", "--json", "folder"), "--json", "is a folder"),
        (("export", "folder", "--to", "other.usda"), "--to", "is a folder"),
        (("graph", "walker.ant", "--out", "x.svg"), "--out", "is a folder"),
    ],
)
def test_where_nothing_can_be_written_nothing_is_run(shot: Path, words: tuple[str, ...], flag: str, why: str) -> None:
    os.mkfifo(shot / "pipe")
    for name in ("other.usda", "x.svg"):
        (shot / name).mkdir()
    result = invoke(*words)
    said = " ".join(result.stderr.replace("│", " ").split())
    assert result.exit_code == ExitCode.USAGE and flag in said and why in said, (result.output, result.exception)
    assert (shot / "taken").read_text() == "mine" and not (shot / "out").exists()


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize(
    ("words", "flag", "why"),
    [
        (("run", "scene.yaml", "--summary", "scene.yaml"), "--summary", "`scene.yaml` is an input"),
        (("run", "scene.yaml", "--summary", "./folder/../ground.ply"), "--summary", "ground.ply` is an input"),
        (("run", "scene.yaml", "--summary", "walker.ant"), "--summary", "`walker.ant` is an input"),
        (("run", "scene.yaml", "--summary", "mine.ant"), "--summary", "`mine.ant` is an input"),
        (("run", "scene.yaml", "--summary", "link"), "--summary", "`link` is an input"),
        (("run", "scene.yaml", "--summary", "out/scene/hashes.jsonl"), "--summary", "is also a result of `--out`"),
        (("run", "more.yaml", "--summary", "scene.yaml"), "--summary", "`scene.yaml` is an input"),
        (("test", ".", "--junit", "walker.ant"), "--junit", "`walker.ant` is an input"),
        (("test", ".", "--json", "ground.ply"), "--json", "`ground.ply` is an input"),
        (("test", ".", "--json", "scene.golden.json"), "--json", "`scene.golden.json` is an input"),
        (("test", ".", "--json", "x", "--junit", "./x"), "--junit", "is named by `--json` too"),
        (("graph", "walker.ant", "--format", "svg", "--out", "walker.ant"), "--out", "`walker.ant` is an input"),
        (("graph", "scene.yaml", "--format", "dot", "--out", "mine.ant"), "--out", "`mine.ant` is an input"),
    ],
)
def test_no_result_takes_the_place_of_what_it_is_made_from(shot: Path, words: tuple[str, ...], flag: str, why: str) -> None:
    (shot / "mine.ant").write_text("ant 1\nbehaviour half(way: push) -> push { way / 2 }\n")
    program = (shot / "walker.ant").read_text(encoding="utf-8")
    (shot / "walker.ant").write_text(program.replace("use steering", 'use steering\nuse "./mine.ant" as mine'), encoding="utf-8")
    (shot / "more.yaml").write_text("antdsl: 1\nextends: scene.yaml\nseed: 4\n")
    (shot / "scene.golden.json").write_text("{}")
    (shot / "link").symlink_to("ground.ply")
    (shot / "out" / "scene").mkdir(parents=True)
    initial_contents = contents(shot)
    result = invoke(*words)
    said = " ".join(result.stderr.replace("│", " ").split())
    assert result.exit_code == ExitCode.USAGE and flag in said and why in said, (result.output, result.exception)
    assert contents(shot) == initial_contents


@pytest.mark.parametrize("output", ["-", "/dev/stdout"])
def test_a_result_may_go_to_standard_output_alone(shot: Path, monkeypatch: pytest.MonkeyPatch, output: str) -> None:
    monkeypatch.undo()
    monkeypatch.chdir(shot)
    result = invoke("run", "scene.yaml", "--frames", "1..2", "--profile", "--summary", output)
    assert result.exit_code == 0 and json.loads(result.stdout)["frames"] == 2 and "the cache is in" in result.stderr
    result = invoke("test", ".", "--json", output)
    assert result.exit_code == 0 and json.loads(result.stdout)["passed"] == 1 and "1 passed" in result.stderr
    assert invoke("graph", "walker.ant", "--format", "dot", "--out", output).stdout.startswith("digraph")
    assert not (shot / "-").exists()


def test_what_goes_to_dev_null_is_gone(shot: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    monkeypatch.chdir(shot)
    result = invoke("test", ".", "--json", os.devnull, "--junit", os.devnull)
    assert result.exit_code == 0 and "1 passed" in result.stdout and not Path(os.devnull).is_file()


def test_a_run_does_not_write_over_the_cache_it_begins_with(shot: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    monkeypatch.chdir(shot)
    assert invoke("run", "scene.yaml", "--frames", "1..2", "--out", "first", "-q").exit_code == 0
    (shot / "more.yaml").write_text("antdsl: 1\nextends: scene.yaml\nfrom: {cache: first, frame: 2}\n")
    initial_contents = contents(shot)
    result = invoke("run", "more.yaml", "--frames", "1..2", "--out", "first")
    assert isinstance(result.exception, CommandError) and "checkpoint.0002.npz` is an input" in result.exception.message
    assert "--out" in result.exception.hint and contents(shot) == initial_contents
    assert invoke("run", "more.yaml", "--frames", "1..2", "--out", "second", "-q").exit_code == 0


@pytest.mark.parametrize(
    "words",
    [
        ("run", "scene.yaml", "--out", "taken"),
        ("run", "scene.yaml", "--out", "taken/deep/er"),
        ("test", ".", "--keep", "taken"),
        ("sweep", "scene.yaml", "--out", "taken"),
    ],
)
def test_a_file_is_no_folder_to_write_into(shot: Path, words: tuple[str, ...]) -> None:
    result = invoke(*words)
    assert isinstance(result.exception, CommandError) and result.exception.code == ExitCode.INPUT_OUTPUT
    assert "taken` is a file" in result.exception.message and words[-2] in result.exception.hint
    assert (shot / "taken").read_text() == "mine" and not (shot / "out").exists()


def test_a_table_of_a_sweep_cannot_take_the_place_of_a_folder(shot: Path) -> None:
    (shot / "folder" / "runs").mkdir()
    (shot / "folder" / "sweep.json").mkdir()
    result = invoke("sweep", "scene.yaml", "--out", "folder")
    assert isinstance(result.exception, CommandError) and "sweep.json` is a folder" in result.exception.message


def test_an_unwritable_folder_is_reported(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for ask in (
        lambda: require_writable_file(Path("/proc/none.json"), "--summary"),
        lambda: require_writable_folder(Path("/proc/x"), "--out"),
    ):
        with pytest.raises(CommandError) as stopped:
            ask()
        assert stopped.value.code == ExitCode.INPUT_OUTPUT and "cannot write" in stopped.value.message


def test_trying_leaves_everything_as_it_was(tmp_path: Path) -> None:
    (tmp_path / "x.json").write_text("mine")
    require_writable_file(tmp_path / "x.json", "--summary")
    require_writable_folder(tmp_path / "a" / "b", "--out", "table.txt")
    require_writable_file(None, "--summary")
    assert [path.name for path in tmp_path.iterdir()] == ["x.json"] and (tmp_path / "x.json").read_text() == "mine"


def _beside(folder: Path) -> tuple[Path, Path]:
    """A file of the user and a pipe without a reader, named as what is written might be named."""
    (folder / ".x.json.part").write_text("mine")
    os.mkfifo(folder / ".antdsl.part")
    return folder / ".x.json.part", folder / ".antdsl.part"


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes with names here")
def test_what_is_there_is_neither_waited_for_nor_taken_away(tmp_path: Path) -> None:
    mine, pipe = _beside(tmp_path)
    require_writable_file(tmp_path / "x.json", "--summary")
    require_writable_file(tmp_path / "antdsl", "--summary")
    require_writable_folder(tmp_path, "--out")
    write_atomically(tmp_path / "x.json", b"new", sync=False)
    write_still(np.zeros((4, 4, 3), np.uint8), tmp_path / "x.json")
    assert mine.read_text() == "mine" and pipe.is_fifo()
    assert sorted(path.name for path in tmp_path.iterdir()) == [".antdsl.part", ".x.json.part", "x.json"]


def test_a_name_that_is_taken_is_passed_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = iter([b"\1", b"\1", b"\1", b"\2"])
    monkeypatch.setattr("antdsl.atomic_write.os.urandom", lambda size: next(names))
    taken = create_sibling_file(tmp_path / "x")
    taken.unlink()
    taken.symlink_to(tmp_path / "elsewhere")
    assert create_sibling_file(tmp_path / "x").name == taken.name.replace("-01.part", "-02.part")
    assert not (tmp_path / "elsewhere").exists() and taken.is_symlink()


def test_what_fails_leaves_the_old_file_and_nothing_beside_it(tmp_path: Path) -> None:
    (tmp_path / "x").write_text("old")
    with pytest.raises(ValueError), atomic_path(tmp_path / "x") as part:
        part.write_text("half")
        raise ValueError
    assert [path.name for path in tmp_path.iterdir()] == ["x"] and (tmp_path / "x").read_text() == "old"


@pytest.mark.parametrize(("words", "taken"), [(("run", "scene.yaml"), "out"), (("sweep", "scene.yaml"), "out")])
def test_the_folder_that_results_go_to_by_themselves_is_tried_too(shot: Path, words: tuple[str, ...], taken: str) -> None:
    (shot / taken).write_text("mine")
    opened = shot / "ground.ply"
    opened.unlink()  # opening the scene would tell of this
    result = invoke(*words)
    assert isinstance(result.exception, CommandError) and result.exception.code == ExitCode.INPUT_OUTPUT
    assert f"{taken}` is a file" in result.exception.message and "--out" in result.exception.hint
    assert (shot / taken).read_text() == "mine"
