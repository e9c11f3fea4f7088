"""What each behaviour of the library does: a few animals on a plane, and what can be seen of them after some seconds."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import meshes
import numpy as np
import pytest
from numpy.typing import NDArray
from test_program import checked, complaints
from test_program_cases import find_library

from antdsl import passes, plan
from antdsl.runtime import CrowdData, FieldStartData, ItemData, MeshData, PlacementData, World, WorldSetting, bind, step
from antdsl.scene.setting import FlowTarget, SpreadFlowData
from antdsl.syntax import nodes

HEAD = """ant 1
use steering
world { surface ground; obstacle rock; curve road; flow drift; items food }
field trail on ground { cell 5 mm; half_life 100 s }
species other {
  wish = vector(0 mm/s, 0 mm/s, 15 mm/s)
  response 1 step
  state s { steer match(wish) }
}
"""
ROAD = np.stack([np.linspace(-150, 150, 61), np.zeros(61), 20 * np.sin(np.linspace(-3, 3, 61))], axis=1)


def crowd(species: str, *points: tuple[float, float]) -> CrowdData:
    positions = np.array([(x, 0.0, z) for x, z in points])
    return CrowdData(species, len(points), PlacementData(points=positions))


def scene(
    steer: str, *crowds: CrowdData, food: tuple[float, float] = (60, 0), fps: int = 24, turned: str = "0 deg", members: str = ""
) -> World:
    """Animals that wish `steer` and set out along x, on a plane with a rock at (40, 0), a road and one item of food."""
    turn = (
        members + f"  on spawn {{ heading = rotate(vector(1, 0, 0), about: up, by: {turned}); velocity = heading * 20 mm/s }}\n"
    )
    text = HEAD + f"species ant {{\n{turn}  state s {{ steer {steer} }}\n}}\n"
    program, report = checked(text)
    assert report.ok, complaints(report)
    lowered, report = plan.lower(program)
    assert complaints(report) == []
    ground, rock = meshes.grid(400.0, 20), meshes.ball(8.0, (40.0, 0.0, 0.0))
    return bind(
        passes.optimise_plan(lowered),
        WorldSetting(
            fps=Fraction(fps),
            surfaces={"ground": MeshData(*ground)},
            obstacles={"rock": MeshData(*rock)},
            curves={"road": ROAD},
            flows={"drift": SpreadFlowData("tangent", FlowTarget(ROAD, np.zeros(len(ROAD)), is_line=True), 60.0)},
            items={"food": (ItemData("crumb", (food[0], 0.0, food[1]), 2.0),)},
            crowds=crowds,
            field_start={"trail": (FieldStartData(1.0, (0.0, 0.0, 60.0), 30.0),)},
        ),
    )


def run(world: World, steps: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Positions and velocities (steps, agents, 3) of `ant` in the plane's own axes."""
    positions, speeds = [], []
    for _ in range(steps):
        step(world)
        ants = world.populations["ant"]
        order = np.argsort(ants.ids)
        positions.append(ants.position[order] + world.origin)
        speeds.append(np.stack([ants.now[f"velocity.{a}"][order] for a in "xyz"], axis=1).astype(float))
    return np.array(positions), np.array(speeds)


def far(positions: NDArray[np.float64], x: float, z: float) -> NDArray[np.float64]:
    return np.hypot(positions[..., 0] - x, positions[..., 2] - z)


def test_seek_goes_there_at_full_speed_and_flee_away() -> None:
    positions, speeds = run(scene("seek(nearest(food))", crowd("ant", (0, 60))), 40)
    assert far(positions, 60, 0)[-1, 0] < 45
    assert np.linalg.norm(speeds[-1, 0]) == pytest.approx(30, rel=0.02)
    positions, _ = run(scene("flee(nearest(food))", crowd("ant", (30, 10))), 48)
    assert (np.diff(far(positions, 60, 0)[10:, 0]) > 0).all()


def test_arrive_slows_down_and_stays() -> None:
    positions, speeds = run(scene("arrive(nearest(food), slowing: 20 mm)", crowd("ant", (0, 30))), 200)
    gap = far(positions, 60, 0)[:, 0]
    assert gap[-1] < 0.5 and gap[-60:].max() < 2
    assert np.linalg.norm(speeds[-1, 0]) < 1
    assert np.linalg.norm(speeds, axis=2)[gap > 25, 0].max() > 29


