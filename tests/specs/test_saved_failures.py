"""Failures are saved and gone on from with the same bits; golden runs tell what differs first; coverage bounds."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from preview_page import coarse
from test_cli import ROOT, antdsl
from test_specs import GROUND

from antdsl.cli import _run_without_warnings as run_in_process
from antdsl.outputs.cache.cache_reader import open_cache
from antdsl.pipeline import RunChoices, open_scene
from antdsl.runtime import bind, state_hash, step
from antdsl.specs.golden.golden_runs import find_golden_path, read_golden

PROGRAM = """ant 1
use steering
world { surface ground; items food { load = 0 } }
field scent on ground { cell 4 mm; half_life 8 s }
species a {
  param swing = 40 deg in 0 deg .. 180 deg
  param pace  = 20 mm/s in 1 mm/s .. 90 mm/s
  max_speed pace
  load = 0
  luck = uniform(0, 1)
  start go
  state go {
    steer wander(swing: swing)
    deposit scent 1 /s
    when luck > 0.5 take 1 load from nearest(food) -> full
  }
  state full { steer wander(swing: swing); when after 0.5 s -> rest }
  state rest { when after 9 s -> go }
  layers { state }
}
"""
SPECS = """spec "nobody rests long" on "scene.yaml" {
  for 3 s
  set a.pace = 30 mm/s
  set scent.half_life = 2 * 2 s
  each a { never: state == rest held 0.8 s }
}
spec "all are there" on "scene.yaml" { for 2 s; always: count(a) == 20 }
"""
SCENE = """antdsl: 1
fps: 24
frames: 11..90
preroll: 2
seed: 5
units: cm
world: {ground: {mesh: ground.ply}, food: {apple: {at: [0, 0, 0], load: 100}, donut: {at: [1, 0, 0], load: 100}}}
crowd: [{species: a, from: a.ant, count: 20, place: {radius: 20 mm}}]
"""


def written(folder: Path, program: str) -> Path:
    (folder / "a.ant").write_text(program)
    (folder / "scene.yaml").write_text(SCENE)
    (folder / "ground.ply").write_text(GROUND)
    return folder


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    return written(tmp_path, PROGRAM + SPECS)


@pytest.fixture
def run(capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):  # type: ignore[no-untyped-def]
    def command(*words: str) -> tuple[int, str]:
        monkeypatch.setattr(sys, "argv", ["antdsl", *words])
        code = run_in_process()
        out, err = capfd.readouterr()
        assert "Traceback" not in out + err, out + err
        return code, out + err

    return command


def test_failure_reports_are_complete(folder: Path, run) -> None:  # type: ignore[no-untyped-def]
    code, out = run("test", "a.ant", "-k", "rests")
    known = re.sub(r", [0-9.]+ s$", ", … s", re.sub(r"position is .*", "position is …", out), flags=re.MULTILINE)
    assert code == 1
    who = re.search(r"by a (\d+)", out)
    assert who is not None
    one = who[1]
    assert known.splitlines()[:9] == [
        'failed  "nobody rests long", seed 5: 32 frames, … s',
        "  a.ant:25:12: never: state == rest held 0.8 s",
        f"    first at frame 42, 1.29167 s from the start, by a {', '.join(agents(out))}",
        f"    of a {one}:",
        "      state is rest",
        "      position is …",
        "  saved: frames 35 to 42 in out/failed/nobody-rests-long-5",
        "    see it:         antdsl render out/failed/nobody-rests-long-5 --frames 41..42 --agents "
        f"{','.join(agents(out))} --show trail,ids",
        "    continue it:    antdsl run scene.yaml --frames 35..90 --seed 5 --set a.pace=30mm/s --set scent.half_life=4.0s "
        "--out out/failed/nobody-rests-long-5 --resume",
    ]


def agents(out: str) -> list[str]:
    match = re.search(r"by a ([\d, ]+)", out)
    return match[1].strip().split(", ") if match else []


def test_saved_failures_continue_the_judged_run(folder: Path, run) -> None:  # type: ignore[no-untyped-def]
    """Each frame in the saved cache, and those that the printed command makes from it, have the hashes of a separate run."""
    assert run("test", "a.ant", "-k", "rests")[0] == 1
    out = folder / "out" / "failed" / "nobody-rests-long-5"
    cache = open_cache(out)
    shot, _ = open_scene(folder / "scene.yaml", RunChoices(params={"a.pace": "30mm/s", "scent.half_life": "4s"}))
    assert shot is not None
    world = bind(shot.plan, shot.setting)
    hash_by_frame = {}
    while world.frame <= 60:
        hash_by_frame[world.frame] = state_hash(world)
        step(world)
    assert cache.frames() == cache.checkpoints() == list(range(35, 43))
    assert cache.read_state_hashes() == {frame: hash_by_frame[frame] for frame in cache.frames()}
    _, text = run("test", "a.ant", "-k", "rests")
    command = next(line.split(":  ")[1] for line in text.splitlines() if "continue it" in line)
    process = antdsl(*shlex.split(command.replace("35..90", "35..60"))[1:], cwd=folder)
    assert process.returncode == 0, process.stdout + process.stderr
    assert open_cache(out).read_state_hashes() == {frame: hash_by_frame[frame] for frame in range(35, 61)}
    picture = next(line.split(":  ")[1] for line in text.splitlines() if "see it" in line)
    drawn = antdsl(*shlex.split(picture)[1:], "--width", "64", "--height", "36", cwd=folder)
    assert drawn.returncode == 0 and (out / "pictures" / "picture.0042.png").is_file(), drawn.stdout + drawn.stderr


def test_where_failures_are_saved(folder: Path, run) -> None:  # type: ignore[no-untyped-def]
    _, text = run("test", "a.ant", "-k", "rests", "--no-keep")
    assert "saved" not in text and not (folder / "out").exists()
    _, text = run("test", "a.ant", "-k", "rests", "--keep", "here")
    assert (folder / "here" / "nobody-rests-long-5" / "manifest.json").is_file() and not (folder / "out").exists()
    (folder / "foreign" / "nobody-rests-long-5").mkdir(parents=True)
    (folder / "foreign" / "nobody-rests-long-5" / "mine.txt").write_text("mine")
    _, text = run("test", "a.ant", "-k", "rests", "--keep", "foreign")
    assert "not saved: " in text and "mine.txt" in text
    (folder / "a.ant").write_text(PROGRAM + 'spec "no" on "scene.yaml" { for 0.1 s; seeds 1 .. 7; always: count(a) == 0 }\n')
    _, text = run("test", "a.ant")
    assert text.count("see it:") == 5 and text.count("not saved: only the first 5 are") == 2
    assert "--frames 11..11" in text  # it was so in the first frame: there is none before


def test_moving_scenes_are_saved_from_the_first_frame(folder: Path, run) -> None:  # type: ignore[no-untyped-def]
    moved = "apple: {at: [0, 0, 0], keys: {11: {at: [0, 0, 0]}, 60: {at: [3, 0, 0]}}, load: 100}"
    (folder / "scene.yaml").write_text(SCENE.replace("apple: {at: [0, 0, 0], load: 100}", moved))
    _, text = run("test", "a.ant", "-k", "rests")
    assert "saved: frames 11 to " in text and "differently" not in text, text


def test_a_fault_is_saved_before_it_happens(folder: Path, run) -> None:  # type: ignore[no-untyped-def]
    (folder / "a.ant").write_text(
        PROGRAM.replace("deposit scent", "load = 1 / (if time > 1 s then 0 else 1); deposit scent") + SPECS
    )
    _, text = run("test", "a.ant", "-k", "there")
    assert "`load` is not finite" in text and "first at frame 25" in text and "saved: frames 23 to 24 in" in text, text
    assert re.search(r"antdsl render \S+ --frames 23\.\.24 --agents \d+", text), text
    cache = open_cache(folder / "out" / "failed" / "all-are-there-5")
    assert cache.frames()[-1] == 24


@pytest.mark.slow
def test_a_failing_spec_of_the_foraging_example_shows_its_cause(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run) -> None:  # type: ignore[no-untyped-def]
    """An ant has lost where the crumb comes from: the failure names the ant, its state and both values."""
    shutil.copytree(ROOT / "examples" / "foraging", tmp_path / "foraging")
    (tmp_path / "foraging" / "terrain.ply").write_bytes(coarse("foraging/terrain.ply", 5))
    monkeypatch.chdir(tmp_path / "foraging")
    program, scene = Path("forager.ant"), Path("scene.yaml")
    text = program.read_text()
    assert "-> carry { source = meal }" in text and "at: [120, 0, 90]" in scene.read_text()
    program.write_text(text.replace("-> carry { source = meal }", "-> carry"))
    scene.write_text(scene.read_text().replace("count: 500", "count: 40").replace("at: [120, 0, 90]", "at: [80, 0, 60]"))
    code, out = run("test", "forager.ant", "-k", "crumb")
    assert code == 1
    lines = re.sub(r", [0-9.]+ s$", ", … s", out, flags=re.MULTILINE).splitlines()
    place = next(f"{n}:5" for n, line in enumerate(text.splitlines(), 1) if "source is not none" in line)
    failure_lines = lines[lines.index(f"  forager.ant:{place}: always: load == 0 or source is not none") :]
    when, who = re.search(r"first at frame (\d+), [0-9.]+ s from the start, by forager (\d+)", failure_lines[1]).groups()  # type: ignore[union-attr]
    assert [re.sub("position is [-0-9., ]+", "position is …", line) for line in failure_lines[2:6] if " of " not in line] == [
        "      load is 1",
        "      source is none",
        "      state is carry, for 0.04167 s",
        "      position is …",
    ]
    folder = "out/failed/no-crumb-is-lost-or-invented-7"
    saved = int(re.search(r"saved: frames (\d+) to (\d+) in", out)[1])  # type: ignore[index]
    assert saved < int(when) and f"antdsl render {folder} --frames {int(when) - 1}..{when} --agents {who}" in out, out
    previous_frame, then = (open_cache(Path(folder)).frame(int(when) - k) for k in (1, 0))
    states = ("search", "turn_home", "approach", "carry")
    row = int(np.flatnonzero(then["id"] == int(who))[0])
    assert [states[frame["state"][row]] for frame in (previous_frame, then)] == ["approach", "carry"]


# --- golden runs -----------------------------------------------------------------------------------------------------

TWO = 'spec "all are there" on "scene.yaml" { for 2 s; seeds 5 .. 6; always: count(a) == 20 }\n'


@pytest.fixture(scope="module")
def golden_run(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The file of a golden run, as the command writes it."""
    folder = written(tmp_path_factory.mktemp("golden"), PROGRAM + TWO)
    process = antdsl("test", "a.ant", "--update", cwd=folder)
    assert process.returncode == 0 and "written golden run of scene.yaml, seed 5: 49 frames" in process.stdout, process.stdout
    return find_golden_path(folder / "scene.yaml").read_bytes()


