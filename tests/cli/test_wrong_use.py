"""What commands say where an option or a file cannot be used: why, and what to write."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest
from commands import run


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("check", "a.yaml", "--trust-usd"), "write: antdsl --trust-usd check a.yaml"),
        (("export", ".", "--to", "x.abc"), "`.usdc` with `--as meshes`"),
        (("export", ".", "--to", "x.FBX"), "`.glb`"),
        (("export", ".", "--to", "-"), "an export needs a file"),
        (("run", "."), "`./shot.yaml`"),
        (("sweep", "."), "`./shot.yaml`"),
        (("jobs", ".", "--to", "j.json"), "`./shot.yaml`"),
        (("run", "a.ant"), "is a program"),
    ],
)
def test_wrong_use_says_what_to_write(tmp_path: Path, words: tuple[str, ...], said: str) -> None:
    (tmp_path / "shot.yaml").write_text("antdsl: 1\n")
    result = run(*words, cwd=tmp_path)
    assert result.returncode == 2 and said in " ".join(result.stderr.split()), result.stderr


def test_an_export_of_ids_that_no_agent_has_says_so(tmp_path: Path) -> None:
    assert run("new", "p", cwd=tmp_path).returncode == 0
    assert run("run", "p/scene.yaml", "-q", "--frames", "1..2", cwd=tmp_path).returncode == 0
    for ids, note in (
        ("9999", "no agent of these frames has the id 9999"),
        ("0,9998..9999", "2 of the ids, such as 9998"),
        ("0", ""),
    ):
        result = run("export", "p/out/scene", "--to", "x.csv", "--ids", ids, cwd=tmp_path)
        assert result.returncode == 0 and note in result.stdout and bool(note) == ("note:" in result.stdout)


def test_new_quotes_the_commands_that_it_prints(tmp_path: Path) -> None:
    name = 'my "new" $proj'
    result = run("new", name, cwd=tmp_path)
    assert f"  {shlex.join(['antdsl', 'test', name])}\n" in result.stdout
