"""Bodies that stand across the last two directions of motion, or the ways to two probes, instead of the ground's normal."""

from __future__ import annotations

from pathlib import Path

import meshes
import numpy as np
import pytest
from meaning import FAST, OPTION_SETS, RunHistory, crowd, play

from antdsl.pipeline import open_scene
from antdsl.runtime import CrowdData, MeshData, Options, PlacementData, bind, state_hash, step

BALL = MeshData(*meshes.ball(40.0, rings=32))
TOP = CrowdData("a", 1, PlacementData(points=np.array([(0.0, 40.0, 0.0)])), 0)
AHEAD = "on spawn { velocity = vector(20 mm/s, 0 mm/s, 0 mm/s); heading = vector(1, 0, 0) }"


def vectors(history: RunHistory, name: str) -> np.ndarray:
    return np.array([[history.every(f"{name}.{axis}", 0)] for axis in "xyz"], np.float64)[:, 0].T


def off(history: RunHistory) -> np.ndarray:
    """Degrees between the body and the normal of the ball, frame by frame."""
    place = vectors(history, "position") + history.world.origin
    cosine = (vectors(history, "up") * place).sum(axis=1) / np.linalg.norm(place, axis=1)
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


@pytest.mark.parametrize("how", ["turns", "probes"])
def test_who_wanders_on_a_slope_stands_across_it(how: str) -> None:
    slope = MeshData(*meshes.grid(400.0, 4, lambda x, z: 0.5 * x))
    text = "use steering\nspecies a { state s { steer wander(swing: 90 deg) } }"
    history = play(text, crowd(5, radius=30), steps=8, surfaces={"ground": slope}, orient=how)
    up = np.array([history[f"up.{axis}"] for axis in "xyz"]).T
    assert up == pytest.approx(np.tile(np.array((-0.5, 1, 0)) / np.sqrt(1.25), (5, 1)), abs=2e-3 if how == "turns" else 1e-5)


def test_straight_on_over_a_ball_turns_say_nothing_and_ten_degrees_remain() -> None:
    history = play(f"species a {{ {AHEAD} }}", TOP, steps=12, surfaces={"ground": BALL}, orient="turns", option_sets=FAST)
    tilt = off(history)
    assert (np.diff(tilt[:3]) > 2).all() and tilt[:3].max() < 9  # 2 mm a step on a ball of 40 mm are 2.9 degrees
    assert tilt[5:] == pytest.approx(np.full(8, 10.0), abs=0.3)


def test_turning_on_the_ground_shows_where_it_is_level() -> None:
    """A body that begins aslant stands up once its way turns, and not before."""
    text = f"""species a {{ {AHEAD}
    start s
    state s {{ when after 0.5 s -> t }}
    state t {{ steer cross(up, heading); when after 9 s -> s }}
    layers {{ state }} }}"""
    floor = MeshData(*meshes.grid(400.0, 4))
    up_values = []

    def lean(world: object) -> None:
        population = world.populations["a"]  # type: ignore[attr-defined]
        if not up_values:
            for name, value in (("up", (0, np.cos(0.1), np.sin(0.1))), ("heading", (1, 0, 0))):
                for axis, component in zip("xyz", value, strict=True):
                    population.now[f"{name}.{axis}"][:] = population.start[f"{name}.{axis}"][:] = component
        up_values.append(float(population.now["up.y"][0]))

    play(text, TOP, steps=9, surfaces={"ground": floor}, orient="turns", option_sets=FAST[:1], each=lean)
    assert up_values[1:4] == pytest.approx([np.cos(0.1)] * 3, abs=1e-4) and up_values[-1] == pytest.approx(1, abs=1e-6)


def test_probes_stand_across_the_ways_to_the_nearest_places_ahead_and_to_the_left() -> None:
    text = "species a { size 20 mm; on spawn { velocity = vector(0 mm/s, 0 mm/s, 0 mm/s); heading = vector(1, 0, 0) } }"
    history = play(
        text, TOP, steps=6, surfaces={"ground": MeshData(*meshes.ball(40.0, rings=64))}, orient="probes", option_sets=FAST
    )
    top, ahead, left = np.array((0, 40, 0)), np.array((10, 40, 0)), np.array((0, 40, -10))
    one, other = (40 * p / np.linalg.norm(p) - top for p in (ahead, left))
    up = np.cross(one, other)
    assert vectors(history, "up")[-1] == pytest.approx(up / np.linalg.norm(up), abs=3e-3)
    assert off(history)[-1] == pytest.approx(np.degrees(np.arctan(np.sqrt(2) * np.tan(np.arctan(0.25) / 2))), abs=0.3)


@pytest.mark.parametrize("how", ["turns", "probes"])
def test_edges_and_creases_give_the_same_bits_and_no_agent_is_stuck(how: str) -> None:
    block = MeshData(*meshes.box((-20.0, 0.0, -20.0), (20.0, 30.0, 20.0)))
    floor = MeshData(*meshes.grid(200.0, 4))
    text = "use steering\nspecies a { max_turn 360 deg/s; state s { steer wander() } }"
    around = CrowdData("a", 6, PlacementData(disc_centre=(0.0, 0.0, 0.0), radius=35.0, surfaces=("ground", "stone")), 0)
    world = "ant 1\nworld { surface ground; surface stone }\n"
    option_sets = (*FAST, OPTION_SETS[2], Options(backend="native"))
    history = play(
        text, around, steps=20, surfaces={"ground": floor, "stone": block}, orient=how, option_sets=option_sets, world=world
    )
    steps = np.linalg.norm([[np.diff(history.every(f"position.{a}", k)) for a in "xyz"] for k in range(6)], axis=1)
    assert (steps[:, -6:].sum(axis=1) > 0.5).all()


def test_a_scene_asks_for_it(tmp_path: Path) -> None:
    (tmp_path / "a.ant").write_text("ant 1\nuse steering\nworld { surface s }\nspecies a { state w { steer wander() } }\n")
    vertices, faces = meshes.ball(40.0)
    lines = [*("v {} {} {}".format(*v) for v in vertices), *("f {} {} {}".format(*(f + 1)) for f in faces)]
    (tmp_path / "s.obj").write_text("\n".join(lines))
    hashes = {}
    for how in ("normal", "turns", "probes", "compass"):
        crowd = "crowd: [{species: a, from: a.ant, count: 5, place: {on: s}}]"
        (tmp_path / "s.yaml").write_text(f"antdsl: 1\norient: {how}\nworld: {{s: {{mesh: s.obj}}}}\n{crowd}\n")
        shot, report = open_scene(tmp_path / "s.yaml")
        if shot is None:
            assert how == "compass" and any("probes" in f"{d.message} {d.help}" for d in report.sort_by_place())
            continue
        world = bind(shot.plan, shot.setting, Options(backend="numpy"))
        for _ in range(3):
            step(world)
        hashes[how] = state_hash(world)
    assert len(set(hashes.values())) == 3
