"""`clear_velocity`: half-planes and optima against brute force, the same bits on all backends, and crowds that cross."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import plans
import pytest
from plan_text import plan_of

from antdsl.bench import programs
from antdsl.bench.cases import opened
from antdsl.numerics import compiled
from antdsl.runtime import Options, bind, step
from antdsl.runtime.hashing import state_hash
from antdsl.senses.clear_velocity import Others, _borders, clear_velocities

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))

from crossing import circle, corridor  # lies beside the tests

FASTEST, DT = 20.0, 1 / 24


def others(draw: np.random.Generator, agents: int, count: int, near: float) -> Others:
    x, y = near * draw.normal(size=(2, agents, count))
    vx, vy = 15 * draw.normal(size=(2, agents, count))
    room = draw.uniform(2, 6, (agents, count))
    return Others(x, y, vx, vy, room, draw.random((agents, count)) < 0.9, np.ones((agents, count), np.bool_))


def case(seed: int, count: int, near: float) -> tuple[Others, tuple[np.ndarray, ...]]:
    draw, n = np.random.default_rng(seed), 60
    velocity, wish = draw.normal(size=(2, 2, n)) * 12
    return others(draw, n, count, near), (velocity, wish, np.full(n, FASTEST), np.full(n, 2.0))


def beyond(o: Others, velocity: np.ndarray, horizon: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """How far velocities [n,k] are beyond the worst border of each agent."""
    b = _borders(o, (velocity[0], velocity[1]), horizon, DT)
    away = b.dx[:, :, None] * (b.py[:, :, None] - y[:, None]) - b.dy[:, :, None] * (b.px[:, :, None] - x[:, None])
    return np.where(b.there[:, :, None], away, -np.inf).max(axis=1, initial=-np.inf)


@pytest.mark.parametrize(("count", "near"), [(1, 20.0), (4, 25.0), (10, 25.0)])
def test_no_velocity_of_a_fine_grid_that_is_allowed_is_nearer_to_the_wish(count: int, near: float) -> None:
    o, (velocity, wish, fastest, horizon) = case(count, count, near)
    x, y = clear_velocities(o, (velocity[0], velocity[1]), (wish[0], wish[1]), fastest, horizon, DT)
    assert (np.hypot(x, y) <= FASTEST * (1 + 1e-9)).all()
    axis = np.linspace(-FASTEST, FASTEST, 81)
    gx, gy = (np.broadcast_to(g.ravel(), (len(x), g.size)) for g in np.meshgrid(axis, axis))
    inside = np.hypot(gx, gy) <= FASTEST
    worst = beyond(o, velocity, horizon, gx, gy)
    mine = beyond(o, velocity, horizon, x[:, None], y[:, None])[:, 0]
    feasible = (inside & (worst <= 0)).any(axis=1)
    assert feasible.sum() > 0
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
    zero, there = np.zeros((2, 1)), np.ones((2, 1), np.bool_)
    o = Others(x, y, v, zero, np.full((2, 1), 4.0), there, there)
    own = (np.array([20.0, -20.0]), np.zeros(2))
    found = clear_velocities(o, own, own, np.full(2, 25.0), np.full(2, 3.0), DT)
    relative = np.array([found[0][0] - found[0][1], found[1][0] - found[1][1]])
    place = np.array([40.0, 1.0])
    part = min(relative @ place / (relative @ relative), 3.0)
    assert np.linalg.norm(place - part * relative) == pytest.approx(4.0, abs=1e-9)
    assert found[0][0] == -found[0][1] and found[1][0] == -found[1][1]


@pytest.mark.parametrize(("count", "near"), [(0, 1.0), (1, 20.0), (4, 25.0), (10, 25.0), (10, 3.0), (16, 0.5)])
def test_kernels_give_the_same_bits(monkeypatch: pytest.MonkeyPatch, count: int, near: float) -> None:
    o, (velocity, wish, fastest, horizon) = case(count, count, near)
    if count:
        o.x[:9, 0] = o.y[:9, 0] = o.vx[:9, 0] = o.vy[:9, 0] = 0.0  # on one spot, as fast
        o.first[:4] = False
        o.vx[9:12, 0] = np.inf
    fastest[5:8], horizon[8:11] = 0.0, 1e-30
    found = []
    for on in (False, True):
        monkeypatch.setattr(compiled, "wanted", lambda count, on=on: on)
        found.append(clear_velocities(o, (velocity[0], velocity[1]), (wish[0], wish[1]), fastest, horizon, DT))
    for plain, by_loops in zip(*found, strict=True):
        assert plain.tobytes() == by_loops.tobytes()


def test_kernels_find_the_same_others_of_two_species(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    line = "{{species: {0}, from: {0}.ant, count: 60, place: {{radius: 3 m}}}}"
    crowds = ", ".join(line.format(name) for name in ("dog", "cat"))
    (tmp_path / "scene.yaml").write_text(f"antdsl: 1\nunits: mm\nfps: 24\nframes: 1..9\nseed: 1\ncrowd: [{crowds}]\n")
    for name in ("dog", "cat"):
        (tmp_path / f"{name}.ant").write_text(programs.CROWD.replace("person", name))
    shot = opened(tmp_path / "scene.yaml", None)
    hashes: list[list[str]] = []
    for on in (False, True):
        monkeypatch.setattr(compiled, "wanted", lambda count, on=on: on)
        world = bind(shot.plan, shot.setting, Options(backend="numpy"))
        hashes.append([])
        for _ in range(4):
            step(world)
            hashes[-1].append(state_hash(world))
    assert hashes[0] == hashes[1] and len(set(hashes[0])) == 4


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
    assert world.faults.count == 0
    return hashes


def test_all_backends_and_any_rows_give_the_same_bits() -> None:
    hashes = run(Options(backend="reference"))
    assert len(set(hashes)) == len(hashes)
    for options in (
        Options(backend="numpy"), Options(backend="numpy", chunk=7), Options(backend="native", wait_for_code=True),
        Options(backend="native", wait_for_code=True, shuffle_rows=5, chunk=16), Options(backend="reference", shuffle_rows=2),
    ):  # fmt: skip
        assert run(options) == hashes


def test_twenty_who_cross_a_circle_come_to_the_other_side_and_do_not_run_into_each_other() -> None:
    found = circle(20, 30)
    assert found.seconds < 20 and found.nearest > 300 and found.stuck == 0  # of 400 mm: who turns away needs a moment to


def test_two_flows_head_on_in_a_corridor_pass_each_other() -> None:
    found = corridor(40, 40, wide=4000, long=10_000)
    assert found.seconds < 20 and found.nearest > 300 and (found.left, found.stuck) == (0, 0)


def test_who_stands_in_a_corridor_too_narrow_to_pass_is_told_to_be_stuck() -> None:
    found = corridor(2, 15, wide=150, long=6_000)
    assert found.seconds == np.inf and (found.left, found.stuck) == (2, 2)


@pytest.mark.slow
def test_of_a_hundred_who_cross_a_circle_none_is_stuck() -> None:
    assert circle(100, 60).seconds < 60


@pytest.mark.slow
def test_of_two_hundred_head_on_in_a_corridor_none_is_stuck() -> None:
    assert corridor(200, 90, wide=5000).seconds < 90