@pytest.fixture
def golden(folder: Path, run, golden_run: bytes):  # type: ignore[no-untyped-def]
    (folder / "a.ant").write_text(PROGRAM + TWO)
    find_golden_path(folder / "scene.yaml").write_bytes(golden_run)
    return run


def change(folder: Path, old: str, new: str) -> None:
    text = (folder / "a.ant").read_text()
    assert old in text
    (folder / "a.ant").write_text(text.replace(old, new))


def test_a_golden_run_is_text_with_a_line_for_each_frame(folder: Path, golden) -> None:  # type: ignore[no-untyped-def]
    path = find_golden_path(folder / "scene.yaml")
    text = path.read_text()
    stored_golden = read_golden(path)
    assert stored_golden is not None and path.name == "scene.golden.json" and json.loads(text)["golden"] == 2
    (one,) = stored_golden.runs
    assert one.seed == 5 and len(one.frames) == 49 and text.count('\n{"frame"') == 49 and len(text) < 60_000
    assert one.summary["a"] == "20 agents" and one.summary["food.load"].startswith("9")
    code, out = golden("test", "a.ant", "--threads", "2")
    assert code == 0 and "same    golden run of scene.yaml, seed 5: 49 frames" in out
    assert golden("test", "a.ant", "--update")[0] == 0 and path.read_text() == text


