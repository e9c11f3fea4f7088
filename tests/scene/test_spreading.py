"""Fields of a program held against a scene: how fast they spread at its frame rate, and whether anybody lays them."""

from __future__ import annotations

from pathlib import Path

import pytest

from antdsl.pipeline import check_path

PROGRAM = """ant 1
use steering
world { surface ground }
field scent on ground { cell 4 mm; half_life 8 s; diffuse 90 mm^2/s }
species walker { state s { steer climb(scent); DO } }
"""
SCENE = """antdsl: 1
fps: 24
world:
  ground: {mesh: ground.ply}
EXTRA
crowd: [{species: walker, from: walker.ant, count: 5, place: {on: ground}}]
"""
ROOT = Path(__file__).resolve().parents[2]


def messages_by_code(tmp_path: Path, lay: bool = True, extra: str = "", fps: int = 24) -> dict[str, str]:
    (tmp_path / "ground.ply").write_bytes((ROOT / "examples/minimal/ground.ply").read_bytes())
    (tmp_path / "walker.ant").write_text(PROGRAM.replace("DO", "deposit scent 1 /s" if lay else ""))
    scene = tmp_path / "scene.yaml"
    scene.write_text(SCENE.replace("EXTRA", extra).replace("fps: 24", f"fps: {fps}"))
    return {d.code: f"{d.span}: {d.message} | {d.help}" for d in check_path(scene)[1].diagnostics}


def test_what_cells_can_follow_is_fine(tmp_path: Path) -> None:
    assert messages_by_code(tmp_path) == {}


@pytest.mark.parametrize(("extra", "fps"), [("", 12), ("set: {scent.diffuse: 100 mm^2/s}", 24)])
def test_spreading_faster_than_the_cells_is_reported_by_check(tmp_path: Path, extra: str, fps: int) -> None:
    messages = messages_by_code(tmp_path, extra=extra, fps=fps)
    assert set(messages) == {"unstable-field"}
    assert f"write `diffuse` {4 * 4 * fps / 4:g} mm^2/s or less" in messages["unstable-field"]


def test_a_field_that_no_agent_lays_is_reported_unless_the_scene_starts_it(tmp_path: Path) -> None:
    assert set(messages_by_code(tmp_path, lay=False)) == {"unlaid-field"}
    assert messages_by_code(tmp_path, lay=False, extra="fields: {scent: {start: 1}}") == {}
