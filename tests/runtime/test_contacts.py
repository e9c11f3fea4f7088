"""Bodies that take room: crowds come apart, across species, by mass, on thin sheets and at rest; the same bits everywhere."""

from __future__ import annotations

from functools import cache

import meshes
import numpy as np
import pytest
from test_program import checked, complaints

from antdsl import passes, plan
from antdsl.runtime import Options, World, bind, checkpoint, restore, state_hash, step
from antdsl.runtime.moving import capsules, contacts
from antdsl.runtime.moving.capsules import Crowd, depths, find
from antdsl.scene.setting import CrowdData, MeshData, PlaceData, Setting

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
    return passes.optimise(plan.lower(program)[0])


def points(*places: tuple[float, float]) -> PlaceData:
    return PlaceData(points=np.array([[x, 0.0, z] for x, z in places]))


def heap(count: int, radius: float = 0.0) -> PlaceData:
    random = np.random.default_rng(count)
    far, way = radius * np.sqrt(random.random(count)), random.random(count) * 2 * np.pi
    return points(*zip(far * np.cos(way), far * np.sin(way), strict=True))


def world(*crowds: CrowdData, text: str = RESTING, options: Options | None = None, **more: object) -> World:
    setting = Setting(crowds=crowds, seed=3, **{"contacts": "hard", **more})  # type: ignore[arg-type]
    return bind(plan_of(text), setting, options or Options(backend="numpy"))


def places(made: World, species: str = "ant") -> np.ndarray:
    population = made.populations[species]
    return population.position[population.in_id_order()]


# --- heaps -----------------------------------------------------------------------------------------------------------


def frames_until_free(made: World, most: int) -> int:
    for frame in range(most):
        if depths(made).max() < 1e-3:
            return frame
        before = places(made)
        step(made)
        assert np.linalg.norm(places(made) - before, axis=1).max() <= 30 / 24 * 1.005
    raise AssertionError(f"still {depths(made).max():.3g} of a width deep")


def test_a_heap_in_one_place_comes_apart_and_lies_still() -> None:
    made = world(CrowdData("ant", 60, heap(60)))
    assert frames_until_free(made, 60) > 5
    for _ in range(12):  # what is left is parted to less than half of that
        step(made)
    before = places(made)
    for _ in range(3):
        step(made)
    assert np.array_equal(places(made), before)
    assert not made.populations["ant"].vector("velocity").any()


@pytest.mark.slow
def test_a_heap_of_a_thousand_is_free_within_three_seconds() -> None:
    assert frames_until_free(world(CrowdData("ant", 1000, heap(1000, 20.0))), 72) > 10


@pytest.mark.parametrize("mode", ["hard", "soft"])
def test_the_same_bits_for_any_rows_threads_chunks_and_backend(mode: str) -> None:
    found = set()
    for options in (
        Options(backend="numpy"),
        Options(backend="numpy", shuffle_rows=5),
        Options(backend="numpy", threads=3, chunk=64),
        Options(backend="reference", shuffle_rows=1),
        Options(backend="native", wait_for_code=True),
    ):
        made = world(
            CrowdData("ant", 120, heap(120, 4.0)),
            CrowdData("ball", 3, heap(3), 1, body="ball"),
            text=WALKING,
            options=options,
            contacts=mode,
        )
        for _ in range(8):
            step(made)
        found.add(state_hash(made))
    assert len(found) == 1


@pytest.mark.parametrize("mass", [np.nan, np.inf])
def test_one_without_a_mass_changes_nothing_for_who_does_not_touch_it(mass: float) -> None:
    found = []
    for far in (False, True):
        near = heap(60, 6.0).points
        made = world(CrowdData("ant", 61, PlaceData(points=np.concatenate([near, [[90.0, 0.0, 0.0]]]))), text=WALKING)
        made.populations["ant"].now["mass"][60] = mass if far else 1.0
        with np.errstate(all="ignore"):
            step(made)
        found.append(places(made)[:60])
    assert np.array_equal(*found) and depths(made).max() > 0


def test_soft_bodies_part_more_slowly_and_none_at_all_without_contacts() -> None:
    deep = {}
    for mode in ("off", "soft", "hard"):
        made = world(CrowdData("ant", 2, points((0.0, 0.0), (0.3, 0.1))), contacts=mode)
        begun = depths(made).max()
        step(made)
        deep[mode] = depths(made).max() / begun
    assert deep["off"] == 1.0 and 0.5 < deep["soft"] < 0.95 and deep["hard"] < 1e-3


def test_a_checkpoint_goes_on_to_the_same_bits() -> None:
    made = world(CrowdData("ant", 40, heap(40, 2.0)), text=WALKING)
    for _ in range(4):
        step(made)
    other = world(CrowdData("ant", 40, heap(40, 2.0)), text=WALKING)
    restore(other, checkpoint(made))
    for _ in range(4):
        step(made)
        step(other)
    assert state_hash(made) == state_hash(other)


# --- pairs -----------------------------------------------------------------------------------------------------------


def test_the_lighter_one_makes_room_across_species() -> None:
    made = world(CrowdData("ant", 1, points((1.0, 0.0))), CrowdData("ball", 1, points((0.0, 0.0)), 1, body="ball"))
    before = places(made), places(made, "ball")
    for _ in range(4):
        step(made)
    gone = np.linalg.norm(places(made) - before[0]), np.linalg.norm(places(made, "ball") - before[1])
    assert depths(made).max() < 1e-3 and gone[0] > 0.3 and gone[1] < 0.01 * gone[0]


