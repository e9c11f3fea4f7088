"""Compiled neighbours against those found with NumPy: the same pairs, bits and order; and whole steps of a crowd."""

from __future__ import annotations

import numpy as np
import pytest
from foraging_shots import EXAMPLE, world

from antdsl.casting.distance_grid import DistanceGrid
from antdsl.numerics import compiled, elementary, randomness
from antdsl.runtime import Options, state_hash, step
from antdsl.senses import neighbours
from antdsl.senses.cell_order import ordered
from antdsl.senses.neighbours import CellGrid, Pairs

COLUMNS = Pairs.__slots__
EXTENTS = ((400, 10, 400), (100, 100, 100), (3000, 0, 0), (0, 900, 0), (9e6, 4e4, 9e6), (60, 1, 60))
RADII = {
    "one": 6.5,
    "each": np.random.default_rng(7).uniform(0, 25, 2000).astype(np.float32),
    "odd": np.resize(np.array([5, np.nan, -1, 0, 12.5, 1e-30], np.float32), 2000),
    "wide": 18.0,
}


def crowd(extent: tuple[float, ...], n: int = 2000) -> tuple[list[np.ndarray], np.ndarray]:
    rng = np.random.default_rng(n)
    places = [rng.uniform(-0.5 * e, 0.5 * e, n).astype(np.float32) for e in extent]
    places[0][::500] = np.nan
    places[2][1::700] = np.inf
    for place in places:
        place[10:13] = place[9]  # four on one spot
    return places, rng.permutation(n).astype(np.int64) * 5


def view_of(n: int) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(2)
    heading = rng.normal(size=(3, n))
    return (*(heading / np.linalg.norm(heading, axis=0)).astype(np.float32), np.cos(rng.uniform(0, np.pi, n)).astype(np.float32))


def both(monkeypatch: pytest.MonkeyPatch, grid: CellGrid, *args: object, **named: object) -> tuple[Pairs, Pairs]:
    found = []
    for on in (False, True):
        monkeypatch.setattr(compiled, "wanted", lambda count, on=on: on)
        found.append(grid.pairs(*args, **named))
    return found[0], found[1]


def same(a: Pairs, b: Pairs) -> None:
    for name in COLUMNS:
        assert getattr(a, name).dtype == getattr(b, name).dtype
        assert np.array_equal(getattr(a, name), getattr(b, name)), name


@pytest.mark.parametrize("radius", RADII)
@pytest.mark.parametrize("extent", EXTENTS, ids=str)
def test_the_same_pairs_in_the_same_order(monkeypatch, extent, radius) -> None:
    places, ids = crowd(extent)
    for cell in (6.0, 80.0):
        grid = CellGrid(*places, ids, cell)
        plain, fast = both(monkeypatch, grid, None, RADII[radius])
        same(plain, fast)
        assert fast.i.size > 0
        same(*both(monkeypatch, grid, None, RADII[radius], view=view_of(2000)))


@pytest.mark.parametrize("ascending", [False, True])
@pytest.mark.parametrize("extent", (*EXTENTS, (0, 0, 0)), ids=str)
def test_the_same_order_of_cells(monkeypatch, extent, ascending) -> None:
    places, ids = crowd(extent)
    if ascending:
        ids = np.sort(ids)
    nobody = [np.full(5, np.nan, np.float32)] * 3
    for cell in (0.0, 6.0, 80.0, 5e4, np.inf):
        for columns, names in ((places, ids), (nobody, np.arange(5)), ([np.empty(0, np.float32)] * 3, np.arange(0))):
            found = []
            for on in (False, True):
                monkeypatch.setattr(compiled, "wanted", lambda count, on=on: on)
                found.append(ordered(*columns, names, cell))
            plain, fast = found
            assert plain.shape == fast.shape
            for name in ("rows", "keys", "starts"):
                a, b = getattr(plain, name), getattr(fast, name)
                assert (a is None) == (b is None) and (a is None or (a.dtype == b.dtype and np.array_equal(a, b))), name
            assert all(a.tobytes() == b.tobytes() for a, b in zip(plain.places, fast.places, strict=True))


