"""Agents with steps longer than a body do not pass through each other: at any angle, size, species, slope and density."""

from __future__ import annotations

from itertools import combinations

import meshes
import numpy as np
import pytest
from test_contact_kernels import bodies, closest
from test_contacts import points, positions_by_id, world

from antdsl.runtime import Options, World, state_hash, step
from antdsl.runtime.moving.contacts.capsules import CapsuleCrowd, find_capsule, measure_overlap_depths
from antdsl.runtime.moving.contacts.impacts import NO_IMPACT_TIME, CapsulePaths, PathEncounters
from antdsl.runtime.moving.contacts.long_steps import StartPositions, _fill_paths, _list_path_encounters
from antdsl.runtime.moving.stopping import find_next_impacts
from antdsl.scene.setting import CrowdData, MeshData, PlacementData

FAST = """ant 1
species ant {
  size 10 mm
  max_speed 3 m/s
  response 0.01 s
  start go
  state go { steer heading }
}
species ball {
  size 14 mm
  max_speed 2 m/s
  response 0.01 s
  start go
  state go { steer heading }
}
"""
HEAVY = FAST.replace("size 14 mm", "size 14 mm\n  mass 1 kg")


def crowd_positions(built: World) -> np.ndarray:
    return np.concatenate([positions_by_id(built, name) for name in built.populations])


def radii(built: World) -> np.ndarray:
    return np.concatenate(
        [
            population.now["size"][population.get_rows_by_id()] * find_capsule(built, name).width / 2
            for name, population in built.populations.items()
        ]
    ).astype(np.float64)


def passed_pairs(start: np.ndarray, end: np.ndarray, radius: np.ndarray, share: float = 0.7) -> list[tuple[int, int]]:
    """The pairs of balls that come nearer than a share of both radii on straight paths, and were not so near before."""
    results = []
    for i, j in combinations(range(len(radius)), 2):
        away, moves = start[i] - start[j], (end[i] - end[j]) - (start[i] - start[j])
        time = np.clip(-(away @ moves) / max(moves @ moves, 1e-12), 0, 1)
        near = share * (radius[i] + radius[j])
        if np.linalg.norm(away + moves * time) < near <= np.linalg.norm(away):
            results.append((i, j))
    return results


def aim(built: World, species: str, directions: np.ndarray) -> None:
    """Turn the agents of a species, by id, to directions (n, 3), with their full speed."""
    population = built.populations[species]
    rows = population.get_rows_by_id()
    for registers in (population.now, population.start):
        for axis, name in enumerate("xyz"):
            registers[f"heading.{name}"][rows] = directions[:, axis]
            registers[f"velocity.{name}"][rows] = directions[:, axis] * registers["max_speed"][rows]


def level(*angles: float) -> np.ndarray:
    """Directions (n, 3) in the plane, by their angles (radians)."""
    return np.array([[np.cos(angle), 0.0, np.sin(angle)] for angle in angles])


def count_passes(built: World, frames: int) -> int:
    """How many pairs pass through each other in a run."""
    passes, radius = 0, radii(built)
    for _ in range(frames):
        start = crowd_positions(built)
        step(built)
        passes += len(passed_pairs(start, crowd_positions(built), radius))
    return passes


def meeting(turn: float, speeds: float = 1.0, text: str = FAST, **setting: object) -> World:
    """An ant from the left and a ball from another direction, which would reach the origin at the same time within a step."""
    far = 300 * speeds
    built = world(
        CrowdData("ant", 1, points((-far, 0.0)), body="ball"),
        CrowdData("ball", 1, points((-far * 2 / 3 * np.cos(turn), -far * 2 / 3 * np.sin(turn))), 1, body="ball"),
        text=text,
        **setting,
    )
    aim(built, "ant", level(0.0))
    aim(built, "ball", level(turn))
    return built


