"""Bodies that take room: crowds come apart, across species, by mass, on thin sheets and at rest; the same bits everywhere."""

from __future__ import annotations

from functools import cache

import meshes
import numpy as np
import pytest
from test_program import checked, complaints

from antdsl import passes, plan
from antdsl.runtime import Options, World, bind, restore_checkpoint, state_hash, step, take_checkpoint
from antdsl.runtime.moving.contacts import capsules, contact_solver
from antdsl.runtime.moving.contacts.capsules import CapsuleCrowd, find_near_pairs, measure_overlap_depths
from antdsl.scene.setting import CrowdData, MeshData, PlacementData, WorldSetting

RESTING = """ant 1
species ant {
  size uniform(3.6 mm, 4.4 mm)
  max_speed 30 mm/s
  on spawn { velocity = 0 * velocity }
  start rest
  state rest { steer 0 * heading }
}
species ball {
  size 10 mm
  mass 1 kg
  max_speed 20 mm/s
  on spawn { velocity = 0 * velocity }
  start rest
  state rest { steer 0 * heading }
}
"""
WALKING = RESTING.replace("state rest { steer 0 * heading }", "state rest { steer -position / 10 mm }", 1)


@cache
def plan_of(text: str) -> plan.ir.Plan:
    program, report = checked(text)
    assert report.ok, complaints(report)
    return passes.optimise_plan(plan.lower(program)[0])


def points(*coordinates: tuple[float, float]) -> PlacementData:
    return PlacementData(points=np.array([[x, 0.0, z] for x, z in coordinates]))


def cluster(count: int, radius: float = 0.0) -> PlacementData:
    random = np.random.default_rng(count)
    far, angle = radius * np.sqrt(random.random(count)), random.random(count) * 2 * np.pi
    return points(*zip(far * np.cos(angle), far * np.sin(angle), strict=True))


def world(*crowds: CrowdData, text: str = RESTING, options: Options | None = None, **setting_arguments: object) -> World:
    setting = WorldSetting(crowds=crowds, seed=3, **{"contacts": "hard", **setting_arguments})  # type: ignore[arg-type]
    return bind(plan_of(text), setting, options or Options(backend="numpy"))


def positions_by_id(bound_world: World, species: str = "ant") -> np.ndarray:
    population = bound_world.populations[species]
    return population.position[population.get_rows_by_id()]


# --- heaps -----------------------------------------------------------------------------------------------------------


def frames_until_free(bound_world: World, most: int) -> int:
    for frame in range(most):
        if measure_overlap_depths(bound_world).max() < 1e-3:
            return frame
        previous_positions = positions_by_id(bound_world)
        step(bound_world)
        assert np.linalg.norm(positions_by_id(bound_world) - previous_positions, axis=1).max() <= 30 / 24 * 1.005
    raise AssertionError(f"still {measure_overlap_depths(bound_world).max():.3g} of a width deep")


def test_a_cluster_in_one_place_separates_and_lies_still() -> None:
    bound_world = world(CrowdData("ant", 60, cluster(60)))
    assert frames_until_free(bound_world, 60) > 5
    for _ in range(12):  # what is left is parted to less than half of that
        step(bound_world)
    previous_positions = positions_by_id(bound_world)
    for _ in range(3):
        step(bound_world)
    assert np.array_equal(positions_by_id(bound_world), previous_positions)
    assert not bound_world.populations["ant"].read_vector("velocity").any()


@pytest.mark.slow
def test_a_cluster_of_a_thousand_is_free_within_three_seconds() -> None:
    assert frames_until_free(world(CrowdData("ant", 1000, cluster(1000, 20.0))), 72) > 10


@pytest.mark.parametrize("mode", ["hard", "soft"])
def test_the_same_bits_for_any_rows_threads_chunks_and_backend(mode: str) -> None:
    hashes = set()
    for options in (
        Options(backend="numpy"),
        Options(backend="numpy", shuffle_rows=5),
        Options(backend="numpy", threads=3, chunk=64),
        Options(backend="reference", shuffle_rows=1),
        Options(backend="native", wait_for_code=True),
    ):
        bound_world = world(
            CrowdData("ant", 120, cluster(120, 4.0)),
            CrowdData("ball", 3, cluster(3), 1, body="ball"),
            text=WALKING,
            options=options,
            contacts=mode,
        )
        for _ in range(8):
            step(bound_world)
        hashes.add(state_hash(bound_world))
    assert len(hashes) == 1


