"""Roaches in a kitchen: how they set out, what controls do to them, and whom they come to like."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from antdsl.pipeline import open_scene
from antdsl.runtime import Options, World, bind, step

SCENE = Path(__file__).resolve().parents[2] / "examples" / "roaches" / "scene.yaml"
COUNT, FRAMES = 160, 150


@pytest.fixture(scope="module")
def frames() -> tuple[World, list[dict[str, np.ndarray]]]:
    shot, report = open_scene(SCENE)
    assert shot is not None, report.sorted()
    setting = replace(shot.setting, crowds=(replace(shot.setting.crowds[0], count=COUNT),))
    world = bind(shot.plan, setting, Options(threads=1))
    roaches, found = world.populations["roach"], []
    for frame in range(FRAMES):
        if frame:
            step(world)
        rows = roaches.in_id_order()
        found.append({name: array[rows].copy() for name, array in roaches.now.items()} | {"place": roaches.position[rows].copy()})
    return world, found


def test_aligners_turn_and_pace_those_near_them_and_blend_between(frames: tuple[World, list[dict[str, np.ndarray]]]) -> None:
    world, found = frames
    first = found[0]
    place = first["place"] + world.origin
    east, west = (np.linalg.norm(place - np.array([x, 0.0, 0.0]), axis=1) for x in (-700.0, 700.0))
    speed = np.sqrt(sum(first[f"velocity.{axis}"].astype(float) ** 2 for axis in "xyz"))
    for near, far, way, pace in ((east, west, 1.0, 90.0), (west, east, -1.0, 60.0)):
        alone = (near < 900) & (far > 900)
        assert alone.sum() > 5
        assert first["heading.x"][alone] == pytest.approx(way, abs=1e-4) and speed[alone] == pytest.approx(pace, rel=1e-3)
    both = (east < 900) & (west < 900)
    weight = [np.maximum(1 - away[both] / 900, 0) for away in (east, west)]
    assert speed[both] == pytest.approx((90 * weight[0] + 60 * weight[1]) / (weight[0] + weight[1]), rel=1e-3)


def test_the_lure_draws_a_crowd_and_the_alarm_upsets_those_in_reach(
    frames: tuple[World, list[dict[str, np.ndarray]]],
) -> None:
    world, found = frames

    def away(frame: int, x: float, z: float) -> np.ndarray:
        return np.linalg.norm((found[frame]["place"] + world.origin)[:, (0, 2)] - np.array([x, z]), axis=1)

    drawn = away(0, -300, 600) < 380
    assert drawn.sum() > 15 and np.median(away(60, -300, 600)[drawn]) < 0.75 * np.median(away(0, -300, 600)[drawn])
    reached = away(121, 200, 100) < 250  # the alarm is from 5 s to 6 s
    before, after, later = (found[frame]["calm"][reached].mean() for frame in (110, 124, FRAMES - 1))
    assert reached.sum() > 5 and after < before - 0.5 and later > after + 0.1


def test_some_have_become_friends_and_some_foes(frames: tuple[World, list[dict[str, np.ndarray]]]) -> None:
    _, found = frames
    values = np.concatenate([array for name, array in found[-1].items() if "likes" in name and array.dtype == np.float32])
    assert (values > 0.01).sum() > 3 and (values < -0.01).sum() > 3
