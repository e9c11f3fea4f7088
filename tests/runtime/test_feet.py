"""Feet in a run: they stand still on what they stand on, are no farther off than legs reach, and are the same for any rows."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import stick_bodies
from compilers import need_llvmlite
from foot_frames import BodyFrames, lean
from numpy.typing import NDArray

from antdsl.numerics import vectors as vec
from antdsl.pipeline import Shot
from antdsl.reload import migrate_world
from antdsl.runtime import Options, World, bind, feet_hash, restore_checkpoint, state_hash, step, take_checkpoint
from antdsl.runtime.feet.feet_state import NO_GROUND_NUMBER, FeetState
from antdsl.runtime.feet.foothold_search import FootGround
from antdsl.runtime.feet.gaits import MAX_CYCLES_PER_FRAME, MAX_SINK_SHARE, compute_rest_positions

NUMPY = Options(backend="numpy", feet=True)


@pytest.fixture(scope="module")
def hill(tmp_path_factory: pytest.TempPathFactory) -> Shot:
    return stick_bodies.opened(stick_bodies.write_scene(tmp_path_factory.mktemp("hill"), 6, "hill", count=24))


def bind_shot(shot: Shot, options: Options = NUMPY) -> World:
    return bind(shot.plan, shot.setting, options)


def feet_of(world: World) -> FeetState:
    return world.feet["walker"]


def off_ground(world: World, feet: FeetState) -> NDArray[np.float64]:
    """How far (mm) feet that stand are from the nearest surface or solid of all."""
    positions = np.ascontiguousarray(feet.shown[:, feet.is_standing].T)
    return world.ground.find_nearest(positions)[1]


def far_from_hips(world: World, feet: FeetState) -> float:
    """The farthest that a foot joint is from its hip, in lengths of its leg; the trunk as low as it may be."""
    population, legs = world.populations["walker"], world.legs_by_species["walker"].legs
    body = BodyFrames.of(population)
    x, y, z = body.to_bodies(feet.shown)
    a, b, c = lean(legs.hip, feet.slope)
    high = (y + legs.foot[:, 1] - b) - (feet.rise / body.size)[:, None]
    high = np.maximum(np.abs(high) - MAX_SINK_SHARE * legs.length * (high < 0), 0)
    return float((np.sqrt((x - a) ** 2 + high**2 + (z - c) ** 2) / legs.length).max())


@pytest.mark.parametrize(
    ("ground", "legs", "speed"),
    [("hill", 6, 24.0), *(pytest.param(*each, marks=pytest.mark.slow) for each in (
        ("flat", 6, 24.0), ("overhang", 6, 20.0), ("can", 6, 24.0), ("tunnel", 6, 24.0), ("hill", 8, 14.0), ("hill", 4, 12.0),
        ("hill", 2, 8.0), ("flat", 6, 60.0)))],
)  # fmt: skip
def test_planted_feet_stay_where_they_are_on_the_ground(tmp_path: Path, ground: str, legs: int, speed: float) -> None:
    """The must-show of the feature: planted feet move less than a thousandth of a leg, and are as near to the surface."""
    shot = stick_bodies.opened(stick_bodies.write_scene(tmp_path, legs, ground, speed=speed, count=16))
    world = bind_shot(shot)
    leg = float(world.legs_by_species["walker"].legs.length.min()) * stick_bodies.SIZE
    slid, off, standing_count, hung, lifted, cycles = 0.0, 0.0, 0, 0, 0, 0.0
    for _ in range(48):
        previous_feet = deepcopy(feet_of(world))
        step(world)
        feet = feet_of(world)
        both = previous_feet.is_standing & feet.is_standing
        slid = max(
            slid, float(np.sqrt(vec.dot(feet.shown - previous_feet.shown, feet.shown - previous_feet.shown))[both].max(initial=0))
        )
        off = max(off, float(off_ground(world, feet).max()))
        hung += int(((feet.on == NO_GROUND_NUMBER) & (feet.swing >= 1)).sum())
        standing_count, lifted = (
            standing_count + int(feet.is_standing.sum()),
            lifted + int((previous_feet.is_standing & ~feet.is_standing).sum()),
        )
        assert far_from_hips(world, feet) <= 1.001
        turned = ((feet.phase - previous_feet.phase) % 1.0)[
            ~previous_feet.is_standing.all(axis=1)
        ]  # who sets out goes on to the next foot at once
        cycles = max(cycles, float(turned.max(initial=0)))
    assert slid < 1e-3 * leg and off < 1e-3 * leg
    assert hung < 0.02 * standing_count and lifted > 60
    assert cycles <= MAX_CYCLES_PER_FRAME + 1e-3


def test_standing_bodies_put_their_feet_back_and_then_keep_still(tmp_path: Path) -> None:
    path = stick_bodies.write_scene(tmp_path, 6, "hill", count=4)
    (tmp_path / "walker.ant").write_text(
        (tmp_path / "walker.ant").read_text().replace("after 1.2 s", "after 1000 s").replace("chance 40 %/s", "after 1 s")
    )
    world = bind_shot(stick_bodies.opened(path))
    lifted = []
    for _ in range(24 * 4):
        was_down = feet_of(world).is_standing.copy()
        step(world)
        lifted.append(was_down & ~feet_of(world).is_standing)
    feet, population = feet_of(world), world.populations["walker"]
    x, _, z = BodyFrames.of(population).to_bodies(feet.place)
    rest = compute_rest_positions(world.legs_by_species["walker"].legs)
    off = np.hypot(x - rest[0], z - rest[1])
    assert np.median(off) < 0.07 and not any(each.any() for each in lifted[-24:]) and feet.is_standing.mean() > 0.98
    last = max(k for k, each in enumerate(lifted) if each.any())
    assert all(each.sum(axis=1).max() <= 4 for each in lifted[30 : last + 1])  # never all six at once


def test_feet_are_the_same_for_any_rows_chunks_threads_and_backends_and_change_no_other_bit(hill: Shot) -> None:
    options = [
        NUMPY, Options(backend="numpy", feet=True, shuffle_rows=5), Options(backend="numpy", feet=True, chunk=7, threads=2),
        Options(backend="reference", feet=True),
    ]  # fmt: skip
    hashes = set()
    for option in options:
        world = bind_shot(hill, option)
        for _ in range(6):
            step(world)
        hashes.add((state_hash(world), feet_hash(world.feet)))
    assert len(hashes) == 1
    without = bind_shot(hill, Options(backend="numpy"))
    for _ in range(6):
        step(without)
    assert not without.feet and feet_hash(without.feet) == "" and state_hash(without) == next(iter(hashes))[0]


@pytest.mark.slow
def test_feet_are_the_same_by_machine_code(hill: Shot) -> None:
    need_llvmlite()
    worlds = [bind_shot(hill), bind_shot(hill, Options(backend="native", feet=True, wait_for_code=True))]
    for _ in range(6):
        for world in worlds:
            step(world)
    assert len({feet_hash(world.feet) for world in worlds}) == 1


@pytest.mark.parametrize("ground", ["hill", "overhang"])
def test_feet_are_the_same_where_no_ray_walks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ground: str) -> None:
    shot = stick_bodies.opened(stick_bodies.write_scene(tmp_path, 6, ground, count=24))
    walking = bind_shot(shot)
    assert walking.foot_ground is not None and (walking.foot_ground.find_start_faces(walking.populations["walker"]) >= 0).all()
    for _ in range(12):
        step(walking)
    monkeypatch.setattr(FootGround, "find_start_faces", lambda _, population: np.full(len(population), -1))
    casting = bind_shot(shot)
    for _ in range(12):
        step(casting)
    assert feet_hash(walking.feet) == feet_hash(casting.feet)


def test_one_bodys_feet_go_as_they_do_among_others(tmp_path: Path) -> None:
    """An agent's feet do not depend on who else there is."""
    shot = stick_bodies.opened(stick_bodies.write_scene(tmp_path, 6, "hill", count=12))
    many, few = (
        bind_shot(shot),
        bind_shot(replace(shot, setting=replace(shot.setting, crowds=(replace(shot.setting.crowds[0], count=3),)))),
    )
    for _ in range(20):
        step(many)
        step(few)
    for name, array in feet_of(few).get_stored_arrays().items():
        all_values = feet_of(many).get_stored_arrays()[name]
        by_component = ("place", "shown", "start", "position", "heading", "up", "tread", "sole")
        axis = array.shape.index(3) if name not in by_component else 1
        assert np.array_equal(array, np.take(all_values, range(3), axis=axis)), name


