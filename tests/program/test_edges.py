"""Bodies at edges and walls: they tilt no faster than they turn, keep their heads out of walls, and fall as fast as they may."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from antdsl.pipeline import RunChoices, Shot, open_scene
from antdsl.runtime import Options, World, bind, state_hash, step
from antdsl.runtime.checkpoints import restore_checkpoint, take_checkpoint
from antdsl.runtime.moving.clearance.head_clearance import find_heads_inside
from antdsl.runtime.world import Population
from antdsl.senses.overlaps import measure_worst_overlaps

PROGRAM = """ant 1
use steering
world { surface ground }
species walker {
  size 4 mm
  max_speed 30 mm/s
  response 0.2 s
  TURN
  start stroll
  state stroll { steer wander(swing: 40 deg) }
}
"""
SCENE = """antdsl: 1
units: mm
frames: 1..200
seed: 5
world: {ground: {mesh: ground.obj}}
crowd: [{species: walker, from: walker.ant, count: 40, place: {on: ground}}]
"""
STEP = np.degrees(1 / 24)


def sheet(corner: tuple[float, float, float], one: tuple[float, float, float], other: tuple[float, float, float], n: int) -> list:
    """Triangles of a flat sheet of n x n squares."""
    a, u, v = (np.array(each) / k for each, k in ((corner, 1.0), (one, n), (other, n)))
    quads = [(a + i * u + j * v, a + (i + 1) * u + j * v, a + (i + 1) * u + (j + 1) * v, a + i * u + (j + 1) * v)
             for i in range(n) for j in range(n)]  # fmt: skip
    return [t for p, q, r, s in quads for t in ((p, q, r), (p, r, s))]


def wall_on_a_floor() -> list:
    return sheet((-24, 0, -24), (0, 0, 48), (48, 0, 0), 8) + sheet((0, 0, -24), (0, 0, 48), (0, 24, 0), 8)


def wedge() -> list:
    """A floor and a roof over it that comes down onto it at 40 degrees."""
    return sheet((-24, 0, -24), (0, 0, 48), (48, 0, 0), 8) + sheet((0, 0, -24), (0, 0, 48), (-18.4, 15.4, 0), 8)


def ridge() -> list:
    """Two steep slopes that meet in an edge of 40 degrees."""
    return sheet((0, 20, -24), (0, 0, 48), (-7.3, -20, 0), 8) + sheet((0, 20, -24), (7.3, -20, 0), (0, 0, 48), 8)


def needle() -> list:
    """A steep cone: a way past its tip leads round it, and back."""
    angle = np.arange(17) * np.pi / 8
    ring = np.stack([4 * np.cos(angle), np.zeros(17), 4 * np.sin(angle)], axis=1)
    return [((0.0, 24.0, 0.0), ring[k + 1], ring[k]) for k in range(16)]


def shot(folder: Path, triangles: list, turn: str = "max_turn 360 deg/s") -> Shot:
    points, faces = np.unique(np.round(np.array(triangles).reshape(-1, 3), 6), axis=0, return_inverse=True)
    lines = [f"v {x} {y} {z}" for x, y, z in points] + [f"f {a} {b} {c}" for a, b, c in faces.reshape(-1, 3) + 1]
    (folder / "ground.obj").write_text("\n".join(lines) + "\n")
    (folder / "walker.ant").write_text(PROGRAM.replace("TURN", turn))
    (folder / "scene.yaml").write_text(SCENE)
    opened_shot, report = open_scene(folder / "scene.yaml", RunChoices())
    assert opened_shot is not None, [each.message for each in report]
    return opened_shot


def run(opened_shot: Shot, frames: int, **options: object) -> World:
    world = bind(opened_shot.plan, opened_shot.setting, Options(**options))  # type: ignore[arg-type]
    for _ in range(frames):
        step(world)
    return world


@pytest.mark.parametrize("ground", [wall_on_a_floor, wedge, ridge])
@pytest.mark.parametrize(("turn", "most"), [("max_turn 360 deg/s", 360), ("", 90 * 30 / 4)])
def test_no_body_tilts_or_turns_faster_than_it_may(tmp_path: Path, ground, turn: str, most: float) -> None:
    world = run(shot(tmp_path, ground(), turn), 60)
    summary = world.motion.summarise()
    assert summary["tilt_max"] <= most / 24 * 1.001 and summary["tilt_max"] > 1, "and somebody has come to an edge"
    assert summary["step_max"] <= 1.001 and not world.faults.fault_count
    if turn:
        population = world.populations["walker"]
        previous_heading = population.read_vector("heading")
        step(world)
        turned = np.degrees(np.arccos(np.clip((previous_heading * population.read_vector("heading")).sum(axis=1), -1, 1)))
        assert turned.max() <= most / 24 * 1.01
    up, heading = (world.populations["walker"].read_vector(name) for name in ("up", "heading"))
    assert np.abs((up * heading).sum(axis=1)).max() < 1e-4 and np.abs((up**2).sum(axis=1) - 1).max() < 1e-4


@pytest.mark.parametrize("ground", [needle, ridge])
def test_the_whole_turn_of_a_body_is_no_faster_than_it_may(tmp_path: Path, ground) -> None:
    """Tilt and turn of the heading together, as an angle about one axis."""
    world = run(shot(tmp_path, ground()), 1)
    population, farthest = world.populations["walker"], 0.0
    previous_axes = axes(population)
    for _ in range(150):
        step(world)
        now = axes(population)
        chord = sum(((a - b) ** 2).sum(axis=1) for a, b in zip(now, previous_axes, strict=True)) / 2
        farthest, previous_axes = max(farthest, float(np.degrees(2 * np.arcsin(np.sqrt(chord) / 2)).max())), now
    assert 14 < farthest <= 15 * 1.006


def axes(population: Population) -> list[np.ndarray]:
    rows = population.get_rows_by_id()
    up, heading = (population.read_vector(name)[rows].astype(np.float64) for name in ("up", "heading"))
    return [up, heading, np.cross(up, heading)]


def test_heads_stay_out_of_walls_and_feet_walk_on(tmp_path: Path) -> None:
    world = run(shot(tmp_path, wall_on_a_floor()), 1)
    population = world.populations["walker"]
    inside = sum(int(find_heads_inside(world, population).sum()) for _ in range(150) if step(world) is None)
    assert inside < 0.01 * 150 * len(population)
    assert world.motion.summarise()["standing"] < 0.02, "nobody waits for long"
    place = population.position
    assert (place[:, 1] > 2).sum() > 3 and (np.abs(place[:, 0]) > 2).sum() > 3, "some are on the wall"


def test_who_begins_before_a_wall_is_tilted_already(tmp_path: Path) -> None:
    opened_shot = shot(tmp_path, wall_on_a_floor())
    many = replace(opened_shot.setting, crowds=tuple(replace(crowd, count=400) for crowd in opened_shot.setting.crowds))
    world = bind(opened_shot.plan, many)
    population = world.populations["walker"]
    leaning = (population.read_vector("up") != population.normal).any(axis=1)
    assert 5 < np.count_nonzero(leaning) < 200
    assert not find_heads_inside(world, population).any()
    heading, up = population.read_vector("heading")[leaning], population.read_vector("up")[leaning]
    assert np.abs((heading * up).sum(axis=1)).max() < 1e-6


def test_the_measures_tell_a_body_that_snaps_a_step_too_long_and_a_head_in_a_wall(tmp_path: Path) -> None:
    world = run(shot(tmp_path, wall_on_a_floor()), 1)
    population = world.populations["walker"]
    for k, (up, heading, place) in enumerate((((-1, 0, 0), (0, 1, 0), (0, 0, 0)), ((0, 1, 0), (1, 0, 0), (-0.3, 0, 0)))):
        for axis, u, h, x in zip("xyz", up, heading, place, strict=True):
            population.start[f"up.{axis}"][k] = population.now[f"up.{axis}"][k] = u
            population.now[f"heading.{axis}"][k] = h
            for registers in (population.start, population.now):
                registers[f"position.{axis}"][k] = x
            population.position[k, "xyz".index(axis)] = x
        population.normal[k] = up
    population.now["up.x"][0], population.now["up.y"][0] = 0, 1
    population.start["position.x"][1] = 5.0
    world.motion.reset_step_measures()
    world.motion.begin_measuring(world)
    world.motion.record_step(world)
    summary = world.motion.summarise()
    assert summary["tilt_max"] == pytest.approx(90, abs=0.01)
    assert summary["step_max"] == pytest.approx(5.3 / (30 / 24), rel=1e-4)
    assert summary["heads_inside"] >= 1 / len(population)
    assert summary["overlap_start"] > 0


def test_feet_are_exact_while_the_body_leans(tmp_path: Path) -> None:
    world, leaning = run(shot(tmp_path, wall_on_a_floor()), 1), 0
    for _ in range(80):
        step(world)
        population = world.populations["walker"]
        normal, up = population.normal.astype(np.float64), population.read_vector("up")
        leaning += int((np.abs(up - normal).max(axis=1) > 0.1).sum())
        assert np.abs(np.abs((normal * world.ground.normal(population.footing)).sum(axis=1)) - 1).max() < 1e-6
        assert np.abs((population.read_vector("velocity") * normal).sum(axis=1)).max() < 1e-3
    assert leaning > 20


def test_edges_give_the_same_bits_however_they_are_run(tmp_path: Path) -> None:
    opened_shot = shot(tmp_path, wall_on_a_floor())
    expected_hash = state_hash(run(opened_shot, 50))
    assert (
        expected_hash
        == state_hash(run(opened_shot, 50, backend="reference"))
        == state_hash(run(opened_shot, 50, shuffle_rows=3, chunk=7))
    )
    half, other = run(opened_shot, 25), bind(opened_shot.plan, opened_shot.setting)
    restore_checkpoint(other, take_checkpoint(half))
    for _ in range(25):
        step(other)
    assert state_hash(other) == expected_hash


@pytest.mark.parametrize("spread", [0.0, 0.5, 3.0, 60.0])
def test_overlap_is_exact_however_dense_a_crowd_is(spread: float) -> None:
    draw = np.random.default_rng(2)
    place, radius = (draw.random((300, 3)) * spread).astype(np.float32), (1 + draw.random(300)).astype(np.float32)
    place[:40] = place[0]
    away = np.sqrt(((place[:, None] - place[None]) ** 2).sum(axis=2))
    expected = np.clip(1 - away / (radius[:, None] + radius[None]), 0, 1)
    np.fill_diagonal(expected, 0)
    assert measure_worst_overlaps(*place.T.copy(), radius) == pytest.approx(expected.max(axis=1), abs=1e-6)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_few_agents_overlap_or_none(count: int) -> None:
    place, radius = np.full((3, count), 4, np.float32), np.zeros(count, np.float32)
    assert measure_worst_overlaps(*place, radius).tolist() == [float(count > 1)] * count
    place[0, 1:] += np.float32(0.5)
    assert measure_worst_overlaps(*place, radius + 1).tolist() == [0.75 if count > 1 else 0] * count
    assert measure_worst_overlaps(*place, radius).tolist() == [0] * count


def test_overlaps_of_thousands_in_one_place_are_exact() -> None:
    place, radius = np.zeros((3, 20_000), np.float32), np.full(20_000, 2, np.float32)
    assert (measure_worst_overlaps(*place, radius) == 1).all()
    place[:] = np.random.default_rng(1).random(place.shape) * 2
    assert measure_worst_overlaps(*place, radius).min() > 0.9
