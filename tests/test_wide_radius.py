"""A radius that reaches a large crowd stops at its line before much is spent; a world is not left in the middle of a step."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from antdsl import limits
from antdsl.pipeline import open_scene
from antdsl.preview.session import Session
from antdsl.runtime import LimitStop, Options, bind, step
from antdsl.runtime.senses.neighbours import CellGrid, TooManyWithin

MINIMAL = Path(__file__).resolve().parent.parent / "examples" / "minimal"
CROWD = limits.WITHIN_RADIUS + 2
PROGRAM = """ant 1
use steering
world {{ surface ground }}
species walker {{
  param sight = {sight} in 0 mm .. 900 mm
  state stroll {{ steer wander() + separate(radius: sight) * 0.1 }}
  layers {{ state }}
}}
"""


def crowd(folder: Path, sight: str) -> Path:
    shutil.copytree(MINIMAL, folder, dirs_exist_ok=True)
    (folder / "walker.ant").write_text(PROGRAM.format(sight=sight))
    scene = folder / "scene.yaml"
    scene.write_text(scene.read_text().replace("count: 50", f"count: {CROWD}"))
    return scene


def test_a_radius_with_the_whole_crowd_in_it_stops_at_its_line(tmp_path: Path) -> None:
    shot, report = open_scene(crowd(tmp_path, "900 mm"))
    assert shot is not None, report.errors
    world = bind(shot.plan, shot.setting, Options())
    with pytest.raises(LimitStop) as stop:
        step(world)
    words = str(stop.value)
    assert "walker.ant:6:18: walker at frame 1" in words and "more than 8,192 others in its radius" in words, words


def test_a_preview_is_whole_again_after_such_a_step(tmp_path: Path) -> None:
    session, report = Session.open(crowd(tmp_path, "3 mm"))
    assert session is not None, report.errors
    session.step()
    before, frame = session.hash, session.frame
    session.set("walker.sight", "900 mm")
    session.step()
    assert session.fault is not None and "8,192" in session.fault and session.frame == frame and not session.playing
    session.set("walker.sight", "3 mm")
    assert session.hash == before
    session.step()
    assert session.fault is None and session.frame == frame + 1


def test_neighbours_are_counted_within_the_radius_and_not_in_its_cells() -> None:
    x = np.concatenate([np.zeros(30), np.full(50, 2.0)]).astype(np.float32)
    grid = CellGrid(x, np.zeros_like(x), np.zeros_like(x), np.arange(x.size), 300.0)
    # a cap of 256 is where they begin to be counted, so the crowd is repeated
    many = CellGrid(*(np.tile(a, 10) for a in (x, x * 0, x * 0)), np.arange(10 * x.size), 300.0)
    assert grid.pairs(None, 1.0, limit=10).i.size == 30 * 29 + 50 * 49
    assert many.pairs(None, 1.0, limit=499).i.size == 800 * limits.NEIGHBOURS
    with pytest.raises(TooManyWithin):
        many.pairs(None, 1.0, limit=498)
    assert many.pairs(np.arange(30), 1.0, limit=299).i.size == 30 * limits.NEIGHBOURS
