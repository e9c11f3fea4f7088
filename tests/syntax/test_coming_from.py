"""The five behaviours of `docs/coming_from.md`: ours together are one program, simulated and judged by its spec."""

from __future__ import annotations

import re
from pathlib import Path

import commands
import pytest

from antdsl.cli.commands.new import build_ground_ply

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "coming_from.md").read_text(encoding="utf-8")
HEAD = "ant 1\nuse steering\n\nworld { surface ground; items food { load = 0 }; items nest { load = 0 } }\n\n"
SCENE = """antdsl: 1
units: mm
fps: {fps}
frames: 1..250
seed: 3
world:
  ground: {{mesh: ground.ply}}
  food: {{apple: {{at: [40, 0, 20], load: 400}}, donut: {{at: [-30, 0, 35], load: 400}}}}
  nest: {{home: {{at: [0, 0, 0]}}}}
crowd:
  - {{species: stroller, from: five.ant, count: 5, place: {{on: ground, radius: 60 mm}}}}
  - {{species: mouse, from: five.ant, count: 5, place: {{on: ground, around: food, radius: 20 mm}}}}
  - {{species: cat, from: five.ant, count: 1, place: {{on: ground, around: nest, radius: 5 mm}}}}
  - {{species: boid, from: five.ant, count: 25, place: {{on: ground, radius: 30 mm}}}}
  - {{species: guide, from: five.ant, count: 10, place: {{on: ground, radius: 60 mm}}}}
  - {{species: follower, from: five.ant, count: 30, place: {{on: ground, radius: 40 mm}}}}
  - {{species: forager, from: five.ant, count: 30, place: {{on: ground, radius: 40 mm}}}}
"""


@pytest.mark.parametrize("fps", [24, pytest.param(30, marks=pytest.mark.slow)])
def test_ported_behaviours_do_not_depend_on_the_frame_rate(tmp_path: Path, fps: int) -> None:
    blocks = re.findall(r"```ant fragment-of-(?:file|page)\n(.*?)```", PAGE, re.DOTALL)
    assert len(blocks) == 6
    (tmp_path / "five.ant").write_text(HEAD + "\n".join(blocks), encoding="utf-8")
    (tmp_path / "scene.yaml").write_text(SCENE.format(fps=fps), encoding="utf-8")
    (tmp_path / "ground.ply").write_bytes(build_ground_ply())
    process = commands.run("test", "five.ant", cwd=tmp_path)
    assert process.returncode == 0 and "1 passed" in process.stdout, process.stdout + process.stderr


def test_each_behaviour_is_there_in_each_language() -> None:
    for part in re.split(r"^## (?=\d)", PAGE, flags=re.M)[1:]:
        part = part.partition("\n## ")[0]
        assert re.findall(r"^```(\w+)", part, re.M) == ["ant", "netlogo", "gaml", "vex"], part[:30]
        assert "\nHoudini" in part
