"""Requirements on `--scheduler` before anything runs: an address, certificates, the extra."""

from __future__ import annotations

from pathlib import Path

import pytest
from cluster_stage import certificates
from typer.testing import CliRunner

from antdsl.cli import app
from antdsl.cli.exits import CommandError
from antdsl.executors import ProcessEngine


@pytest.fixture(autouse=True)
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    CliRunner().invoke(app, ["new", "walkers"])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("render1:8786",), "is not a scheduler: write `local`"),
        (("tls://render1:8786",), "name their folder with `--tls DIR`"),
        (("tls://render1:8786", "--tls", "walkers"), "has no `ca.pem`"),
        (("tcp://render1:8786",), "is not encrypted"),
        (("tcp://10.0.0.7:8786",), "is not encrypted"),
        (("tcp://127.0.0.1:8786", "--tls", "walkers"), "write tls://127.0.0.1:8786"),
        (("local", "--tls", "walkers"), "creates its own certificates"),
        (("tcp://127.0.0.1:99999",), "is not a scheduler"),
    ],
)
def test_only_safe_schedulers_are_contacted(words: tuple[str, ...], message: str) -> None:
    for command in (("sweep", "walkers/scene.yaml", "--seeds", "1"), ("run", "walkers/scene.yaml")):
        result = CliRunner().invoke(app, [*command, "--scheduler", *words], env={"COLUMNS": "400"})
        assert result.exit_code == 2 and message in result.output


@pytest.mark.parametrize("flag", [("--tls", "walkers"), ("--no-tls",)])
def test_options_of_an_unnamed_scheduler_are_refused(flag: tuple[str, ...]) -> None:
    scene = "walkers/scene.yaml"
    for command in (("sweep", scene), ("run", scene), ("render", "walkers"), ("export", "walkers", "--to", "a.ply")):
        result = CliRunner().invoke(app, [*command, *flag], env={"COLUMNS": "400"})
        assert result.exit_code == 2 and "add `--scheduler tls://HOST:8786`" in result.output


def test_bad_certificates_are_reported(tmp_path: Path) -> None:
    pytest.importorskip("cryptography")
    pytest.importorskip("distributed")
    tls = certificates(tmp_path / "tls")
    words = ["sweep", "walkers/scene.yaml", "--scheduler", "tls://127.0.0.1:1", "--tls", str(tls)]
    key_text = (tls / "key.pem").read_text()
    for name, text, message in (("key.pem", "none", "cert.pem` and `key.pem`"), ("ca.pem", "none", "ca.pem` is no certificate")):
        (tls / name).write_text(text)
        result = CliRunner().invoke(app, words, env={"COLUMNS": "400"})
        assert result.exit_code == 2 and message in result.output
        (tls / "key.pem").write_text(key_text)


def test_without_the_extra_the_message_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    result = CliRunner().invoke(app, ["sweep", "walkers/scene.yaml", "--seeds", "1", "--scheduler", "local", "--no-plots"])
    assert isinstance(result.exception, CommandError) and "pip install 'antdsl[cluster]'" in result.exception.hint


def test_processes_run_tasks_without_a_scheduler(monkeypatch: pytest.MonkeyPatch) -> None:
    executor_calls = []

    def run_all(todo: object, executors: object, report: object, noted: object) -> list[object]:
        executor_calls.append(executors)
        return []

    monkeypatch.setattr("antdsl.sweeps.run_jobs", run_all)
    assert CliRunner().invoke(app, ["sweep", "walkers/scene.yaml", "--seeds", "2", "--no-plots"]).exit_code == 0
    assert isinstance(executor_calls[0], ProcessEngine)