@pytest.mark.parametrize("turn", [np.pi, 3.0, 2.3, np.pi / 2, 1.0])
def test_two_that_meet_at_any_angle_do_not_pass_through_each_other(turn: float) -> None:
    assert count_passes(meeting(turn, contacts="soft"), 6) == 1
    built = meeting(turn)
    assert count_passes(built, 6) == 0 and measure_overlap_depths(built).max() < 1e-3


def test_agents_stop_where_they_touch() -> None:
    built = meeting(np.pi)
    for _ in range(6):
        step(built)
    ant, ball = crowd_positions(built)
    assert np.isclose(ball[0] - ant[0], np.sqrt(12**2 - 2**2), rtol=3e-3) and -40 < ant[0] < ball[0] < 40


def test_without_a_body_in_between_steps_are_as_without_contacts() -> None:
    ends = []
    for mode in ("off", "hard"):
        built = meeting(np.pi / 2, contacts=mode)
        aim(built, "ball", level(np.pi / 2 + 0.4))
        for _ in range(4):
            step(built)
        ends.append(crowd_positions(built))
    assert np.array_equal(*ends)


def test_a_third_one_does_not_pass_through_two_that_have_stopped() -> None:
    built = world(CrowdData("ant", 3, points((-150.0, 0.0), (-60.0, 0.0), (60.0, 0.0)), body="ball"), text=FAST)
    aim(built, "ant", level(0.0, 0.0, np.pi))
    passes = count_passes(built, 5)
    x = crowd_positions(built)[:, 0]
    assert passes == 0 and (np.diff(x) > 9.9).all() and x.max() - x.min() < 60


def test_a_follower_behind_a_slower_one_stays_behind_and_as_fast() -> None:
    built = world(
        CrowdData("ant", 1, points((-200.0, 0.0)), body="ball"),
        CrowdData("ball", 1, points((0.0, 0.0)), 1, body="ball"),
        text=FAST,
    )
    aim(built, "ant", level(0.0))
    aim(built, "ball", level(0.0))
    assert count_passes(built, 12) == 0
    ant, ball = crowd_positions(built)
    assert ball[0] == pytest.approx(1000, rel=1e-3) and ball[0] - 25 < ant[0] < ball[0] - 11


def test_a_heavy_one_pushes_a_light_one_and_does_not_pass_it() -> None:
    built = meeting(np.pi, text=HEAVY)
    assert count_passes(built, 8) == 0
    ant, ball = crowd_positions(built)
    assert ant[0] < ball[0] < -20  # the ball goes on from right to left


@pytest.mark.parametrize("spread", [70.0, 150.0, 300.0])
def test_no_pair_of_a_crowd_passes_and_all_options_give_the_same_bits(spread: float) -> None:
    rng, positions = np.random.default_rng(int(spread)), np.empty((0, 2))
    while len(positions) < 36:
        place = rng.uniform(-spread, spread, 2)
        if not len(positions) or np.linalg.norm(positions - place, axis=1).min() > 14.1:
            positions = np.concatenate([positions, [place]])
    angles, hashes = rng.uniform(0, 7, (2, 18)), set()
    for mode, options in (
        ("soft", Options(backend="numpy")),
        ("hard", Options(backend="numpy")),
        ("hard", Options(backend="numpy", shuffle_rows=5)),
        ("hard", Options(backend="reference", shuffle_rows=1)),
        ("hard", Options(backend="native", wait_for_code=True, threads=3, chunk=64)),
    ):
        crowds = (
            CrowdData("ant", 18, points(*positions[:18]), body="ball"),
            CrowdData("ball", 18, points(*positions[18:]), 1, body="ball"),
        )
        built = world(*crowds, text=FAST, contacts=mode, options=options)
        aim(built, "ant", level(*angles[0]))
        aim(built, "ball", level(*angles[1]))
        passes = count_passes(built, 6)
        assert (passes > 3) if mode == "soft" else (passes == 0)
        hashes |= {state_hash(built)} if mode == "hard" else set()
    assert len(hashes) == 1


