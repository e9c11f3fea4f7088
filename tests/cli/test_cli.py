"""The command line as people meet it: words, exit codes, machine formats, and never a traceback."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import commands
import pytest
from children import child_environment

from antdsl.cli import _run_without_warnings as run_in_process

ROOT = Path(__file__).resolve().parents[2]
GOOD = """ant 1
use steering
species walker {
  max_speed 25 mm/s
  start stroll
  state stroll amber { steer wander() }
  layers { state }
}
"""
SCENE = "antdsl: 1\nframes: 1..4\ncrowd: [{species: walker, from: walker.ant, count: 5, place: {radius: 60 mm}}]\n"


def antdsl(*words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    result = commands.run(*words, cwd=cwd)
    assert "Traceback" not in result.stderr + result.stdout, result.stderr[-800:]
    return result


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "walker.ant").write_text(GOOD)
    (tmp_path / "scene.yaml").write_text(SCENE)
    return tmp_path


def test_check_finds_programs_and_scenes_in_folders(folder: Path) -> None:
    (folder / "sub").mkdir()
    (folder / "sub" / "bad.ant").write_text(GOOD.replace("wander", "wonder"))
    (folder / "other.yaml").write_text("recipe: soup\n")
    (folder / ".git").mkdir()
    (folder / ".git" / "x.ant").write_text("nonsense {")
    (folder / "loop").symlink_to(folder)
    result = antdsl("check", ".", cwd=folder)
    assert result.returncode == 1
    assert "error[unknown-behaviour]: no behaviour `wonder`" in result.stdout and "sub/bad.ant:6:30" in result.stdout
    assert "nonsense" not in result.stdout and "soup" not in result.stdout
    assert antdsl("check", "walker.ant", "scene.yaml", cwd=folder).stdout == "checked 2 files, no findings\n"


@pytest.mark.parametrize("format", ["full", "concise", "json", "sarif", "github", "junit"])
def test_formats_are_written_with_and_without_findings(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], format: str
) -> None:
    (folder / "bad.ant").write_text(GOOD.replace("25 mm/s", "25 s"))
    monkeypatch.chdir(folder)
    for name, code in (("walker.ant", 0), ("bad.ant", 1)):
        monkeypatch.setattr(sys, "argv", ["antdsl", "check", name, "--format", format])
        assert run_in_process() == code
        printed = capfd.readouterr().out
        if format in ("json", "sarif"):
            json.loads(printed)
        assert ("wrong-unit" in printed or "units" in printed) == (code == 1), printed


def test_a_file_named_like_one_of_the_library_is_reported_by_its_own_name(folder: Path) -> None:
    (folder / "<odd").mkdir()
    for name in ("<bad>.ant", "<odd/bad.ant"):
        (folder / name).write_text(GOOD.replace("25 mm/s", "25 s"))
        assert antdsl("check", name, "--format", "concise", cwd=folder).stdout.startswith(f"{name}:4:")


def test_strict_makes_warnings_errors_and_explain_says_what_a_code_means(folder: Path) -> None:
    (folder / "walker.ant").write_text(GOOD.replace("start", 'param pace = 3 mm/s in 1 mm/s .. 9 mm/s  "unused"\n  start'))
    assert antdsl("check", "walker.ant", cwd=folder).returncode == 0
    assert antdsl("check", "walker.ant", "--strict", cwd=folder).returncode == 1
    listed = antdsl("check", "walker.ant", "--params", cwd=folder).stdout
    assert re.search(r"walker\.pace +3 +mm/s +1 \.\. 9 +unused", listed)
    assert "given twice" in antdsl("check", "--explain", "duplicate-key", cwd=folder).stdout
    wrong = antdsl("check", "--explain", "duplicate-kee", cwd=folder)
    assert wrong.returncode == 2 and "did you mean `duplicate-key`?" in wrong.stderr


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["run", "none.yaml"], 3, "there is no file `none.yaml`"),
        (["check", "none.ant"], 3, "none.ant"),
        (["check", "walker.txt"], 3, "neither a program"),
        (["run", "scene.yaml", "--frames", "9..1"], 2, "ends before it begins"),
        (["run", "scene.yaml", "--set", "pace"], 2, "NAME=VALUE"),
        (["run", "scene.yaml", "--set", "walker.pce=3mm/s"], 1, "no program has a param"),
        (["run", "scene.yaml", "--seed", "-1"], 2, "--seed"),
        (["run", "scene.yaml", "--root", "assets=none"], 2, "there is no folder"),
        (["run", "scene.yaml", "--out", "."], 3, "has files that do not belong to a cache"),
        (["run", "scene.yaml", "--out", "walker.ant"], 3, "is a file"),
        (["info", "."], 3, "is not a cache"),
        (["render", "none"], 3, "is not a cache"),
        (["march"], 2, "march"),
        (["run", "x\udcff.yaml"], 2, "`x\\xff.yaml` is not UTF-8"),
        (["export", "out/scene", "--to", "x\udcff\x1b.csv"], 2, "`x\\xff\ufffd.csv` is not UTF-8"),
    ],
)  # fmt: skip
def test_mistakes_give_a_message_and_an_exit_code(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], words: list[str], code: int, said: str
) -> None:
    monkeypatch.chdir(folder)
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setattr(sys, "argv", ["antdsl", *words])
    assert run_in_process() == code
    printed = "".join(capfd.readouterr())
    assert said in printed and "Traceback" not in printed


def test_run_prints_progress_and_info_prints_contents(folder: Path) -> None:
    result = antdsl("run", "scene.yaml", "--seed", "5", "--frames", "11..13", cwd=folder)
    assert result.returncode == 0, result.stderr
    assert re.search(r"frame 13 of 13, [0-9.]+ fps, stroll 5", result.stdout) and "the cache is in" in result.stdout
    info = antdsl("info", "out/scene", "--verify", cwd=folder).stdout
    assert "3 of 3: 11..13" in info and "seed 5" in info and "verified     3 frames" in info
    assert antdsl("run", "scene.yaml", "--quiet", cwd=folder).stdout == ""
    assert (
        antdsl("plan", "walker.ant", cwd=folder).stdout.startswith("species walker")
        or "walker" in antdsl("plan", "walker.ant", cwd=folder).stdout
    )


def test_new_makes_a_project_that_runs_and_does_not_overwrite(tmp_path: Path) -> None:
    assert antdsl("new", "ants", cwd=tmp_path).returncode == 0
    assert antdsl("check", "ants", "--strict", cwd=tmp_path).returncode == 0
    assert antdsl("run", "ants/scene.yaml", "--frames", "1..5", cwd=tmp_path).returncode == 0
    again = antdsl("new", "ants", cwd=tmp_path)
    assert again.returncode == 3 and "not empty" in again.stderr


def test_a_closed_pipe_is_no_error(folder: Path) -> None:
    for n in range(40):
        (folder / f"bad{n}.ant").write_text(GOOD.replace("wander", "wonder"))
    command = f"{sys.executable} -m antdsl check . | head -1"
    env = child_environment()
    result = subprocess.run(["bash", "-c", command], cwd=folder, env=env, capture_output=True, text=True, timeout=60)
    assert result.stdout.startswith("error") and result.stderr == ""


def test_unprintable_characters_are_replaced(folder: Path) -> None:
    (folder / "walker.ant").write_text(GOOD.replace("wander", "wänder"))
    command = [sys.executable, "-m", "antdsl", "check", "walker.ant"]
    environment = child_environment(PYTHONIOENCODING="ascii")
    result = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=60)
    assert result.stderr == ""
    assert result.returncode == 1 and "error[" in result.stdout


@pytest.mark.parametrize(("words", "most"), [(["--help"], 240), (["check", "walker.ant"], 570), (["check", "scene.yaml"], 610)])
def test_a_command_imports_only_what_it_needs(folder: Path, words: list[str], most: int) -> None:
    code = (
        "import sys; from antdsl.cli import _run_without_warnings as run;"
        " r = run(); print(r, sorted(sys.modules), file=sys.stderr)"
    )
    result = subprocess.run(
        [sys.executable, "-c", code, *words], cwd=folder, env=child_environment(), capture_output=True, text=True, timeout=300
    )
    assert result.returncode == 0 and result.stderr.startswith("0 "), result.stderr[-300:]
    loaded = set(re.findall(r"'([a-z0-9_.]+)'", result.stderr))
    assert not loaded & {"open3d", "scipy", "trimesh", "numpy", "PIL"}
    assert len(loaded) < most


def test_a_check_of_the_repository_finds_the_cases_that_are_wrong() -> None:
    result = subprocess.run(
        [sys.executable, "-m", "antdsl", "check", ".", "--format", "json"],
        cwd=ROOT, env=child_environment(), capture_output=True, text=True, timeout=600,
    )  # fmt: skip
    assert result.returncode == 1 and json.loads(result.stdout)["left_out"] > 100


def test_pictures_sheets_and_films_are_drawn(tmp_path: Path) -> None:
    from PIL import Image

    assert antdsl("new", "ants", cwd=tmp_path).returncode == 0
    assert antdsl("run", "ants/scene.yaml", "--frames", "1..6", "--out", "cache", cwd=tmp_path).returncode == 0
    small = ("--width", "96", "--height", "64")
    result = antdsl("render", "cache", "--sheet", "--every", "2", *small, cwd=tmp_path)
    assert result.stdout.split() == ["cache/pictures/sheet.png", "cache/pictures/picture.0005.png"], result.stderr
    with Image.open(tmp_path / "cache" / "pictures" / "picture.0005.png") as picture:
        assert picture.size == (96, 64) and len(picture.getcolors(96 * 64) or ()) > 100
    result = antdsl(
        "render", "cache", "--agents", "7", "--camera", "eye", "--show", "ids,velocity", "--out", "eye", *small, cwd=tmp_path
    )
    assert result.stdout.split() == ["eye/picture.0006.png"], result.stderr
    wrong = antdsl("render", "cache", "--show", "smell", *small, cwd=tmp_path)
    assert wrong.returncode == 2 and "cannot show" in wrong.stderr
    words = ("--camera", "top", "--marks", "5", "--blur", "0.5", "--legend", "none", "--out", "top", *small)
    result = antdsl("render", "cache", "--frames", "5..5", *words, cwd=tmp_path)
    assert result.stdout.split() == ["top/picture.0005.png"], result.stderr
    wrong = antdsl("render", "cache", "--full", "smell=3", *small, cwd=tmp_path)
    assert wrong.returncode == 1 and "no field `smell`" in wrong.stderr
    wrong = antdsl("render", "cache", "--full", "smell", *small, cwd=tmp_path)
    assert wrong.returncode == 2 and "trail=20" in wrong.stderr


def test_a_mistake_is_reported_once_however_the_file_is_named(folder: Path) -> None:
    (folder / "walker.ant").write_text(GOOD.replace("wander", "wonder"))
    result = antdsl("check", ".", str(folder), "--format", "concise", cwd=folder)
    assert result.returncode == 1 and result.stdout.count("unknown-behaviour") == 1


def test_strict_reports_dependence_on_the_frame_rate(folder: Path) -> None:
    porting = GOOD.replace("wander()", "wander(); size += 0.1 mm/step").replace("  start", "  size 4 mm\n  start")
    (folder / "walker.ant").write_text(porting)
    assert antdsl("check", "walker.ant", cwd=folder).returncode == 0
    result = antdsl("check", "walker.ant", "--strict", "--format", "concise", cwd=folder)
    assert result.returncode == 1 and "per-step" in result.stdout, result.stdout


def test_check_reads_meshes_through_granted_roots_without_rays(tmp_path: Path) -> None:
    assert antdsl("new", "set", cwd=tmp_path).returncode == 0
    (tmp_path / "assets").mkdir()
    (tmp_path / "set" / "ground.ply").rename(tmp_path / "assets" / "ground.ply")
    scene = tmp_path / "set" / "scene.yaml"
    scene.write_text(scene.read_text().replace("ground.ply", "'assets:ground.ply'"))
    assert "root-not-granted" in antdsl("check", "set/scene.yaml", cwd=tmp_path).stdout
    assert antdsl("check", "set/scene.yaml", "--root", "assets=assets", cwd=tmp_path).returncode == 0
    mesh = tmp_path / "assets" / "ground.ply"
    mesh.write_bytes(mesh.read_bytes()[:20_000])
    result = antdsl("check", "set/scene.yaml", "--root", "assets=assets", cwd=tmp_path)
    assert result.returncode == 1 and "error[bad-mesh]" in result.stdout and "scene.yaml:8:18" in result.stdout


def test_params_are_listed_once(tmp_path: Path) -> None:
    assert antdsl("new", "ants", cwd=tmp_path).returncode == 0
    result = antdsl("check", "ants", "--params", cwd=tmp_path)
    assert len(re.findall(r"walker\.pace +30 +mm/s +5 \.\. 100 +How fast", result.stdout)) == 1
    assert antdsl("check", "ants", "--params", "--format", "json", cwd=tmp_path).returncode == 2


def test_unreadable_files_have_the_exit_code_of_io_errors(folder: Path) -> None:
    for words in (("check", "none.ant"), ("check", "none.yaml"), ("run", "none.yaml"), ("plan", "none.ant")):
        result = antdsl(*words, cwd=folder)
        assert result.returncode == 3 and "error[" in result.stdout + result.stderr, words
    (folder / "bad.ant").write_text("ant 1\n")
    assert antdsl("check", "none.ant", "bad.ant", cwd=folder).returncode == 1


def test_wrong_use_is_reported_before_anything_is_simulated(folder: Path) -> None:
    result = antdsl("run", "walker.ant", cwd=folder)
    assert result.returncode == 2 and "is a program" in result.stderr
    result = antdsl("run", ".", cwd=folder)
    assert result.returncode == 2 and "./scene.yaml" in result.stderr
    result = antdsl("run", "scene.yaml", "--summary", "none/summary.json", cwd=folder)
    assert result.returncode == 2 and "no folder `none`" in result.stderr and not (folder / "out").exists()


def test_set_up_reports_wrong_values_and_failures(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "antdsl.bootstrap", "example", "--ouz", "x"]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert result.returncode == 2 and "--ouz" in result.stderr


def test_the_resume_command_contains_all_options_of_results() -> None:
    from antdsl.cli.commands.run import _build_resume_command

    command = _build_resume_command(
        Path("a b/scene.yaml"), Path("o"), "1..9", 0, ["x.y=1mm", "x.z=2"], None, ["lib=d"], Path("t.json"), True
    )
    words = "--frames 1..9 --seed 0 --set x.y=1mm --set x.z=2 --root lib=d --out o --summary t.json --any-memory --resume"
    assert command == f"antdsl run 'a b/scene.yaml' {words}"
    assert _build_resume_command(Path("s.yaml"), None, None, None, [], None, [], None, False) == "antdsl run s.yaml --resume"
