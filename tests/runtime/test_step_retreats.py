"""Steps after which bodies overlap are taken back, so no frame shows a body inside another."""

from __future__ import annotations

import digging_shots
import numpy as np
import pytest
from test_contacts import plan_of, points

from antdsl.ground.solid import Volume
from antdsl.runtime import Options, World, bind, state_hash, step
from antdsl.runtime.moving.contacts.capsules import CapsuleCrowd, find_near_pairs
from antdsl.runtime.moving.contacts.step_retreats import Stances, take_back_overlapping_steps
from antdsl.scene.setting import CrowdData, WorldSetting
from tests.motion_track import Trunks, overlapping

TEXT = """ant 2
species ant {
  size 4 mm
  max_speed 30 mm/s
  start rest
  state rest { steer 0 * heading }
}
"""
PROGRAM = """ant 2
use steering
world { surface ground; solid hill; items goal }
species walker {
  size 4 mm
  max_speed 30 mm/s
  response 0.15 s
  max_turn 400 deg/s
  start go
  state go { steer wander(swing: 50 deg) }
}
"""
SCENE = """antdsl: 1
units: mm
fps: 24
frames: 1..60
seed: 3
contacts: hard
world:
  ground: {mesh: ground.ply}
  hill: {mesh: hill.ply, voxel: 0.5 mm}
  goal: {there: {at: [19, 0, 0], on: ground, radius: 2 mm}}
crowd:
  - {species: walker, from: dig.ant, count: 24, place: {on: hill, around: [0, 0, 0], radius: 12 mm}}
"""


def ants_at(*positions: tuple[float, float], shuffle_rows: int | None = None) -> World:
    crowd = CrowdData("ant", len(positions), points(*positions))
    options = Options(backend="numpy", shuffle_rows=shuffle_rows)
    return bind(plan_of(TEXT), WorldSetting(crowds=(crowd,), seed=3, contacts="hard"), options)


def row_of_ants(*ahead: float) -> World:
    return ants_at(*((x, 0.0) for x in ahead))


def count_overlaps(world: World) -> int:
    """The agents that overlap visibly, by the measure of the motion gate."""
    crowd = CapsuleCrowd(world)
    axis = np.stack(crowd.read_vector("heading"), axis=1).astype(np.float64)
    return int(overlapping(Trunks(crowd.middle.T, axis, crowd.half, crowd.radius, np.ones(len(crowd)))).sum())


def move(world: World, row: int, x: float, z: float = 0.0) -> None:
    """Move an agent to (x, 0, z) mm. Its arrays are new ones, as after a walk."""
    ants = world.populations["ant"]
    ants.position = ants.position.copy()
    ants.footing = ants.footing.copy()
    ants.position[row, 0] = ants.now["position.x"][row] = x
    ants.position[row, 2] = ants.now["position.z"][row] = z
    place, *_ = world.ground.find_nearest(ants.position[row : row + 1])
    ants.footing.write_rows(np.array([row]), place)


def test_a_pair_that_overlaps_returns_and_so_do_others_in_its_places() -> None:
    world = row_of_ants(0.0, 10.0, 20.0, 40.0)
    ants = world.populations["ant"]
    for k, axis in enumerate("xyz"):
        ants.now[f"heading.{axis}"][:] = ants.start[f"heading.{axis}"][:] = float(k == 0)
    start, began = {"ant": Stances(ants)}, ants.position.copy()
    near = find_near_pairs(CapsuleCrowd(world))
    move(world, 1, 19.0)  # into the third
    move(world, 0, 8.0)  # into the place of the second
    move(world, 3, 41.0)
    ants.now["velocity.x"][:] = 5
    assert count_overlaps(world) == 2
    take_back_overlapping_steps(world, start, near)
    assert count_overlaps(world) == 0
    assert np.array_equal(ants.position[:3], began[:3]) and ants.position[3, 0] == 41
    assert np.array_equal(ants.now["position.x"], ants.position[:, 0].astype(np.float32))
    assert ants.now["velocity.x"].tolist() == [0, 0, 0, 5]
    assert np.allclose(world.ground.position(ants.footing), ants.position)