def test_pursue_meets_what_moves_earlier_than_seek() -> None:
    def closest(steer: str) -> int:
        positions, _ = run(scene(steer, crowd("ant", (0, 0)), crowd("other", (-60, -40))), 150)
        path = -40 + 15 * np.arange(1, 151) / 24
        return int(np.argmax(np.hypot(positions[:, 0, 0] + 60, positions[:, 0, 2] - path) < 4) or 999)

    sought, pursued = closest("seek(nearest(other))"), closest("pursue(nearest(other), ahead: 3 s)")
    cut_off = closest("offset_pursuit(nearest(other), ahead: 3 s)")
    assert pursued < sought < 999
    assert cut_off < sought


def test_evade_leaves_the_way_of_what_comes() -> None:
    positions, _ = run(scene("evade(nearest(other), ahead: 2 s)", crowd("ant", (5, 0)), crowd("other", (0, -60))), 120)
    path = -60 + 15 * np.arange(1, 121) / 24
    assert np.hypot(positions[:, 0, 0], positions[:, 0, 2] - path).min() > 25


def test_wander_turns_smoothly_both_ways_and_the_same_at_any_frame_rate() -> None:
    spread = {}
    for fps in (24, 48):
        _, speeds = run(
            scene("wander(swing: 40 deg)", crowd("ant", *[(90, float(z)) for z in range(-40, 40, 4)]), fps=fps), 4 * fps
        )
        bearing = np.unwrap(np.arctan2(speeds[..., 2], speeds[..., 0]), axis=0)
        turn = np.diff(bearing, axis=0)
        assert np.degrees(np.abs(turn)).max() < 300 / fps  # no jump
        assert (turn.mean(axis=0) > 0).any() and (turn.mean(axis=0) < 0).any()
        assert np.linalg.norm(speeds[-1], axis=1).min() > 15
        spread[fps] = np.degrees(np.std(turn * fps))
    assert 12 < spread[24] < 45
    assert spread[24] == pytest.approx(spread[48], rel=0.35)


def test_avoid_goes_round_a_rock() -> None:
    blind, _ = run(scene("toward(vector(1, 0, 0))", crowd("ant", (0, 0.5))), 80)
    wary, _ = run(scene("avoid(rock, reach: 12 mm) * 2 + toward(vector(1, 0, 0))", crowd("ant", (0, 0.5))), 80)
    assert far(wary, 40, 0).min() > 8
    assert wary[-1, 0, 0] > 60
    assert wary[-1, 0, 0] > blind[-1, 0, 0] + 5


def test_turn_back_turns_at_the_rim() -> None:
    world = scene("turn_back(road, margin: 20 mm) + toward(heading) * 0.3", crowd("ant", (-60, 60)), turned="90 deg")
    positions, _ = run(world, 120)
    assert positions[:, 0, 2].min() > ROAD[:, 2].min() - 5
    assert far(positions, -60, 60)[:, 0].max() > 20
    assert positions[-1, 0, 2] > positions[:, 0, 2].min() + 10


def test_climb_keeps_to_a_winding_trail() -> None:
    def beside(steer: str) -> NDArray[np.float64]:
        world = scene(steer, crowd("ant", *[(-90.0, 105.0 + offset) for offset in range(-8, 9, 4)]))
        trail = world.fields["trail"]
        x, _, z = (trail.cells.position + world.origin).T
        trail.amounts[:] = np.where(np.abs(z - _trail_z(x)) < 10, 1 + (x + 200) / 400, 0.0)
        positions, _ = run(world, 144)
        assert (positions[-1, :, 0] > 20).all()  # not round and round on it
        return np.abs(positions[..., 2] - _trail_z(positions[..., 0]))

    assert np.quantile(beside("climb(trail)"), 0.95) < 14
    assert np.quantile(beside("toward(heading)"), 0.95) > 20


