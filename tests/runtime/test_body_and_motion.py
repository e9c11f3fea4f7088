"""Bodies that face another way than they go, and animals that never stop: `face` lines and `min_speed`."""

from __future__ import annotations

from fractions import Fraction

import meshes
import numpy as np
import pytest
from meaning import OPTION_SETS, RunHistory, crowd, item, play
from plan_text import WORLD, plan_of

from antdsl.bench.cases import find_case
from antdsl.passes import optimise_plan
from antdsl.runtime import MeshData, Options, WorldSetting, bind, step
from antdsl.runtime.moving.clearance.head_clearance import find_heads_inside

ALL = (*OPTION_SETS, Options(backend="native", wait_for_code=True))
SET_OUT = "on spawn { velocity = vector(20 mm/s, 0 mm/s, 0 mm/s); heading = vector(1, 0, 0) }\n"


def crab(states: str, layers: str = "layers { state }", attributes: str = "") -> str:
    return f"use steering\nspecies a {{ {attributes}\n{SET_OUT}start go\n{states}\n{layers} }}"


def vector(history: RunHistory, name: str, frame: int = -1) -> np.ndarray:
    return np.array([history.at(f"{name}.{axis}", frame) for axis in "xyz"], np.float64).T


def vectors(history: RunHistory, name: str) -> np.ndarray:
    return np.array([vector(history, name, frame)[0] for frame in range(len(history.frames))])


def test_who_faces_back_walks_backward_where_it_is_steered() -> None:
    back, forth = (play(crab(f"state go {{ steer vector(0, 0, 1) * 0.5; {face} }}"), steps=20) for face in ("face -velocity", ""))
    assert (vectors(back, "position") == vectors(forth, "position")).all()  # the body changes nothing of the way
    velocity, heading = vector(back, "velocity")[0], vector(back, "heading")[0]
    assert np.dot(velocity, heading) / np.linalg.norm(velocity) < -0.99
    assert np.dot(vector(forth, "velocity")[0], vector(forth, "heading")[0]) > 0.99 * np.linalg.norm(velocity)


def test_the_topmost_line_that_gives_a_direction_decides() -> None:
    layers = "layers { face vector(0, 0, 1) when age > 1 s; vector(1, 0, 0); state; face vector(0, 0, -1) }"
    nearest = "face direction(nearest(food)); face vector(-1, 0, 0)"
    states = f"state go {{ steer coast(); {nearest}; when after 2 s -> none_near }}\nstate none_near {{ steer coast() }}"
    for food, first in (((item("f", 0, 900),), (0, 0, 1)), ((), (-1, 0, 0))):
        history = play(crab(states, layers), steps=10, items={"food": food})
        assert vector(history, "heading")[0] == pytest.approx(
            first, abs=0.05
        )  # that of the state: no strength is left, none needed
    states = states.replace("after 2 s", "after 0.4 s")
    history = play(crab(states, layers.replace("age > 1 s", "age > 1 s and age < 2.5 s")), steps=40, option_sets=ALL)
    assert vector(history, "heading", 9)[0] == pytest.approx((0, 0, -1), abs=0.05)  # the state gives none: the last line
    assert vector(history, "heading", 24)[0] == pytest.approx((0, 0, 1), abs=0.05)  # the first line
    assert vector(history, "heading", 40)[0] == pytest.approx((0, 0, -1), abs=0.05)


def test_of_several_machines_the_first_that_faces_decides_and_none_leaves_it_to_the_way() -> None:
    machines = """machine eyes { start look
        state look { face uphill; when after 1 s -> stare }
        state stare { face vector(0, 0, 1); when after 1 s -> look } }
    machine legs { start go
        state go { steer vector(1, 0, 0); face vector(0, 0, -1); when after 3 s -> on }
        state on { steer vector(1, 0, 0); when after 9 s -> go } }"""
    text = f"use steering\nspecies a {{ {SET_OUT}{machines}\nlayers {{ state }} }}"
    history = play(text, steps=36)
    assert vector(history, "heading", 9)[0] == pytest.approx((0, 0, -1), abs=0.02)  # level ground has no uphill
    assert vector(history, "heading", 19)[0] == pytest.approx((0, 0, 1), abs=0.1)
    assert vector(history, "heading", 36)[0] == pytest.approx((0, 0, 1), abs=0.1)
    text = text.replace("state stare { face vector(0, 0, 1);", "state stare {")
    assert vector(play(text, steps=39), "heading")[0] == pytest.approx((1, 0, 0), abs=0.02)


