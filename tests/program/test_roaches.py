"""Roaches in a kitchen: how they set out, what controls do to them, and which others they come to like."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import meshes
import numpy as np
import pytest

from antdsl.pipeline import open_scene
from antdsl.runtime import CrowdData, MeshData, Options, PlacementData, World, WorldSetting, bind, step

SCENE = Path(__file__).resolve().parents[2] / "examples" / "roaches" / "scene.yaml"
COUNT, FRAMES = 160, 150


@pytest.fixture(scope="module")
def frames() -> tuple[World, list[dict[str, np.ndarray]]]:
    shot, report = open_scene(SCENE)
    assert shot is not None, report.sort_by_place()
    setting = replace(shot.setting, crowds=(replace(shot.setting.crowds[0], count=COUNT),))
    world = bind(shot.plan, setting, Options(threads=1))
    roaches, snapshots = world.populations["roach"], []
    for frame in range(FRAMES):
        if frame:
            step(world)
        rows = roaches.get_rows_by_id()
        snapshots.append(
            {name: array[rows].copy() for name, array in roaches.now.items()} | {"place": roaches.position[rows].copy()}
        )
    return world, snapshots


def test_aligners_turn_and_pace_those_near_them_and_blend_between(frames: tuple[World, list[dict[str, np.ndarray]]]) -> None:
    world, snapshots = frames
    first = snapshots[0]
    place = first["place"] + world.origin
    east, west = (np.linalg.norm(place - np.array([x, 0.0, 0.0]), axis=1) for x in (-700.0, 700.0))
    speed = np.sqrt(sum(first[f"velocity.{axis}"].astype(float) ** 2 for axis in "xyz"))
    for near, far, direction, pace in ((east, west, 1.0, 90.0), (west, east, -1.0, 60.0)):
        alone = (near < 900) & (far > 900)
        assert alone.sum() > 5
        assert first["heading.x"][alone] == pytest.approx(direction, abs=1e-4) and speed[alone] == pytest.approx(pace, rel=1e-3)
    both = (east < 900) & (west < 900)
    weight = [np.maximum(1 - away[both] / 900, 0) for away in (east, west)]
    assert speed[both] == pytest.approx((90 * weight[0] + 60 * weight[1]) / (weight[0] + weight[1]), rel=1e-3)


def test_the_lure_draws_a_crowd_and_the_alarm_upsets_those_in_reach(frames: tuple[World, list[dict[str, np.ndarray]]]) -> None:
    world, snapshots = frames

    def away(frame: int, x: float, z: float) -> np.ndarray:
        return np.linalg.norm((snapshots[frame]["place"] + world.origin)[:, (0, 2)] - np.array([x, z]), axis=1)

    drawn = away(0, -300, 600) < 380
    assert drawn.sum() > 15 and np.median(away(60, -300, 600)[drawn]) < 0.75 * np.median(away(0, -300, 600)[drawn])
    reached = away(121, 200, 100) < 250  # the alarm is from 5 s to 6 s
    initial_calm, alarmed_calm, later = (snapshots[frame]["calm"][reached].mean() for frame in (110, 124, FRAMES - 1))
    assert reached.sum() > 5 and alarmed_calm < initial_calm - 0.5 and later > alarmed_calm + 0.1


def test_some_have_become_friends_and_some_foes(frames: tuple[World, list[dict[str, np.ndarray]]]) -> None:
    _, snapshots = frames
    values = np.concatenate([array for name, array in snapshots[-1].items() if "likes" in name and array.dtype == np.float32])
    assert (values > 0.01).sum() > 3 and (values < -0.01).sum() > 3


def run_roaches(*points: tuple[float, float], frames: int) -> tuple[World, list[dict[str, np.ndarray]]]:
    """Roaches at points (x, z, mm) of an endless floor without controls, who run towards the middle."""
    shot, _ = open_scene(SCENE)
    assert shot is not None
    crowd = CrowdData("roach", len(points), PlacementData(points=np.array([[x, 0.0, z] for x, z in points])))
    legs = {"legs": MeshData(*meshes.ball(10.0, (9000, 5, 9000), 2))}
    world = bind(shot.plan, WorldSetting(seed=3, crowds=(crowd,), obstacles=legs), Options(threads=1))
    roaches, snapshots = world.populations["roach"], []
    for frame in range(frames):
        if frame:
            step(world)
        rows = roaches.get_rows_by_id()
        snapshots.append({name: array[rows].copy() for name, array in roaches.now.items()})
    return world, snapshots


def likes(frame: dict[str, np.ndarray], roach: int) -> dict[int, float]:
    """What a roach keeps about others, by id."""
    return {
        int(frame[f"likes|{k}.id"][roach]): float(frame[f"likes|{k}"][roach])
        for k in range(8)
        if frame[f"likes|{k}.id"][roach] >= 0
    }


def test_a_collision_upsets_both_and_makes_them_foes() -> None:
    _, snapshots = run_roaches((0, 0), (5, 0), (300, 300), frames=2)
    assert snapshots[1]["calm"] == pytest.approx([0.95, 0.95, 1.0], abs=1e-6)
    assert likes(snapshots[1], 0) == {1: pytest.approx(-0.1, abs=0.01)} and likes(snapshots[1], 1) == {
        0: pytest.approx(-0.1, abs=0.01)
    }


def test_a_crowd_upsets_and_calm_comes_back() -> None:
    side = np.arange(5) * 40.0
    _, snapshots = run_roaches(*((float(x), float(z)) for x in side for z in side), (2000.0, 2000.0), frames=240)
    middle, alone = 12, 25
    calm = np.array([frame["calm"] for frame in snapshots])
    lowest = int(calm[:120, middle].argmin())
    assert calm[lowest, middle] < 0.9 and calm[lowest:, middle].max() > calm[lowest, middle] + 0.05
    assert (calm[:, alone] == 1).all()


def test_who_is_alone_grows_lonely_and_goes_to_look_for_others() -> None:
    world, snapshots = run_roaches((0, 0), (20, 40), (3000, 0), frames=200)
    lonely = np.array([frame["lonely"] for frame in snapshots])
    assert (np.diff(lonely[:20, 2]) > 0).all() and lonely[:10, 0].max() == 0
    states = world.plan.species["roach"].machines[1].states
    assert "homesick" in {states[int(frame["moving.state"][2])] for frame in snapshots}