def test_antennae_keep_to_a_trail_however_faint_it_is() -> None:
    def beside(steer: str, strength: float) -> NDArray[np.float64]:
        world = scene(steer, crowd("ant", *[(-90.0, 100.0 + offset) for offset in (-12, -7, 1, 6, 11)]))
        trail = world.fields["trail"]
        x, _, z = (trail.cells.position + world.origin).T
        trail.amounts[:] = strength * np.exp(-(((z - _trail_z(x)) / 10) ** 2))
        positions, _ = run(world, 144)
        return np.abs(positions[48:, :, 2] - _trail_z(positions[48:, :, 0])).max(axis=0)

    strong, faint = (beside("antennae(trail, reach: 8 mm)", strength) for strength in (40.0, 0.05))
    assert strong.max() < 8 and faint.max() < 8
    assert beside("antennae(trail, reach: 8 mm)", 1e-5).min() > 10  # below `least`
    assert beside("toward(heading)", 40.0).min() > 10


def test_antennae_turn_by_the_relative_difference_to_the_stronger_side() -> None:
    world = scene("antennae(trail, reach: 8 mm, spread: 40 deg)", crowd("ant", (0.0, 0.0)), members="response 1 step\n")
    trail = world.fields["trail"]
    _, _, z = (trail.cells.position + world.origin).T
    trail.amounts[:] = np.where(z < 0, 6.0, 2.0)  # left of x is -z
    _, speeds = run(world, 1)
    assert np.degrees(np.arctan2(-speeds[0, 0, 2], speeds[0, 0, 0])) == pytest.approx(20, abs=0.01)  # 40 * (6 - 2) / (6 + 2)


