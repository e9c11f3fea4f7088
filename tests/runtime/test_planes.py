"""The plane of an agent's ground, and how it moves there, against the same in NumPy's float64."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from antdsl.numerics import parallel
from antdsl.runtime.neighbourhood import Plane

N = 3000


def vectors(rng: np.random.Generator, size: float) -> np.ndarray:
    random_vectors = rng.normal(0, size, (3, N)).astype(np.float32)
    random_vectors[:, rng.random(N) < 0.1] = 0.0
    random_vectors[:, rng.random(N) < 0.05] *= np.float32(1e-20)
    random_vectors[rng.integers(0, 3, 40), rng.integers(0, N, 40)] = np.nan
    random_vectors[rng.integers(0, 3, 40), rng.integers(0, N, 40)] = np.inf
    random_vectors[rng.integers(0, 3, 200), rng.integers(0, N, 200)] = -0.0
    return random_vectors


def of(name: str, three: np.ndarray) -> dict[str, np.ndarray]:
    return {f"{name}.{axis}": component.copy() for axis, component in zip("xyz", three, strict=True)}


@pytest.mark.parametrize("threads", [1, 3])
def test_planes_and_moves_are_those_of_the_ground(threads: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parallel, "LIGHT", 100)
    rng = np.random.default_rng(4)
    up = vectors(rng, 1.0)
    with np.errstate(all="ignore"):
        up = np.where(rng.random(N) < 0.8, up / np.sqrt((up * up).sum(axis=0)), up).astype(np.float32)
    heading = vectors(rng, 1.0)
    heading[:, :200] = 2 * up[:, :200]  # no way along the ground
    start = of("up", up) | of("heading", heading) | of("velocity", vectors(rng, 30.0))
    start["max_speed"] = rng.choice([0.0, -3.0, 20.0, np.nan, np.inf, 1e12], N).astype(np.float32)
    population, rows = SimpleNamespace(start=start), rng.permutation(N)[: N - 50]
    wish = tuple(each[: len(rows)] for each in vectors(rng, 20.0))
    x, y = rng.normal(0, 9, (2, len(rows)))
    plane = Plane.of(population, rows, threads)
    moves = plane.measure_moves(population, rows, wish, threads)
    results = (*plane.up, *plane.ahead, *plane.left, *moves.own, *moves.velocity, *moves.wish, moves.fastest)

    def known(name: str) -> np.ndarray:
        v = np.stack([start[f"{name}.{axis}"] for axis in "xyz"], axis=1)[rows].astype(float)
        return np.where(np.isfinite(v).all(axis=1, keepdims=True), v, 0.0)

    with np.errstate(all="ignore"):
        above, facing, velocity = known("up"), known("heading"), known("velocity")
        wished = np.where(np.isfinite(wish).all(axis=0), wish, 0).T.astype(float)
        ahead = facing - above * (facing * above).sum(axis=1, keepdims=True)
        size = np.linalg.norm(ahead, axis=1, keepdims=True)
        side = np.where(np.abs(above[:, :1]) > 0.9, [[0.0, 1, 0]], [[1.0, 0, 0]])
        side -= above * (side * above).sum(axis=1, keepdims=True)
        ahead = np.where(size > 1e-12, ahead / size, side / np.linalg.norm(side, axis=1, keepdims=True))
        left = np.cross(above, ahead)
        speed = start["max_speed"][rows].astype(float)
    laid = [(v * axis).sum(axis=1) for v in (velocity, wished) for axis in (ahead, left)]
    expected = (*above.T, *ahead.T, *left.T, *velocity.T, *laid, np.where(speed > 0, np.minimum(speed, 1e9), 0.0))
    sure = (size[:, 0] == 0) | (size[:, 0] > 1e-6)  # else the way along the ground is what rounding leaves
    for one, other in zip(results, expected, strict=True):
        assert np.allclose(one[sure], other[sure], rtol=1e-9, atol=1e-9, equal_nan=True)
    assert sure.mean() > 0.8 and (size == 0).sum() > 10
    raised = np.stack(plane.to_space(x, y, threads))
    assert raised.dtype == np.float32
    assert np.allclose(raised, np.stack(plane.ahead) * x + np.stack(plane.left) * y, rtol=1e-6, atol=1e-6, equal_nan=True)
