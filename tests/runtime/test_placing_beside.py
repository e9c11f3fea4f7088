"""A crowd that is to begin where there is no surface is warned of."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import meshes
import numpy as np
import pytest
from test_placing_apart import world
from test_scene_files import SCENE, folder, opened  # noqa: F401

from antdsl.outputs.surface_error import measure_surface_error
from antdsl.preview.session import PreviewSession
from antdsl.runtime import bind
from antdsl.scene.setting import CrowdData, MeshData, PlacementData, SolidData, WorldSetting
from antdsl.scene.staging.item_placement import is_away_from_surfaces

MINIMAL = Path(__file__).resolve().parents[2] / "examples" / "minimal"

PLACE = "{on: ground, around: apple, radius: 20 mm}"


@pytest.mark.parametrize(
    ("place", "beside"),
    [
        (PLACE, False),
        ("{around: [900, 0, 0], radius: 20 mm}", True),
        ("{on: ground, around: [0, 0, -900], radius: 20 mm}", True),
        ("{around: [900, 0, 0], radius: 900 mm}", False),
        ("{around: [0, 900, 0], radius: 20 mm}", False),  # it is dropped
        ("{around: [900, 0, 0], radius: 20 cm}", True),
        ("{on: ground}", False),
        ("{on: ground, around: apple, radius: 20 mm, by: area}", False),
        ("{on: ground, around: [0, 900, 0], radius: 20 mm, by: area}", True),
        ("{around: [0, 900, 0], radius: 1000 mm, by: area}", False),
        ("{on: ground, around: [0, 1.0e+9, 0], radius: 1.0e+8 mm, by: area}", True),
        ("{on: ground, around: [1.0e+9, 0, 0], radius: 20 mm}", True),
    ],
)
def test_a_disc_beside_all_surfaces(folder: Path, place: str, beside: bool) -> None:  # noqa: F811
    assert PLACE in SCENE
    shot, report = opened(folder, SCENE.replace(PLACE, place))
    assert shot is not None
    warnings = [(d.severity, d.span.text if d.span else "") for d in report.diagnostics if d.code == "off-surface"]
    assert warnings == ([("warning", place)] if beside else [])
    bound_world = bind(shot.plan, shot.setting)
    assert len(bound_world) == 5 and measure_surface_error(bound_world) < 0.01


@pytest.mark.parametrize(
    ("middle", "radius", "is_beside"), [(0, 5, True), (0, 18.9, True), (0, 21, False), (18, 3, False), (24, 3, True)]
)
def test_a_ball_inside_or_outside_of_what_is_closed(middle: float, radius: float, is_beside: bool) -> None:
    block = MeshData(*meshes.box((-20, -20, -20), (20, 20, 20)))
    place = PlacementData(surfaces=("block",), disc_centre=(middle, 0.0, 1.0), radius=float(radius), is_by_area=True)
    assert is_away_from_surfaces(place, WorldSetting(solids={"block": SolidData(block, 2.0)}), "y") == is_beside
    text = "ant 1\nuse steering\nworld { solid block }\nspecies ant { size 2 mm; state go { steer wander() } }\n"
    solids = {"block": SolidData(block, 2.0)}
    bound_world = world(CrowdData("ant", 9, place), text=text, surfaces={}, solids=solids, obstacles={}, maps={})
    assert (
        len(bound_world) == 9
        and np.abs(bound_world.solids["block"].sample_distances(bound_world.populations["ant"].position)).max() < 0.1
    )


def test_a_hole_in_the_ground_is_beside_it() -> None:
    vertices, faces = meshes.grid(100.0, 10)
    middle = vertices[faces].mean(axis=1)
    rim = MeshData(vertices, faces[np.abs(middle).max(axis=1) > 20])
    disc = PlacementData(disc_centre=(0.0, 0.0, 0.0), radius=15.0)
    assert is_away_from_surfaces(disc, WorldSetting(surfaces={"rim": rim}), "y")
    assert not is_away_from_surfaces(replace(disc, radius=25.0), WorldSetting(surfaces={"rim": rim}), "y")


def test_a_restart_tells_of_a_ball_that_meets_nothing(tmp_path: Path) -> None:
    shutil.copytree(MINIMAL, tmp_path, dirs_exist_ok=True)
    scene = tmp_path / "scene.yaml"
    session, report = PreviewSession.open(scene)
    assert session is not None, report.errors
    text = scene.read_text()
    scene.write_text(text.replace("{on: ground,", "{on: ground, around: [0, 900, 0], by: area,"))
    assert scene.read_text() != text
    outcome = session.restart()
    assert [d.code for d in outcome.report.diagnostics] == ["off-surface"] and outcome.is_successful
    session.step()


def test_an_empty_crowd_gives_no_warning(folder: Path) -> None:  # noqa: F811
    text = SCENE.replace(PLACE, "{around: [900, 0, 0], radius: 20 mm}").replace("count: 5", "count: 0")
    _, report = opened(folder, text)
    assert "off-surface" not in {d.code for d in report.diagnostics}