def test_agents_that_overlapped_at_the_start_keep_their_steps() -> None:
    world = row_of_ants(0.0, 1.0)
    ants = world.populations["ant"]
    for k, axis in enumerate("xyz"):
        ants.now[f"heading.{axis}"][:] = ants.start[f"heading.{axis}"][:] = float(k == 2)
    move(world, 1, 0.5)
    start = {"ant": Stances(ants)}
    near = find_near_pairs(CapsuleCrowd(world))
    move(world, 1, 0.7)
    assert count_overlaps(world) == 2
    take_back_overlapping_steps(world, start, near)
    assert ants.position[:, 0] == pytest.approx([0.0, 0.7])


def walk_across(frames: int, shuffle_rows: int | None = None) -> np.ndarray:
    """The positions (mm) of two agents by frame and id. The first walks along x, and the second along z into its path: both steps
    together make them overlap, but the step of the first alone does not."""
    world = ants_at((0.0, 0.0), (1.0, -1.9), shuffle_rows=shuffle_rows)
    ants = world.populations["ant"]
    for k, axis in enumerate("xyz"):
        ants.now[f"heading.{axis}"][:] = ants.start[f"heading.{axis}"][:] = float(k == 0)
    first, second = ants.get_rows_by_id()
    path = []
    for _ in range(frames):
        world.frame += 1
        start = {"ant": Stances(ants)}
        near = find_near_pairs(CapsuleCrowd(world))
        move(world, first, ants.position[first, 0] + 0.4)
        move(world, second, 1.0, ants.position[second, 2] + 0.4)
        take_back_overlapping_steps(world, start, near)
        assert count_overlaps(world) == 0
        path.append(ants.position[[first, second]])
    return np.array(path)


def test_agents_on_paths_that_cross_pass_each_other() -> None:
    """If both steps are taken back in each frame, neither ever goes on."""
    path = walk_across(60)
    assert path[-1, 0, 0] > 8 and path[-1, 1, 2] > 8
    still = (np.diff(path, axis=0) == 0).all(axis=(1, 2))
    assert not (still[1:] & still[:-1]).any()  # in two frames, at least one of them goes on


def test_turns_depend_on_ids_and_not_on_rows() -> None:
    assert any(ants_at((0.0, 0.0), (9.0, 0.0), shuffle_rows=k).populations["ant"].ids[0] == 1 for k in range(4))
    paths = [walk_across(30, shuffle_rows) for shuffle_rows in (None, 0, 1, 2, 3)]
    assert all(np.array_equal(path, paths[0]) for path in paths[1:])


@pytest.fixture(scope="module")
def shaft(tmp_path_factory: pytest.TempPathFactory) -> digging_shots.Shot:
    return digging_shots.opened(digging_shots.folder(tmp_path_factory.mktemp("shaft"), PROGRAM, SCENE))


def test_no_bodies_overlap_in_a_dug_shaft(shaft: digging_shots.Shot) -> None:
    """The ups of bodies differ by any angle there. Without retreats, two agents overlap in five of these frames."""
    hashes = []
    for options in (Options(), Options(threads=2, chunk=5, shuffle_rows=4)):
        world = bind(shaft.plan, shaft.setting, options)
        hill = world.solids["hill"]
        assert isinstance(hill, Volume)
        y = np.linspace(0, 22, 60)
        hill.carve_balls(np.stack([0 * y, y, 0 * y], axis=1), np.full(60, 4.0), np.arange(60))
        counts = []
        for _ in range(60):
            step(world)
            counts.append(count_overlaps(world))
        assert max(counts[10:]) == 0
        hashes.append(state_hash(world))
    assert hashes[0] == hashes[1]
