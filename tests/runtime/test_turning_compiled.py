"""Velocities after a push, within the limits of speed and turn: the same bits compiled and with NumPy."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from antdsl.runtime.moving import advance, strides
from antdsl.runtime.world import Population

N = 4000
DT = np.float32(1 / 24)


def vectors(rng: np.random.Generator, size: float) -> np.ndarray:
    found = rng.normal(0, size, (3, N)).astype(np.float32)
    found[:, rng.random(N) < 0.1] = 0.0
    found[:, rng.random(N) < 0.05] *= np.float32(1e-13)
    found[rng.integers(0, 3, 20), rng.integers(0, N, 20)] = np.nan
    found[rng.integers(0, 3, 20), rng.integers(0, N, 20)] = np.inf
    return found


def crowd(seed: int) -> tuple[SimpleNamespace, tuple[np.ndarray, ...]]:
    rng = np.random.default_rng(seed)
    up = rng.normal(0, 1, (3, N))
    up = (up / np.sqrt((up * up).sum(axis=0))).astype(np.float32)
    before, push = vectors(rng, 30.0), vectors(rng, 2.0)
    straight = rng.random(N) < 0.2
    before[:, straight] = -push[:, straight]  # right behind: it turns to a side of its own
    now = {
        f"{name}.{axis}": v
        for name, three in (("velocity", before), ("push", push))
        for axis, v in zip("xyz", three, strict=True)
    }
    turn = rng.choice([0.0, 0.3, 4.0, 100.0, 1e9, np.inf, np.nan, -1.0], N)
    now |= {"max_turn": turn, "max_speed": rng.choice([0.0, 20.0, 50.0], N), "max_force": rng.choice([0.0, 400.0, 1e5], N)}
    now |= {"mass": rng.choice([0.0, 1.0, 5.0], N), "response": rng.choice([0.0, 0.5], N)}
    now = {name: np.ascontiguousarray(value, np.float32) for name, value in now.items()}
    now |= {f"{name}.{axis}": up[k].copy() for name in ("up", "heading", "position") for k, axis in enumerate("xyz")}
    now["size"] = np.ones(N, np.float32)
    stands = {"normal": np.ascontiguousarray(up.T), "quarantined": np.zeros(N, np.bool_)}
    crowd = type("Crowd", (SimpleNamespace,), {"__len__": lambda self: N, "room": Population.room})
    return crowd(now=now, rooms={}, **stands), tuple(np.ascontiguousarray(u) for u in up)


@pytest.mark.parametrize("substep", [0, 1])
def test_turns_are_limited_the_same_compiled(monkeypatch: pytest.MonkeyPatch, substep: int) -> None:
    population, up = crowd(substep)
    world = SimpleNamespace(dt=float(2 * DT), options=SimpleNamespace(threads=1))
    world.setting = SimpleNamespace(crowds=())
    with np.errstate(all="ignore"):
        wanted = advance._velocity(world, population, up, DT, substep)
    on = strides._Crowd.of(world, population, DT, False)
    on.set_out(substep)
    for slow, fast in zip(wanted, on.velocity, strict=True):
        assert np.array_equal(slow, fast, equal_nan=True)
    monkeypatch.setattr(advance, "_limit_turn", lambda *_: None)
    with np.errstate(all="ignore"):
        free = advance._velocity(world, population, up, DT, substep)
    assert np.count_nonzero(free[0] != on.velocity[0]) > N / 20  # many were turned back
