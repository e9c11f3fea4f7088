"""Neighbours in odd crowds against all pairs; the order of cells; items; whole steps in parallel parts."""

from __future__ import annotations

import numpy as np
import pytest
from foraging_shots import EXAMPLE, world

from antdsl import limits
from antdsl.numerics import parallel
from antdsl.numerics.sorting import sort_stably
from antdsl.runtime import Options, state_hash, step
from antdsl.runtime.sensing import item_pairs
from antdsl.senses import cell_order, neighbours
from antdsl.senses.cell_order import NO_ORDER, CellOrder, GridShape, find_bounding_box, pack_columns_by_position
from antdsl.senses.neighbours import CellGrid, NeighbourPairs, TooManyNeighboursError

EXTENTS = ((400, 10, 400), (100, 100, 100), (3000, 0, 0), (0, 900, 0), (9e6, 4e4, 9e6), (60, 1, 60))
RADII = {
    "one": 6.5,
    "each": np.random.default_rng(7).uniform(0, 25, 2000).astype(np.float32),
    "odd": np.resize(np.array([5, np.nan, -1, 0, 12.5, 1e-30], np.float32), 2000),
    "wide": 18.0,
}


def crowd(extent: tuple[float, ...], n: int = 2000) -> tuple[list[np.ndarray], np.ndarray]:
    rng = np.random.default_rng(n)
    positions = [rng.uniform(-0.5 * e, 0.5 * e, n).astype(np.float32) for e in extent]
    positions[0][::500] = np.nan
    positions[2][1::700] = np.inf
    for place in positions:
        place[10:13] = place[9]  # four on one spot
    return positions, rng.permutation(n).astype(np.int64) * 5


def view_of(n: int) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(2)
    heading = rng.normal(size=(3, n))
    return (*(heading / np.linalg.norm(heading, axis=0)).astype(np.float32), np.cos(rng.uniform(0, np.pi, n)).astype(np.float32))


def all_pairs(grid: CellGrid, query, radius, who=None, view=None) -> list[tuple[np.ndarray, ...]]:
    """Pairs as `CellGrid.pairs` gives them, from all candidates of one query after another."""
    reach = np.broadcast_to(np.float32(radius), query[0].shape)
    key = np.where(np.isfinite([grid.x, grid.y, grid.z]).all(axis=0), cells_of(grid.shape, [grid.x, grid.y, grid.z]), -1)
    result = []
    with np.errstate(all="ignore"):
        for i in np.flatnonzero(np.isfinite(query[0]) & np.isfinite(query[1]) & np.isfinite(query[2]) & (reach >= 0)):
            path = [place - q[i] for place, q in zip((grid.x, grid.y, grid.z), query, strict=True)]
            distance = np.sqrt((path[0] * path[0] + path[1] * path[1]) + path[2] * path[2])
            j = np.flatnonzero((distance <= reach[i]) & (key >= 0))
            j = j if who is None else j[grid.ids[j] != who[i]]
            j = j[np.lexsort((grid.ids[j], distance[j]))][: neighbours.MAX_QUERY_NEIGHBOURS]
            j = j[np.lexsort((grid.ids[j], key[j]))]
            if view is not None:
                ahead = (path[0][j] * view[0][i] + path[1][j] * view[1][i]) + path[2][j] * view[2][i]
                j = j[ahead >= view[3][i] * distance[j]]
            result.append((np.full(len(j), i), j, *(each[j] for each in (*path, distance))))
    return [np.concatenate(column) for column in zip(*result, strict=True)]


def assert_same(pairs: NeighbourPairs, expected: list[np.ndarray]) -> None:
    for name, own in zip(NeighbourPairs.__slots__, expected, strict=True):
        assert np.array_equal(getattr(pairs, name), own), name
    assert [getattr(pairs, name).dtype.itemsize for name in NeighbourPairs.__slots__] == [8, 8, 4, 4, 4, 4]


