"""The plane of an agent's ground, and how it moves there, against the same in NumPy's float64."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from neighbour_columns import Neighbours, fill_neighbours

from antdsl.numerics import parallel
from antdsl.senses.clear_velocity import WishedVelocities, fill_clear_velocities
from antdsl.senses.nearest_others import CrowdTables, NeighbourRequests, pack_up_and_motion
from antdsl.senses.neighbours import CellGrid

N = 3000


def vectors(rng: np.random.Generator, size: float) -> np.ndarray:
    random_vectors = rng.normal(0, size, (3, N)).astype(np.float32)
    random_vectors[:, rng.random(N) < 0.1] = 0.0
    random_vectors[:, rng.random(N) < 0.05] *= np.float32(1e-20)
    random_vectors[rng.integers(0, 3, 40), rng.integers(0, N, 40)] = np.nan
    random_vectors[rng.integers(0, 3, 40), rng.integers(0, N, 40)] = np.inf
    random_vectors[rng.integers(0, 3, 200), rng.integers(0, N, 200)] = -0.0
    return random_vectors


@pytest.mark.parametrize("threads", [1, 3])
def test_planes_and_moves_are_those_of_the_ground(threads: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parallel, "MIN_LIGHT_ITEMS_PER_THREAD", 100)
    rng = np.random.default_rng(4)
    up = vectors(rng, 1.0)
    with np.errstate(all="ignore"):
        up = np.where(rng.random(N) < 0.8, up / np.sqrt((up * up).sum(axis=0)), up).astype(np.float32)
    heading = vectors(rng, 1.0)
    heading[:, :200] = 2 * up[:, :200]  # no way along the ground
    velocity, radius = vectors(rng, 30.0), np.ones(N, np.float32)
    max_speed = rng.choice([0.0, -3.0, 20.0, np.nan, np.inf, 1e12], N).astype(np.float32)
    rows = rng.permutation(N)[: N - 50]
    wish, n = vectors(rng, 20.0)[:, : N - 50].astype(float), N - 50
    grid = CellGrid(*rng.normal(0, 9, (3, N)).astype(np.float32), np.arange(N), 1.0)
    fours, motion = np.empty((2, 4 * N + 32), np.float32)
    work = partial(
        pack_up_and_motion,
        grid.order.position_by_row,
        tuple(up),
        tuple(velocity),
        radius,
        np.arange(N, dtype=np.int32),
        fours,
        motion,
    )
    parallel.run_in_parts(work, N, threads, parallel.MIN_LIGHT_ITEMS_PER_THREAD)
    crowd = CrowdTables(grid.make_tables(), fours, motion, np.empty(0, np.int32), np.full(3, np.inf, np.float32))
    alone, one = np.zeros(n), np.ones(n)
    requesters = NeighbourRequests(grid.order.position_by_row.take(rows), rows, alone, one, tuple(heading))
    planes, velocities = np.empty((9, n)), np.empty((3, n), np.float32)
    fill_neighbours(crowd, requesters, Neighbours(*np.zeros((5, n, 1)), *np.zeros((2, n, 1), np.bool_)), planes)
    wishes = WishedVelocities(tuple(wish), one, max_speed)
    parallel.run_in_parts(partial(fill_clear_velocities, crowd, requesters, wishes, 0.04, velocities), n, threads, 100)

    def known(vectors: np.ndarray) -> np.ndarray:
        v = vectors.T[rows].astype(float)
        return np.where(np.isfinite(v).all(axis=1, keepdims=True), v, 0.0)

    with np.errstate(all="ignore"):
        above, facing, own = known(up), known(heading), known(velocity)
        wished = np.where(np.isfinite(wish).all(axis=0), wish, 0).T
        ahead = facing - above * (facing * above).sum(axis=1, keepdims=True)
        size = np.linalg.norm(ahead, axis=1, keepdims=True)
        side = np.where(np.abs(above[:, :1]) > 0.9, [[0.0, 1, 0]], [[1.0, 0, 0]])
        side -= above * (side * above).sum(axis=1, keepdims=True)
        ahead = np.where(size > 1e-12, ahead / size, side / np.linalg.norm(side, axis=1, keepdims=True))
        left = np.cross(above, ahead)
        speed = max_speed[rows].astype(float)
        x, y = (wished * ahead).sum(axis=1), (wished * left).sum(axis=1)
        part = np.minimum(1.0, np.where(speed > 0, np.minimum(speed, 1e9), 0.0) / np.maximum(np.hypot(x, y), 1e-300))
    sure = (size[:, 0] == 0) | (size[:, 0] > 1e-6)  # else the way along the ground is what rounding leaves
    expected = np.concatenate([above.T, ahead.T, left.T])
    assert np.allclose(planes[:, sure], expected[:, sure], rtol=1e-9, atol=1e-9, equal_nan=True)
    expected = ahead.T * (x * part) + left.T * (y * part)
    assert np.allclose(velocities[:, sure], expected[:, sure], rtol=1e-6, atol=1e-6, equal_nan=True)
    assert np.array_equal(motion.reshape(-1, 4)[grid.order.position_by_row[rows], :3], own.astype(np.float32))
    assert sure.mean() > 0.8 and (size == 0).sum() > 10
