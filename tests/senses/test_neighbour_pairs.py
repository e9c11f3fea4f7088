"""Neighbours in odd crowds against all pairs; the order of cells; items; whole steps in parallel parts."""

from __future__ import annotations

import numpy as np
import pytest
from foraging_shots import EXAMPLE, world

from antdsl import limits
from antdsl.numerics import parallel
from antdsl.runtime import Options, item_pairs, state_hash, step
from antdsl.senses import neighbours
from antdsl.senses.cell_order import Shape, ordered
from antdsl.senses.neighbours import CellGrid, Pairs, TooManyWithin

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


def all_pairs(grid: CellGrid, query, radius, who=None, view=None) -> list[tuple[np.ndarray, ...]]:
    """Pairs as `CellGrid.pairs` gives them, from all candidates of one query after another."""
    reach = np.broadcast_to(np.float32(radius), query[0].shape)
    key = np.full(len(grid.ids), -1)
    key[grid._rows] = grid._keys
    found = []
    with np.errstate(all="ignore"):
        for i in np.flatnonzero(np.isfinite(query[0]) & np.isfinite(query[1]) & np.isfinite(query[2]) & (reach >= 0)):
            way = [place - q[i] for place, q in zip((grid.x, grid.y, grid.z), query, strict=True)]
            distance = np.sqrt((way[0] * way[0] + way[1] * way[1]) + way[2] * way[2])
            j = np.flatnonzero((distance <= reach[i]) & (key >= 0))
            j = j if who is None else j[grid.ids[j] != who[i]]
            j = j[np.lexsort((grid.ids[j], distance[j]))][: neighbours.NEIGHBOURS]
            j = j[np.lexsort((grid.ids[j], key[j]))]
            if view is not None:
                ahead = (way[0][j] * view[0][i] + way[1][j] * view[1][i]) + way[2][j] * view[2][i]
                j = j[ahead >= view[3][i] * distance[j]]
            found.append((np.full(len(j), i), j, *(each[j] for each in (*way, distance))))
    return [np.concatenate(column) for column in zip(*found, strict=True)]


def assert_same(pairs: Pairs, wanted: list[np.ndarray]) -> None:
    for name, own in zip(Pairs.__slots__, wanted, strict=True):
        assert np.array_equal(getattr(pairs, name), own), name
    assert [getattr(pairs, name).dtype.itemsize for name in Pairs.__slots__] == [8, 8, 4, 4, 4, 4]


@pytest.mark.parametrize("radius", RADII)
@pytest.mark.parametrize("extent", EXTENTS, ids=str)
def test_pairs_are_all_in_reach_in_the_order_of_cells_and_ids(extent, radius) -> None:
    places, ids = crowd(extent)
    for cell in (6.0, 80.0):
        grid = CellGrid(*places, ids, cell)
        pairs = grid.pairs(None, RADII[radius])
        assert_same(pairs, all_pairs(grid, places, RADII[radius], ids))
        assert pairs.i.size > 0
    assert_same(grid.pairs(None, RADII[radius], view=view_of(2000)), all_pairs(grid, places, RADII[radius], ids, view_of(2000)))


@pytest.mark.parametrize("ascending", [False, True])
@pytest.mark.parametrize("extent", (*EXTENTS, (0, 0, 0)), ids=str)
def test_agents_are_put_in_the_order_of_cells_and_ids(extent, ascending) -> None:
    places, ids = crowd(extent)
    if ascending:
        ids = np.sort(ids)
    nobody = [np.full(5, np.nan, np.float32)] * 3
    for cell in (0.0, 6.0, 80.0, 5e4, np.inf):
        for columns, names in ((places, ids), (nobody, np.arange(5)), ([np.empty(0, np.float32)] * 3, np.arange(0))):
            found = ordered(*columns, names, cell)
            rows = np.flatnonzero(np.isfinite(columns[0]) & np.isfinite(columns[1]) & np.isfinite(columns[2]))
            wide = [np.float64(column[rows]) for column in columns]
            box = [[float(each.min()) for each in wide], [float(each.max()) for each in wide]] if len(rows) else [[0.0] * 3] * 2
            shape = Shape.of(*box, cell)
            shape = shape.as_sheet() if shape.is_sheet(wide) else shape
            assert found.shape == shape
            fast, middle, slow = (
                np.floor((wide[axis] - low) / width).astype(int)
                for axis, low, width in zip(shape.axes, shape.low, shape.width, strict=True)
            )
            key = (slow * shape.size[1] + middle) * shape.size[0] + fast
            order = np.lexsort((names[rows], key))
            assert np.array_equal(found.rows, rows[order]) and np.array_equal(found.keys, key[order])
            assert all(np.array_equal(own, column[rows[order]]) for own, column in zip(found.places, columns, strict=True))
            assert (found.starts is None) == (shape.cells > max(1 << 16, 16 * len(rows)))
            if found.starts is not None:
                assert np.array_equal(found.starts, np.searchsorted(key[order], np.arange(shape.cells + 1)))


