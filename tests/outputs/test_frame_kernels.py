"""Kernels that make frames and measure them give the bits of the NumPy code beside them, for extreme values too."""

from __future__ import annotations

import numpy as np
import pytest
from compilers import need_llvmlite
from plans import bare, block, crowd

from antdsl.numerics import compiled
from antdsl.outputs.cache.frames import _made, _made_compiled
from antdsl.outputs.surface_error import surface_error
from antdsl.runtime import Options, World, bind

EXTREMES = np.array([0.0, -0.0, 1.0, -1.0, 1e-13, -1e-13, 1e-30, 1e30, np.inf, -np.inf, np.nan, 0.6, -0.8], np.float32)


@pytest.fixture
def world() -> World:
    made = bind(bare(block()), crowd(600, radius=90.0), Options(backend="numpy"))
    rng = np.random.default_rng(5)
    now = made.populations["ant"].now
    for name in ("heading", "up", "velocity"):
        for axis in "xyz":
            now[f"{name}.{axis}"][:300] = rng.choice(EXTREMES, 300)
            now[f"{name}.{axis}"][300:] = rng.normal(size=300)
    now["heading.x"][:40], now["heading.z"][:40] = -1.0, 0.0  # straight back, where `up` may lie along it
    now["heading.y"][:40] = rng.choice(EXTREMES[:2], 40)
    return made


@pytest.mark.parametrize("attribute", ["P", "v", "orient"])
def test_arrays_of_a_frame(world: World, attribute: str) -> None:
    need_llvmlite()
    population = world.populations["ant"]
    rows = np.random.default_rng(2).permutation(600)
    with np.errstate(all="ignore"):
        wanted = _made(population, attribute, rows, np.array([1.0, -2.5, 1e4]), 0.1)
    found = _made_compiled(population, attribute, rows, np.array([1.0, -2.5, 1e4]), 0.1)
    assert found.dtype == wanted.dtype == np.float32 and found.shape == wanted.shape
    unknown = np.isnan(wanted)  # of what is no number neither the sign nor the rest of the bits says anything
    assert (found.view(np.int32) == wanted.view(np.int32))[~unknown].all() and np.isnan(found[unknown]).all()
    assert np.count_nonzero(~unknown) > 0


@pytest.mark.parametrize("odd", [0.0, np.nan])
def test_the_distance_from_the_ground(world: World, odd: float, monkeypatch: pytest.MonkeyPatch) -> None:
    need_llvmlite()
    population = world.populations["ant"]
    population.position += np.random.default_rng(3).normal(size=(600, 3))
    population.now["size"][:3] = 0.0
    population.now["clearance"][7] = odd
    found = []
    for on in (False, True):
        monkeypatch.setattr(compiled, "wanted", lambda count, on=on: on)
        found.append(surface_error(world))
    assert found[0] == found[1] and (found[0] > 0 or np.isnan(odd))
