"""Kernels that make frames and measure them give the bits of the NumPy code beside them, for extreme values too."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from compilers import need_llvmlite
from plans import bare, block, crowd

from antdsl.numerics import compiled
from antdsl.outputs.cache.frames import FrameMaker, _made, _made_compiled, _not_zero
from antdsl.outputs.cache.shown_arrays import _put_on
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
    population.ids = np.random.default_rng(2).permutation(600).astype(np.int64) * 3
    population.version += 1
    with np.errstate(all="ignore"):
        wanted = _made(population, attribute, np.array([1.0, -2.5, 1e4]), 0.1)
    found = _made_compiled(population, attribute, np.array([1.0, -2.5, 1e4]), 0.1)
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


@pytest.mark.parametrize("count", [1, 7, 4000])
def test_cells_of_a_field(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    need_llvmlite()
    values = np.random.default_rng(count).choice([0.0, -0.0, 1e-300, -2.5, 1e300, np.inf, np.nan, 0.1], count)
    found = []
    for on in (False, True):
        monkeypatch.setattr(compiled, "wanted", lambda count, on=on: on)
        with np.errstate(over="ignore"):
            found.append(_not_zero(values))
    for wanted, got in zip(*found, strict=True):
        assert got.dtype == wanted.dtype and np.array_equal(got, wanted, equal_nan=wanted.dtype.kind == "f")


def test_who_wears_a_layer(monkeypatch: pytest.MonkeyPatch) -> None:
    need_llvmlite()
    rng = np.random.default_rng(4)
    on, rows, before = rng.random(500) < 0.3, rng.permutation(500)[:400], rng.integers(0, 2**63, 400).astype(np.uint64)
    found = []
    for fast in (False, True):
        monkeypatch.setattr(compiled, "wanted", lambda count, fast=fast: fast)
        found.append(before.copy())
        for bit in (0, 5, 63):
            _put_on(on, rows, np.uint64(1 << bit), found[-1])
    assert np.array_equal(*found) and not np.array_equal(found[0], before)


def test_colours_of_states(monkeypatch: pytest.MonkeyPatch) -> None:
    need_llvmlite()
    states = np.random.default_rng(6).integers(0, 5, 300).astype(np.int32)
    population = SimpleNamespace(name="ant", plan=SimpleNamespace(machines=[SimpleNamespace(name="m")]), now={"m.state": states})
    maker = SimpleNamespace(colours={"ant": np.random.default_rng(7).random((5, 3)).astype(np.float32)})
    rows, found = np.random.default_rng(8).permutation(300), []
    for on in (False, True):
        monkeypatch.setattr(compiled, "wanted", lambda count, on=on: on)
        found.append(FrameMaker._coloured(maker, population, rows))  # type: ignore[arg-type]
    assert np.array_equal(*found) and found[1].dtype == np.float32
    states[17] = 5
    with pytest.raises(IndexError):
        FrameMaker._coloured(maker, population, rows)  # type: ignore[arg-type]