def test_a_cell_table_too_large_to_list_is_searched() -> None:
    places, ids = crowd(EXTENTS[4])
    grid = CellGrid(*places, ids, 2e4)
    assert grid._starts is None
    pairs = grid.pairs(None, 1e5)
    assert_same(pairs, all_pairs(grid, places, 1e5, ids))
    assert pairs.i.size > 1000


def test_others_ask_and_some_rows_of_them() -> None:
    places, ids = crowd(EXTENTS[0])
    asking, _ = crowd((500, 60, 300), 900)
    grid = CellGrid(*places, ids, 20.0)
    named = dict(zip(("qx", "qy", "qz"), asking, strict=True))
    rows = np.array([5, 800, 800, 3, 77])
    for chosen, m in ((None, 900), (rows, 5)):
        pairs = grid.pairs(chosen, 30.0, **named, view=view_of(m))
        query = asking if chosen is None else [place[chosen] for place in asking]
        assert_same(pairs, all_pairs(grid, query, 30.0, None, view_of(m)))
        assert pairs.i.size > 0
    nobody = CellGrid(*(np.empty(0, np.float32),) * 3, np.empty(0, np.int64), 5.0)
    assert nobody.pairs(None, 5.0, **named).i.size == 0
    assert grid.pairs(np.empty(0, np.intp), 5.0).i.size == 0


def test_arrays_grow_and_several_threads_come_to_the_same(monkeypatch) -> None:
    monkeypatch.setattr(parallel, "PART", 500)
    places, ids = crowd((90, 2, 90))
    grid = CellGrid(*places, ids, 3.0)
    for view in (None, view_of(2000)):
        wanted = all_pairs(grid, places, 12.0, ids, view)
        assert len(wanted[0]) > 3 * 8 * 2000 / (1 if view is None else 2)
        for threads in (1, 3):
            assert_same(grid.pairs(None, 12.0, threads=threads, view=view), wanted)


def test_of_more_than_the_cap_the_nearest_stay() -> None:
    places, ids = crowd((30, 1, 30))
    places[0][1000:1400] = np.round(places[0][1000:1400])  # many as near
    places[1][1000:1400], places[2][1000:1400] = 0.0, np.round(places[2][1000:1400])
    for place in places:
        place[1500:1800] = place[1500]  # more than the cap on one spot
    grid = CellGrid(*places, ids, 8.0)
    for view in (None, view_of(2000)):
        wanted = all_pairs(grid, places, 8.0, ids, view)
        for threads in (1, 2):
            assert_same(grid.pairs(None, 8.0, view=view, threads=threads), wanted)
    assert_same(grid.pairs(None, np.inf), all_pairs(grid, places, np.inf, ids))
    asking = dict(zip(("qx", "qy", "qz"), (place[:50] for place in places), strict=True))
    assert_same(grid.pairs(None, 20.0, **asking), all_pairs(grid, [place[:50] for place in places], 20.0))


def test_more_than_the_limit_within_a_radius_are_refused() -> None:
    places, ids = crowd((30, 1, 30))
    grid = CellGrid(*places, ids, 8.0)
    most = max(len(np.flatnonzero(np.linalg.norm(np.stack(places) - p[:, None], axis=0) <= 8)) for p in np.stack(places).T) - 1
    assert most > limits.NEIGHBOURS
    for threads in (1, 2):
        with pytest.raises(TooManyWithin):
            grid.pairs(None, 8.0, limit=most - 1, threads=threads)
        assert grid.pairs(None, 8.0, limit=most, threads=threads).i.size > 0


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
            ways.append(item_pairs.items_within(items, tuple(places), radius))
        for columns in ways:
            assert [column.dtype.itemsize for column in columns] == [8, 8, 4, 4, 4, 4]
            assert [(i, j, *(w.tobytes() for w in way)) for i, j, *way in zip(*columns, strict=True)] == wanted


def test_parts_walked_side_by_side_come_to_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parallel, "PART", 100)
    hashes = []
    for threads in (1, 3):
        crowd_of_many = world(count=700, scene=EXAMPLE / "many.yaml", options=Options(threads=threads))
        for _ in range(8):
            step(crowd_of_many)
        hashes.append(state_hash(crowd_of_many))
    assert hashes[0] == hashes[1]