@pytest.mark.parametrize("response", ["", "response 1 step"])
def test_a_body_turns_at_a_stand_at_most_max_turn_fast(response: str) -> None:
    rest = "state go { face vector(-1, 0, 0.2) }\n"
    rest += "state never { steer halt(); when after 1 s -> go }\nfrom any when age > 99 s -> never"
    history = play(crab(rest, attributes=f"max_turn 90 deg/s; {response}"), steps=40)
    heading = vectors(history, "heading")
    turned = np.degrees(np.arccos(np.clip((heading[1:] * heading[:-1]).sum(axis=1), -1, 1)))
    assert 8 < turned.max() < 9.1  # degrees in a tenth of a second
    assert heading[-1] == pytest.approx(np.array((-1, 0, 0.2)) / np.hypot(1, 0.2), abs=0.02)
    assert np.linalg.norm(vector(history, "velocity")) < 0.2


def test_a_way_off_the_ground_says_nothing() -> None:
    history = play(crab("state go { steer coast(); face up }"), steps=5)
    assert vector(history, "heading")[0] == pytest.approx((1, 0, 0), abs=1e-5)


# --- the slowest ------------------------------------------------------------------------------------------------------


def speeds(history: RunHistory) -> np.ndarray:
    return np.linalg.norm(vectors(history, "velocity"), axis=1)


@pytest.mark.parametrize("response", ["", "response 1 step"])
def test_who_brakes_goes_on_at_its_slowest_and_is_not_turned_round(response: str) -> None:
    history = play(crab("state go { steer halt() }", attributes=f"min_speed 5 mm/s; {response}"), steps=20)
    assert speeds(history)[-1] == pytest.approx(5, rel=1e-4) and speeds(history).min() > 4.999
    assert (vectors(history, "velocity")[:, 0] > 4.99).all()
    distances = np.linalg.norm(np.diff(vectors(history, "position"), axis=0), axis=1)
    assert distances.min() > 0.4999  # mm in a tenth of a second: it is the way that is walked


def test_who_has_no_way_sets_out_along_its_heading() -> None:
    text = "species a { min_speed 5 mm/s\non spawn { velocity = vector(0 mm/s, 0 mm/s, 0 mm/s); heading = vector(0, 0, 1) } }"
    history = play(text, steps=3)
    assert vector(history, "velocity")[0] == pytest.approx((0, 0, 5), abs=1e-4)


def test_a_push_aside_turns_the_slowest_way_and_a_strong_one_back_turns_it_round() -> None:
    aside = play(
        crab("state go { steer vector(-0.1, 0, 0.05) }", attributes="min_speed 5 mm/s; response 4 s"),
        steps=400,
        option_sets=OPTION_SETS[:1],
    )
    assert speeds(aside).min() > 4.999 and vector(aside, "velocity")[0, 0] < -5  # it came round in a bow
    turned = np.diff(np.unwrap(np.arctan2(vectors(aside, "velocity")[:, 2], vectors(aside, "velocity")[:, 0])))
    assert np.abs(turned).max() < 0.2
    back = play(crab("state go { steer vector(-1, 0, 0) }", attributes="min_speed 5 mm/s; response 1 step"), steps=2)
    assert vector(back, "velocity")[0, 0] < -5


def test_the_fastest_wins_over_the_slowest_where_a_run_changes_them() -> None:
    text = crab("state go { steer coast(); when after 1 s -> go { max_speed = 3 mm/s } }", attributes="min_speed 5 mm/s")
    assert speeds(play(text, steps=15))[-1] == pytest.approx(3, rel=1e-4)


