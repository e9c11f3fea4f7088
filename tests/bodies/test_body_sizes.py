"""Sizes of species by their bodies: `height`, collision sizes from the idle clip, warnings of numbers that differ."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from antdsl.bodies.agents.body_extents import compute_standing_box
from antdsl.bodies.agents.definition import Definition
from antdsl.bodies.crowd_bodies import compute_collision_size
from antdsl.bodies.library import load_library_body
from antdsl.bodies.posed_body import find_base_layer
from antdsl.diagnostics import Report
from antdsl.pipeline import Shot, open_scene
from antdsl.runtime import Options, World, bind, step

FLOOR = "v -9 0 -9\nv -9 0 9\nv 9 0 9\nv 9 0 -9\nf 1 2 3 4\n"


def opened(
    folder: Path, members: str, edition: int = 2, body: str = "person", name: str = "walker"
) -> tuple[Shot | None, Report]:
    (folder / "floor.obj").write_text(FLOOR)
    (folder / "a.ant").write_text(
        f"ant {edition}\nworld {{ surface ground }}\nspecies {name} {{ {members}; start s; state s {{ steer heading }} }}\n"
    )
    crowd = f"crowd: [{{species: {name}, from: a.ant, count: 40, body: {body}}}]"
    (folder / "scene.yaml").write_text(f"antdsl: 1\nunits: m\ncontacts: hard\nworld: {{ground: {{mesh: floor.obj}}}}\n{crowd}\n")
    return open_scene(folder / "scene.yaml")


def bound_world(folder: Path, members: str, **options: str) -> World:
    shot, report = opened(folder, members, **options)  # type: ignore[arg-type]
    assert shot is not None and not report.diagnostics, str(report)
    return bind(shot.plan, shot.setting, Options())


def spread_arms(body: Definition, degrees: float) -> Definition:
    """The body with both arms raised sideways in its rest pose, and an idle clip of the former rest pose."""
    rest = body.rig.rest_matrices.copy()
    local = {name: rest[body.rig.find_joint(name)].copy() for name in ("arm_l", "arm_r")}
    for name, sign in (("arm_l", -1.0), ("arm_r", 1.0)):
        c, s = np.cos(np.radians(degrees)), sign * np.sin(np.radians(degrees))
        rest[body.rig.find_joint(name)][:3, :3] = np.array([[1, 0, 0], [0, c, s], [0, -s, c]]) @ local[name][:3, :3]
    return replace(body, rig=replace(body.rig, rest_matrices=rest))


def test_the_collision_size_comes_from_the_idle_clip_and_not_from_a_rest_pose_with_spread_arms() -> None:
    body = load_library_body("person")
    spread = spread_arms(body, 80)
    assert compute_collision_size(spread).width > 1.8 * compute_collision_size(body).width
    assert compute_collision_size(spread, is_standing=True).width == pytest.approx(
        compute_collision_size(body, is_standing=True).width, rel=1e-3
    )


def test_without_an_idle_clip_the_rest_pose_counts() -> None:
    body = replace(load_library_body("person"), idle="")
    low, high = compute_standing_box(body, find_base_layer(body))
    assert high[1] - low[1] == pytest.approx(1.77 / 0.5, rel=0.02)
    assert compute_collision_size(body, is_standing=True) == compute_collision_size(body)


def test_a_body_is_as_tall_as_its_species_says(tmp_path: Path) -> None:
    world = bound_world(tmp_path, "height normal(1.72 m, 70 mm)")
    now = world.populations["walker"].now
    low, high = compute_standing_box(load_library_body("person"), find_base_layer(load_library_body("person")))
    assert now["size"] * (high[1] - low[1]) == pytest.approx(now["height"], rel=1e-6)
    assert 1500 < now["height"].min() < now["height"].max() < 1950 and np.ptp(now["height"]) > 50
    assert now["radius"] == pytest.approx(now["size"] * 0.42, rel=1e-6)
    assert np.degrees(now["max_slope"]) == pytest.approx([40] * 40, rel=1e-6) and (now["upright"] == 1).all()
    for _ in range(3):
        step(world)
    assert (world.populations["walker"].read_vector("up")[:, 1] == 1).all()


def test_a_body_from_a_file_gives_its_own_proportions(tmp_path: Path) -> None:
    source = Path(__file__).resolve().parents[2] / "examples" / "walker"
    for path in (source / "walker.json", source / "parts.glb"):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    now = bound_world(tmp_path, "height 1.75 m", body="walker.json").populations["walker"].now
    assert json.loads((source / "walker.json").read_text())["length"] == 1.75  # of this body, the length is the height
    assert now["size"] == pytest.approx([1750] * 40, rel=0.01)


@pytest.mark.parametrize(
    ("members", "edition", "place", "advice"),
    [
        ("size 1.75 m", 1, "1.75 m", "write `size 0.5 m`"),
        ("size uniform(4 mm, 5 mm)", 2, "uniform(4 mm, 5 mm)", "write `size 0.5 m`"),
        ("height 0.5 m", 2, "0.5 m", "write `height 1.77 m`"),
        ("height 1.7 m; radius 1 m", 2, "1 m", "write `radius 202 mm`"),
    ],
)
def test_numbers_that_do_not_fit_each_other_are_reported(
    tmp_path: Path, members: str, edition: int, place: str, advice: str
) -> None:
    shot, report = opened(tmp_path, members, edition)
    assert shot is not None
    assert [(d.code, d.severity, d.span and d.span.text, d.help) for d in report.diagnostics] == [
        ("odd-size", "warning", place, advice)
    ]


@pytest.mark.parametrize("members", ["size 0.5 m", "size 0.3 m; radius 0.2 m", "height 1.2 m", "height 3 m; radius 0.3 m"])
def test_numbers_within_a_factor_of_two_are_not_reported(tmp_path: Path, members: str) -> None:
    assert not opened(tmp_path, members)[1].diagnostics


@pytest.mark.parametrize(
    ("members", "code", "place"),
    [
        ("size 0.5 m; height 1.7 m", "duplicate-name", "size"),
        ("mass 1 g", "missing-setting", "walker"),
        ("height 0 m", "out-of-range", "0 m"),
        ("height 3 s", "wrong-unit", "3 s"),
        ("height 1.7 m; upright 120 %", "out-of-range", "120 %"),
        ("height 1.7 m; upright 20 deg", "wrong-unit", "20 deg"),
        ("height 1.7 m; max_slope 3 mm", "wrong-unit", "3 mm"),
        ("height 1.7 m; crouch 120 %", "out-of-range", "120 %"),
        ("height 1.7 m; crouch 0 %", "out-of-range", "0 %"),
        ("size 0.5 m; mass height * 1 g/m", "unknown-name", "height"),
    ],
)
def test_wrong_sizes_and_postures_are_errors_with_their_location(tmp_path: Path, members: str, code: str, place: str) -> None:
    shot, report = opened(tmp_path, members)
    assert shot is None
    assert [(d.code, d.span and d.span.text) for d in report.errors] == [(code, place)], str(report)
