"""Editions: defaults by edition, settings that a newer edition adds, and upgrades that keep the results to the bit."""

from __future__ import annotations

import re
import shutil
from math import inf, radians
from pathlib import Path

import pytest
from commands import run
from meaning import crowd
from sampling import sampled
from state_hashes import SCENES, frames_of, named

from antdsl import syntax
from antdsl.diagnostics import Report
from antdsl.loading import find_library
from antdsl.plan.lowering.lower import lower
from antdsl.program.checker import check
from antdsl.program.model import Program
from antdsl.program.tables.editions import EDITION_DEFAULTS, SWITCH_HELP
from antdsl.program.tables.vocabulary import BUILTIN_ATTRIBUTE_BY_NAME
from antdsl.program.upgrade import upgrade_source
from antdsl.runtime import Options, WorldSetting, bind
from antdsl.source import Source
from antdsl.syntax.editions import EDITIONS

ROOT = Path(__file__).resolve().parents[2]
_QUICK_SCENES = [each for each in SCENES if each.parent.name in ("roaches", "worth", "flow")]


def checked(text: str) -> tuple[Program, Report]:
    file, report = syntax.parse(Source("a.ant", text))
    program, findings = check(file, find_library)
    report.extend(findings)
    return program, report


def species(members: str, edition: int = 2) -> str:
    size = "" if "size " in members or "height " in members else "size 4 mm\n"
    return f"ant {edition}\nworld {{ surface ground }}\nspecies a {{\n{size}{members}\nstart s\nstate s {{ steer heading }} }}\n"


def upgraded(text: str) -> str:
    source, report = upgrade_source(Source("a.ant", text), 2)
    assert source is not None, str(report)
    result, report = syntax.format(source)
    assert result is not None, str(report)
    return result


def first_edition(text: str) -> str:
    """Return a program of edition 2 as one of edition 1, with a length instead of a height."""
    lines = [line for line in text.replace("ant 2\n", "ant 1\n", 1).splitlines() if not line.startswith("  body_")]
    return re.sub(r"(?m)^  height .*$", "  size 0.5 m", "\n".join(lines) + "\n")


