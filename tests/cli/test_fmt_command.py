"""`antdsl fmt`: files in place, `--check`, `--diff`, standard input; broken files are left alone, nothing is half written."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from children import child_environment
from test_cli import GOOD, antdsl

ROOT = Path(__file__).resolve().parents[2]
UGLY = b"\xef\xbb\xbfant 1\r\nspecies a{size 4mm # long\r\n}"
NEAT = b"ant 1\nspecies a {\n  size 4 mm  # long\n}\n"
BROKEN = b"ant 1\nspecies a { size 4 mm\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "ugly.ant").write_bytes(UGLY)
    (tmp_path / "neat.ant").write_bytes(NEAT)
    return tmp_path


def piped(text: bytes, *words: str) -> subprocess.CompletedProcess[bytes]:
    environment = child_environment(NO_COLOR="1")
    return subprocess.run([sys.executable, "-m", "antdsl", "fmt", "-", *words], input=text, capture_output=True, env=environment)


def test_files_of_folders_are_formatted(folder: Path) -> None:
    (folder / "scene.yaml").write_text("antdsl: 1\n")
    result = antdsl("fmt", ".", cwd=folder)
    assert (result.returncode, result.stdout, result.stderr) == (0, "ugly.ant\n", "1 file changed, 1 file laid out well\n")
    assert (folder / "ugly.ant").read_bytes() == NEAT
    assert (folder / "scene.yaml").read_text() == "antdsl: 1\n"
    assert antdsl("fmt", ".", cwd=folder).stderr == "2 files laid out well\n"


def test_check_names_files_and_changes_none(folder: Path) -> None:
    result = antdsl("fmt", "--check", ".", cwd=folder)
    assert (result.returncode, result.stdout) == (1, "ugly.ant\n")
    assert (folder / "ugly.ant").read_bytes() == UGLY
    assert antdsl("fmt", "--check", "neat.ant", cwd=folder).returncode == 0


def test_diff_shows_what_would_change(folder: Path) -> None:
    result = antdsl("fmt", "--diff", ".", cwd=folder)
    assert (
        result.returncode == 1 and "-species a{size 4mm # long\n" in result.stdout and "+  size 4 mm  # long\n" in result.stdout
    )
    assert (folder / "ugly.ant").read_bytes() == UGLY
    (folder / "ends.ant").write_bytes(NEAT.replace(b"\n", b"\r\n"))
    assert antdsl("fmt", "--diff", "ends.ant", cwd=folder).stdout == "ends.ant: only line ends differ\n"


def test_files_with_errors_are_reported_and_unchanged(folder: Path) -> None:
    (folder / "broken.ant").write_bytes(BROKEN)
    (folder / "binary.ant").write_bytes(b"\x89PNG\r\n")
    result = antdsl("fmt", ".", cwd=folder)
    assert result.returncode == 1 and "error[unclosed-brace]" in result.stderr and "error[not-an-ant-file]" in result.stderr
    assert "1 file changed, 1 file laid out well, 2 files left alone" in result.stderr
    assert (folder / "broken.ant").read_bytes() == BROKEN and (folder / "ugly.ant").read_bytes() == NEAT


def test_standard_input_is_formatted() -> None:
    assert (piped(UGLY).returncode, piped(UGLY).stdout) == (0, NEAT)
    checked = piped(UGLY, "--check")
    assert (checked.returncode, checked.stdout) == (1, b"<stdin>\n")
    assert (piped(NEAT, "--check").returncode, piped(NEAT, "--diff").stdout) == (0, b"")
    broken = piped(BROKEN)
    assert (
        (broken.returncode, broken.stdout) == (1, b"")
        and b"error[unclosed-brace]" in broken.stderr
        and b"<stdin>:2:11" in broken.stderr
    )
    assert b"not UTF-8" in piped(b"ant 1\n\xff").stderr
    assert b"larger than" in piped(b"#" * 300_000).stderr


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        ((), 2, "name a file or a folder"),
        (("-", "neat.ant"), 2, "standard input cannot be combined with other inputs"),
        (("nowhere.ant",), 3, "cannot read `nowhere.ant`"),
        (("scene.yaml",), 1, "`scene.yaml` is not an .ant file"),
        (("empty",), 0, "this folder has no .ant files"),
    ],
)
def test_wrong_use_is_reported(folder: Path, words: tuple[str, ...], code: int, said: str) -> None:
    (folder / "scene.yaml").write_text("antdsl: 1\n")
    (folder / "empty").mkdir()
    result = antdsl("fmt", *words, cwd=folder)
    assert result.returncode == code and said in " ".join(result.stderr.split())


def test_links_and_permissions_are_preserved(folder: Path) -> None:
    (folder / "ugly.ant").chmod(0o640)
    (folder / "link.ant").symlink_to("ugly.ant")
    assert antdsl("fmt", "link.ant", cwd=folder).returncode == 0
    assert (folder / "link.ant").is_symlink() and (folder / "ugly.ant").read_bytes() == NEAT
    assert (folder / "ugly.ant").stat().st_mode & 0o777 == 0o640
    assert sorted(path.name for path in folder.iterdir()) == ["link.ant", "neat.ant", "ugly.ant"]


def test_a_failed_write_preserves_the_file(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from antdsl import syntax

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        syntax.write(folder / "ugly.ant", "ant 1\n")
    assert (folder / "ugly.ant").read_bytes() == UGLY and len(list(folder.iterdir())) == 2


def test_read_only_files_are_not_replaced(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from antdsl.cli import _run_without_warnings

    monkeypatch.setattr(os, "access", lambda path, mode: mode != os.W_OK)  # root may write any file
    monkeypatch.setattr(sys, "argv", ["antdsl", "fmt", str(folder / "ugly.ant")])
    assert _run_without_warnings() == 3
    assert "cannot write" in capsys.readouterr().err and (folder / "ugly.ant").read_bytes() == UGLY


def test_formatting_imports_no_heavy_package(folder: Path) -> None:
    code = (
        "import sys; sys.argv = ['antdsl', 'fmt', '.']\nfrom antdsl.cli import _run_without_warnings\n_run_without_warnings()\n"
    )
    code += "print(sorted({'numpy', 'scipy', 'open3d', 'llvmlite'} & set(sys.modules)))"
    result = subprocess.run([sys.executable, "-c", code], cwd=folder, env=child_environment(), capture_output=True, text=True)
    assert result.stdout.splitlines()[-1] == "[]", result.stdout + result.stderr


def test_files_of_a_new_project_are_formatted(folder: Path) -> None:
    (folder / "good.ant").write_text(GOOD)
    antdsl("new", "walkers", cwd=folder)
    result = antdsl("fmt", "--check", "good.ant", "walkers", cwd=folder)
    assert (result.returncode, result.stdout) == (0, "")