@pytest.mark.parametrize("mass", [np.nan, np.inf])
def test_one_without_a_mass_changes_nothing_for_who_does_not_touch_it(mass: float) -> None:
    position_sets = []
    for far in (False, True):
        near = cluster(60, 6.0).points
        bound_world = world(CrowdData("ant", 61, PlacementData(points=np.concatenate([near, [[90.0, 0.0, 0.0]]]))), text=WALKING)
        bound_world.populations["ant"].now["mass"][60] = mass if far else 1.0
        with np.errstate(all="ignore"):
            step(bound_world)
        position_sets.append(positions_by_id(bound_world)[:60])
    assert np.array_equal(*position_sets) and measure_overlap_depths(bound_world).max() > 0


def test_soft_bodies_part_more_slowly_and_none_at_all_without_contacts() -> None:
    depth_ratios = {}
    for mode in ("off", "soft", "hard"):
        bound_world = world(CrowdData("ant", 2, points((0.0, 0.0), (0.3, 0.1))), contacts=mode)
        start_depth = measure_overlap_depths(bound_world).max()
        step(bound_world)
        depth_ratios[mode] = measure_overlap_depths(bound_world).max() / start_depth
    assert depth_ratios["off"] == 1.0 and 0.5 < depth_ratios["soft"] < 0.95 and depth_ratios["hard"] < 1e-3


def test_a_checkpoint_goes_on_to_the_same_bits() -> None:
    bound_world = world(CrowdData("ant", 40, cluster(40, 2.0)), text=WALKING)
    for _ in range(4):
        step(bound_world)
    other = world(CrowdData("ant", 40, cluster(40, 2.0)), text=WALKING)
    restore_checkpoint(other, take_checkpoint(bound_world))
    for _ in range(4):
        step(bound_world)
        step(other)
    assert state_hash(bound_world) == state_hash(other)


# --- pairs -----------------------------------------------------------------------------------------------------------


def test_the_lighter_one_makes_room_across_species() -> None:
    bound_world = world(CrowdData("ant", 1, points((1.0, 0.0))), CrowdData("ball", 1, points((0.0, 0.0)), 1, body="ball"))
    start_positions = positions_by_id(bound_world), positions_by_id(bound_world, "ball")
    for _ in range(4):
        step(bound_world)
    distances = (
        np.linalg.norm(positions_by_id(bound_world) - start_positions[0]),
        np.linalg.norm(positions_by_id(bound_world, "ball") - start_positions[1]),
    )
    assert measure_overlap_depths(bound_world).max() < 1e-3 and distances[0] > 0.3 and distances[1] < 0.01 * distances[0]


def test_who_meets_one_that_stands_goes_round_it_and_not_through() -> None:
    text = RESTING.replace("state rest { steer 0 * heading }", "state rest { steer heading }", 1)
    text = text.replace(
        "on spawn { velocity = 0 * velocity }", "on spawn { heading = vector(1, 0, 0); velocity = 0 * velocity }", 1
    )
    text = text.replace("max_speed 20 mm/s", "max_speed 0.001 mm/s")
    bound_world = world(
        CrowdData("ant", 1, points((-12.0, 0.0))), CrowdData("ball", 1, points((0.0, 0.0)), 1, body="ball"), text=text
    )
    nearest = 12.0
    for _ in range(30):
        step(bound_world)
        assert measure_overlap_depths(bound_world).max() < 0.02
        nearest = min(nearest, float(np.linalg.norm(positions_by_id(bound_world)[0])))
    # The room of both, at the heights of their trunks: the ball's swells above the ant.
    assert 3.0 < nearest < 6.0 and np.abs(positions_by_id(bound_world, "ball")).max() < 0.01


def test_two_sides_of_a_thin_sheet_do_not_meet() -> None:
    plate = MeshData(*meshes.box((-40, 0, -40), (40, 0.1, 40)))
    surfaces = {"plate": plate}
    text = RESTING.replace("species ant", 'world { surface plate "thin" }\nspecies ant', 1)
    bound_world = world(CrowdData("ant", 300, PlacementData(surfaces=("plate",), is_by_area=True)), text=text, surfaces=surfaces)
    sides = np.sign(bound_world.populations["ant"].normal[:, 1])
    assert (sides > 0).any() and (sides < 0).any()
    for _ in range(30):
        step(bound_world)
    assert measure_overlap_depths(bound_world).max() < 1e-3
    crowd = CapsuleCrowd(bound_world)
    middles = crowd.middle.T
    near = np.linalg.norm(middles[:, None] - middles[None], axis=2) < 1.5
    assert (
        near & (np.sign(bound_world.populations["ant"].normal[:, 1])[:, None] != sides[None])
    ).any()  # right below one another