def test_a_cell_table_too_large_to_list_is_searched(monkeypatch) -> None:
    places, ids = crowd(EXTENTS[4])
    grid = CellGrid(*places, ids, 2e4)
    assert grid._starts is None
    plain, fast = both(monkeypatch, grid, None, 1e5)
    same(plain, fast)
    assert fast.i.size > 1000


def test_others_ask_and_some_rows_of_them(monkeypatch) -> None:
    places, ids = crowd(EXTENTS[0])
    asking, _ = crowd((500, 60, 300), 900)
    grid = CellGrid(*places, ids, 20.0)
    named = dict(zip(("qx", "qy", "qz"), asking, strict=True))
    rows = np.array([5, 800, 800, 3, 77])
    for chosen, m in ((None, 900), (rows, 5)):
        plain, fast = both(monkeypatch, grid, chosen, 30.0, **named, view=view_of(m))
        same(plain, fast)
        assert fast.i.size > 0
    nobody = CellGrid(*(np.empty(0, np.float32),) * 3, np.empty(0, np.int64), 5.0)
    assert both(monkeypatch, nobody, None, 5.0, **named)[1].i.size == 0
    assert both(monkeypatch, grid, np.empty(0, np.intp), 5.0)[1].i.size == 0


def test_arrays_that_grow_and_several_threads(monkeypatch) -> None:
    monkeypatch.setattr(compiled, "PART", 500)
    places, ids = crowd((90, 2, 90))
    for named in ({}, {"threads": 3}, {"threads": 3, "view": view_of(2000)}):
        plain, fast = both(monkeypatch, CellGrid(*places, ids, 3.0), None, 12.0, **named)
        same(plain, fast)
        assert fast.i.size > 3 * 8 * 2000 / (2 if "view" in named else 1)


def test_more_than_the_cap_is_left_to_numpy(monkeypatch) -> None:
    places, ids = crowd((30, 1, 30))
    grid = CellGrid(*places, ids, 8.0)
    for named in ({}, {"view": view_of(2000)}, {"view": view_of(2000), "threads": 2}):
        same(*both(monkeypatch, grid, None, 8.0, **named))
    monkeypatch.setattr(neighbours, "NEIGHBOURS", int(np.bincount(grid.pairs(None, 3.0).i).max()))
    compiled_only = grid._compiled(tuple(places), np.full(2000, 3.0, np.float32), ids, None, 1)
    assert compiled_only is not None  # as many as the cap, and no more
    monkeypatch.setattr(neighbours, "NEIGHBOURS", neighbours.NEIGHBOURS - 1)
    assert grid._compiled(tuple(places), np.full(2000, 3.0, np.float32), ids, None, 1) is None


@pytest.mark.slow
def test_a_crowd_goes_the_same_way_compiled_and_not(monkeypatch) -> None:
    hashes = []
    for on in (False, True):
        monkeypatch.setattr(compiled, "wanted", lambda count, on=on: on)
        under_way = world(Options(threads=2), count=600, around=(70.0, 0.0, 50.0), radius=60.0)
        hashes.append([])
        for _ in range(12):
            step(under_way)
            hashes[-1].append(state_hash(under_way))
    assert hashes[0] == hashes[1]


def near_items(seen: dict, places, radius) -> list[tuple]:
    """Pairs by row and item, with their way and distance, from one item after another."""
    found = []
    for k in range(len(seen["x"])):
        way = [seen[axis][k] - place for axis, place in zip("xyz", places, strict=True)]
        distance = np.sqrt((way[0] * way[0] + way[1] * way[1]) + way[2] * way[2])
        found += [(i, k, *(w[i].tobytes() for w in (*way, distance))) for i in np.flatnonzero(distance <= radius)]
    return sorted(found)