@pytest.mark.parametrize("offset", [0.0, 0.013, -0.02])
def test_two_on_a_hill_do_not_pass_through_each_other(offset: float) -> None:
    passes = {}
    for mode in ("soft", "hard"):
        angles = np.array([np.pi / 2 - 0.4, np.pi / 2 + 0.35 + offset])
        place = PlacementData(points=300 * np.stack([np.cos(angles), np.sin(angles), 0.3 * offset * np.ones(2)], axis=1))
        text = FAST.replace("ant 1\n", "ant 1\nworld { surface hill }\n")
        surfaces = {"hill": MeshData(*meshes.ball(300.0, rings=40))}
        built = world(CrowdData("ant", 2, place, body="ball"), text=text, contacts=mode, surfaces=surfaces)
        aim(built, "ant", level(np.pi, 0.0))
        passes[mode] = count_passes(built, 4)
    assert passes == {"soft": 1, "hard": 0}


@pytest.mark.parametrize("turn", [np.pi / 2, 2.0, np.pi])
def test_capsules_that_walk_sideways_do_not_pass_either(turn: float) -> None:
    text, passes = FAST.replace("state go { steer heading }", "state go { steer heading; face vector(0, 0, 1) }"), {}
    for mode in ("soft", "hard"):
        built = world(
            CrowdData("ant", 2, points((-100.0, 0.0), (-100 * np.cos(turn), -100 * np.sin(turn)))), text=text, contacts=mode
        )
        aim(built, "ant", level(0.0, turn))
        passes[mode], (start, end) = 0, (crowd_positions(built), None)
        for _ in range(4):
            step(built)
            end = crowd_positions(built)
            passes[mode] += len(passed_pairs(start, end, radii(built)))
            start = end
    assert passes["hard"] == 0 < passes["soft"]


@pytest.mark.parametrize("seed", range(2))
def test_impacts_are_the_first_contacts_of_sampled_paths(seed: int) -> None:
    built, rng = bodies(seed, spread=14.0), np.random.default_rng(seed)
    n, moves = built.middle.shape[1], rng.normal(0, 4, built.middle.shape)
    paths = CapsulePaths(
        built.middle, moves, built.axis_directions, built.up, built.half_lengths, built.radius, np.zeros(n), np.ones(n)
    )
    pairs = PathEncounters(
        built.first_indices,
        built.second_indices,
        np.full(len(built.first_indices), NO_IMPACT_TIME),
        np.zeros((3, len(built.first_indices))),
    )
    touched, first, times = np.ones(n, np.bool_), np.empty(n), np.linspace(0, 1, 41)
    assert find_next_impacts(pairs, paths, touched, touched.copy(), first) == (pairs.meeting_time <= 1).sum() > 10
    for pair, (p, q) in list(enumerate(zip(built.first_indices, built.second_indices, strict=True)))[seed::4]:
        wide, gaps = (built.radius[p] + built.radius[q]) * (1 - 2e-3), np.empty(len(times))
        for k, time in enumerate(times):
            away, a, b = (
                (built.middle + moves * time)[:, [p, q]] @ [1, -1],
                built.axis_directions[:, p],
                built.axis_directions[:, q],
            )
            s, t = closest(away, a, b, built.half_lengths[p], built.half_lengths[q])
            gaps[k] = np.linalg.norm(away + a * s - b * t) - wide
        inside = np.flatnonzero(gaps < 0)
        if gaps[0] < 0:
            continue  # they overlap from the start
        if len(inside):
            assert times[inside[0]] - 1 / 40 - 1e-6 <= pairs.meeting_time[pair] <= times[inside[0]] + 1e-6
        elif pairs.meeting_time[pair] <= 1:  # a graze between two samples
            assert gaps.min() < 0.2
    for k in range(n):
        assert first[k] == min(pairs.meeting_time[(built.first_indices == k) | (built.second_indices == k)])


