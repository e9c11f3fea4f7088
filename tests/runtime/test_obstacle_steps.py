"""Steps past obstacles: kernels leave out faces that are out of reach, and come to what the arrays come to, which ask all."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from compilers import need_llvmlite

from antdsl.casting.rays import RayScene
from antdsl.numerics import compiled
from antdsl.runtime.moving import obstacles, obstacles_compiled
from tests.meshes import Mesh, ball, box, terrain


def shards() -> Mesh:
    """Triangles through each other, so that many places have near faces before and behind them."""
    rng = np.random.default_rng(1)
    corners = rng.uniform(-60, 60, (1500, 1, 3)) + rng.normal(0, 5, (1500, 3, 3))
    return corners.reshape(-1, 3), np.arange(4500, dtype=np.int32).reshape(-1, 3)


MESHES: dict[str, Callable[[], list[Mesh]]] = {
    "ball": lambda: [ball(30.0, (0, 0, 0), 16)],
    "through each other": lambda: [ball(20.0, (0, 0, 0), 16), ball(9.0, (18, 4, 0), 12), box((-6, -30, -6), (6, 30, 6))],
    "hills": lambda: [terrain(120, 30)],
    "shards": lambda: [shards()],
}


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("name", MESHES)
def test_steps_past_an_obstacle_are_the_same_with_and_without_kernels(name: str, threads: int, monkeypatch: pytest.MonkeyPatch):
    need_llvmlite()
    scene = RayScene.of(MESHES[name]())
    grid = scene._triangles()
    assert grid is not None
    rng = np.random.default_rng(3)
    n, width = 6000, grid.tables[0][3]
    near = scene._faces.corners[rng.integers(0, len(scene._faces.corners), n)].mean(axis=1)
    near += rng.normal(size=(n, 3)) * width * rng.uniform(0, 1.5, (n, 1))
    near = near[~np.isnan(grid.apart(tuple(np.float32(near.T)))[0][0])]  # the grid can tell of all
    n = len(near)
    x, y, z = np.ascontiguousarray(near.T, np.float32)
    steps = np.ascontiguousarray((rng.normal(size=(n, 3)) * width * 0.2).T, np.float32)
    steps[1, ::3], steps[1, 1::9], steps[:, ::50] = 0.0, -0.0, 0.0
    up = rng.normal(size=(3, n))
    up[:, ::2] = [[0], [1], [0]]
    up = np.ascontiguousarray(up / np.sqrt((up * up).sum(axis=0)), np.float32)
    radius = rng.uniform(-0.1, 1.5, n).astype(np.float32) * np.float32(width / 3)
    given = ((x, y, z), tuple(steps), up, radius, np.zeros(n, np.float32), threads)

    def never(*_: object) -> None:
        raise AssertionError

    monkeypatch.setattr(obstacles_compiled, "touching", never)  # what is called where the grid cannot tell
    found = []
    for one in (True, False):
        monkeypatch.setattr(compiled, "wanted", lambda count, one=one: one)
        found.append(np.stack(obstacles._along(scene, *given)))
    assert np.array_equal(found[0].view(np.int32), found[1].view(np.int32))
    gap = scene.apart(x, y, z, np.inf)[0]
    bent = (found[0] != steps).any(axis=0)
    assert (bent & (gap > 0)).sum() > 100 and (bent & (gap < -width / 2)).sum() > 10 and (~bent).sum() > 1000