@pytest.mark.parametrize("many", [0, 1, 7, 200])
def test_items_are_found_the_same_in_every_way(monkeypatch: pytest.MonkeyPatch, many: int) -> None:
    from antdsl.runtime import item_pairs

    places, _ = crowd((400, 10, 400), 1000)
    rng = np.random.default_rng(4)
    seen = {axis: rng.uniform(-200, 200, many).astype(np.float32) for axis in "xyz"}
    for axis, values in seen.items():
        values[: many // 50] = {"x": np.nan, "y": np.inf, "z": 3e38}[axis]
        values[many // 50 : many // 20] = places["xyz".index(axis)][0]
    places[0][5], places[1][6], places[2][7] = np.nan, np.inf, -3e38
    items = type("Held", (), {"seen": seen, "__len__": lambda self: many})()
    numbers = rng.uniform(-5, 300, 1000).astype(np.float32)
    numbers[::50] = np.nan
    monkeypatch.setattr(item_pairs, "_MEASURED", 5000)
    for radius in (np.float32(np.inf), np.float32(60), np.float32(0), numbers):
        reach = np.broadcast_to(radius, 1000).astype(np.float32)
        monkeypatch.setattr(item_pairs, "_MANY_ITEMS", 1000)
        with np.errstate(all="ignore"):
            wanted = near_items(seen, places, radius)
            ways = [item_pairs.each(items, tuple(places), reach)]
            ways += [item_pairs.along(items, tuple(places), reach)] if many else []
            for fast in (False, True):
                monkeypatch.setattr(compiled, "wanted", lambda count, fast=fast: fast)
                ways.append(item_pairs.items_within(items, tuple(places), radius, 1000))
        for columns in ways:
            assert [column.dtype.itemsize for column in columns] == [8, 8, 4, 4, 4, 4]
            assert [(i, j, *(w.tobytes() for w in way)) for i, j, *way in zip(*columns, strict=True)] == wanted


def test_parts_walked_side_by_side_come_to_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled, "wanted", lambda count: True)
    monkeypatch.setattr(compiled, "PART", 100)
    hashes = []
    for threads in (1, 3):
        crowd_of_many = world(count=700, scene=EXAMPLE / "many.yaml", options=Options(threads=threads))
        for _ in range(8):
            step(crowd_of_many)
        hashes.append(state_hash(crowd_of_many))
    assert hashes[0] == hashes[1]


_RNG = np.random.default_rng(1)
_NUMBERS = (_RNG.normal(0, 1, 4000) * 10 ** _RNG.uniform(-6, 5, 4000)).astype(np.float32)
_NUMBERS = np.concatenate([_NUMBERS, np.array([0.0, -0.0, 1e-38, -1e-45, 3e-39], np.float32)])
_GRID = DistanceGrid(_RNG.normal(0, 100, (200, 1, 3)) + _RNG.normal(0, 3, (200, 3, 3)), 20_000)
_PLACES = _RNG.normal(0, 200, (3, 4000)).astype(np.float32)
_IDS = np.concatenate([np.arange(500), _RNG.integers(0, 2**62, 500)])
LOOPS = {
    "sin": lambda: elementary.sin(_NUMBERS),
    "sin, far": lambda: elementary.sin(_NUMBERS * np.float32(1e9)),
    "cos": lambda: elementary.cos(_NUMBERS),
    "exp": lambda: elementary.exp(np.append(_NUMBERS, np.float32(np.inf))),
    "exp, nan": lambda: elementary.exp(np.append(_NUMBERS, np.float32(np.nan))),
    "log": lambda: elementary.log(np.abs(_NUMBERS) + np.float32(1e-42)),
    "log, odd": lambda: elementary.log(_NUMBERS),
    "atan2": lambda: elementary.atan2(_NUMBERS, _NUMBERS[::-1]),
    "atan2, inf": lambda: elementary.atan2(np.append(_NUMBERS, np.float32(np.inf)), np.append(_NUMBERS, np.float32(1))),
    "at_least": lambda: _GRID.at_least(*_PLACES),
    **{f"uniform {k}": lambda k=k: randomness.uniform(2**40 + 5, -3, "ant", "wander", k, _IDS) for k in range(6)},
    **{f"word {k}": lambda k=k: randomness.word(2**40 + 5, -3, "ant", "wander", k, _IDS) for k in range(6)},
}


@pytest.mark.filterwarnings("ignore:overflow")
@pytest.mark.parametrize("name", LOOPS)
def test_elementary_functions_draws_and_clearances_are_the_same_compiled(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    found = []
    for wanted in (False, True):
        monkeypatch.setattr(compiled, "wanted", lambda count, wanted=wanted: wanted)
        found.append(LOOPS[name]())
    assert found[0].dtype == found[1].dtype and found[0].tobytes() == found[1].tobytes()