@pytest.mark.parametrize("radius", RADII)
@pytest.mark.parametrize("extent", EXTENTS, ids=str)
def test_pairs_are_all_in_reach_in_the_order_of_cells_and_ids(extent, radius) -> None:
    positions, ids = crowd(extent)
    for cell in (6.0, 80.0):
        grid = CellGrid(*positions, ids, cell)
        pairs = grid.find_pairs(None, RADII[radius])
        assert_same(pairs, all_pairs(grid, positions, RADII[radius], ids))
        assert pairs.i.size > 0
    assert_same(
        grid.find_pairs(None, RADII[radius], view=view_of(2000)), all_pairs(grid, positions, RADII[radius], ids, view_of(2000))
    )


def cells_of(shape: GridShape, positions) -> np.ndarray:
    """The number of each agent's cell; as many as there are cells where a place is not finite."""
    key = np.zeros(len(positions[0]), np.int64)
    finite = np.isfinite(np.array(positions)).all(axis=0)
    for axis, low, width, size in reversed(
        list(zip(shape.axes, shape.low_corner, shape.cell_widths, shape.cells_per_axis, strict=True))
    ):
        along = np.where(finite, positions[axis], low).astype(np.float64)
        key = key * size + np.clip(np.floor((along - low) * (1 / width)), 0, size - 1).astype(np.int64)
    return np.where(finite, key, shape.cell_count)


@pytest.mark.parametrize("threads", [1, 2, 3, 4])
@pytest.mark.parametrize("extent", (*EXTENTS, (0, 0, 0)), ids=str)
def test_agents_are_sorted_by_cells(monkeypatch: pytest.MonkeyPatch, extent, threads: int) -> None:
    monkeypatch.setattr(cell_order, "_MIN_CHUNKED_AGENTS", 20)
    for name in ("MIN_LIGHT_ITEMS_PER_THREAD", "MIN_AGENTS_PER_THREAD"):
        monkeypatch.setattr(parallel, name, 16)
    for module in (cell_order, parallel):
        monkeypatch.setattr(module, "count_available_cores", lambda: threads)
    many, ids = crowd(extent)
    crowds = [[each[:count] for each in many] for count in (0, 1, 2, 8, 50, 333, 2000)]
    for positions in (*crowds, [np.full(5, np.nan, np.float32)] * 3):
        columns, count = tuple(np.ascontiguousarray(each) for each in positions), len(positions[0])
        finite = np.isfinite(np.array(columns)).all(axis=0)
        low, high = find_bounding_box(columns)
        assert low == [float(each[finite].min()) if finite.any() else 0 for each in columns]
        assert high == [float(each[finite].max()) if finite.any() else 0 for each in columns]
        order = CellOrder(count, threads)
        for cell in (6.0, 80.0, 0.0, 5e4, 2.0, np.inf):  # arrays serve again
            shape = GridShape.from_bounds(low, high, cell)
            for each in (shape, shape.flatten_to_one_layer() if shape.extent[2] > 0 else shape):
                key = cells_of(each, columns)
                for names in (NO_ORDER, sort_stably(ids[:count])):
                    order.sort(each, columns, names)
                    rows = names if names.size else np.arange(count)
                    rows = rows[np.argsort(key[rows], kind="stable")]
                    assert np.array_equal(order.rows, rows) and np.array_equal(order.position_by_row[rows], np.arange(count))
                    for own, column in zip(order.columns, columns, strict=True):
                        assert np.array_equal(own[:count], column[rows], equal_nan=True)
                    assert np.array_equal(
                        order.tables["places"][:count, :3].T, [column[rows] for column in columns], equal_nan=True
                    )
                    assert (
                        (order.tables["starts"] is None)
                        == (each.cell_count > max(1 << 16, 16 * count))
                        == (order.cell_starts.size == 0)
                    )
                    if order.cell_starts.size:
                        assert np.array_equal(
                            order.cell_starts[: each.cell_count + 1], np.searchsorted(key[rows], np.arange(each.cell_count + 1))
                        )
                    else:
                        assert np.array_equal(order.keys, key[rows]) and order.tables["keys"] is order.keys
                    width = order.tables["floats"][3:6]
                    assert width.tolist() == each.cell_widths and order.tables["whole"].tolist() == [
                        *each.axes,
                        *each.cells_per_axis,
                        count,
                    ]