def test_who_meets_one_that_stands_goes_round_it_and_not_through() -> None:
    text = RESTING.replace("state rest { steer 0 * heading }", "state rest { steer heading }", 1)
    text = text.replace(
        "on spawn { velocity = 0 * velocity }", "on spawn { heading = vector(1, 0, 0); velocity = 0 * velocity }", 1
    )
    text = text.replace("max_speed 20 mm/s", "max_speed 0.001 mm/s")
    made = world(CrowdData("ant", 1, points((-12.0, 0.0))), CrowdData("ball", 1, points((0.0, 0.0)), 1, body="ball"), text=text)
    nearest = 12.0
    for _ in range(30):
        step(made)
        assert depths(made).max() < 0.02
        nearest = min(nearest, float(np.linalg.norm(places(made)[0])))
    # The room of both, at the heights of their trunks: the ball's swells above the ant.
    assert 3.0 < nearest < 6.0 and np.abs(places(made, "ball")).max() < 0.01


def test_two_sides_of_a_thin_sheet_do_not_meet() -> None:
    plate = MeshData(*meshes.box((-40, 0, -40), (40, 0.1, 40)))
    surfaces = {"plate": plate}
    text = RESTING.replace("species ant", 'world { surface plate "thin" }\nspecies ant', 1)
    made = world(CrowdData("ant", 300, PlaceData(on=("plate",), by_area=True)), text=text, surfaces=surfaces)
    sides = np.sign(made.populations["ant"].normal[:, 1])
    assert (sides > 0).any() and (sides < 0).any()
    for _ in range(30):
        step(made)
    assert depths(made).max() < 1e-3
    crowd = Crowd(made)
    middles = crowd.middle.T
    near = np.linalg.norm(middles[:, None] - middles[None], axis=2) < 1.5
    assert (near & (np.sign(made.populations["ant"].normal[:, 1])[:, None] != sides[None])).any()  # right below one another


def test_who_is_frozen_by_a_fault_is_not_pushed() -> None:
    made = world(CrowdData("ant", 2, points((0.0, 0.0), (0.2, 0.0))))
    made.populations["ant"].quarantined[0] = True
    before = places(made)
    for _ in range(3):
        step(made)
    assert np.array_equal(places(made)[0], before[0]) and depths(made).max() < 1e-3


# --- who is near ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("n", [300, 600])
def test_pairs_of_a_crowd_in_one_place_grow_with_it_and_not_with_its_square(n: int) -> None:
    assert 40 * n < len(find(Crowd(world(CrowdData("ant", n, heap(n))))).i) < 60 * n


# --- crowds that want somewhere ---------------------------------------------------------------------------------------

DOOR = WALKING.replace("ant 1\n", "ant 1\nuse steering\nworld { obstacle walls }\n", 1).replace(
    "steer -position / 10 mm",
    "steer if dot(position, vector(1, 0, 0)) < 3 mm then seek(vector(4 mm, 0 mm, 0 mm)) else seek(vector(200 mm, 0 mm, 0 mm))",
)


@pytest.mark.parametrize("count, radius, frames", [(12, 5.0, 100), pytest.param(40, 9.0, 240, marks=pytest.mark.slow)])
def test_a_crowd_goes_through_a_door_and_does_not_shiver_before_it(count: int, radius: float, frames: int) -> None:
    near, far = meshes.box((-1, -1, 2.5), (1, 6, 25)), meshes.box((-1, -1, -25), (1, 6, -2.5))
    walls = MeshData(np.concatenate([near[0], far[0]]), np.concatenate([near[1], far[1] + len(near[0])]))
    start = heap(count, radius).points
    assert start is not None
    made = world(
        CrowdData("ant", count, PlaceData(points=start - (radius + 4.0, 0.0, 0.0))), text=DOOR, obstacles={"walls": walls}
    )
    turned, back, steps = np.zeros(count), 0, 0
    for frame in range(frames):
        before = made.populations["ant"].vector("heading").copy()
        step(made)
        after, waiting = made.populations["ant"].vector("heading"), places(made)[:, 0] < 0
        turn = np.degrees(np.arcsin(np.clip(np.cross(before, after)[:, 1], -1, 1)))
        if frame > 12:
            back += int(((np.abs(turn) > 2) & (np.abs(turned) > 2) & (turn * turned < 0) & waiting).sum())
            steps += int(waiting.sum())
        turned = turn
    assert (places(made)[:, 0] > 1).all()
    assert steps > 5 * count and back < 0.03 * steps


def test_who_faces_as_before_has_its_trunk_where_that_puts_it(monkeypatch: pytest.MonkeyPatch) -> None:
    made = world(CrowdData("ant", 80, heap(80, 9.0)), text=WALKING)
    apart, face = contacts._apart, contacts._face_as_before
    as_before: list[int] = []
    faced: list[float] = []

    def counted(crowd: Crowd, near: capsules.Near, stopped: np.ndarray, headings: object) -> None:
        as_before.append(len(stopped))
        face(crowd, near, stopped, headings)  # type: ignore[arg-type]

    def looked_at(near: capsules.Near, *rest: object) -> np.ndarray:
        if len(faced) < len(as_before):  # before anybody is walked
            faced.append(float(np.abs(near.middle - Crowd(made).middle[:, near.rows]).max()))
        return apart(near, *rest)  # type: ignore[arg-type]

    monkeypatch.setattr(contacts, "_face_as_before", counted)
    monkeypatch.setattr(contacts, "_apart", looked_at)
    for _ in range(20):
        step(made)
    assert sum(as_before) > 20 and max(faced) < 1e-6
