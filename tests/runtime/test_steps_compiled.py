"""Kernels of the phases of a step give the bits of the NumPy version that stands beside them."""

from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest

from antdsl.bench.cases import case_of
from antdsl.fields import cells as cell_tables
from antdsl.fields.cells import SurfaceCells
from antdsl.fields.growing import GrowingCells
from antdsl.fields.pheromone import PheromoneField
from antdsl.machine_code.memory import has_room, roomy, roomy_rows
from antdsl.numerics import compiled
from antdsl.plan import ir
from antdsl.runtime import Options, bind, claims, motion_measures, state_hash, step
from antdsl.runtime.requests import ClaimEntry
from antdsl.runtime.world import select_rows
from antdsl.senses.overlaps import worst_overlaps
from tests.compilers import need_llvmlite

SLOPE = (np.array([[0, 0, 0], [60, 0, 0], [60, 60, 12], [0, 60, 0]], float), np.array([[0, 1, 2], [0, 2, 3]]))


@pytest.fixture
def by_kernels(monkeypatch):
    """Chooses whether kernels run."""
    need_llvmlite()
    return lambda fast: monkeypatch.setattr(compiled, "wanted", lambda count: fast and count > 0)


def bits(array):
    return array.view({4: np.int32, 8: np.int64}[array.dtype.itemsize])


def test_every_half_chord_near_a_bin_is_counted_where_numpy_counts_it():
    least, first = motion_measures._bins()
    near = least[1:-1].view(np.int32).astype(np.int64)[:, None] + np.arange(-32, 33)
    half = np.clip(near, 0, np.float32(1).view(np.int32)).astype(np.int32).ravel().view(np.float32)
    half = np.concatenate([half, np.random.default_rng(1).random(100_000, np.float32), np.float32([0, 1])])
    wanted = motion_measures._bin_of(motion_measures._angle(half))
    assert np.array_equal(np.searchsorted(least[1:-1], half, side="right"), wanted)
    assert (first[(half * np.float32(4096)).astype(np.int64)] <= wanted).all()


def test_claims_are_served_as_numpy_serves_them(by_kernels):
    rng = np.random.default_rng(4)
    for count in (1, 2, 9, 300):
        item = np.sort(rng.integers(0, 40, count))
        change = rng.choice([0.0, 0.25, 1.0, 1.0, 3.0, np.nan, np.inf], count, p=[0.1, 0.3, 0.2, 0.2, 0.16, 0.02, 0.02])
        found = []
        for fast in (False, True):
            by_kernels(fast)
            rest = np.random.default_rng(5).random(40) * 8
            asks = claims._Asks(change, np.zeros(count, bool), np.zeros(count, np.float32), np.zeros(count, bool), 0.0)
            found.append((claims._served(rest, item, asks), rest))
        (got, rest), (own, left) = found
        assert np.array_equal(bits(got), bits(own)) and np.array_equal(bits(rest), bits(left))
        assert count < 300 or ((got >= 0).any() and (got < 0).any())