def test_another_one_reads_it_and_who_has_none_has_zero() -> None:
    text = """species a { sum_of = 0 mm/s
    start go
    state go { sum_of = nearest(b).min_speed + nearest(a).min_speed + min_speed } }
    species b { min_speed 4 mm/s }"""
    history = play(text, crowd(at=[(0, 0), (3, 0)]), crowd(species="b", at=[(1, 0)]), steps=2)
    assert history["sum_of"] == [4, 4]
    assert "min_speed" not in history.world.populations["a"].now  # nothing more to keep or hash


def test_a_wall_bends_its_way_and_does_not_slow_it_down() -> None:
    wall = {"stones": MeshData(*meshes.box((10.0, -5.0, -20.0), (14.0, 5.0, 30.0)))}
    states = "state go { steer vector(0.1, 0, 0.01); when after 9 s -> go }"
    for least, slowest in (("min_speed 8 mm/s;", 7.99), ("", 0.0)):
        history = play(
            crab(states, attributes=f"{least} max_speed 9 mm/s; response 1 step"),
            steps=22,
            obstacles=wall,
            option_sets=(OPTION_SETS[0], OPTION_SETS[2]),
        )
        speeds_walked = np.linalg.norm(np.diff(vectors(history, "position"), axis=0), axis=1) * 10
        assert vector(history, "position")[0, 0] < 10 and vector(history, "position")[0, 2] > 1
        assert speeds_walked[-10:].min() >= slowest and (slowest or speeds_walked[-10:].min() < 5)


# --- all of it, on real ground ----------------------------------------------------------------------------------------

_BOX_QUADS = [(0, 3, 2, 1), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]


def box_room(half: float, high: float) -> MeshData:
    """A floor and four walls, faces inward."""
    corners = [(x * half, y * high, z * half) for y in (0, 1) for x, z in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return MeshData(
        np.array(corners, float), np.array([f for a, b, c, d in _BOX_QUADS for f in ((a, b, c), (a, c, d))], np.int32)
    )


BACK = """state go { steer wander(); face -velocity; when after 1 s -> aside }
state aside { steer wander(); face cross(up, heading) }"""


def test_bodies_back_up_walls_without_a_jerk_and_with_their_heads_out() -> None:
    text = crab(
        BACK.replace("-> aside", "-> go"), attributes="size 6 mm; max_speed 20 mm/s; max_turn 180 deg/s; min_speed 2 mm/s"
    )
    plan = optimise_plan(plan_of(text, WORLD))
    setting = WorldSetting(fps=Fraction(24), crowds=(crowd(30, radius=25),), surfaces={"ground": box_room(30, 60)}, seed=4)
    world = bind(plan, setting, Options(backend="native"))
    population, inside, most = world.populations["a"], 0, 0.0
    previous_directions = np.concatenate([population.read_vector("up"), population.read_vector("heading")])
    for _ in range(96):
        step(world)
        inside += int(find_heads_inside(world, population).sum())
        directions = np.concatenate([population.read_vector("up"), population.read_vector("heading")])
        most = max(most, float(np.degrees(np.arccos(np.clip((previous_directions * directions).sum(axis=1), -1, 1))).max()))
        previous_directions = directions
    assert inside / (96 * 30) < 0.005 and most < 7.6  # degrees a step, of 7.5
    assert (population.position[:, 1] - world.ground.meshes.low[1] > 3).mean() > 0.3  # many went up
    velocity, heading = population.read_vector("velocity"), population.read_vector("heading")
    assert np.median((velocity * heading).sum(axis=1) / np.linalg.norm(velocity, axis=1)) < -0.9


def test_straightness_of_paths_is_the_same_for_any_order_of_rows() -> None:
    shot, values = find_case("boids").make_shot(200), set()
    for order in (None, 3, 5):
        world = bind(shot.plan, shot.setting, Options(backend="numpy", shuffle_rows=order))
        for _ in range(50):
            step(world)
        assert world.motion.ways > 100
        values.add(world.motion.straightness)
    assert len(values) == 1
