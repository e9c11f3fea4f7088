"""`antdsl plan`: what it prints of programs and scenes, as array passes and as machine code."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import commands
import pytest
from compilers import need_llvmlite

from antdsl.machine_code import llvm_compiler
from antdsl.pipeline import open_scene
from antdsl.plan import format_plan
from antdsl.runtime.backends.native import program_listing
from antdsl.runtime.backends.native.programs import WorldFacts

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def plan(*words: str, cwd: Path = EXAMPLES) -> str:
    result = commands.run("plan", *words, cwd=cwd)
    assert result.returncode == 0, result.stderr
    return result.stdout


def test_a_scene_has_the_plan_that_runs() -> None:
    shot, _ = open_scene(EXAMPLES / "minimal" / "scene.yaml")
    assert shot is not None
    assert plan("minimal/scene.yaml") == format_plan(shot.plan) + "\n"
    raw, _ = open_scene(EXAMPLES / "minimal" / "scene.yaml", raw=True)
    assert (
        raw is not None and plan("minimal/scene.yaml", "--raw") == format_plan(raw.plan) + "\n" != format_plan(shot.plan) + "\n"
    )


def test_listed_machine_code_is_that_of_the_scene(tmp_path: Path) -> None:
    """With level of detail another function asks rays, so that the code is another one."""
    need_llvmlite()
    shutil.copytree(EXAMPLES / "foraging", tmp_path / "far", ignore=shutil.ignore_patterns("out"))
    scene = tmp_path / "far" / "scene.yaml"
    still = plan("far/scene.yaml", "--native", cwd=tmp_path)
    assert plan("far/forager.ant", "--native", cwd=tmp_path).startswith("for static ground without `lod`")
    scene.write_text(scene.read_text(encoding="utf-8") + "lod: {near: 60 mm, far: 80 mm}\n", encoding="utf-8")
    shot, _ = open_scene(scene)
    assert shot is not None and shot.setting.level_of_detail is not None
    far_listing = plan("far/scene.yaml", "--native", cwd=tmp_path)
    assert (
        far_listing
        == program_listing.format_listing(
            program_listing.build_program(
                shot.plan, llvm_compiler.find_host_target(), WorldFacts(has_moving_ground=False, has_detail_levels=True)
            )
        )
        + "\n"
        != still
    )
    assert re.search(r"then NumPy: ray\(stones\), <steering>:\d+, 3 times\n", still)
    assert "asks for claim, forager.ant:53\n" in still


def test_the_code_option_works_alone_and_with_native() -> None:
    need_llvmlite()
    code = plan("minimal/scene.yaml", "--ir")
    assert code == plan("minimal/scene.yaml", "--native", "--ir") and "define void @" in code
    assert code.startswith(plan("minimal/scene.yaml", "--native"))


def test_the_reason_for_missing_machine_code_is_given(monkeypatch: pytest.MonkeyPatch) -> None:
    why = "llvmlite 0.30 is too old: install another"
    monkeypatch.setattr(llvm_compiler, "find_unavailability_reason", lambda: why)
    result = commands.run("plan", "minimal/scene.yaml", "--native", cwd=EXAMPLES)
    assert result.returncode == 1 and result.stderr.startswith("error: ") and why in result.stderr