def claim(rng, count):
    """A population of so many agents and claims of two thirds of them on 40 things, of which some are not there."""
    rows = np.sort(rng.permutation(count)[: 2 * count // 3 + 1])
    statement = ir.Claim(
        "food", "load", None, ir.Node("const", (), (1.0,), ir.Kind.F32, ir.Rate.CONST, None, 0), "won", "load", "site", None
    )
    now = {"load": rng.random(count, np.float32) * 3, "won": np.zeros(count, np.bool_)}
    population = SimpleNamespace(name="a", ids=rng.permutation(count), now=now)
    amount = rng.choice(np.float32([0, 0.1, 0.25, 1, 3, np.nan, -1]), len(rows))
    return population, ClaimEntry(statement, 0, rows, rng.integers(-1, 41, len(rows)).astype(np.int32), amount)


@pytest.mark.parametrize("all_of_it", [False, True])
def test_claims_of_one_statement_are_settled_as_numpy_settles_them(by_kernels, all_of_it):
    world = SimpleNamespace(setting=SimpleNamespace(seed=3), frame=5)
    for count in (1, 2, 9, 300):
        found = []
        for fast in (False, True):
            by_kernels(fast)
            rng = np.random.default_rng(count)
            population, entry = claim(rng, count)
            population.all_taken = {}
            if all_of_it:
                entry.amount[len(entry.amount) // 2] = np.inf
            rest = rng.random(40) * 8
            claims._settle_one(world, rest, entry.item, entry.amount, 0.0, [(population, entry)])
            found.append((bits(rest), bits(population.now["load"]), population.now["won"]))
        for plain, own in zip(*found, strict=True):
            assert np.array_equal(plain, own)
        assert count < 300 or (own.any() and (~own[entry.rows[entry.amount >= 0]]).any())


def flock(count):
    """Boids before their first step."""
    shot = case_of("boids").make(count)
    return bind(shot.plan, shot.setting, Options(backend="numpy"))


def wander(population, rng):
    """Registers as a step may leave them: turned, tilted, some standing that wish to walk."""
    n = len(population)
    for name, spread in (("position", 3.0), ("velocity", 30.0), ("heading", 0.3), ("up", 0.2), ("push", 0.5)):
        for k, axis in enumerate("xyz"):
            register = f"{name}.{axis}"
            population.start[register][:] = population.now[register]
            population.now[register][:] = rng.normal(0, spread, n) * (rng.random(n) < 0.7)
            if name == "position":
                population.now[register] += population.start[register]
                population.position[:, k] = population.now[register]


def test_measures_of_motion_are_the_same(by_kernels):
    found = []
    for fast in (False, True):
        by_kernels(fast)
        world, rng = flock(700), np.random.default_rng(8)
        population = world.populations["boid"]
        for frame in range(110):
            wander(population, rng)
            world.motion._step(world, population)
            if frame % 10 == 5:
                select_rows(population, rng.permutation(len(population)))
        found.append(world.motion.arrays())
    assert found[0].keys() == found[1].keys() and found[0]["ways"] > 100 and found[0]["standing"] > 0
    assert all(np.array_equal(found[0][name], found[1][name]) for name in found[0])


def test_ways_go_with_their_agents_when_rows_change():
    world, rng = flock(60), np.random.default_rng(4)
    population, motion = world.populations["boid"], world.motion
    for _ in range(3):
        wander(population, rng)
        motion._step(world, population)
    for kept in (60, 60, 41, 41):
        before = dict(zip(population.ids.tolist(), motion._window(population).path.tolist(), strict=True))
        select_rows(population, rng.permutation(len(population))[:kept])
        window = motion._window(population)
        assert window.ids is population.ids and window.path.tolist() == [before[i] for i in population.ids.tolist()]
    before = dict(zip(population.ids.tolist(), window.path.tolist(), strict=True))
    for kept in (41, 30):  # two changes since it was last looked at
        select_rows(population, rng.permutation(len(population))[:kept])
    assert motion._window(population).path.tolist() == [before[i] for i in population.ids.tolist()]


@pytest.mark.parametrize("combine, limit", [*product(("add", "max"), (np.inf, 3.0))])
def test_a_step_of_a_field_is_the_same(by_kernels, combine, limit):
    cells = SurfaceCells([SLOPE], 2.0)
    for stencil, first, diffusion, keep in product((4, 8), (False, True), (0.0, 2.0), (1.0, 0.97)):
        found = []
        for fast in (False, True):
            by_kernels(fast)
            field, rng = PheromoneField(cells, combine, limit, stencil, first), np.random.default_rng(3)
            for number in range(12):
                if number % 3 == 0:
                    field.deposit(rng.integers(0, len(cells), 50).astype(np.int32), 2 * rng.random(50, np.float32))
                if number == 7:
                    field.leave(np.arange(5), np.full(5, 0.25))
                field.step(keep, diffusion, 1 / 24)
            found.append(field.values.copy())
        assert np.array_equal(*map(bits, found)) and found[0].any()


@pytest.mark.parametrize("first", (False, True))
def test_a_field_that_is_full_everywhere_spreads_the_same(by_kernels, first):
    cells, found = SurfaceCells([SLOPE], 2.0), []
    for fast in (False, True):
        by_kernels(fast)
        field = PheromoneField(cells, "add", 3.0, 8, first)
        for _ in range(6):
            field.deposit(np.arange(len(cells), dtype=np.int32), np.full(len(cells), 7, np.float32))
            field.step(1.0, 16.0, 1 / 24)
        found.append(field.values.copy())
    assert np.array_equal(*map(bits, found))


@pytest.mark.parametrize("kind, dense", [*product((SurfaceCells, GrowingCells), (8_000_000, 0))])
def test_cells_of_agents_are_the_same(by_kernels, monkeypatch, kind, dense):
    monkeypatch.setattr(cell_tables, "_DENSE", dense)
    cells, rng, known, room = kind([SLOPE], 2.0), np.random.default_rng(1), None, None
    points = rng.random((3, 1500)).T * [60, 60, 12]
    points[:, 2] = points[:, 0] * points[:, 1] / 300
    for number in range(6):
        points = np.asarray(points + rng.normal(0, 0.4, points.shape), order="FC"[number % 2])
        points[3], points[4] = np.nan, 1e9
        side = np.where(rng.random(1500) < 0.1, rng.integers(0, 6, 1500), 4).astype(np.int8)
        by_kernels(True)
        room, known = cells.follow(points, side, known, room)
        by_kernels(False)
        assert np.array_equal(room, cells.follow(points, side, None)[0])
    assert 0.5 < (room >= 0).mean() < 1


@pytest.mark.parametrize("count, box", [(1500, 60), (1500, 8), (3, 1), (1500, 2e5)])
def test_overlaps_are_the_same(by_kernels, count, box):
    rng = np.random.default_rng(count)
    x, y, z = (rng.random((3, count)) * box).astype(np.float32)
    radius = (2 * rng.random(count)).astype(np.float32)
    x[0], z[1], radius[2] = np.nan, np.inf, 0
    found = []
    for fast in (False, True):
        by_kernels(fast)
        found.append(worst_overlaps(x, y, z, radius))
    assert np.array_equal(*map(bits, found)) and (box == 60) <= (0 < found[0].max() < 1)


def test_rows_are_put_in_order_in_arrays_with_room():
    array = np.arange(100, dtype=np.float32)
    rows = np.random.default_rng(0).permutation(100)[:70]
    found = roomy_rows(array, rows)
    assert np.array_equal(found, array[rows]) and has_room(found) and has_room(roomy(array))
    assert not found.base[70:].any()
    assert not any(map(has_room, (array, array[:95], array[4:50], np.zeros((3, 50), np.float32)[0])))


def test_parts_on_threads_give_the_same_bits_as_one(by_kernels, monkeypatch):
    by_kernels(True)
    shot, whole, parts, split = case_of("foraging").make(1_500), compiled.in_parts, compiled.parts, []

    def parted(work, count, threads, least=0):
        split.append(min(threads, count // 50) > 1)
        return whole(work, count, threads, 50)

    def stepped(threads):
        world = bind(shot.plan, shot.setting, Options(backend="native", threads=threads, wait_for_code=True))
        for _ in range(3):
            step(world)
        return state_hash(world), world.motion.arrays()

    alone, counted = stepped(1)
    monkeypatch.setattr(compiled, "in_parts", parted)
    monkeypatch.setattr(compiled, "parts", lambda count, threads, least=0: parts(count, threads, 50))
    found, other = stepped(3)
    assert found == alone and sum(split) > 15
    assert counted.keys() == other.keys() and all(np.array_equal(counted[name], other[name]) for name in counted)