def test_a_golden_run_of_states_hashed_differently_is_reported_and_rewritten(folder: Path, golden) -> None:  # type: ignore[no-untyped-def]
    path = find_golden_path(folder / "scene.yaml")
    text = path.read_text()
    path.write_text(text.replace('{"golden": 2', '{"golden": 1', 1))
    code, out = golden("test", "a.ant")
    assert code == 1 and "another method of state hashes" in out and "--update" in out and "differs" not in out, out
    assert golden("test", "a.ant", "--update")[0] == 0 and path.read_text() == text


CHANGES = [
    # one agent, one attribute, at once
    ("luck = uniform(0, 1)", "luck = if id == 7 then 0.25 else uniform(0, 1)", 11, ["`a.luck` of a 7 is 0.25, was "]),
    # one agent from a moment on
    ("deposit scent 1 /s", "deposit scent (if id == 1 and time > 1 s then 2 /s else 1 /s)", 25, ["differs golden"]),
    ("param pace  = 20", "param pace  = 21", 11, ["`a.pace` is 21, was 20", "`a.max_speed` of a 0, 1, 2"]),
    ("state rest {", "state rest { load += 0.5 /s;", 22, ["`a.load` of a "]),
]


@pytest.mark.parametrize(("old", "new", "frame", "expected"), CHANGES)
def test_the_first_difference_is_named(folder: Path, golden, old: str, new: str, frame: int, expected: list[str]) -> None:  # type: ignore[no-untyped-def]
    change(folder, old, new)
    code, text = golden("test", "a.ant", "-q")
    assert code == 1 and "1 golden run differs" in text and "--update" in text
    assert f"differs golden run of scene.yaml, seed 5: first at frame {frame}" in text, text
    for words in expected:
        assert words in text, text


