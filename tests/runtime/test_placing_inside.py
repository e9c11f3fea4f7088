"""`place: {inside: …}`: a crowd begins where lines from a place end, so inside what is closed, on its walls and under its lid."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from torture_long import SHAPES, Rooms

from antdsl.pipeline import RunChoices, open_scene
from antdsl.runtime import Options, World, bind, step

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "torture"


def bind_crowd(folder: Path, place: str, count: int = 300) -> World:
    """The crowd of a scene with the can and the cube of the torture example."""
    for name in ("can.ply", "cube.ply"):
        shutil.copy(EXAMPLE / name, folder)
    (folder / "ant.ant").write_text(
        "ant 1\nuse steering\nworld { surface can; surface cube; items crumb }\n"
        "species ant { size 2 mm; max_speed 20 mm/s; start roam\n"
        "  state roam { steer wander() }\n}\n"
    )
    scene = folder / "scene.yaml"
    scene.write_text(
        "antdsl: 1\nseed: 5\nworld:\n  can: {mesh: can.ply}\n  cube: {mesh: cube.ply, at: [100, 0, 0]}\n"
        "  crumb: {one: {at: [0, 20, 0]}}\n"
        f"crowd:\n  - {{species: ant, from: ant.ant, count: {count}, place: {place}}}\n"
    )
    shot, report = open_scene(scene, RunChoices())
    assert shot is not None, report.sort_by_place()
    return bind(shot.plan, shot.setting, Options())


@pytest.mark.parametrize("place", ["{inside: [0, 20, 0]}", "{inside: one, on: can}"])
def test_they_begin_inside_on_all_walls_and_stay_there(tmp_path: Path, place: str) -> None:
    world = bind_crowd(tmp_path, place)
    ants = world.populations["ant"]
    position, up = ants.position, np.stack([ants.now[f"up.{axis}"] for axis in "xyz"], axis=1)
    away = np.hypot(position[:, 0], position[:, 2])
    within = (position[:, 1] > 0) & (position[:, 1] < SHAPES.CAN) & (away < SHAPES.RIM)
    assert within.mean() > (0.9 if "on" not in place else 0.999)  # through the hole in the lid some see the sky
    positions_inside = position[within]
    assert ((np.array([0.0, 20.0, 0.0]) - positions_inside) * up[within]).sum(axis=1).min() > 0  # they face the middle
    assert (up[:, 1] > 0.9).sum() > 20 and (up[:, 1] < -0.9).sum() > 20 and (np.abs(up[:, 1]) < 0.1).sum() > 100
    for _ in range(24):
        step(world)
    assert np.isfinite(ants.position).all()


def test_more_agents_move_no_others(tmp_path: Path) -> None:
    smaller, larger = (bind_crowd(tmp_path, "{inside: [0, 20, 0]}", count).populations["ant"].position for count in (100, 150))
    assert np.array_equal(smaller, larger[:100])


def test_inside_a_cube_no_agent_is_outside_it(tmp_path: Path) -> None:
    world = bind_crowd(tmp_path, "{inside: [100, 20, 0]}")
    ants = world.populations["ant"]
    up = np.stack([ants.now[f"up.{axis}"] for axis in "xyz"], axis=1)
    vertices, faces = SHAPES.cube()
    rooms = Rooms([(vertices + np.array([100.0, 0, 0]), faces)])
    for _ in range(40):
        assert rooms.parity(ants.position + 0.01 * np.stack([ants.now[f"up.{a}"] for a in "xyz"], axis=1)).all()
        step(world)
    assert np.abs(up).max(axis=1).min() > 0.5


@pytest.mark.parametrize("other", ["radius: 5 mm", "around: one, radius: 5 mm", "density: one"])
def test_one_way_to_place_a_crowd(tmp_path: Path, other: str) -> None:
    with pytest.raises(AssertionError, match="`inside`"):
        bind_crowd(tmp_path, f"{{inside: [0, 20, 0], {other}}}")


def test_an_item_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(AssertionError, match="no item is named `two`"):
        bind_crowd(tmp_path, "{inside: two}")