@pytest.fixture(scope="session")
def examples_by_edition(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Copies of all examples in edition 1, and upgraded from there to edition 2."""
    folders = [tmp_path_factory.mktemp(name) / "examples" for name in ("old", "upgraded")]
    for folder, change in zip(folders, (first_edition, lambda text: upgraded(first_edition(text))), strict=True):
        shutil.copytree(ROOT / "examples", folder)
        for path in folder.rglob("*.ant"):
            path.write_text(change(path.read_text(encoding="utf-8").replace("\r\n", "\n")), encoding="utf-8")
    return folders[0], folders[1]


@pytest.mark.parametrize("scene", sampled(SCENES, _QUICK_SCENES), ids=named)
def test_an_upgraded_example_has_the_same_states(scene: Path, examples_by_edition: tuple[Path, Path]) -> None:
    runs = [frames_of(folder / scene.relative_to(ROOT / "examples"), 2, None) for folder in examples_by_edition]
    old, new = (list(run) for run in runs)
    assert len(old) == 3 and old == new


def test_upgrades_write_the_old_defaults_and_preserve_comments() -> None:
    text = species("  size 4 mm  # body length\n  # how fast\n  max_speed 10 mm/s  # slow", 1)
    result = upgraded(text)
    assert result.startswith("ant 2\n") and result.count("body_clearance false") == 1
    assert "# body length" in result and "max_speed      10 mm/s  # slow\n" in result
    assert upgraded(result) == result


@pytest.mark.parametrize(
    "text", ["species a { size 4 mm }", "species a { load = 0 }", "species a { size 4 mm; load = 0 }  # end"]
)
def test_upgrades_of_short_species_are_valid(text: str) -> None:
    program, report = checked(upgraded(f"ant 1\n{text}\n"))
    assert report.ok, str(report)
    assert not program.species["a"].has_body_clearance and program.species["a"].edition == 2


def test_an_upgrade_reports_names_that_become_built_in() -> None:
    source, report = upgrade_source(Source("a.ant", species("body_clearance = 1", 1)), 2)
    assert source is None
    assert [(d.code, d.span and d.span.text) for d in report.diagnostics] == [("reserved-name", "body_clearance")]


def test_a_file_without_an_edition_has_the_newest() -> None:
    text = "species a { size 4 mm }\n"
    program, report = checked(text)
    assert [d.code for d in report.diagnostics] == ["missing-edition"] and program.species["a"].edition == EDITIONS[-1]
    assert upgraded(text) == f"ant {EDITIONS[-1]}\n{text}"


def test_switches_have_the_default_of_the_edition_and_are_true_or_false() -> None:
    for members, edition, expected in (("", 1, False), ("", 2, True), ("body_clearance false", 2, False)):
        program, report = checked(species(members, edition))
        assert report.ok and program.species["a"].has_body_clearance is expected
        plan, report = lower(program)
        assert report.ok and plan.species["a"].has_body_clearance is expected
        assert not any("body_clearance" in register for register in plan.species["a"].registers)


@pytest.mark.parametrize(
    ("members", "edition", "code", "place", "advice"),
    [
        ("body_clearance true", 1, "unknown-property", "body_clearance", "antdsl fmt --edition 2"),
        ("body_clearance 3 mm", 2, "wrong-kind", "3 mm", ""),
        ("body_clearance id == 3", 2, "wrong-rate", "id == 3", "`body_clearance true`"),
        ("max_turn none of a", 2, "wrong-kind", "none of a", ""),
        ("size none", 2, "none-of-what", "none", ""),
    ],
)
def test_wrong_settings_are_reported_with_the_text_to_write(
    members: str, edition: int, code: str, place: str, advice: str
) -> None:
    _, report = checked(species(members, edition))
    assert [(d.code, d.span and d.span.text) for d in report.diagnostics] == [(code, place)], str(report)
    assert advice in (report.diagnostics[0].help or "")


def test_none_is_no_limit() -> None:
    program, report = checked(species("max_turn none", 2))
    assert report.ok
    (attribute,) = (each for each in program.species["a"].attributes if each.name == "max_turn")
    assert attribute.default.number == inf  # type: ignore[attr-defined]


def test_the_rows_are_settings_with_a_default_for_each_edition() -> None:
    for row in EDITION_DEFAULTS:
        assert row.setting in BUILTIN_ATTRIBUTE_BY_NAME or row.setting in SWITCH_HELP
        assert len(row.defaults) == len(EDITIONS) and row.reason
    assert SWITCH_HELP.keys() <= {row.setting for row in EDITION_DEFAULTS}


def test_the_page_has_the_table_of_editions() -> None:
    page = (ROOT / "docs" / "editions.md").read_text(encoding="utf-8")
    for row in EDITION_DEFAULTS:
        values = " | ".join(f"`{each}`" if each else "none" for each in row.defaults)
        assert f"| `{row.setting}` | {values} | {row.reason} |\n" in page


def test_the_default_turn_limit_is_a_right_angle_per_body_length() -> None:
    for members, edition, expected in (
        ("size 4 mm; max_speed 30 mm/s", 1, inf),
        ("size 4 mm; max_speed 30 mm/s; max_turn none", 2, inf),
        ("size 4 mm; max_speed 60 mm/s", 2, radians(1350)),
        ("size 4 mm; max_speed 3 mm/s", 2, radians(600)),
        ("size 4 mm; max_speed 3 mm/s; max_turn 90 deg/s", 2, radians(90)),
    ):
        program, report = checked(species(members, edition))
        assert report.ok, str(report)
        plan, report = lower(program)
        assert report.ok, str(report)
        world = bind(plan, WorldSetting(crowds=(crowd(2),)), Options(backend="reference"))
        assert world.populations["a"].now["max_turn"] == pytest.approx([expected] * 2, rel=1e-6)


def test_the_command_lists_settings_with_their_values_and_origins(tmp_path: Path) -> None:
    (tmp_path / "a.ant").write_text(species("height 1.7 m\nmax_slope 30 deg"))
    lines = [line.split(maxsplit=1) for line in run("check", "a.ant", "--params", cwd=tmp_path).stdout.splitlines()]
    table = {words[0]: re.split(r"  +", words[1]) for words in lines if words and words[0].startswith("a.") and len(words) == 2}
    assert table == {
        "a.height": ["1.7 m", "line 4"],
        "a.body_clearance": ["false", "edition 2"],
        "a.body_contacts": ["true", "edition 2"],
        "a.max_turn": ["max(90 deg * max_speed / size, 600 deg/s)", "edition 2"],
        "a.upright": ["100 %", "edition 2"],
        "a.max_slope": ["30 deg", "line 5"],
    }


@pytest.mark.parametrize(("number", "code"), [("1", 0), ("2", 0), ("7", 2)])
def test_fmt_takes_known_editions_and_never_goes_back(tmp_path: Path, number: str, code: int) -> None:
    text = upgraded(species("", 1))
    (tmp_path / "a.ant").write_text(text)
    result = run("fmt", "a.ant", "--edition", number, cwd=tmp_path)
    assert result.returncode == code and (tmp_path / "a.ant").read_text() == text
    assert code == 0 or "no edition 7" in result.stderr
