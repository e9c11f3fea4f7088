"""`compute_clear_velocity`: half-planes and optima against brute force, the same bits on all backends, and crowds that cross."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import plans
import pytest
from neighbour_columns import Moves, Neighbours, clear_velocities, fill_neighbours, nearest_others
from plan_text import plan_of

from antdsl.bench import programs
from antdsl.bench.cases import open_shot
from antdsl.runtime import Options, bind, step
from antdsl.runtime.checkpoints import state_hash
from antdsl.runtime.sensing.neighbourhood import build_nearest_search

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))

from crossing import circle, corridor  # lies beside the tests

FASTEST, DT = 20.0, 1 / 24


def others(draw: np.random.Generator, agents: int, count: int, near: float) -> Neighbours:
    x, y = near * draw.normal(size=(2, agents, count))
    vx, vy = 15 * draw.normal(size=(2, agents, count))
    radius_sum = draw.uniform(2, 6, (agents, count))
    return Neighbours(x, y, vx, vy, radius_sum, draw.random((agents, count)) < 0.9, np.ones((agents, count), np.bool_))


def case(seed: int, count: int, near: float) -> tuple[Neighbours, tuple[np.ndarray, ...]]:
    draw, n = np.random.default_rng(seed), 60
    velocity, wish = draw.normal(size=(2, 2, n)) * 12
    return others(draw, n, count, near), (tuple(velocity), tuple(wish), np.full(n, FASTEST), np.full(n, 2.0))


def border(x: np.ndarray, v: np.ndarray, radius_sum: float, seconds: float, first: bool) -> tuple[np.ndarray, np.ndarray]:
    """The least change of a relative velocity to where no agent is met within some time, and the direction away from there.

    Velocities that meet are a cone from the circle at `x` / seconds on; candidates are the nearest points of circle and legs."""
    far, middle = float(np.hypot(*x)), x / seconds
    off = v - middle
    outward = off / np.hypot(*off) if np.hypot(*off) > 1e-30 else np.array([1.0 if first else -1.0, 0.0])
    round_end = middle + outward * radius_sum / seconds
    if far <= radius_sum:
        return round_end - v, outward
    candidates = []
    if -(outward @ x) > radius_sum:  # on the arc that faces the start
        candidates.append((round_end - v, outward))
    leg = np.sqrt(far**2 - radius_sum**2)
    for side in (1.0, -1.0):
        along = np.array([[leg, -side * radius_sum], [side * radius_sum, leg]]) @ x / far**2
        if v @ along >= leg / seconds:
            candidates.append((along * (v @ along) - v, side * np.array([-along[1], along[0]])))
    return min(candidates, key=lambda each: float(np.hypot(*each[0])))


def beyond(o: Neighbours, velocity: tuple[np.ndarray, ...], horizon: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """How far velocities [n,k] are beyond the worst border of each agent."""
    worst = np.full(x.shape, -np.inf)
    for a in range(len(x)):
        for c in np.flatnonzero(o.is_present[a]):
            place, own = np.array([o.x[a, c], o.y[a, c]]), np.array([o.vx[a, c], o.vy[a, c]])
            seconds = horizon[a] if np.hypot(*place) > o.radius_sum[a, c] else DT
            change, normal = border(place, own, o.radius_sum[a, c], seconds, bool(o.first[a, c]))
            px, py = velocity[0][a] + change[0] / 2, velocity[1][a] + change[1] / 2
            worst[a] = np.maximum(worst[a], (px - x[a]) * normal[0] + (py - y[a]) * normal[1])
    return worst


@pytest.mark.parametrize(("count", "near"), [(0, 1.0), (1, 20.0), (4, 25.0), (10, 25.0), (10, 3.0)])
def test_no_allowed_velocity_is_nearer_to_the_wish(count: int, near: float) -> None:
    o, (velocity, wish, fastest, horizon) = case(count, count, near)
    if count:
        o.x[:9, 0] = o.y[:9, 0] = o.vx[:9, 0] = o.vy[:9, 0] = 0.0  # on one spot, as fast
        o.first[:4], o.is_present[:9, 0] = False, True
    if count > 1:  # between two that overlap it: both borders are parallel
        o.x[20:24, :2] = o.y[20:24, :2] = [1.0, -2.0]
        o.vx[20:24, :2] = o.vy[20:24, :2] = 0.0
        o.is_present[20:24, :2] = True
    x, y = clear_velocities(o, Moves(velocity, wish, fastest, horizon), DT)
    assert (np.hypot(x, y) <= FASTEST * (1 + 1e-9)).all()
    axis = np.linspace(-FASTEST, FASTEST, 81)
    gx, gy = (np.broadcast_to(g.ravel(), (len(x), g.size)) for g in np.meshgrid(axis, axis))
    inside = np.hypot(gx, gy) <= FASTEST
    worst = beyond(o, velocity, horizon, gx, gy)
    mine = beyond(o, velocity, horizon, x[:, None], y[:, None])[:, 0]
    feasible = (inside & (worst <= 0)).any(axis=1)
    assert feasible.sum() > 0 or near < 5
    allowed = mine <= 1e-6
    assert allowed[feasible].all()
    best = np.where(inside & (worst <= 0), np.hypot(gx - wish[0][:, None], gy - wish[1][:, None]), np.inf).min(axis=1)
    assert (np.hypot(x - wish[0], y - wish[1])[feasible] <= best[feasible] + 1e-9).all()
    # Where nothing is allowed it is beyond its worst border by no more than any other velocity.
    least = np.where(inside, worst, np.inf).min(axis=1)
    assert (mine[~allowed] <= least[~allowed] + 1e-6).all()
    if count == 10:
        assert (~allowed).sum() > 5


def test_a_change_by_half_each_just_misses_within_the_horizon() -> None:
    # Two discs of 4 mm together, 40 mm apart, head on but for 1 mm, 20 mm/s: section 4 of the paper.
    x, y, v = np.array([[40.0], [-40.0]]), np.array([[1.0], [-1.0]]), np.array([[40.0], [-40.0]])
    zero, is_present = np.zeros((2, 1)), np.ones((2, 1), np.bool_)
    o = Neighbours(x, y, v, zero, np.full((2, 1), 4.0), is_present, is_present)
    own = (np.array([20.0, -20.0]), np.zeros(2))
    velocities = clear_velocities(o, Moves(own, own, np.full(2, 25.0), np.full(2, 3.0)), DT)
    relative = np.array([velocities[0][0] - velocities[0][1], velocities[1][0] - velocities[1][1]])
    place = np.array([40.0, 1.0])
    part = min(relative @ place / (relative @ relative), 3.0)
    assert np.linalg.norm(place - part * relative) == pytest.approx(4.0, abs=1e-9)
    assert velocities[0][0] == -velocities[0][1] and velocities[1][0] == -velocities[1][1]


def test_blocked_and_invalid_agents_do_not_affect_others() -> None:
    o, (velocity, wish, fastest, horizon) = case(6, 6, 20.0)
    expected = clear_velocities(o, Moves(velocity, wish, fastest, horizon), DT)
    o.vx[9:12, 0], fastest[5:8], horizon[20:22] = np.inf, 0.0, 1e-30
    velocities = clear_velocities(o, Moves(velocity, wish, fastest, horizon), DT)
    alike = np.setdiff1d(np.arange(60), [5, 6, 7, 9, 10, 11, 20, 21])
    for one, other in zip(expected, velocities, strict=True):
        assert np.array_equal(one[alike], other[alike]) and np.isfinite(other).all() and not other[5:8].any()


@pytest.mark.parametrize(("most", "high", "far"), [(1, 0, 900.0), (4, 0, 900.0), (40, 0, 900.0), (40, 3000, 2000.0)])
def test_the_nearest_agents_of_all_species_are_avoided(most: int, high: int, far: float, tmp_path: Path) -> None:
    line = "{{species: {0}, from: {0}.ant, count: 60, place: {{radius: 3 m}}}}"
    crowds = ", ".join(line.format(name) for name in ("dog", "cat"))
    (tmp_path / "scene.yaml").write_text(f"antdsl: 1\nunits: mm\nfps: 24\nframes: 1..9\nseed: 1\ncrowd: [{crowds}]\n")
    for name in ("dog", "cat"):
        (tmp_path / f"{name}.ant").write_text(programs.CROWD_PROGRAM.replace("person", name))
    shot, draw = open_shot(tmp_path / "scene.yaml", None), np.random.default_rng(3)
    world = bind(shot.plan, shot.setting, Options(backend="numpy", shuffle_rows=4))
    together = world.populations["dog"].start
    for population in world.populations.values():
        for name in ("velocity", "up"):
            for axis in "xyz":
                population.start[f"{name}.{axis}"][:] += draw.normal(0, 1, len(population)).astype(np.float32)
        population.start["position.y"] += draw.uniform(-high, high, len(population)).astype(np.float32)
        for axis in "xyz":  # as near as each other
            population.start[f"position.{axis}"][9:] += draw.normal(0, 40, len(population) - 9).astype(np.float32)
            population.start[f"position.{axis}"][5:9] = together[f"position.{axis}"][5]
        for axis, offset in (("x", 6000), ("y", -9000), ("z", 2500)):
            population.start[f"position.{axis}"] += np.float32(offset)
        population.start["radius"][:3] = [np.nan, -1, np.inf]
        population.start["velocity.y"][7] = np.nan
    asking, rows = world.populations["dog"], draw.permutation(60)[:50]
    within = np.where(draw.random(50) < 0.9, far, draw.choice([-1, 2000.0 if high else 3000.0], 50))
    count = np.where(draw.random(50) < 0.2, draw.choice([0, -1, 0.5, 2], 50), most).astype(float)
    columns, planes = nearest_others(world, asking, rows, within, count)
    for a, row in enumerate(rows):
        near = []
        for number, (name, other) in enumerate(world.populations.items()):
            for b in range(len(other)):
                at = [np.float32(each.start[f"position.{axis}"][k]) for each, k in ((other, b), (asking, row)) for axis in "xyz"]
                displacement = np.float32(at[:3]) - np.float32(at[3:])
                distance = np.sqrt(
                    (displacement[0] * displacement[0] + displacement[1] * displacement[1]) + displacement[2] * displacement[2]
                )
                up, velocity = ([float(other.start[f"{name}.{axis}"][b]) for axis in "xyz"] for name in ("up", "velocity"))
                side = sum(one * two for one, two in zip(planes[:3, a], up, strict=True))
                if distance <= np.float32(within[a]) and side > 0 and not (other is asking and b == row):
                    velocity = velocity if np.isfinite(velocity).all() else [0.0, 0.0, 0.0]
                    near.append((distance, number, other.ids[b], name, other, b, displacement.astype(float), np.array(velocity)))
        near = sorted(near, key=lambda each: each[:3])[: max(int(count[a]), 0)]
        assert columns.is_present[a].sum() == len(near) and not columns.is_present[a, len(near) :].any()
        axes = planes[3:6, a], planes[6:, a]
        for c, (_, _, name_id, name, other, b, displacement, velocity) in enumerate(near):
            own = np.array([float(asking.start[f"velocity.{axis}"][row]) for axis in "xyz"])
            relative = (own if np.isfinite(own).all() else 0.0) - velocity
            expected = [displacement @ axes[0], displacement @ axes[1], relative @ axes[0], relative @ axes[1]]
            assert np.allclose(
                [columns.x[a, c], columns.y[a, c], columns.vx[a, c], columns.vy[a, c]], expected, rtol=1e-9, atol=1e-9
            )
            radii = [float(each.start["radius"][k]) for each, k in ((asking, row), (other, b))]
            assert np.isclose(columns.radius_sum[a, c], sum(radius if 0 < radius < np.inf else 0.0 for radius in radii))
            assert columns.first[a, c] == (asking.ids[row] < name_id if other is asking else asking.name < name)
    assert columns.is_present.sum() > 30 * min(most, 5)


def test_agents_of_one_species_have_the_order_of_their_ids() -> None:
    """The memory behind the empty table of names has the opposite order."""
    world, rows = bind(plan_of(PROGRAM), plans.crowd(40), Options(shuffle_rows=3)), np.arange(40)
    (population,) = world.populations.values()
    crowd, requesters = build_nearest_search(world, population, rows, np.full(40, 1e6), np.full(40, 39.0))
    assert not crowd.name_ranks.size
    columns = Neighbours(*np.zeros((5, 40, 40)), *np.zeros((2, 40, 40), np.bool_))
    opposite = np.arange(40, dtype=np.int32)[::-1].copy()
    fill_neighbours(crowd._replace(name_ranks=opposite[:0]), requesters, columns, np.empty((9, 40)))
    assert np.array_equal(columns.first.sum(axis=1), np.sum(population.ids > population.ids[:, None], axis=1))


PROGRAM = """species ant {
  way = vector(0 mm/s, 0 mm/s, 0 mm/s)
  start go
  state go {
    way = clear_velocity(heading * 30 mm/s, within: 30 mm, horizon: 1 s, most: 3 + id)
    steer match(way) + widest_gap(within: 20 mm) * 0.3
  }
}
"""


def run(options: Options, frames: int = 4) -> list[str]:
    world = bind(plan_of(PROGRAM), plans.crowd(40), options)
    hashes = []
    for _ in range(frames):
        step(world)
        hashes.append(state_hash(world))
    assert world.faults.fault_count == 0
    return hashes


def test_all_backends_and_any_rows_give_the_same_bits() -> None:
    hashes = run(Options(backend="reference"))
    assert len(set(hashes)) == len(hashes)
    for options in (
        Options(backend="numpy"), Options(backend="numpy", chunk=7), Options(backend="native", wait_for_code=True),
        Options(backend="native", wait_for_code=True, shuffle_rows=5, chunk=16), Options(backend="reference", shuffle_rows=2),
    ):  # fmt: skip
        assert run(options) == hashes


def test_twenty_agents_cross_a_circle_without_collisions() -> None:
    outcome = circle(20, 30)
    assert outcome.seconds < 20 and outcome.nearest > 300 and outcome.stuck == 0  # of 400 mm: who turns away needs a moment to


def test_two_flows_head_on_in_a_corridor_pass_each_other() -> None:
    outcome = corridor(40, 40, wide=4000, long=10_000)
    assert outcome.seconds < 20 and outcome.nearest > 300 and (outcome.left, outcome.stuck) == (0, 0)


def test_agents_in_a_corridor_too_narrow_to_pass_are_reported_as_stuck() -> None:
    outcome = corridor(2, 15, wide=150, long=6_000)
    assert outcome.seconds == np.inf and (outcome.left, outcome.stuck) == (2, 2)


@pytest.mark.slow
def test_a_hundred_agents_cross_a_circle_without_being_stuck() -> None:
    assert circle(100, 60).seconds < 60


@pytest.mark.slow
def test_two_hundred_agents_in_a_corridor_are_not_stuck() -> None:
    assert corridor(200, 90, wide=5000).seconds < 90
