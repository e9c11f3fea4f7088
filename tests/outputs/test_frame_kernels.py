"""Kernels that make frames and measure them give the bits of the NumPy code beside them, for extreme values too."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from compilers import need_llvmlite
from numpy.typing import NDArray
from plans import bare, block, crowd

from antdsl.numerics import compiled
from antdsl.outputs.cache.agent_arrays import write_colours, write_numbers, write_placed
from antdsl.outputs.cache.clip_arrays import _REGISTERS, clips_playing
from antdsl.outputs.cache.frames import _not_zero
from antdsl.outputs.cache.shown_arrays import _put_on
from antdsl.outputs.surface_error import surface_error
from antdsl.runtime import Options, Population, World, bind

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


def both(monkeypatch: pytest.MonkeyPatch, write: Callable[[NDArray[Any]], None], shape: tuple[int, ...]) -> list[NDArray[Any]]:
    """What is written without kernels and with them, into the middle rows of an array: those beside them stay."""
    found = []
    for on in (False, True):
        monkeypatch.setattr(compiled, "wanted", lambda count, on=on: on)
        whole = np.full((shape[0] + 5, *shape[1:]), 77, np.float32)
        with np.errstate(all="ignore"):
            write(whole[2:-3])
        assert (whole[:2] == 77).all() and (whole[-3:] == 77).all()
        found.append(whole[2:-3])
    return found


def mixed(population: Population) -> None:
    """Give the rows ids in another order."""
    population.ids = np.random.default_rng(2).permutation(len(population)).astype(np.int64) * 3
    population.version += 1


@pytest.mark.parametrize("attribute", ["P", "v", "orient"])
def test_arrays_of_a_frame(world: World, attribute: str, monkeypatch: pytest.MonkeyPatch) -> None:
    need_llvmlite()
    population = world.populations["ant"]
    mixed(population)
    shape = (600, 4 if attribute == "orient" else 3)
    wanted, found = both(monkeypatch, lambda out: write_placed(population, attribute, 0.1, out), shape)
    unknown = np.isnan(wanted)  # of what is no number neither the sign nor the rest of the bits says anything
    assert (found.view(np.int32) == wanted.view(np.int32))[~unknown].all() and np.isnan(found[unknown]).all()
    assert np.count_nonzero(~unknown) > 0


def test_numbers_of_agents(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    need_llvmlite()
    population = world.populations["ant"]
    mixed(population)
    population.now["size"][:] = np.random.default_rng(9).choice(EXTREMES, 600)
    wanted, found = both(monkeypatch, lambda out: write_numbers(population, "size", 0.1, out), (600,))
    assert np.array_equal(wanted, found, equal_nan=True) and len(np.unique(wanted)) > 5


@pytest.mark.parametrize("three", [False, True])
def test_what_agents_play(three: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    need_llvmlite()
    rng, ids = np.random.default_rng(11), np.random.default_rng(12).permutation(300)
    now = {
        f"m.{register}": rng.integers(-1, 9, 300).astype(np.int32 if kind is np.int16 else kind)
        for register, kind in _REGISTERS.values()
    }
    now["m.clip_earlier_fade"] = (now["m.clip_fade"] > 0).astype(np.float32) * np.float32(three)
    ranks = ids.astype(np.int32)
    plan = SimpleNamespace(machines=[SimpleNamespace(name="m")], registers={"m.clip": None})

    class Some(SimpleNamespace):
        def __len__(self) -> int:
            return 300

    population = Some(name="ant", plan=plan, now=now, ranks=lambda: ranks, in_id_order=lambda: np.argsort(ids))
    found = []
    for on in (False, True):
        monkeypatch.setattr(compiled, "wanted", lambda count, on=on: on)
        found.append(clips_playing(population))  # type: ignore[arg-type]
    wanted, got = found
    assert list(wanted) == list(got) and len(got) == (11 if three else 7)
    for name, array in wanted.items():
        assert got[name].dtype == array.dtype and np.array_equal(got[name], array) and len(np.unique(array)) > 1
    some = clips_playing(population, np.array([3, 1]))  # type: ignore[arg-type]
    assert all(np.array_equal(array, got[name][ids[[3, 1]]]) for name, array in some.items())


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
    on, ids, before = rng.random(500) < 0.3, rng.permutation(500), rng.integers(0, 2**63, 500).astype(np.uint64)
    population, found = SimpleNamespace(ranks=lambda: ids.astype(np.int32), in_id_order=lambda: np.argsort(ids)), []
    for fast in (False, True):
        monkeypatch.setattr(compiled, "wanted", lambda count, fast=fast: fast)
        found.append(before.copy())
        for bit in (0, 5, 63):
            _put_on(population, on, None, np.uint64(1 << bit), found[-1])  # type: ignore[arg-type]
    assert np.array_equal(*found) and not np.array_equal(found[0], before)


def test_colours_of_states(monkeypatch: pytest.MonkeyPatch) -> None:
    need_llvmlite()
    states = np.random.default_rng(6).integers(0, 5, 300).astype(np.int32)
    ids = np.random.default_rng(8).permutation(300)
    plan = SimpleNamespace(machines=[SimpleNamespace(name="m")])
    population = SimpleNamespace(
        plan=plan, now={"m.state": states}, ranks=lambda: ids.astype(np.int32), in_id_order=lambda: np.argsort(ids)
    )
    colours = np.random.default_rng(7).random((5, 3)).astype(np.float32)
    wanted, found = both(monkeypatch, lambda out: write_colours(population, colours, out), (300, 3))  # type: ignore[arg-type]
    assert np.array_equal(wanted, found) and np.array_equal(found[ids], colours[states])
    states[17] = 5
    with pytest.raises(IndexError):
        write_colours(population, colours, found)  # type: ignore[arg-type]
