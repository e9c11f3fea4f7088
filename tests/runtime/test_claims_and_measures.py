"""Claims on amounts, served one after the other; measures of motion against plain NumPy; parallel parts of a step."""

from types import SimpleNamespace

import numpy as np
import pytest

from antdsl.bench.cases import find_case
from antdsl.machine_code.memory import copy_padded, gather_padded, has_padding
from antdsl.numerics import parallel, randomness
from antdsl.plan import ir
from antdsl.runtime import Options, bind, claims, motion_measures, state_hash, step
from antdsl.runtime.requests import ClaimEntry
from antdsl.runtime.world import retain_rows
from antdsl.senses.overlaps import measure_worst_overlaps


def test_every_half_chord_near_a_bin_is_counted_where_numpy_counts_it():
    least, first = motion_measures._make_bin_table()
    near = least[1:-1].view(np.int32).astype(np.int64)[:, None] + np.arange(-32, 33)
    half = np.clip(near, 0, np.float32(1).view(np.int32)).astype(np.int32).ravel().view(np.float32)
    half = np.concatenate([half, np.random.default_rng(1).random(100_000, np.float32), np.float32([0, 1])])
    expected = motion_measures._find_bins(motion_measures._compute_degrees(half))
    assert np.array_equal(np.searchsorted(least[1:-1], half, side="right"), expected)
    assert (first[(half * np.float32(4096)).astype(np.int64)] <= expected).all()


def serve(rest, item, asks):
    """What each claim gets, one after the other, and what is left; changes are whole quarters, so that sums are exact."""
    got, closed = np.full(len(item), -1.0), set()
    for k, which in enumerate(item.tolist()):
        part = asks.changes[k]
        if asks.claims_all[k]:
            part = float(asks.compute_total_amounts(np.array([k]), rest[[which]])[0])
        if which in closed or not part <= rest[which] or (asks.claims_all[k] and not part > 0):
            closed.add(which)
            continue
        got[k] = part
        rest[which] -= part
    return got


@pytest.mark.parametrize("share", [0.0, 0.15, 0.7])
@pytest.mark.parametrize("count", [0, 1, 2, 9, 300])
def test_claims_are_served_one_after_the_other(count, share):
    rng = np.random.default_rng(4)
    item = np.sort(rng.integers(0, 40 if share < 0.5 else 300, count))
    change = rng.choice([0.0, 0.25, 1.0, 3.0, np.nan, np.inf], count, p=[0.1, 0.3, 0.4, 0.16, 0.02, 0.02])
    every, rest = rng.random(count) < share, np.round(rng.random(300) * 32) / 4
    had, cached = np.round(rng.random(count) * 8).astype(np.float32), rng.random(count) < 0.5
    asks, left = claims._OrderedClaims(change, every, had, cached, 0.25), rest.copy()
    expected = serve(left, item, asks)
    got = claims._grant_amounts(rest, item, asks)
    assert np.array_equal(got, expected) and np.array_equal(rest, left)
    assert count < 300 or ((got >= 0).any() and (got < 0).any() and (share == 0 or (got[every] > 0).any()))