def _trail_z(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """z of a trail that winds along x."""
    return 100 + 15 * np.sin(x / 25)


def test_follow_goes_along_a_curve_as_it_was_drawn() -> None:
    positions, speeds = run(scene("follow(road, within: 25 mm)", crowd("ant", (-120, 5), (0, 100))), 140)
    off = np.array([np.hypot(*(ROAD[:, [0, 2]] - p[[0, 2]]).T).min() for p in positions[60:, 0]])
    assert off.max() < 6
    assert positions[-1, 0, 0] > 0 and (speeds[20:, 0, 0] > 0).all()
    assert positions[-1, 1, 2] == pytest.approx(100, abs=1)  # too far off to care


def test_follow_goes_against_the_drawing_or_by_the_smaller_turn() -> None:
    for direction, faced, goes in ((-1, 0, -1), (0, 60, 1), (0, 120, -1), (0.5, 120, 1)):
        world = scene(f"follow(road, within: 25 mm, way: {direction})", crowd("ant", (0, 5)), turned=f"{faced} deg")
        positions, _ = run(world, 110)
        off = [np.hypot(*(ROAD[:, [0, 2]] - p[[0, 2]]).T).min() for p in positions[80:, 0]]
        assert max(off) < 6 and goes * positions[-1, 0, 0] > 50, (direction, faced)


def test_along_goes_with_a_flow_and_against_it() -> None:
    for steer, direction in (("along(drift)", 1), ("along(drift, weight: -0.5)", -1)):
        positions, speeds = run(scene(steer, crowd("ant", (-100, 5), (0, 140))), 72)
        off = np.array([np.hypot(*(ROAD[:, [0, 2]] - p[[0, 2]]).T).min() for p in positions[:, 0]])
        assert off[-1] < 40 and direction * speeds[-1, 0, 0] > 20
        assert positions[-1, 1, 2] == pytest.approx(140) and speeds[-1, 1, 0] == pytest.approx(20, rel=1e-3)  # nothing there


def test_separate_spreads_and_cohere_gathers() -> None:
    rng = np.random.default_rng(4)
    points = [tuple(p) for p in rng.uniform(-12, 12, (20, 2))]
    for steer, wider in (("separate(radius: 20 mm) + halt() * 0.5", True), ("cohere(radius: 60 mm) + halt() * 0.5", False)):
        positions, _ = run(scene(steer, crowd("ant", *points)), 60)
        size = [np.linalg.norm(p - p.mean(axis=0), axis=1).mean() for p in (positions[0], positions[-1])]
        assert (size[1] > 1.2 * size[0]) if wider else (size[1] < 0.8 * size[0])


def test_give_way_lets_two_that_meet_pass_without_touching() -> None:
    def nearest(steer: str) -> float:
        world = scene(steer, crowd("ant", (-60, 100), (60, 100.3)))
        ants = world.populations["ant"]
        for name in ("heading", "velocity"):  # the second comes the other way
            ants.now[f"{name}.x"][1] *= -1
            ants.start[f"{name}.x"][1] = ants.now[f"{name}.x"][1]
        positions, speeds = run(world, 110)
        assert speeds[-1, 0, 0] > 15 and speeds[-1, 1, 0] < -15  # both still go their way
        return float(np.linalg.norm(positions[:, 0] - positions[:, 1], axis=1).min())

    assert nearest("toward(heading)") < 0.5
    assert nearest("give_way(radius: 12 mm) + toward(heading)") > 1.6  # room for the bodies of both


def test_keep_clear_leads_four_past_each_other_that_meet_in_one_place() -> None:
    world = scene("keep_clear(heading, within: 60 mm)", crowd("ant", (-60, 101), (60, 99), (1, 160), (-1, 40)))
    ants = world.populations["ant"]
    for name in ("heading", "velocity"):
        for row, (x, z) in enumerate(((1, 0), (-1, 0), (0, -1), (0, 1))):
            speed = 20 if name == "velocity" else 1
            for state in (ants.start, ants.now):
                state[f"{name}.x"][row], state[f"{name}.z"][row] = speed * x, speed * z
    positions, speeds = run(world, 150)
    gaps = [np.linalg.norm(positions[:, a] - positions[:, b], axis=1).min() for a in range(4) for b in range(a)]
    assert min(gaps) > 3.6 and positions[-1, 0, 0] > 20 and positions[-1, 1, 0] < -20  # their radii together are 4 mm
    assert positions[-1, 2, 2] < 80 and positions[-1, 3, 2] > 120 and np.linalg.norm(speeds[-1], axis=1).min() > 15


def test_align_makes_them_go_the_same_way() -> None:
    points = [(float(x), float(z)) for x in (-6, 0, 6) for z in (94, 100, 106)]
    world = scene("align(radius: 60 mm, fov: 360 deg)", crowd("ant", *points), turned="uniform(-80 deg, 80 deg)")
    _, speeds = run(world, 48)
    unit = speeds / np.linalg.norm(speeds, axis=2, keepdims=True)
    order = np.linalg.norm(unit.mean(axis=1), axis=1)
    assert order[0] < 0.95 and order[-1] > 0.99


def test_steady_faces_the_aim_of_an_animal_that_is_pushed_aside_slowly() -> None:
    def facing(speed: float, face: str) -> np.ndarray:
        world = scene(f"match(vector(0 mm/s, 0 mm/s, {speed} mm/s))\n    {face}", crowd("ant", (0, 0)))
        run(world, 36)
        return np.array([float(world.populations["ant"].now[f"heading.{a}"][0]) for a in "xz"])

    assert facing(2.0, "")[1] > 0.99  # where it goes
    assert facing(2.0, "face steady(direction(food))")[0] > 0.95  # almost to the food along x
    assert facing(28.0, "face steady(direction(food))")[1] > 0.9


def test_amble_gives_each_its_own_pace_that_drifts() -> None:
    points = [(float(x), float(z)) for x in range(-100, -50, 8) for z in range(-60, 70, 16)]
    _, velocity = run(scene("amble(vector(1, 0, 0), pace: 0.6, spread: 0.2)", crowd("ant", *points)), 96)
    speed = np.linalg.norm(velocity[24:], axis=2) / 30.0
    assert abs(speed.mean() - 0.6) < 0.04 and 0.06 < speed.std(axis=1).mean() < 0.16
    assert np.abs(np.diff(speed, axis=0)).max() < 0.08 and speed.std(axis=0).mean() > 0.04


def test_hesitate_stands_still_now_and_then_and_each_at_other_times() -> None:
    points = [(float(x), float(z)) for x in range(-150, -100, 8) for z in range(-60, 70, 16)]
    for fps in (24, 96):
        world = scene("hesitate(toward(vector(1, 0, 0)), every: 1.5 s, lasting: 0.5 s)", crowd("ant", *points), fps=fps)
        _, velocity = run(world, 4 * fps)
        stands = np.linalg.norm(velocity[fps:], axis=2) < 3.0
        assert 0.08 < stands.mean() < 0.25  # a quarter of the time, less 0.35 s of each stop in which it brakes
        assert stands.mean(axis=1).max() < 0.4 and stands.any(axis=0).mean() > 0.5  # never all at once


def test_set_off_starts_a_crowd_one_by_one() -> None:
    points = [(float(x), float(z)) for x in range(-150, -100, 8) for z in range(-60, 70, 16)]
    _, velocity = run(scene("set_off(toward(vector(1, 0, 0)), within: 2 s)", crowd("ant", *points)), 72)
    speed = np.linalg.norm(velocity, axis=2)
    begins = np.array([(each > 20.0)[12:].argmax() + 12 for each in speed.T])
    assert speed[-1].min() > 29 and begins.std() > 8 and begins.max() > 40 and np.median(begins) < 40


def test_yield_keeps_its_distance_from_an_animal_that_has_arrived() -> None:
    def least(steer: str) -> float:
        positions, _ = run(scene(steer, crowd("ant", (30, 0), (0, 0)), food=(60, 60)), 120)
        return float(np.linalg.norm(positions[:, 0] - positions[:, 1], axis=1).min())

    assert least("arrive(food)") < 2.0
    assert least("yield(arrive(food), radius: 24 mm)") > 7.0


def test_tolerate_leaves_what_exceeds_a_push() -> None:
    def spread(gap: float) -> float:
        positions, _ = run(scene("tolerate(separate(20 mm), limit: 0.3) + halt()", crowd("ant", (0, 0), (0, gap))), 48)
        return float(np.linalg.norm(positions[-1, 0] - positions[-1, 1]))

    assert spread(16.0) == pytest.approx(16.0, abs=1e-3)
    assert 13.0 < spread(6.0) < 14.5


def test_halt_stands_still() -> None:
    _, speeds = run(scene("halt()", crowd("ant", (0, 0))), 30)
    assert np.linalg.norm(speeds[-1]) < 0.2


def test_coast_goes_on_as_it_goes() -> None:
    _, speeds = run(scene("coast()", crowd("ant", (0, 60))), 30)
    assert np.linalg.norm(speeds[-1, 0] - (20, 0, 0)) < 1e-3


@pytest.mark.parametrize("response", ["1 step", "0.001 s", "1.5 step"])
def test_who_answers_within_a_step_does_not_overshoot(response: str) -> None:
    """An animal that may turn right round in a step has twice the strength, of which these ask for no more than they need."""
    members = f"  response {response}\n"
    exact = response != "1.5 step"
    _, speeds = run(scene("halt()", crowd("ant", (0, 60)), members=members), 12)
    assert np.linalg.norm(speeds, axis=2).max(axis=1)[0 if exact else -1] < (1e-4 if exact else 0.01)
    _, speeds = run(scene("seek(nearest(food))", crowd("ant", (60, 90)), members=members), 20)
    assert np.all(speeds[4:, 0, 2] < -29) and np.all(np.abs(speeds[4:, 0, 0]) < 0.5)  # straight there, not in zigzag
    _, speeds = run(scene("adjust(vector(0, 0, 0.5))", crowd("ant", (0, 60)), members=members), 1)
    assert speeds[0, 0] == pytest.approx((20, 0, 15 if exact else 10), abs=1e-3)
    _, speeds = run(scene("wander(swing: 60 deg)", crowd("ant", (0, 60)), members=members), 24)
    assert np.ptp(np.linalg.norm(speeds[6:, 0], axis=1)) < 0.5  # one pace, instead of a short and a long step in turn


def test_every_behaviour_of_the_library_has_help_and_a_test() -> None:
    file = find_library("steering")
    assert file is not None
    behaviours = [item for item in file.items if isinstance(item, nodes.Behaviour)]
    assert all(item.help is not None and len(item.help.text) > 10 for item in behaviours)
    text = "".join(path.read_text(encoding="utf-8") for path in (Path(__file__), Path(__file__).with_name("test_jitter.py")))
    for item in behaviours:
        assert item.name.text == "level" or f"{item.name.text}(" in text
