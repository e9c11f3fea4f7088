"""A radius that reaches a large crowd stops at its line before much is spent; a world is not left in the middle of a step."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from test_program import checked

from antdsl import limits
from antdsl.pipeline import open_scene
from antdsl.preview.session import PreviewSession
from antdsl.runtime import LimitStop, Options, World, bind, state_hash, step
from antdsl.senses.neighbours import CellGrid, TooManyNeighboursError

MINIMAL = Path(__file__).resolve().parents[2] / "examples" / "minimal"
CROWD = limits.MAX_CANDIDATES_IN_RADIUS + 2
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
    assert (
        "walker.ant:6:35: walker at frame 1: `separate(radius: sight)" in words
        and "more than 8,192 neighbours in its radius" in words
    ), words


def test_a_preview_is_whole_again_after_such_a_step(tmp_path: Path) -> None:
    session, report = PreviewSession.open(crowd(tmp_path, "3 mm"))
    assert session is not None, report.errors
    session.step()
    initial_hash, frame = session.state_hash, session.frame
    session.set_value("walker.sight", "900 mm")
    session.step()
    assert session.fault_text is not None and "8,192" in session.fault_text and session.frame == frame and not session.playing
    session.set_value("walker.sight", "3 mm")
    assert session.state_hash == initial_hash
    session.step()
    assert session.fault_text is None and session.frame == frame + 1


def test_neighbours_are_counted_within_the_radius_and_not_in_its_cells() -> None:
    x = np.concatenate([np.zeros(30), np.full(50, 2.0)]).astype(np.float32)
    grid = CellGrid(x, np.zeros_like(x), np.zeros_like(x), np.arange(x.size), 300.0)
    # a cap of 256 is where they begin to be counted, so the crowd is repeated
    many = CellGrid(*(np.tile(a, 10) for a in (x, x * 0, x * 0)), np.arange(10 * x.size), 300.0)
    assert grid.find_pairs(None, 1.0, limit=10).i.size == 30 * 29 + 50 * 49
    assert many.find_pairs(None, 1.0, limit=499).i.size == 800 * limits.MAX_QUERY_NEIGHBOURS
    with pytest.raises(TooManyNeighboursError):
        many.find_pairs(None, 1.0, limit=498)
    assert many.find_pairs(np.arange(30), 1.0, limit=299).i.size == 30 * limits.MAX_QUERY_NEIGHBOURS


FEW, ENOUGH = 400, 300  # agents, and what the limit is lowered to: still more than count
ASKING = """ant 1
use steering
world {{ surface ground }}
species walker {{
  seen = 0 mm
  let far = {query}
  start stroll
  state stroll {{ steer wander(); seen += 1 mm/s; when far -> rest }}
  state rest {{ steer halt(); when after 2 step -> stroll }}
  layers {{ state }}
}}
"""


def asking(folder: Path, expression: str, place: str = "{on: ground}") -> World:
    shutil.copytree(MINIMAL, folder, dirs_exist_ok=True)
    (folder / "walker.ant").write_text(ASKING.format(query=expression))
    scene = folder / "scene.yaml"
    scene.write_text(re.sub("count: 50, place: {.*?}", f"count: {FEW}, place: {place}", scene.read_text()))
    shot, report = open_scene(scene)
    assert shot is not None, report.errors
    return bind(shot.plan, shot.setting, Options())


@pytest.mark.parametrize(
    "query",
    [
        "distance(nearest(walker, within: 900 m)) > 6 mm",
        "distance(nearest(walker, with: time_in_state > 0.1 s, within: 900 m)) > 9 mm",
        "distance(nearest(neighbours(900 m, 40 deg))) > 20 mm",
    ],
)
def test_the_nearest_one_is_found_however_many_are_within(tmp_path: Path, query: str, monkeypatch: pytest.MonkeyPatch) -> None:
    hashes = []
    for limit in (limits.MAX_CANDIDATES_IN_RADIUS, ENOUGH):
        monkeypatch.setattr(limits, "MAX_CANDIDATES_IN_RADIUS", limit)
        world = asking(tmp_path, query)
        for _ in range(6):
            step(world)
        hashes.append(state_hash(world))
    assert hashes[0] == hashes[1] and world.transitions


@pytest.mark.parametrize(
    ("query", "place", "marked", "advice"),
    [
        (
            "count(neighbours(900 m)) > 5",
            "{on: ground}",
            "count(neighbours(900 m))",
            "neighbours in its radius, of which it uses only the 256 nearest",
        ),
        ("count(all(walker, within: 900 m)) > 5", "{on: ground}", "count(all(walker, within: 900 m))", "write a smaller radius"),
        (
            "count(neighbours(30 mm)) > 5",
            "{on: ground, radius: 10 mm}",
            "count(neighbours(30 mm))",
            "the agents overlap: place them farther apart, or write a smaller radius",
        ),
    ],
)
def test_what_is_refused_is_marked_itself(
    tmp_path: Path, query: str, place: str, marked: str, advice: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(limits, "MAX_CANDIDATES_IN_RADIUS", ENOUGH)
    with pytest.raises(LimitStop) as stop:
        step(asking(tmp_path, query, place))
    fault = stop.value.fault
    assert fault.span is not None and fault.span.text == fault.value_name == marked and advice in fault.reason


@pytest.mark.parametrize(
    ("query", "marked"),
    [
        ("count(all(walker, within: 900 m)) > 5", ["900 m"]),
        ("distance(nearest(walker, with: speed > 1 mm/s, within: 900 m)) > 5 mm", ["900 m"]),
        ("distance(nearest(walker, within: 900 m)) > 5 mm", []),
        ("distance(nearest(home, within: 900 m)) > 5 mm", []),
        ("count(neighbours(sight)) > 5", ["sight"]),
        ("count(neighbours(reach)) > 5", ["sight"]),
        ("count(neighbours(near)) > 5", []),
    ],
)
def test_a_check_tells_of_every_radius_that_reaches_all(query: str, marked: list[str]) -> None:
    declarations = "param sight = 900 m in 0 m .. 900 m\n  param near = 9 mm in 0 m .. 900 m\n  let reach = sight\n  let far ="
    text = ASKING.format(query=query).replace("let far =", declarations).replace("surface ground", "surface ground; items home")
    _, report = checked(text)
    assert [d.span.text for d in report.diagnostics if d.code == "wide-radius" and d.span is not None] == marked


@pytest.mark.parametrize(
    ("member", "count"), [("height normal(1.7 m, 60 mm)", 0), ("size normal(4 mm, 1 mm)", 1), ("height 2 mm", 1)]
)
def test_a_radius_is_wide_relative_to_the_size_or_height_of_a_body(member: str, count: int) -> None:
    program = PROGRAM.format(sight="5 m").replace("ant 1", "ant 2").replace("0 mm .. 900 mm", f"0 m .. 9 m\n  {member}")
    assert [d.code for d in checked(program)[1].diagnostics] == ["wide-radius"] * count
