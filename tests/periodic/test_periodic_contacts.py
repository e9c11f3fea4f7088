"""Contacts across the seam of a periodic world."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from periodic_scenes import HALF, open_world, read_vector, run, wrapped, write_points

from antdsl.runtime import Options, bind, state_hash
from antdsl.runtime.moving.contacts.capsules import CapsuleCrowd, find_near_pairs, measure_overlap_depths

BALLS = """ant 2
use steering
world { surface ground }
species ball {
  size 1.5 mm; max_speed 0.5 mm/step; response 1 step; max_turn none
  hits = 0
  on collision(other: ball) { hits += 1 }
  start go
  state go { steer wander() }
  layers { state }
}
"""


def open_balls(folder: Path, crowd: str, contacts: str = "hard") -> object:
    """A shot of balls that wander on a torus."""
    return open_world(folder, BALLS, crowd, keys=f"contacts: {contacts}\n", body="ball")


def distances(world: object) -> np.ndarray:
    """The distances between the nearest images of all agents, infinite on the diagonal."""
    place = read_vector(world, "position")  # type: ignore[arg-type]
    distance = np.sqrt((wrapped(place[None, :] - place[:, None]) ** 2).sum(axis=2))
    np.fill_diagonal(distance, np.inf)
    return distance


@pytest.mark.parametrize("contacts", ["soft", "hard"])
def test_bodies_make_room_across_the_seam(tmp_path: Path, contacts: str) -> None:
    points = np.random.default_rng(6).uniform(-HALF, HALF, (50, 3)) * (1, 0, 1)
    shot = open_balls(tmp_path, write_points(tmp_path, points), contacts)
    start = bind(shot.plan, shot.setting)  # type: ignore[attr-defined]
    world = run(shot, 30)  # type: ignore[arg-type]
    widths = 2 * CapsuleCrowd(world).radius.max()
    assert distances(start).min() < 0.5 * widths
    seam = np.abs(read_vector(world, "position")).max(axis=1) > HALF - widths
    assert seam.sum() > 10
    assert distances(world)[seam].min() > (0.95 if contacts == "hard" else 0.6) * widths
    assert measure_overlap_depths(world).max() == pytest.approx(max(0, 1 - distances(world).min() / widths), abs=1e-5)


def test_each_pair_is_found_once(tmp_path: Path) -> None:
    points = np.random.default_rng(8).uniform(-HALF, HALF, (60, 3)) * (1, 0, 1)
    world = run(open_balls(tmp_path, write_points(tmp_path, points), "off"), 0)  # type: ignore[arg-type]
    near = find_near_pairs(CapsuleCrowd(world))
    pairs = {
        frozenset(pair) for pair in np.stack([near.rows[near.first_indices], near.rows[near.second_indices]], axis=1).tolist()
    }
    assert len(pairs) == len(near.first_indices)
    (population,) = world.populations.values()
    gap = distances(world) - 2 * near.radius.max()
    ids = {frozenset(population.ids[list(pair)].tolist()) for pair in pairs}
    expected = {frozenset(pair) for pair in np.argwhere(gap < 0.5 * near.radius.max()).tolist()}
    assert expected <= ids
    i, j = population.ids[near.rows[near.first_indices]], population.ids[near.rows[near.second_indices]]
    np.testing.assert_allclose(near.gap, gap[i, j], atol=1e-5)


@pytest.mark.parametrize("by", [(8.0, 0.0, 8.0), (8.0, 0.0, 0.0)])
def test_a_shifted_crowd_makes_room_in_the_same_way(tmp_path: Path, by: tuple[float, float, float]) -> None:
    """For six frames: in the eighth, two balls touch so exactly that rounding decides which of them waits."""
    points = np.round(np.random.default_rng(9).uniform(-HALF, HALF, (30, 3)) * 1024) / 1024 * (1, 0, 1)
    one, other = (run(open_balls(tmp_path, write_points(tmp_path, points + shift)), 6) for shift in (0, np.array(by)))  # type: ignore[arg-type]
    difference = wrapped(read_vector(other, "position") - read_vector(one, "position") - by)
    assert np.abs(difference).max() < 1e-3
    hits = [world.populations["ball"].now["hits"][world.populations["ball"].get_rows_by_id()] for world in (one, other)]
    assert hits[0].sum() > 0 and np.array_equal(*hits)


def test_contacts_have_the_same_bits_everywhere(tmp_path: Path) -> None:
    shot = open_balls(tmp_path, "count: 40, place: {on: ground}")
    every = (Options(backend="reference"), Options(backend="numpy"), Options(threads=2, shuffle_rows=4, wait_for_code=True))
    assert len({state_hash(run(shot, 5, options)) for options in every}) == 1  # type: ignore[arg-type]
    for count in (0, 1):
        run(open_balls(tmp_path, f"count: {count}, place: {{on: ground}}"), 2)  # type: ignore[arg-type]


CLEAR = """ant 2
world { surface ground }
species walker {
  size 0.4 mm; max_speed 0.5 mm/step; response 1 step; max_turn none
  start go
  state go { steer match(clear_velocity(heading * 0.4 mm/step, within: 6 mm, horizon: 8 s)) }
  layers { state }
}
"""


def test_clear_velocity_in_a_narrow_world(tmp_path: Path) -> None:
    """`within` is wider than the world along z and less than half of its width along x. A shift by half a width along both
    changes no course, and neither do threads and rows."""
    points = np.round(np.random.default_rng(9).uniform(-0.5, 0.5, (40, 3)) * (32, 0, 4) * 1024) / 1024
    runs = []
    for by in (np.zeros(3), np.array([16.0, 0, 2.0])):
        wrap = "{x: -16 mm .. 16 mm, z: -2 mm .. 2 mm}"
        shot = open_world(tmp_path, CLEAR, write_points(tmp_path, points + by), wrap=wrap, half=40)
        options = (Options(backend="numpy"), Options(threads=2, shuffle_rows=3, chunk=7), Options(backend="reference"))
        assert len({state_hash(run(shot, 4, each)) for each in options}) == 1
        world = run(shot, 4)
        runs.append((read_vector(world, "unwrapped") - by, read_vector(world, "heading")))
    (place, heading), (moved, turned) = runs
    offset = moved - place
    assert np.abs(offset - np.rint(offset / (32, 1, 4)) * (32, 1, 4)).max() < 1e-4
    assert np.abs(turned - heading).max() < 1e-4
    start = read_vector(run(shot, 0), "heading")
    assert (np.abs(heading - start).max(axis=1) > 0.05).sum() > 10, "agents avoid each other"
