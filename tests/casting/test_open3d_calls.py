"""What Open3D answers: calls of its scenes are counted while crowds are placed and rays are cast."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from antdsl.casting.rays import RayScene
from antdsl.pipeline import open_scene
from antdsl.runtime import Options, bind, step
from tests.meshes import terrain

FORAGING = Path(__file__).parents[2] / "examples" / "foraging" / "scene.yaml"


class CountedScene:
    """An Open3D scene that counts its calls."""

    def __init__(self, scene: Any, calls: Counter[str]) -> None:
        self._scene, self._calls = scene, calls

    def __getattr__(self, name: str) -> Any:
        method: Callable[..., Any] = getattr(self._scene, name)

        def call(*arguments: Any, **named: Any) -> Any:
            self._calls[name] += 1
            return method(*arguments, **named)

        return call


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    counter: Counter[str] = Counter()
    built = RayScene._build_scene
    monkeypatch.setattr(RayScene, "_build_scene", lambda self, corners: CountedScene(built(self, corners), counter))
    return counter


def test_open3d_queries_place_agents_on_ground_outside_obstacles(calls: Counter[str]) -> None:
    shot, report = open_scene(FORAGING)
    assert shot is not None, report.sort_by_place()
    world = bind(shot.plan, shot.setting, Options(feet=False))
    placed = calls["cast_rays"]
    assert placed >= 2, "the ground below 500 agents, and the faces of obstacles above them"
    for _ in range(3):
        step(world)
    assert calls["cast_rays"] == placed, "walking agents have footings, and feelers are short"


def test_long_rays_use_open3d_and_short_rays_use_the_grid(calls: Counter[str]) -> None:
    scene = RayScene(*terrain(400.0, 40))
    origin = np.array([[0.0, 500.0, 0.0], [5.0, 500.0, 5.0]])
    down = np.array([[0.0, -1.0, 0.0], [0.0, -1.0, 0.0]])
    assert scene.find_first_hits(origin, down).is_hit.all() and calls["cast_rays"] == 1
    hits, part, _, _ = scene.find_hits_along_step(origin, down * 5_000.0, 1)
    assert len(hits) == 2 and calls["cast_rays"] == 2
    low = np.array([[0.0, 10.0, 0.0], [5.0, 10.0, 5.0]])
    total = calls.total()
    scene.find_hits_along_step(low, down * 15.0, 1)
    assert calls.total() == total and part.size == 2
