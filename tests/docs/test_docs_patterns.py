"""Recipes of docs/patterns.md and docs/specs.md that are complete: their specs are run."""

from __future__ import annotations

import re
from pathlib import Path

from commands import run

from antdsl.cli.commands.new import build_ground_ply

ROOT = Path(__file__).resolve().parents[2]


def block(page: str, heading: str, language: str) -> str:
    """The first code block of a language below a heading of a page."""
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    match = re.search(f"^```{language}[^\n]*\n(.*?)^```", text[text.index(heading) :], re.M | re.S)
    assert match is not None
    return match[1]


def test_the_last_hare_is_caught(tmp_path: Path) -> None:
    heading = "## One species hunts another\n"
    (tmp_path / "hunt.ant").write_text(block("patterns.md", heading, "ant"))
    scene = block("patterns.md", heading, "yaml scene")
    assert "count: 20," in scene
    (tmp_path / "scene.yaml").write_text(scene.replace("count: 20,", "count: 3,"))
    (tmp_path / "ground.ply").write_bytes(build_ground_ply(9, 80.0))
    result = run("test", "hunt.ant", "--no-keep", "--backend", "numpy", cwd=tmp_path)
    assert result.returncode == 0 and "changes made: 3 of 3" in result.stdout, result.stdout + result.stderr


def test_specs_can_ask_for_what_is_reachable(tmp_path: Path) -> None:
    text = block("specs.md", "test whether agents can reach", "ant").replace("for 10 s", "for 0.1 s")
    (tmp_path / "walker.ant").write_text("ant 1\nuse steering\n" + text)
    (tmp_path / "ground.ply").write_bytes(build_ground_ply(9, 80.0))
    (tmp_path / "scene.yaml").write_text(
        "antdsl: 1\nworld: {ground: {mesh: ground.ply}, homeward: {solved: [0, 0, 0], cell: 10 mm}}\n"
        "crowd: [{species: walker, from: walker.ant, count: 5}]\n"
    )
    result = run("test", "walker.ant", "--no-keep", "--backend", "numpy", cwd=tmp_path)
    assert result.returncode == 0 and "2 passed" in result.stdout, result.stdout + result.stderr
