"""A name that cannot be written is told before the work begins, with its flag and an exit code, and never as a traceback."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from antdsl.cli import app
from antdsl.cli.destinations import file_to_write, folder_to_write
from antdsl.cli.exits import Exit, Stop

MINIMAL = Path(__file__).resolve().parent.parent / "examples" / "minimal"


@pytest.fixture
def shot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A scene, a file and a folder; whoever simulates a step fails the test."""
    for name in ("walker.ant", "ground.ply", "scene.yaml"):
        shutil.copy(MINIMAL / name, tmp_path)
    program = (tmp_path / "walker.ant").read_text(encoding="utf-8")
    spec = 'spec "they are there" on "scene.yaml" { for 1 s; always: count(walker) == 50 }'
    (tmp_path / "walker.ant").write_text(f"{program}\n{spec}\n", encoding="utf-8")
    (tmp_path / "taken").write_text("mine")
    (tmp_path / "folder").mkdir()
    monkeypatch.chdir(tmp_path)

    def begun(*_: object) -> None:
        raise AssertionError("a run began")

    for place in ("antdsl.outputs.recording.bind", "antdsl.specs.running.bind", "antdsl.sweep.run_all"):
        monkeypatch.setattr(place, begun)
    return tmp_path


def asked(*words: str) -> Result:
    return CliRunner().invoke(app, list(words))


@pytest.mark.parametrize(
    ("words", "flag", "why"),
    [
        (("run", "scene.yaml", "--summary", "."), "--summary", "`.` is a folder; name a file"),
        (("run", "scene.yaml", "--summary", "folder"), "--summary", "is a folder"),
        (("run", "scene.yaml", "--summary", "none/x.json"), "--summary", "there is no folder `none`"),
        (("run", "scene.yaml", "--summary", "taken/x.json"), "--summary", "there is no folder `taken`"),
        (("run", "scene.yaml", "--summary", "/dev/null"), "--summary", "is no regular file"),
        (("test", ".", "--junit", "."), "--junit", "is a folder"),
        (("test", ".", "--json", "folder"), "--json", "is a folder"),
        (("export", "folder", "--to", "other.usda"), "--to", "is a folder"),
        (("graph", "walker.ant", "--out", "x.svg"), "--out", "is a folder"),
    ],
)
def test_where_nothing_can_be_written_nothing_is_run(shot: Path, words: tuple[str, ...], flag: str, why: str) -> None:
    for name in ("other.usda", "x.svg"):
        (shot / name).mkdir()
    done = asked(*words)
    said = " ".join(done.stderr.replace("│", " ").split())
    assert done.exit_code == Exit.USAGE and flag in said and why in said, (done.output, done.exception)
    assert (shot / "taken").read_text() == "mine" and not (shot / "out").exists()


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
    done = asked(*words)
    assert isinstance(done.exception, Stop) and done.exception.code == Exit.INPUT_OUTPUT
    assert "taken` is a file" in done.exception.message and words[-2] in done.exception.hint
    assert (shot / "taken").read_text() == "mine" and not (shot / "out").exists()


def test_a_table_of_a_sweep_cannot_take_the_place_of_a_folder(shot: Path) -> None:
    (shot / "folder" / "runs").mkdir()
    (shot / "folder" / "sweep.json").mkdir()
    done = asked("sweep", "scene.yaml", "--out", "folder")
    assert isinstance(done.exception, Stop) and "sweep.json` is a folder" in done.exception.message


def test_a_folder_that_takes_no_files_is_told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for ask in (lambda: file_to_write(Path("/proc/none.json"), "--summary"), lambda: folder_to_write(Path("/proc/x"), "--out")):
        with pytest.raises(Stop) as stopped:
            ask()
        assert stopped.value.code == Exit.INPUT_OUTPUT and "cannot write" in stopped.value.message


def test_trying_leaves_everything_as_it_was(tmp_path: Path) -> None:
    (tmp_path / "x.json").write_text("mine")
    file_to_write(tmp_path / "x.json", "--summary")
    folder_to_write(tmp_path / "a" / "b", "--out", "table.txt")
    file_to_write(None, "--summary")
    assert [path.name for path in tmp_path.iterdir()] == ["x.json"] and (tmp_path / "x.json").read_text() == "mine"