@pytest.mark.parametrize(
    "layers, agents, sheet", [(1, 900, True), (2, 9000, True), (5, 9000, False), (5, 1200, True), (5, 300, True)]
)
def test_a_crowd_of_few_layers_is_a_sheet(layers: int, agents: int, sheet: bool) -> None:
    rng = np.random.default_rng(3)
    x, z = rng.uniform(0, 300, (2, agents)).astype(np.float32)
    y = (rng.integers(0, layers, agents) * 20 + rng.uniform(0, 1, agents)).astype(np.float32)
    x[::50] = np.nan
    shape = GridShape.from_bounds(*find_bounding_box((x, y, z)), 20.0)
    assert shape.is_one_layer_enough((x, y, z)) == sheet
    assert not GridShape.from_bounds([0, 0, 0], [300, 0, 300], 20.0).is_one_layer_enough((x, y, z))
    x[1:3], z[1:3] = (-1e6, 1e6), (-1e6, 1e6)
    shape = GridShape.from_bounds(*find_bounding_box((x, y, z)), 20.0)
    assert not shape.has_cell_table(agents) and shape.is_one_layer_enough((x, y, z)) == sheet


@pytest.mark.parametrize("count", [1, 3, 16, 2500])
def test_registers_are_sorted_by_cells(count: int) -> None:
    rng = np.random.default_rng(count)
    four, at = rng.random((4, count)).astype(np.float32), rng.permutation(count).astype(np.int32)
    expected, ordered = np.zeros((count, 4), np.float32), np.zeros((count, 4), np.float32)
    expected[at] = four.T
    for first in range(0, count, 1000):
        pack_columns_by_position(at, tuple(four), ordered.reshape(-1), first, min(first + 1000, count))
    assert np.array_equal(ordered, expected)


def test_a_cell_table_too_large_to_list_is_searched() -> None:
    positions, ids = crowd(EXTENTS[4])
    grid = CellGrid(*positions, ids, 2e4)
    assert not grid.order.cell_starts.size
    pairs = grid.find_pairs(None, 1e5)
    assert_same(pairs, all_pairs(grid, positions, 1e5, ids))
    assert pairs.i.size > 1000


def test_other_species_and_subsets_of_rows_can_query() -> None:
    positions, ids = crowd(EXTENTS[0])
    asking, _ = crowd((500, 60, 300), 900)
    grid = CellGrid(*positions, ids, 20.0)
    named = dict(zip(("qx", "qy", "qz"), asking, strict=True))
    rows = np.array([5, 800, 800, 3, 77])
    for chosen, m in ((None, 900), (rows, 5)):
        pairs = grid.find_pairs(chosen, 30.0, **named, view=view_of(m))
        query = asking if chosen is None else [place[chosen] for place in asking]
        assert_same(pairs, all_pairs(grid, query, 30.0, None, view_of(m)))
        assert pairs.i.size > 0
    empty_grid = CellGrid(*(np.empty(0, np.float32),) * 3, np.empty(0, np.int64), 5.0)
    assert empty_grid.find_pairs(None, 5.0, **named).i.size == 0
    assert grid.find_pairs(np.empty(0, np.intp), 5.0).i.size == 0


def test_growing_arrays_and_threads_give_equal_pairs(monkeypatch) -> None:
    monkeypatch.setattr(parallel, "MIN_AGENTS_PER_THREAD", 500)
    positions, ids = crowd((90, 2, 90))
    grid = CellGrid(*positions, ids, 3.0)
    for view in (None, view_of(2000)):
        expected = all_pairs(grid, positions, 12.0, ids, view)
        assert len(expected[0]) > 3 * 8 * 2000 / (1 if view is None else 2)
        for threads in (1, 3):
            assert_same(grid.find_pairs(None, 12.0, threads=threads, view=view), expected)