def test_different_agents_are_not_compared(folder: Path, golden) -> None:  # type: ignore[no-untyped-def]
    scene = folder / "scene.yaml"
    assert "count: 20" in scene.read_text()
    scene.write_text(scene.read_text().replace("count: 20", "count: 21"))
    change(folder, "count(a) == 20", "count(a) == 21")
    code, text = golden("test", "a.ant", "-q")
    assert code == 1 and "`a` is 21 agents, was others" in text, text
    assert "`a.mass`" not in text and "of a 20" not in text, text


def test_a_golden_run_is_not_made_of_a_failure_and_damage_is_reported(folder: Path, golden) -> None:  # type: ignore[no-untyped-def]
    path = find_golden_path(folder / "scene.yaml")
    old_text = path.read_text()
    change(folder, "count(a) == 20", "count(a) == 21")
    code, text = golden("test", "a.ant", "--update", "--no-keep")
    assert code == 1 and "not written, because its specs failed" in text and path.read_text() == old_text
    change(folder, "count(a) == 21", "count(a) == 20")
    path.write_text(old_text.replace('"hash"', '"hush"'))
    code, text = golden("test", "a.ant")
    assert code == 1 and "`scene.golden.json` is damaged" in text and "--update" in text
    assert golden("test", "a.ant", "--update")[0] == 0 and path.read_text() == old_text
    path.write_text(old_text.replace('"numpy": "', '"numpy": "0.'))
    assert golden("test", "a.ant")[0] == 0  # the same bits, wherever they come from
    change(folder, "param pace  = 20", "param pace  = 21")
    assert "it was made with antdsl " in golden("test", "a.ant")[1]
    (folder / "scene.yaml").write_text(SCENE.replace("11..90", "21..90"))
    assert "the run starts at frame 21, but it started at frame 11" in golden("test", "a.ant")[1]


def test_junit_contains_golden_runs_and_allowed_failures(folder: Path, golden) -> None:  # type: ignore[no-untyped-def]
    junitparser = pytest.importorskip("junitparser")
    change(folder, "param pace  = 20", "param pace  = 21")
    lucky = 'spec "lucky" on "scene.yaml" { for 0.1 s; seeds 1 .. 4; pass 1 %; each a { always: luck < 0.93 } }\n'
    (folder / "a.ant").write_text((folder / "a.ant").read_text() + lucky)
    code, text = golden("test", "a.ant", "--no-keep", "--junit", "out.xml", "--json", "out.json")
    document = json.loads((folder / "out.json").read_text())
    allowed = [case for case in document["specs"] if case["outcome"] == "allowed"]
    assert code == 1 and 0 < len(allowed) < 4 and f"{len(allowed)} allowed to fail" in text
    assert f'"lucky": {4 - len(allowed)} of 4 seeds passed, enough for 1 %' in text
    (result,) = document["golden"]
    assert (result["outcome"], result["frame"]) == ("differs", 11) and result["differences"][0]["now"] == "21"
    suites = {suite.name: suite for suite in junitparser.JUnitXml.fromfile(str(folder / "out.xml"))}
    assert suites["golden runs"].failures == 1 and suites["a.ant"].skipped == len(allowed) and suites["a.ant"].failures == 0


def test_coverage_counts_a_run_of_one_frame(folder: Path, run) -> None:  # type: ignore[no-untyped-def]
    scene = folder / "scene.yaml"
    scene.write_text(re.sub("preroll: [0-9]+", "preroll: 0", scene.read_text()))
    (folder / "a.ant").write_text(PROGRAM + 'spec "soon over" on "scene.yaml" { for 2 s; never: count(a) == 20 }\n')
    code, text = run("test", "a.ant", "--coverage", "--no-keep")
    assert code == 1 and re.search(r"^ *20 +a\.go$", text, re.MULTILINE), text


def test_coverage_is_listed_and_bounded(folder: Path, run) -> None:  # type: ignore[no-untyped-def]
    code, text = run("test", "a.ant", "-k", "there", "--coverage", "--fail-under", "60")
    lines = [line.strip() for line in text.splitlines()]
    assert code == 0 and any(re.fullmatch(r"[0-9,]+ +a\.go", line) for line in lines)
    assert "0    a.rest -> go" in lines
    code, text = run("test", "a.ant", "-k", "there", "--fail-under", "100")
    assert code == 1 and "83.33 % of states and transitions were reached, less than 100 %" in text
    assert run("test", "a.ant", "--fail-under", "101")[0] == 2
