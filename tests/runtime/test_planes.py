"""The plane of an agent's ground, and how it moves there: the same bits compiled and with NumPy."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from antdsl.numerics import compiled
from antdsl.runtime.planes import Plane

N = 3000


def vectors(rng: np.random.Generator, size: float) -> np.ndarray:
    found = rng.normal(0, size, (3, N)).astype(np.float32)
    found[:, rng.random(N) < 0.1] = 0.0
    found[:, rng.random(N) < 0.05] *= np.float32(1e-20)
    found[rng.integers(0, 3, 40), rng.integers(0, N, 40)] = np.nan
    found[rng.integers(0, 3, 40), rng.integers(0, N, 40)] = np.inf
    found[rng.integers(0, 3, 200), rng.integers(0, N, 200)] = -0.0
    return found


def of(name: str, three: np.ndarray) -> dict[str, np.ndarray]:
    return {f"{name}.{axis}": component.copy() for axis, component in zip("xyz", three, strict=True)}


@pytest.mark.parametrize("threads", [1, 3])
def test_planes_and_moves_have_the_same_bits(threads: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled, "LIGHT", 100)
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
    found = []
    for on in (False, True):
        monkeypatch.setattr(compiled, "wanted", lambda count, on=on: on)
        with np.errstate(all="ignore"):
            plane = Plane.of(population, rows, threads)
            moves = plane.moves(population, rows, wish, threads)
            columns = (*plane.up, *plane.ahead, *plane.left, *moves.own, *moves.velocity, *moves.wish, moves.fastest)
            found.append([*columns, *plane.raised(x, y, threads)])
    for plain, fast in zip(*found, strict=True):
        assert plain.dtype == fast.dtype
        assert np.array_equal(plain, fast, equal_nan=True)
        signs = [np.signbit(each[~np.isnan(each)]) for each in (plain, fast)]
        assert np.array_equal(*signs)