def test_a_checkpoint_goes_on_with_the_same_bits(hill: Shot) -> None:
    world = bind_shot(hill)
    for _ in range(9):
        step(world)
    saved = take_checkpoint(world)
    again = bind_shot(hill)
    restore_checkpoint(again, saved)
    assert feet_hash(again.feet) == feet_hash(world.feet)
    for _ in range(9):
        step(world)
        step(again)
    assert feet_hash(again.feet) == feet_hash(world.feet)
    other = bind_shot(hill, Options(backend="numpy"))
    restore_checkpoint(other, saved)  # of a run with feet, where no feet are requested
    none = {name: array for name, array in saved.items() if not name.startswith("feet.")}
    restore_checkpoint(again, none)  # and the other way round: all feet are planted again
    assert feet_of(again).is_standing.mean() > 0.9 and state_hash(again) == state_hash(other)


def test_a_reload_keeps_feet_and_new_legs_start_again(hill: Shot) -> None:
    world = bind_shot(hill)
    for _ in range(9):
        step(world)
    other, _ = migrate_world(world, hill.plan, hill.setting)
    assert feet_hash(other.feet) == feet_hash(world.feet)
    legs = hill.setting.legs["walker"]
    longer = replace(hill.setting, legs={"walker": replace(legs, length=legs.length * 1.1)})
    restarted, _ = migrate_world(world, hill.plan, longer)
    assert feet_of(restarted).is_standing.mean() > 0.9 and feet_hash(restarted.feet) != feet_hash(world.feet)


