"""Steps past obstacles against the same rules in float64, which ask the scene about all agents.

Rays and distances have tests of their own."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from antdsl.casting.rays import RayScene
from antdsl.numerics import parallel
from antdsl.runtime.moving import obstacles
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


def unit(v: np.ndarray) -> np.ndarray:
    size = np.linalg.norm(v, axis=0)
    return np.where(size > 1e-12, v / np.where(size > 1e-12, size, 1.0), 0.0)


def feel(scene: RayScene, place: np.ndarray, step: np.ndarray, margin: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which agents meet a face on their step, how much of it is free, and the normals of the faces."""
    size = np.linalg.norm(step, axis=0)
    going = np.flatnonzero(size > 1e-9)
    rays = np.float32([*place[:, going], *unit(step[:, going]), size[going] + margin[going]])
    hits = scene.cast_feelers(rays[:3], rays[3:6], rays[6])
    hit_rows, hit = going[hits.hit], hits.hit
    return (
        hit_rows,
        np.clip(hits.t[hit] - margin[hit_rows], 0, size[hit_rows]),
        np.float64([hits.nx[hit], hits.ny[hit], hits.nz[hit]]),
    )


def expected_steps(scene: RayScene, place, step, up, radius, clear) -> np.ndarray:
    """Steps (3, n) that keep half a radius from faces and slide along those that they lead into."""
    size, margin, place = np.linalg.norm(step, axis=0), np.maximum(radius, 0) / 2, np.asarray(place)
    asks = (size > 1e-9) & (clear <= size + margin)
    gap, out = scene.measure_signed_distances(*place, np.float32(size + margin))
    wall = unit(out - up * (out * up).sum(axis=0))
    least = np.minimum(margin - gap, size / 2) - (step * wall).sum(axis=0)
    new_steps = step + wall * np.where(asks & (least > 0), least, 0.0)
    long = np.linalg.norm(new_steps, axis=0)
    new_steps = new_steps * np.where(long > size, size / np.maximum(long, 1e-300), 1.0)
    looks = asks & (gap >= 0) & (np.fmax(clear, gap) <= np.minimum(long, size) + margin)  # nothing holds who is inside
    hit_rows, free, normal = feel(scene, place, new_steps * looks, margin)
    flat = normal - up[:, hit_rows] * (normal * up[:, hit_rows]).sum(axis=0)
    wall = np.where(np.linalg.norm(flat, axis=0) > 1e-12, unit(flat), normal)
    part = free / np.linalg.norm(new_steps[:, hit_rows], axis=0)
    rest = new_steps[:, hit_rows] * (1 - part)
    along = new_steps[:, hit_rows] * part + rest - wall * np.minimum((rest * wall).sum(axis=0), 0)
    again, free, _ = feel(scene, place[:, hit_rows], along, margin[hit_rows])
    along[:, again] *= free / np.linalg.norm(along[:, again], axis=0)
    new_steps[:, hit_rows] = along
    return new_steps


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("by_grid", [True, False])
def test_steps_past_an_obstacle_keep_their_margin_and_slide(
    name: str, by_grid: bool, threads: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = RayScene.from_meshes(MESHES[name]())
    grid = scene._get_triangle_grid()
    assert grid is not None
    rng = np.random.default_rng(3)
    n, width = 3000, grid.tables[0][3]
    near = scene._faces.corners[rng.integers(0, len(scene._faces.corners), n)].mean(axis=1)
    near += rng.normal(size=(n, 3)) * width * rng.uniform(0, 1.5, (n, 1))
    near = near[~np.isnan(grid.measure_signed_distances(tuple(np.float32(near.T)))[0][0])]  # the grid can tell of all
    n = len(near)
    x, y, z = np.ascontiguousarray(near.T, np.float32)
    steps = np.ascontiguousarray((rng.normal(size=(n, 3)) * width * 0.2).T, np.float32)
    steps[1, ::3], steps[1, 1::9], steps[:, ::50] = 0.0, -0.0, 0.0
    up = rng.normal(size=(3, n))
    up[:, ::2] = [[0], [1], [0]]
    up = np.ascontiguousarray(up / np.sqrt((up * up).sum(axis=0)), np.float32)
    radius = rng.uniform(-0.1, 1.5, n).astype(np.float32) * np.float32(width / 3)
    clear = (rng.choice([0, 0.9, 3.0], n) * scene.measure_clearance(x, y, z)).astype(np.float32)
    calls: list[object] = []
    touching = obstacles.select_agents_near_obstacle
    monkeypatch.setattr(
        obstacles, "select_agents_near_obstacle", lambda *arguments: calls.append(arguments) or touching(*arguments)
    )
    monkeypatch.setattr(parallel, "MIN_LIGHT_ITEMS_PER_THREAD", n // 4)
    if not by_grid:
        monkeypatch.setattr(scene, "get_tables", lambda: None)
    new_steps = np.stack(obstacles._slide_along_obstacle(scene, (x, y, z), tuple(steps), tuple(up), radius, clear, threads))  # type: ignore[arg-type]
    expected = expected_steps(scene, np.stack([x, y, z]), steps.astype(float), up.astype(float), radius.astype(float), clear)
    assert bool(calls) != by_grid
    off = np.abs(new_steps - expected).max(axis=0)
    assert (off > width * 1e-4).mean() < 0.005  # what is decided the other way by rounding
    gap = scene.measure_signed_distances(x, y, z, np.inf)[0]
    changed = (new_steps != steps).any(axis=0)
    assert (changed & (gap > 0)).sum() > 50 and (changed & (gap < -width / 2)).sum() > 5 and (~changed).sum() > 500


def test_only_agents_that_were_stopped_are_slowed_and_only_those_that_stay_count_as_the_same() -> None:
    rng = np.random.default_rng(5)
    requested_steps, velocity = rng.normal(size=(2, 3, 40)).astype(np.float32)
    step, old_velocity = requested_steps.copy(), velocity.copy()
    for axis in range(3):
        step[axis, axis::7] *= np.float32(0.5)
    obstacles.scale_velocities_with_steps(tuple(requested_steps), tuple(step), tuple(velocity), np.float32(24), 4, 36)
    stopped = (step != requested_steps).any(axis=0) & (np.arange(40) >= 4) & (np.arange(40) < 36)
    assert np.array_equal(velocity, np.where(stopped, step * np.float32(24), old_velocity))
    for axis in range(3):
        other = requested_steps.copy()
        other[axis, 20] = np.nan if axis else np.nextafter(other[axis, 20], np.float32(9))
        assert not obstacles.are_vectors_equal(tuple(requested_steps), tuple(other), 0, 40) and obstacles.are_vectors_equal(
            tuple(requested_steps), tuple(other), 21, 40
        )
    assert not obstacles.are_vectors_equal(tuple(other), tuple(other), 0, 40) and obstacles.are_vectors_equal(
        tuple(requested_steps), tuple(requested_steps.copy()), 0, 40
    )
    rows, at, (radius, distances) = np.array([3, 9, 30]), np.empty((3, 3), np.float32), np.empty((2, 3), np.float32)
    obstacles.measure_distance_from_start(rows, tuple(requested_steps), tuple(step), velocity[0], at, radius, distances)
    far = np.linalg.norm((requested_steps - step)[:, rows], axis=0)
    assert np.array_equal(at, requested_steps[:, rows]) and np.array_equal(radius, velocity[0, rows])
    assert np.allclose(distances, far * (1 + 1e-6), rtol=3e-7) and (distances >= far).all() and far.any()