def test_the_nearest_neighbours_are_used_beyond_the_limit() -> None:
    positions, ids = crowd((30, 1, 30))
    positions[0][1000:1400] = np.round(positions[0][1000:1400])  # many as near
    positions[1][1000:1400], positions[2][1000:1400] = 0.0, np.round(positions[2][1000:1400])
    for place in positions:
        place[1500:1800] = place[1500]  # more than the cap on one spot
    grid = CellGrid(*positions, ids, 8.0)
    for view in (None, view_of(2000)):
        expected = all_pairs(grid, positions, 8.0, ids, view)
        for threads in (1, 2):
            assert_same(grid.find_pairs(None, 8.0, view=view, threads=threads), expected)
    assert_same(grid.find_pairs(None, np.inf), all_pairs(grid, positions, np.inf, ids))
    asking = dict(zip(("qx", "qy", "qz"), (place[:50] for place in positions), strict=True))
    assert_same(grid.find_pairs(None, 20.0, **asking), all_pairs(grid, [place[:50] for place in positions], 20.0))


def test_more_than_the_limit_within_a_radius_are_refused() -> None:
    positions, ids = crowd((30, 1, 30))
    grid = CellGrid(*positions, ids, 8.0)
    most = (
        max(len(np.flatnonzero(np.linalg.norm(np.stack(positions) - p[:, None], axis=0) <= 8)) for p in np.stack(positions).T) - 1
    )
    assert most > limits.MAX_QUERY_NEIGHBOURS
    for threads in (1, 2):
        with pytest.raises(TooManyNeighboursError):
            grid.find_pairs(None, 8.0, limit=most - 1, threads=threads)
        assert grid.find_pairs(None, 8.0, limit=most, threads=threads).i.size > 0


def near_items(visited: dict, positions, radius) -> list[tuple]:
    """Pairs by row and item, with their way and distance, from one item after another."""
    result = []
    for k in range(len(visited["x"])):
        path = [visited[axis][k] - place for axis, place in zip("xyz", positions, strict=True)]
        distance = np.sqrt((path[0] * path[0] + path[1] * path[1]) + path[2] * path[2])
        result += [(i, k, *(w[i].tobytes() for w in (*path, distance))) for i in np.flatnonzero(distance <= radius)]
    return sorted(result)


@pytest.mark.parametrize("many", [0, 1, 7, 200])
def test_all_searches_find_equal_items(monkeypatch: pytest.MonkeyPatch, many: int) -> None:
    positions, _ = crowd((400, 10, 400), 1000)
    rng = np.random.default_rng(4)
    visited = {axis: rng.uniform(-200, 200, many).astype(np.float32) for axis in "xyz"}
    for axis, values in visited.items():
        values[: many // 50] = {"x": np.nan, "y": np.inf, "z": 3e38}[axis]
        values[many // 50 : many // 20] = positions["xyz".index(axis)][0]
    positions[0][5], positions[1][6], positions[2][7] = np.nan, np.inf, -3e38
    items = type("Held", (), {"visible_values": visited, "__len__": lambda self: many})()
    numbers = rng.uniform(-5, 300, 1000).astype(np.float32)
    numbers[::50] = np.nan
    monkeypatch.setattr(item_pairs, "_PAIRS_PER_CHUNK", 5000)
    for radius in (np.float32(np.inf), np.float32(60), np.float32(0), numbers):
        reach = np.broadcast_to(radius, 1000).astype(np.float32)
        monkeypatch.setattr(item_pairs, "_MIN_ITEMS_TO_FILTER", 1000)
        with np.errstate(all="ignore"):
            expected = near_items(visited, positions, radius)
            paths = [item_pairs.find_pairs_among_all_items(items, tuple(positions), reach)]
            paths += [item_pairs.find_pairs_among_near_items(items, tuple(positions), reach)] if many else []
            paths.append(item_pairs.find_items_within(items, tuple(positions), radius))
        for columns in paths:
            assert [column.dtype.itemsize for column in columns] == [8, 8, 4, 4, 4, 4]
            assert [(i, j, *(w.tobytes() for w in path)) for i, j, *path in zip(*columns, strict=True)] == expected


def test_parallel_parts_give_equal_pairs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parallel, "MIN_AGENTS_PER_THREAD", 100)
    hashes = []
    for threads in (1, 3):
        crowd_of_many = world(count=700, scene=EXAMPLE / "many.yaml", options=Options(threads=threads))
        for _ in range(8):
            step(crowd_of_many)
        hashes.append(state_hash(crowd_of_many))
    assert hashes[0] == hashes[1]