def test_all_pairs_that_pass_are_listed_for_any_sizes_and_densities() -> None:
    rng, n = np.random.default_rng(5), 160
    angle, middle = rng.uniform(0, 7, n), rng.uniform(-400, 400, (3, n)) * [[1], [0.01], [1]]
    ahead = np.stack([np.cos(angle), np.zeros(n), np.sin(angle)])
    moves = rng.normal(0, 60, (3, n)) * rng.choice([0.1, 1.0, 3.0], n) * [[1], [0], [1]]
    half, radius = rng.uniform(0, 9, n), rng.choice([2.0, 5.0, 20.0], n)
    up = np.zeros((3, n)) + np.array([[0.0], [1], [0]])
    paths = CapsulePaths(middle, moves, ahead, up, half, radius, np.zeros(n), np.ones(n))
    active, rank = (rng.random(n) < 0.5).astype(np.int64), rng.permutation(n)
    listed = _list_path_encounters(paths, rank, active, True)
    i, j = (np.array(each) for each in zip(*combinations(range(n), 2), strict=True))
    every = PathEncounters(i, j, np.full(len(i), NO_IMPACT_TIME), np.zeros((3, len(i))))
    find_next_impacts(every, paths, np.ones(n, np.bool_), np.ones(n, np.bool_), np.empty(n))
    thin = PathEncounters(i, j, np.full(len(i), NO_IMPACT_TIME), np.zeros((3, len(i))))
    find_next_impacts(thin, paths._replace(radius=radius * 0.8), np.ones(n, np.bool_), np.ones(n, np.bool_), np.empty(n))
    far, wide = np.linalg.norm(moves[:, i] - moves[:, j], axis=0), radius[i] + radius[j]
    passes = (thin.meeting_time <= 1) & (far > wide * 2.0) & ((active[i] | active[j]) > 0)
    results = {(min(p, q), max(p, q)) for p, q in zip(listed.first_rows.tolist(), listed.second_rows.tolist(), strict=True)}
    assert {(int(p), int(q)) for p, q in zip(i[passes], j[passes], strict=True)} <= results and passes.sum() > 60
    touching = {(int(p), int(q)) for p, q in zip(i[every.meeting_time <= 1], j[every.meeting_time <= 1], strict=True)}
    assert len(results) == len(listed.first_rows) and len(results - touching) <= 2  # the radii of `every` are 0.2 % less
    assert (rank[listed.first_rows] < rank[listed.second_rows]).all()
    assert (np.diff(rank[listed.first_rows] * n + rank[listed.second_rows]) > 0).all()


def test_paths_run_from_the_start_to_the_end_with_the_bodies_of_the_end() -> None:
    place = PlacementData(points=300 * np.array([[0.1, 0.9, 0.3], [-0.3, 0.8, 0.1]]))
    text = FAST.replace("ant 1\n", "ant 1\nworld { surface hill }\n")
    built = world(CrowdData("ant", 2, place), text=text, surfaces={"hill": MeshData(*meshes.ball(300.0, rings=40))})
    population = built.populations["ant"]
    began = StartPositions({"ant": population.position.copy()}, {"ant": population.normal.copy()})
    step(built)
    crowd = CapsuleCrowd(built)
    paths = _fill_paths(crowd, began)
    walked = (population.position - began.positions["ant"]).T
    ups = np.stack([population.now[f"up.{axis}"] for axis in "xyz"]).astype(np.float64)
    assert np.array_equal(paths.displacement, walked) and np.allclose(paths.middle, crowd.middle - walked)
    assert np.array_equal(paths.axis_direction, np.stack([population.now[f"heading.{axis}"] for axis in "xyz"]))
    mean = ups + began.normals["ant"].T
    assert np.allclose(paths.up, mean / np.linalg.norm(mean, axis=0)) and np.array_equal(paths.mass, population.now["mass"])
    far, bend = np.linalg.norm(walked, axis=0), np.linalg.norm(ups - began.normals["ant"].T, axis=0)
    assert np.allclose(paths.path_sag, far * bend / 4) and (paths.path_sag > 2 * far**2 / 8 / 300 * 0.8).all()