def test_who_is_frozen_by_a_fault_is_not_pushed() -> None:
    bound_world = world(CrowdData("ant", 2, points((0.0, 0.0), (0.2, 0.0))))
    bound_world.populations["ant"].quarantined[0] = True
    start_positions = positions_by_id(bound_world)
    for _ in range(3):
        step(bound_world)
    assert (
        np.array_equal(positions_by_id(bound_world)[0], start_positions[0]) and measure_overlap_depths(bound_world).max() < 1e-3
    )


# --- who is near ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("n", [300, 600])
def test_pairs_of_a_crowd_in_one_place_grow_with_it_and_not_with_its_square(n: int) -> None:
    assert 40 * n < len(find_near_pairs(CapsuleCrowd(world(CrowdData("ant", n, cluster(n))))).first_indices) < 60 * n


# --- crowds that want somewhere ---------------------------------------------------------------------------------------

DOORWAY = WALKING.replace("ant 1\n", "ant 1\nuse steering\nworld { obstacle walls }\n", 1).replace(
    "steer -position / 10 mm",
    "steer if dot(position, vector(1, 0, 0)) < 3 mm then seek(vector(4 mm, 0 mm, 0 mm)) else seek(vector(200 mm, 0 mm, 0 mm))",
)


@pytest.mark.parametrize("count, radius, frames", [(12, 5.0, 100), pytest.param(40, 9.0, 240, marks=pytest.mark.slow)])
def test_a_crowd_goes_through_a_doorway_and_does_not_shiver_in_front_of_it(count: int, radius: float, frames: int) -> None:
    near, far = meshes.box((-1, -1, 2.5), (1, 6, 25)), meshes.box((-1, -1, -25), (1, 6, -2.5))
    walls = MeshData(np.concatenate([near[0], far[0]]), np.concatenate([near[1], far[1] + len(near[0])]))
    start = cluster(count, radius).points
    assert start is not None
    bound_world = world(
        CrowdData("ant", count, PlacementData(points=start - (radius + 4.0, 0.0, 0.0))), text=DOORWAY, obstacles={"walls": walls}
    )
    turned, back, steps = np.zeros(count), 0, 0
    for frame in range(frames):
        previous_headings = bound_world.populations["ant"].read_vector("heading").copy()
        step(bound_world)
        headings, waiting = bound_world.populations["ant"].read_vector("heading"), positions_by_id(bound_world)[:, 0] < 0
        turn = np.degrees(np.arcsin(np.clip(np.cross(previous_headings, headings)[:, 1], -1, 1)))
        if frame > 12:
            back += int(((np.abs(turn) > 2) & (np.abs(turned) > 2) & (turn * turned < 0) & waiting).sum())
            steps += int(waiting.sum())
        turned = turn
    assert (positions_by_id(bound_world)[:, 0] > 1).all()
    assert steps > 5 * count and back < 0.03 * steps


def test_who_faces_as_before_has_its_trunk_where_that_puts_it(monkeypatch: pytest.MonkeyPatch) -> None:
    bound_world = world(CrowdData("ant", 80, cluster(80, 9.0)), text=WALKING)
    separate, face = contact_solver._solve_separation, contact_solver._restore_headings
    as_before: list[int] = []
    faced: list[float] = []

    def counted(crowd: CapsuleCrowd, near: capsules.NearbyCapsulePairs, stopped: np.ndarray, headings: object) -> None:
        as_before.append(len(stopped))
        face(crowd, near, stopped, headings)  # type: ignore[arg-type]

    def looked_at(near: capsules.NearbyCapsulePairs, *rest: object) -> np.ndarray:
        if len(faced) < len(as_before):  # before anybody is walked
            faced.append(float(np.abs(near.middle - CapsuleCrowd(bound_world).middle[:, near.rows]).max()))
        return separate(near, *rest)  # type: ignore[arg-type]

    monkeypatch.setattr(contact_solver, "_restore_headings", counted)
    monkeypatch.setattr(contact_solver, "_solve_separation", looked_at)
    for _ in range(20):
        step(bound_world)
    assert sum(as_before) > 20 and max(faced) < 1e-6