BIRTHS = """ant 1
use steering
world { surface ground }
species walker {
  size 6 mm
  max_speed 20 mm/s
  response 0.1 s
  kids = 0
  start go
  state go "Goes" amber {
    steer wander(swing: 40 deg)
    when chance 90 %/s -> grow { spawn walker }
    when chance 60 %/s -> gone { die }
  }
  state grow "Bears" blue {
    when after 0.1 s -> go
  }
  state gone "Dies" grey { when after 1 s -> go }
  layers { state }
}
"""


def test_the_newborn_stand_and_the_dead_have_no_feet(tmp_path: Path) -> None:
    path = stick_bodies.write_scene(tmp_path, 6, "flat", count=20, program=BIRTHS)
    world = bind_shot(stick_bodies.opened(path))
    changed = 0
    for _ in range(20):
        known = set(feet_of(world).ids.tolist())
        step(world)
        feet, population = feet_of(world), world.populations["walker"]
        assert np.array_equal(feet.ids, population.ids) and np.array_equal(feet.sort_by_id().ids, np.sort(population.ids))
        new = ~np.isin(feet.ids, list(known))
        changed += int(new.sum()) + len(known - set(feet.ids.tolist()))
        assert off_ground(world, feet).max() < 1e-3
    assert changed > 10


# ---- what feet stand on


def test_feet_go_along_with_ground_that_moves_and_stand_still_on_it(tmp_path: Path) -> None:
    """A sheet that moves and turns, under bodies that stand: no foot lifts, and each stays where it is on the sheet."""
    path = stick_bodies.write_scene(tmp_path, 6, stick_bodies.grid(120.0, 6), count=4, pauses=False)
    text = (tmp_path / "walker.ant").read_text().replace("steer wander(swing: 40 deg)", "steer halt()")
    (tmp_path / "walker.ant").write_text(text)
    keys = "keys: {60: {at: [0, 0, 0], rotate: [0, 0, 0]}, 84: {at: [30, 12, 5], rotate: [0, 40, 25]}}"
    moved = path.read_text().replace("mesh: ground.ply", f"mesh: ground.ply, {keys}")
    path.write_text(moved.replace("place: {on: ground}", "place: {on: ground, around: [0, 0, 0], radius: 40 mm}"))
    world = bind_shot(stick_bodies.opened(path))
    for _ in range(58):  # until all have come to a stand
        step(world)
    first = deepcopy(feet_of(world))
    for _ in range(20):
        step(world)
    feet = feet_of(world)
    assert first.is_standing.all() and feet.is_standing.all() and float(np.abs(feet.place - first.place).max()) > 10
    assert np.array_equal(feet.face, first.face) and np.array_equal(feet.weight, first.weight)
    assert off_ground(world, feet).max() < 1e-9
    x, y, _ = BodyFrames.of(world.populations["walker"]).to_bodies(feet.place)
    assert np.abs(x - compute_rest_positions(world.legs_by_species["walker"].legs)[0]).max() < 0.1 and np.abs(y).max() < 1e-3