def claim(rng, count):
    """A population of so many agents and claims of two thirds of them on 40 things, of which some are not there."""
    rows = np.sort(rng.permutation(count)[: 2 * count // 3 + 1])
    statement = ir.Claim(
        "food",
        "load",
        None,
        ir.PlanNode("const", (), (1.0,), ir.ValueKind.F32, ir.UpdateRate.CONST, None, 0),
        "won",
        "load",
        "site",
        None,
    )
    now = {"load": rng.random(count, np.float32) * 3, "won": np.zeros(count, np.bool_)}
    population = SimpleNamespace(name="a", ids=rng.permutation(count), now=now)
    amount = rng.choice(np.float32([0, 0.1, 0.25, 1, 3, np.nan, -1]), len(rows))
    return population, ClaimEntry(statement, 0, rows, rng.integers(-1, 41, len(rows)).astype(np.int32), amount)


@pytest.mark.parametrize("all_of_it", [False, True])
@pytest.mark.parametrize("count", [1, 2, 9, 300])
def test_claims_of_one_statement_are_settled_by_draw_and_id(count, all_of_it):
    world = SimpleNamespace(setting=SimpleNamespace(seed=3), frame=5)
    rng = np.random.default_rng(count)
    population, entry = claim(rng, count)
    population.claimed_totals, population.now["load"] = {}, np.round(population.now["load"] * 4) / np.float32(4)
    entry.amount[entry.amount == np.float32(0.1)] = np.float32(0.5)
    if all_of_it:
        entry.amount[len(entry.amount) // 2] = np.inf
    entry.item[0], entry.item[-1] = 0, 39
    rest, load = np.round(rng.random(40) * 32) / 4, population.now["load"].copy()
    rest[0], rest[39] = 60.0, 60.0  # enough for claims on the first and the last item
    ids = population.ids[entry.rows]
    draw = randomness.draw_word(3, 5, "a", "site", 0, ids)
    order = [n for n in np.lexsort((ids, draw, entry.item)) if 0 <= entry.item[n] < 40 and entry.amount[n] >= 0]
    at = np.array(order, int)
    asks = claims._OrderedClaims(
        entry.amount[at].astype(float), np.isinf(entry.amount[at]), load[entry.rows[at]], np.ones(len(at), bool), 0
    )
    left = rest.copy()
    got = serve(left, entry.item[at], asks)
    claims._resolve_claims_on_amount(world, rest, entry.item, entry.amount, 0.0, [(population, entry)])
    load[entry.rows[at[got >= 0]]] += entry.amount[at[got >= 0]]
    won = np.zeros(count, bool)
    won[entry.rows[at[got >= 0]]] = True
    assert (
        np.array_equal(rest, left) and np.array_equal(population.now["load"], load) and np.array_equal(population.now["won"], won)
    )
    assert count < 300 or (won.any() and (got < 0).any())


def flock(count):
    """Boids before their first step."""
    shot = find_case("boids").make_shot(count)
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


def observe(result, population, window, dt, steps):
    """Add a step to plain counts."""
    now, start = population.now, population.start

    def length(registers, name, smaller=None):
        v = [registers[f"{name}.{axis}"] - (0 if smaller is None else smaller[f"{name}.{axis}"]) for axis in "xyz"]
        return np.sqrt((v[0] * v[0] + v[1] * v[1]) + v[2] * v[2])

    for name, of in (("turns", "heading"), ("tilts", "up")):
        angle = motion_measures._compute_degrees(np.minimum(length(now, of, start) * np.float32(0.5), np.float32(1)))
        result[name] += np.bincount(motion_measures._find_bins(angle), minlength=1801)
    result["tilt_max"] = max(result["tilt_max"], float(angle.max()))
    longest = now["max_speed"] * dt
    share = length(now, "position", start)[longest > 0] / longest[longest > 0]
    result["step_max"] = max(result["step_max"], float(np.fmax.reduce(share, initial=0.0)))
    speed = length(now, "velocity")
    result["standing"] += int(((length(now, "push") > 0.2) & (speed < now["max_speed"] * np.float32(0.03))).sum())
    for row, name in enumerate(population.ids.tolist()):
        walk = window.setdefault(name, [population.position[row].copy(), 0.0, 0])
        walk[1] += float(np.float32(speed[row]) * dt)
        walk[2] += 1
        if walk[2] >= steps:
            if walk[1] > 3 * now["size"][row]:
                straight = min(np.linalg.norm(population.position[row] - walk[0]) / walk[1], 1.0)
                result["ways"] += 1
                result["circling"] += int(straight < 0.15)
                result["straightness"] += straight
            window[name] = [population.position[row].copy(), 0.0, 0]


@pytest.mark.parametrize("threads", [1, 3])
def test_measures_of_motion_are_those_of_plain_numpy(threads, monkeypatch):
    monkeypatch.setattr(parallel, "MIN_LIGHT_ITEMS_PER_THREAD", 100)
    world, rng = flock(700), np.random.default_rng(8)
    world.options = Options(backend="numpy", threads=threads)
    population, window, result = world.populations["boid"], {}, {"turns": np.zeros(1801, int), "tilts": np.zeros(1801, int)}
    result |= dict.fromkeys(("tilt_max", "step_max", "standing", "ways", "circling", "straightness"), 0)
    population.now["max_speed"][::50] = rng.choice([0, -1, np.nan], len(population.now["max_speed"][::50]))
    for frame in range(110):
        wander(population, rng)
        if frame == 0:
            for row, name in enumerate(population.ids.tolist()):
                window[name] = [population.position[row].copy(), 0.0, 0]
        with np.errstate(all="ignore"):
            observe(result, population, window, np.float32(world.dt), round(2 / world.dt))
            world.motion._add_step_of_species(world, population)
        if frame % 10 == 5:
            retain_rows(population, rng.permutation(len(population)))
    measured = world.motion.collect_checkpoint_arrays()
    for name, own in result.items():
        assert np.allclose(measured[name], own, rtol=1e-9), name
    assert result["ways"] > 100 and result["standing"] > 0 and result["circling"] > 0


def test_the_longest_step_is_a_share_of_the_longest_allowed_one():
    world = flock(60)
    population, share = world.populations["boid"], np.linspace(0, 0.5, 60, dtype=np.float32)
    for axis in "xyz":
        population.start[f"position.{axis}"][:] = population.now[f"position.{axis}"]
    population.now["max_speed"][:] = 1000
    population.now["position.x"] += 1000 * np.float32(world.dt) * share
    world.motion._add_step_of_species(world, population)
    assert world.motion.step_max == pytest.approx(0.5, rel=1e-3)


def test_ways_go_with_their_agents_when_rows_change():
    world, rng = flock(60), np.random.default_rng(4)
    population, motion = world.populations["boid"], world.motion
    for _ in range(3):
        wander(population, rng)
        motion._add_step_of_species(world, population)
    for cached in (60, 60, 41, 41):
        previous = dict(zip(population.ids.tolist(), motion._update_window(population).path.tolist(), strict=True))
        retain_rows(population, rng.permutation(len(population))[:cached])
        window = motion._update_window(population)
        assert window.ids is population.ids and window.path.tolist() == [previous[i] for i in population.ids.tolist()]
    previous = dict(zip(population.ids.tolist(), window.path.tolist(), strict=True))
    for cached in (41, 30):  # two changes since it was last looked at
        retain_rows(population, rng.permutation(len(population))[:cached])
    assert motion._update_window(population).path.tolist() == [previous[i] for i in population.ids.tolist()]


@pytest.mark.parametrize("count, box", [(1500, 60), (1500, 8), (3, 1), (1500, 2e5), (900, 1e15)])
def test_overlaps_are_those_of_all_pairs(count, box):
    rng = np.random.default_rng(count)
    x, y, z = (rng.random((3, count)) * box).astype(np.float32)
    radius = (2 * rng.random(count)).astype(np.float32)
    x[0], z[1], radius[2] = np.nan, np.inf, 0
    with np.errstate(all="ignore"):
        displacement = [axis[:, None] - axis for axis in (x, y, z)]
        distance = np.sqrt(
            (displacement[0] * displacement[0] + displacement[1] * displacement[1]) + displacement[2] * displacement[2]
        )
        part = np.float32(1) - distance / np.maximum(radius[:, None] + radius, np.float32(1e-9))
    np.fill_diagonal(part, 0)
    expected = np.maximum(np.where(np.isfinite(part), part, 0).max(axis=1), 0)
    assert np.array_equal(measure_worst_overlaps(x, y, z, radius), expected) and (box == 60) <= (0 < expected.max() < 1)


def test_rows_are_put_in_order_in_arrays_with_room():
    array = np.arange(100, dtype=np.float32)
    rows = np.random.default_rng(0).permutation(100)[:70]
    result = gather_padded(array, rows)
    assert np.array_equal(result, array[rows]) and has_padding(result) and has_padding(copy_padded(array))
    assert not result.base[70:].any()
    assert not any(map(has_padding, (array, array[:95], array[4:50], np.zeros((3, 50), np.float32)[0])))


def test_parts_on_threads_give_the_same_bits_as_one(monkeypatch):
    shot, total, parts, split = find_case("foraging").make_shot(1_500), parallel.run_in_parts, parallel.count_parts, []

    def parted(work, count, threads, least=0):
        split.append(min(threads, count // 50) > 1)
        return total(work, count, threads, 50)

    def stepped(threads):
        world = bind(shot.plan, shot.setting, Options(backend="native", threads=threads, wait_for_code=True))
        for _ in range(3):
            step(world)
        return state_hash(world), world.motion.collect_checkpoint_arrays()

    alone, counted = stepped(1)
    monkeypatch.setattr(parallel, "run_in_parts", parted)
    monkeypatch.setattr(parallel, "count_parts", lambda count, threads, least=0: parts(count, threads, 50))
    result, other = stepped(3)
    assert result == alone and sum(split) > 15
    assert counted.keys() == other.keys() and all(np.array_equal(counted[name], other[name]) for name in counted)
