"""`antdsl test` as people and build servers meet it: words, exit codes, JUnit, JSON, Ctrl-C."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from xml.etree import ElementTree

import pytest
from children import child_environment
from test_cli import ROOT, antdsl

from antdsl.cli import _run_without_warnings as run_in_process

PROGRAM = """ant 1
species a {
  tick = 0
  start go
  state go { tick += 1 /s; when tick > 99 -> never }
  state never { when after 1 s -> go }
}
spec "fine" on "scene.yaml" { seeds 1 .. 2; always: count(a) == 3 }
spec "slow <&>" on "scene.yaml" { each a { always: tick < 0.25 } }
"""
SCENE = "antdsl: 1\nfps: 10\nframes: 1..11\ncrowd: [{species: a, from: a.ant, count: 3, place: {radius: 9 mm}}]\n"


PLACE = "position is somewhere"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "a.ant").write_text(PROGRAM)
    (tmp_path / "scene.yaml").write_text(SCENE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    return tmp_path


def run(capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, *words: str) -> tuple[int, str, str]:
    monkeypatch.setattr(sys, "argv", ["antdsl", "test", *words])
    code = run_in_process()
    return code, *capfd.readouterr()


def test_results_are_reported_in_words(folder: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    code, out, err = run(capfd, monkeypatch, ".")
    assert code == 1 and not err
    out = re.sub(r": \d+ frames, [0-9.]+ s", "", out)
    out = re.sub("position is .*", PLACE, out)
    assert [line.strip() for line in out.splitlines()] == [
        'passed  "fine", seed 1',
        'passed  "fine", seed 2',
        'failed  "slow <&>", seed 0',
        "a.ant:9:44: always: tick < 0.25",
        "first at frame 4, 0.3 s from the start, by a 0, 1, 2",
        "of a 0:",
        "tick is 0.3",
        "state is go, for 0.3 s",
        PLACE,
        "saved: frames 1 to 4 in out/failed/slow-0",
        "see it:         antdsl render out/failed/slow-0 --frames 3..4 --agents 0,1,2 --show trail,ids",
        "continue it:    antdsl run scene.yaml --frames 1..11 --seed 0 --out out/failed/slow-0 --resume",
        "2 passed, 1 failed",
        "states entered: 1 of 2",
        "changes made: 0 of 2",
        "a.ant:5:28: `a.go -> never` was never made",
        "a.ant:6:9: `a.never` was never entered",
        "a.ant:6:17: `a.never -> go` was never made",
    ]
    assert run(capfd, monkeypatch, "a.ant", "-k", "FIN", "--seeds", "3", "-q") == (0, "3 passed\n", "")


def test_results_are_written_for_build_servers(
    folder: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    code, *_ = run(capfd, monkeypatch, "scene.yaml", "--junit", "out.xml", "--json", "out.json", "--backend", "reference")
    assert code == 1
    root = ElementTree.parse(folder / "out.xml").getroot()
    assert (root.get("tests"), root.get("failures"), root.get("skipped")) == ("3", "1", "0")
    failed = [case for case in root.iter("testcase") if case.find("failure") is not None]
    assert [case.get("name") for case in failed] == ["slow <&> [scene.yaml, seed 0]"]
    assert failed[0].get("file") == "a.ant" and failed[0].get("line") == "9"
    failure = failed[0].find("failure")
    assert failure is not None and "tick is 0.3" in (failure.text or "") and failure.get("message") == "always: tick < 0.25"
    document = json.loads((folder / "out.json").read_text())
    assert (document["passed"], document["failed"]) == (2, 1)
    (bad,) = document["specs"][-1]["failures"]
    assert bad["agent"] == {"species": "a", "id": 0} and (bad["frame"], bad["time"]) == (4, 0.3)
    assert bad["place"] == {"file": "a.ant", "line": 9, "column": 44} and bad["values"] == [{"text": "tick", "value": "0.3"}]
    counts = {each["name"]: each["count"] for table in document["coverage"].values() for each in table}
    assert counts["a.main.go"] > 0 and counts["a.main.go->never#1"] == 0


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["none.ant"], 3, "none.ant"),
        (["a.ant", "-k", "nothing"], 2, "no spec has `nothing` in its name"),
        (["plain.ant"], 2, "no spec was found"),
        (["bad.ant"], 1, "no `total(b.load)`"),
        (["lost.ant"], 1, "there is no file `lost.yaml`"),
        (["a.ant", "--junit", "none/x.xml"], 2, "there is no folder"),
        (["a.ant", "--seeds", "0"], 2, "--seeds"),
        (["a.ant", "bad.ant", "-k", "fine"], 1, "2 passed, 2 mistakes in files"),
    ],
)
def test_specs_that_cannot_run_give_a_message_and_an_exit_code(
    folder: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, words: list[str], code: int, said: str
) -> None:
    (folder / "plain.ant").write_text(PROGRAM[: PROGRAM.index('spec "')])
    (folder / "bad.ant").write_text(PROGRAM.replace("count(a) == 3", "total(b.load) == 3"))
    (folder / "lost.ant").write_text(PROGRAM.replace("scene.yaml", "lost.yaml"))
    exit_code, out, err = run(capfd, monkeypatch, *words, "--json", "told.json")
    assert exit_code == code and (said in out + err or "error[" in err), out + err
    assert "Traceback" not in out + err
    if (folder / "told.json").exists() and code == 1:
        assert json.loads((folder / "told.json").read_text())["problems"][0]["place"]["file"].endswith(".ant")


def test_ctrl_c_writes_what_was_finished(folder: Path) -> None:
    (folder / "a.ant").write_text(PROGRAM + 'spec "long" on "scene.yaml" { seeds 5; for 999 min; always: count(a) == 3 }\n')
    command = [sys.executable, "-m", "antdsl", "test", ".", "--junit", "out.xml"]
    environment = child_environment(PYTHONUNBUFFERED="1")
    running = subprocess.Popen(command, cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert running.stdout is not None
    while "slow" not in running.stdout.readline():  # the long one comes last
        assert running.poll() is None
    time.sleep(0.2)
    running.send_signal(signal.SIGINT)
    out, err = running.communicate(timeout=60)
    assert running.returncode == 130 and "stopped by Ctrl-C" in err and "Traceback" not in err
    assert "2 passed, 1 failed, 1 not finished" in out
    root = ElementTree.parse(folder / "out.xml").getroot()
    assert (root.get("tests"), root.get("failures"), root.get("skipped")) == ("4", "1", "1")


def test_a_new_project_has_a_spec_that_holds(tmp_path: Path) -> None:
    assert antdsl("new", "ants", cwd=tmp_path).returncode == 0
    process = antdsl("test", "ants", "--quiet", cwd=tmp_path)
    assert process.returncode == 0 and process.stdout == "1 passed\n", process.stdout + process.stderr


@pytest.mark.slow
def test_the_specs_of_the_examples_hold() -> None:
    process = subprocess.run(
        [sys.executable, "-m", "antdsl", "test", "examples"], cwd=ROOT, capture_output=True, text=True, timeout=900,
        env=child_environment(),
    )  # fmt: skip
    assert process.returncode == 0, process.stdout + process.stderr
