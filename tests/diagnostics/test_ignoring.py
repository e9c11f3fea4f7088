"""Comments that ignore a warning: which they take away, and what is said about one that takes nothing or gives no reason."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from antdsl.checking import check_files
from antdsl.diagnostics import Report
from antdsl.diagnostics.codes import CODE_DESCRIPTIONS, MESH_CODES, RUN_CODES, STRICT_CODES
from antdsl.diagnostics.ignore_comments import apply_ignore_comments, find_ignore_comments, remove_ignored
from antdsl.files import find_files
from antdsl.pipeline import RunChoices, check_path
from antdsl.source import Source

ROOT = Path(__file__).resolve().parents[2]
TEXT = """ant 1
species walker {
  {above}
  energy = 0 {beside}
  start idle
  state idle { energy += 1 /s; when after 1 s -> rest }
  state rest { steer heading; when after 1 s -> idle }
}
"""


def check_text(tmp_path: Path, above: str = "", beside: str = "", strict: bool = False) -> list[tuple[str, str]]:
    path = tmp_path / "walker.ant"
    path.write_text(TEXT.replace("{above}", above).replace("{beside}", beside))
    _, report = check_path(path, strict=strict)
    source = Source(str(path), path.read_text())
    return [(d.code, d.help or "") for d in apply_ignore_comments(report, [source], strict=strict).diagnostics]


def test_without_a_comment_the_warning_is_given(tmp_path: Path) -> None:
    assert [code for code, _ in check_text(tmp_path)] == ["unread-attribute"]


@pytest.mark.parametrize(
    ("above", "beside"),
    [
        ("# antdsl: ignore[unread-attribute] the renderer reads it", ""),
        ("# antdsl: ignore[unread-attribute] the renderer reads it\n\n  # and another comment", ""),
        ("", "# antdsl: ignore[unread-attribute] the renderer reads it"),
        ("", "#antdsl:ignore[ unread-attribute ]   the renderer reads it"),
    ],
)
def test_a_comment_with_a_reason_removes_the_warning(tmp_path: Path, above: str, beside: str) -> None:
    assert check_text(tmp_path, above, beside) == []


def test_a_comment_without_a_reason_is_a_finding_itself(tmp_path: Path) -> None:
    assert [code for code, _ in check_text(tmp_path, beside="# antdsl: ignore[unread-attribute]")] == ["ignore-without-reason"]


def test_a_comment_that_ignores_nothing_is_a_finding_itself(tmp_path: Path) -> None:
    assert [code for code, _ in check_text(tmp_path, above="# antdsl: ignore[unread-attribute, flicker] both")] == [
        "ignored-nothing"
    ]
    findings = check_text(tmp_path, beside="# antdsl: ignore[unraed-attribute] the renderer reads it")
    assert ("ignored-nothing", "did you mean `unread-attribute`?") in findings and len(findings) == 2
    assert {code for code, _ in check_text(tmp_path, beside="# antdsl: ignore[] why not")} == {
        "ignored-nothing",
        "unread-attribute",
    }


def test_only_warnings_are_ignored(tmp_path: Path) -> None:
    path = tmp_path / "walker.ant"
    path.write_text("ant 1\nspecies a { state s { steer headin } }  # antdsl: ignore[unknown-name] no\n")
    _, report = check_path(path)
    assert [d.code for d in remove_ignored(report).errors] == ["unknown-name"]


def test_comments_for_strict_findings_are_not_unused_without_strict(tmp_path: Path) -> None:
    path = tmp_path / "a.ant"
    comment = "# antdsl: ignore[per-step] a port of an old shot"
    path.write_text(f"ant 1\nspecies a {{ load = 0; state s {{ load += 1 /step {comment}\n when load > 3 -> s }} }}\n")
    for strict in (False, True):
        _, report = check_path(path, strict=strict)
        left = apply_ignore_comments(report, [Source(str(path), path.read_text())], strict=strict)
        assert left.diagnostics == [] and len(report.diagnostics) == strict


def test_text_in_quotes_is_no_comment() -> None:
    assert list(find_ignore_comments(Source("a.ant", 'x "# antdsl: ignore[flicker] why"\n'))) == []
    (one,) = find_ignore_comments(Source("a.ant", 'x "a # b" # antdsl: ignore[flicker, trap] why\n'))
    assert (one.line, [code for code, _ in one.codes], one.reason) == (1, ["flicker", "trap"], "why")


def test_the_command_ignores_and_takes_patterns(tmp_path: Path) -> None:
    check_text(tmp_path, beside="# antdsl: ignore[unread-attribute] the renderer reads it")
    (tmp_path / "shots" / "deep").mkdir(parents=True)
    (tmp_path / "shots" / "deep" / "b.ant").write_text("ant 1\nspecies a { state s { steer headin } }\n")
    command = [sys.executable, "-m", "antdsl", "check", "--strict", "--format", "json"]
    result = subprocess.run([*command, "*.ant"], cwd=tmp_path, env={"PYTHONPATH": str(ROOT)}, capture_output=True, text=True)
    assert (result.returncode, json.loads(result.stdout)["diagnostics"]) == (0, []), result.stderr
    result = subprocess.run([*command, "**/*.ant"], cwd=tmp_path, env={"PYTHONPATH": str(ROOT)}, capture_output=True, text=True)
    assert result.returncode == 1 and [d["code"] for d in json.loads(result.stdout)["diagnostics"]] == ["unknown-name"]


def test_a_pattern_that_matches_nothing_is_reported(tmp_path: Path) -> None:
    (tmp_path / "[odd].ant").write_text("ant 1\n")
    files, report = find_files([tmp_path / "[odd].ant"])  # a name that is there is no pattern
    assert len(files) == 1 and report.ok
    files, report = find_files([tmp_path / "*.yaml"])
    assert files == [] and [d.code for d in report.errors] == ["no-such-file"]


def test_a_folder_does_not_choose_files_outside_it(tmp_path: Path) -> None:
    folder = tmp_path / "project"
    (folder / "shared").mkdir(parents=True)
    for place in (tmp_path / "other.ant", folder / "shared" / "near.ant"):
        place.write_text("ant 2\n")
    (folder / "far.ant").symlink_to(tmp_path / "other.ant")
    (folder / "near.ant").symlink_to(folder / "shared" / "near.ant")
    assert [path.relative_to(folder).as_posix() for path in find_files([folder])[0]] == ["near.ant", "shared/near.ant"]
    assert find_files([folder / "far.ant"])[0] == [folder / "far.ant"]  # named by the user


def test_unused_comments_are_not_reported_in_files_with_errors(tmp_path: Path) -> None:
    """What it ignores is not looked for then."""
    findings = check_text(tmp_path, beside="# antdsl: ignore[unread-attribute] kept for later")
    assert findings == []
    file = next(tmp_path.glob("*.ant"))
    file.write_text(file.read_text().replace("ant 1\n", "ant 1\nuse stearing\n"))
    report = check_path(file)[1]
    said = apply_ignore_comments(report, [Source(str(file), file.read_text())])
    assert [d.code for d in said.diagnostics] == ["unknown-library"]


def test_unchecked_codes_are_not_reported_as_unused(tmp_path: Path) -> None:
    """Only a run finds `no-room`, and an editor reads no meshes."""
    source = Source("scene.yaml", "antdsl: 1  # antdsl: ignore[no-room, far-away, flicker] all three are meant\n")
    for meshes, idle in ((True, ["far-away", "flicker"]), (False, ["flicker"])):
        findings = apply_ignore_comments(Report(), [source], meshes_checked=meshes).diagnostics
        assert [(d.code, d.message.split("`")[1]) for d in findings] == [("ignored-nothing", code) for code in idle]
    assert CODE_DESCRIPTIONS.keys() >= STRICT_CODES | MESH_CODES | RUN_CODES


def test_a_scene_that_writes_an_attribute_reads_it(tmp_path: Path) -> None:
    check_text(tmp_path)
    program = tmp_path / "walker.ant"
    scene = "antdsl: 1\ncrowd: [{species: walker, from: walker.ant, count: 1}]\n"
    (tmp_path / "plain.yaml").write_text(scene)
    assert [d.code for d in check_path(tmp_path / "plain.yaml")[1].diagnostics] == ["unread-attribute"]
    (tmp_path / "written.yaml").write_text(scene + "output: {attributes: [P, energy]}\n")
    assert check_path(tmp_path / "written.yaml")[1].diagnostics == []
    files, report = find_files([tmp_path])
    checked = check_files(files, RunChoices())
    for file in files:
        report.extend(checked.reports[file])
    assert len(files) == 3 and report.diagnostics == []
    # the comment is needed where the program is checked alone, so no message says that it ignores nothing
    assert check_text(tmp_path, beside="# antdsl: ignore[unread-attribute] the renderer reads it") == []
    report = check_path(tmp_path / "written.yaml")[1]
    assert apply_ignore_comments(report, [Source(str(program), program.read_text())]).diagnostics == []