def test_a_foot_without_its_ground_lifts_and_seeks_again(tmp_path: Path) -> None:
    block = stick_bodies.block((-30, -12, -30), (30, 0, 30))
    program = stick_bodies.PROGRAM.format(size=6, speed=0.001, leave="", more="").replace("surface ground", "solid ground")
    path = stick_bodies.write_scene(
        tmp_path, 6, block, count=3, program=program.replace("steer wander(swing: 40 deg)", "steer halt()")
    )
    path.write_text(path.read_text().replace("mesh: ground.ply", "mesh: ground.ply, voxel: 0.5 mm"))
    world = bind_shot(stick_bodies.opened(path))
    step(world)
    feet = feet_of(world)
    assert feet.is_standing.all()
    dug = feet.place[:, 0, 1].copy()
    others = deepcopy(feet)
    world.solids["ground"].carve_balls(dug[None], np.array([0.9]), np.array([0]))
    lifted = False
    for _ in range(30):
        step(world)
        lifted |= not feet_of(world).is_standing[0, 1]
    feet = feet_of(world)
    assert lifted and feet.is_standing[0, 1]
    assert abs(float(world.solids["ground"].sample_distances(feet.place[:, 0, 1][None])[0])) < 0.02
    assert np.array_equal(feet.place[:, 1], others.place[:, 1]) and np.linalg.norm(feet.place[:, 0, 1] - dug) > 0.1


def test_feet_stand_on_obstacles_and_on_the_side_of_a_sheet_that_they_walk_on(tmp_path: Path) -> None:
    """A slab that is an obstacle lies on the floor: feet stand on it. Of a sheet, legs never pass to its other side."""
    slab = stick_bodies.block((-60, -1, -60), (60, 0.4, 60))
    path = stick_bodies.write_scene(
        tmp_path, 6, "flat", count=10, world_lines="; obstacle slab", things=["slab: {mesh: slab.ply}"]
    )
    stick_bodies.save(slab, tmp_path / "slab.ply")
    scene = path.read_text().replace("place: {on: ground}", "place: {on: ground, around: [0, 0, 0], radius: 25 mm}")
    path.write_text(scene)
    world = bind_shot(stick_bodies.opened(path))
    for _ in range(10):
        step(world)
    feet = feet_of(world)
    assert feet.is_standing.sum() > 20 and np.allclose(feet.shown[1][feet.is_standing], 0.4, atol=1e-6)
    tin = stick_bodies.write_scene(tmp_path / "tin", 6, "can", count=30)
    world = bind_shot(stick_bodies.opened(tin))
    for _ in range(40):
        step(world)
    feet, population = feet_of(world), world.populations["walker"]
    side = np.hypot(
        population.position[population.get_rows_by_id()][:, 0], population.position[population.get_rows_by_id()][:, 2]
    )
    bodies = BodyFrames.of(population)
    up, place = bodies.axes[:, 1].T, bodies.place.T
    inside = (up[0] * place[0] + up[2] * place[2] < 0) & (side > 20)
    hips = bodies.to_world(world.legs_by_species["walker"].legs.hip)
    hit = world.obstacles["ground"].find_hits_along_step(
        hips[:, feet.is_standing].T.copy(), ((feet.shown - hips)[:, feet.is_standing] * 0.999).T.copy()
    )[0]
    assert len(hit) < 0.01 * feet.is_standing.sum() and side.max() > 15 and inside.size


@pytest.mark.parametrize(("clearance", "high", "look"), [(1, 0.5, ""), (0, -0.5, ", look: none")])
def test_feet_are_on_the_floor_that_is_seen_where_the_body_walks_a_coarser_one(
    tmp_path: Path, clearance: int, high: float, look: str
) -> None:
    """A body on a few large triangles, or held over them, with a finely bumped floor below it (row R01)."""

    def bumps(x: np.ndarray, z: np.ndarray) -> np.ndarray:
        return high + 0.3 * np.sin(x / 1.7) * np.cos(z / 2.1)

    floor = stick_bodies.grid(90.0, 90, bumps)
    program = stick_bodies.PROGRAM.format(size=6, speed=20, leave="", more="; surface floor").replace(
        "response 0.1 s", f"response 0.1 s\n  clearance {clearance} mm"
    )
    path = stick_bodies.write_scene(
        tmp_path, 6, stick_bodies.grid(90.0, 2), count=6, program=program, things=["floor: {mesh: floor.ply}"]
    )
    stick_bodies.save(floor, tmp_path / "floor.ply")
    text = path.read_text().replace("mesh: ground.ply", f"mesh: ground.ply{look}")
    path.write_text(text.replace("place: {on: ground}", "place: {on: ground, around: [0, 0, 0], radius: 20 mm}"))
    world = bind_shot(stick_bodies.opened(path))
    for _ in range(12):
        step(world)
        feet = feet_of(world)
        floor_distances = world.obstacles["floor"].find_closest(np.ascontiguousarray(feet.shown[:, feet.is_standing].T))[3]  # type: ignore[attr-defined]
        assert floor_distances.max() < 1e-6 and feet.is_standing.sum() > 12
    assert (world.populations["walker"].footing.mesh == 0).all()
    assert high - 0.31 < feet.shown[1][feet.is_standing].min() < high < feet.shown[1][feet.is_standing].max() < high + 0.31
