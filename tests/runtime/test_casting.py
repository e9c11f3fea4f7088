"""How agents of crowd lines begin: attributes and states from distributions, shapes of places, and the directions they face."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_crowd_lines import shot_of, world_of
from test_scene_files import folder, opened  # noqa: F401

from antdsl.pipeline import open_scene
from antdsl.runtime import Options, bind, state_hash, step
from antdsl.runtime.world import AXES, World

PROGRAM = """ant 1
use steering
world {
  surface ground
  obstacle rock
  items food { load = 0 }
  curve way
  map damp
}
species ant {
  max_speed 40 mm/s
  size 3 mm
  load = 0
  angry = false
  speed_up = 2 * load
  start rest
  state rest { steer halt(); when after 9 s -> walk }
  state walk {
    enter { load = 9 }
    steer wander()
    when after 9 s -> rest
  }
  machine mood {
    start calm
    state calm { when after 9 s -> hot }
    state hot { when after 9 s -> calm }
  }
  layers { state }
}
"""
HEAD = """antdsl: 1
frames: 1..60
world:
  ground: {mesh: ground.ply}
  rock: {mesh: rock.ply, at: [0, 900, 0]}
  food:
    apple: {at: [10, 0, 10], on: ground, radius: 5 mm}
    pear: {at: [0, 0, 0], keys: {1: {at: [0, 0, 0]}, 21: {at: [40, 0, 0]}}}
  way: {curve: way.json}
  damp: {painted: damp.npz, attribute: damp, on: ground}
crowd:
"""


@pytest.fixture
def project(folder: Path) -> Path:  # noqa: F811
    (folder / "ant.ant").write_text(PROGRAM)
    (folder / "rock.ply").write_bytes((folder / "ground.ply").read_bytes())
    (folder / "way.json").write_text(json.dumps([[-40, 0, 0], [40, 0, 0], [40, 0, 40]]))
    from antdsl.scene.geometry.mesh_files import read_mesh

    vertices = read_mesh((folder / "ground.ply").read_bytes(), "ground.ply").vertices
    np.savez(folder / "damp.npz", damp=(vertices[:, 0] > 0).astype(np.float64))
    return folder


def text(*lines: str) -> str:
    return HEAD + "".join(f"  - {{species: ant, from: ant.ant, {line}}}\n" for line in lines)


def begin_world(project: Path, *lines: str) -> World:
    return world_of(shot_of(project, text(*lines)))


def by_id(world: World, register: str) -> np.ndarray:
    population = world.populations["ant"]
    return population.now[register][population.get_rows_by_id()]


def positions(world: World) -> np.ndarray:
    population = world.populations["ant"]
    return population.position[population.get_rows_by_id()]


def headings(world: World) -> np.ndarray:
    return np.stack([by_id(world, f"heading.{axis}") for axis in AXES], axis=1)


# --- attributes and states ------------------------------------------------------------------------------------------------


def test_attributes_at_birth(project: Path) -> None:
    world = begin_world(
        project,
        "count: 3, each: {load: 2, angry: true}",
        "count: 2000, each: {size: {normal: [3 mm, 0.5 mm]}, load: {choice: {0: 3, 5: 1}}}, place: {by: area}",
        "count: 1000, each: {max_speed: {uniform: [10 mm/s, 20 mm/s]}, angry: {choice: {true: 1, false: 1}}}",
        "count: 4",
    )
    load, size, speed, angry = (by_id(world, name) for name in ("load", "size", "max_speed", "angry"))
    assert load[:3].tolist() == [2, 2, 2] and by_id(world, "speed_up")[:3].tolist() == [4, 4, 4]  # later defaults follow
    assert angry[:3].all() and not angry[3:2003].any() and not angry[-4:].any()
    normal = size[3:2003]
    assert abs(normal.mean() - 3) < 0.05 and abs(normal.std() - 0.5) < 0.05
    assert normal.min() >= 1.5 - 1e-6 and normal.max() <= 4.5 + 1e-6
    assert set(load[3:2003].tolist()) == {0, 5} and 400 < (load[3:2003] == 5).sum() < 600
    fast = speed[2003:3003]
    assert 10 <= fast.min() < 10.2 and 19.8 < fast.max() < 20 and abs(fast.mean() - 15) < 0.4
    assert 400 < angry[2003:3003].sum() < 600
    assert size[-4:].tolist() == [3] * 4 and speed[-4:].tolist() == [40] * 4 and load[-4:].tolist() == [0] * 4


def test_states_at_birth(project: Path) -> None:
    world = begin_world(
        project,
        "count: 3",
        "count: 4, each: {state: walk, mood.state: hot}",
        "count: 400, each: {state: {choice: {rest: 1, walk: 3}}}",
    )
    state, mood, load = by_id(world, "main.state"), by_id(world, "mood.state"), by_id(world, "load")
    assert state[:7].tolist() == [0] * 3 + [1] * 4 and mood[:7].tolist() == [0] * 3 + [1] * 4
    assert 250 < state[7:].sum() < 350 and not mood[7:].any()
    assert (load == 9 * state).all()  # what states do on entry
    assert (by_id(world, "main.previous") == state).all() and not by_id(world, "main.time_in_state").any()
    step(world)
    assert (by_id(world, "main.state") == state).all()


def test_a_painted_map_gives_a_value_at_the_position(project: Path) -> None:
    world = begin_world(project, "count: 300, each: {size: {painted: damp, from: 2 mm, to: 4 mm}, load: {painted: damp}}")
    x, size, load = positions(world)[:, 0], by_id(world, "size"), by_id(world, "load")
    cell = 30  # mm; the map is linear from 0 to 1 there
    assert (size[x < -cell] == 2).all() and (size[x > cell] == 4).all()
    assert np.allclose(size, 2 + 2 * load) and 50 < (load > 0.5).sum() < 250


def test_values_of_other_agents_do_not_change(project: Path) -> None:
    plain = begin_world(project, "count: 40", "count: 40")
    drawn = begin_world(project, "count: 40", "count: 40, each: {load: {uniform: [0, 9]}}")
    for name in ("size", "load", "position.x", "heading.z", "velocity.x"):
        assert np.array_equal(by_id(plain, name)[:40], by_id(drawn, name)[:40])
    assert len(set(by_id(drawn, "load")[40:].tolist())) == 40
    larger = begin_world(project, "count: 40", "count: 50, each: {load: {uniform: [0, 9]}}")
    assert np.array_equal(by_id(larger, "load")[:80], by_id(drawn, "load"))


def test_backends_agree(project: Path) -> None:
    lines = (
        "count: 9, each: {state: {choice: {rest: 1, walk: 1}}, size: {normal: [3 mm, 0.9 mm]}, load: {painted: damp}}",
        "frames: 2..4, count: 9, each: {mood.state: hot}, place: {along: way, radius: 5 mm, facing: along}",
    )
    shot = shot_of(project, text(*lines))
    worlds = [world_of(shot), bind(shot.plan, shot.setting, Options(backend="reference", shuffle_rows=3))]
    for _ in range(4):
        assert state_hash(worlds[0]) == state_hash(worlds[1])
        for world in worlds:
            step(world)


# --- shapes ----------------------------------------------------------------------------------------------------------------


def _distance_to_way(place: np.ndarray) -> np.ndarray:
    """The level distance to the curve of two pieces."""
    x, z = place[:, 0], place[:, 2]
    first = np.hypot(x - np.clip(x, -40, 40), z)
    second = np.hypot(x - 40, z - np.clip(z, 0, 40))
    return np.minimum(first, second)


def test_along_a_curve(project: Path) -> None:
    world = begin_world(project, "count: 200, place: {along: way, facing: along}")
    place, ahead = positions(world), headings(world)
    assert _distance_to_way(place).max() < 0.01
    assert 0.55 < (np.abs(place[:, 2]) < 1e-3).mean() < 0.8  # two thirds of its length
    on_first = (np.abs(place[:, 2]) < 1e-3) & (place[:, 0] < 35)
    assert (ahead[on_first, 0] > 0.9).all() and (ahead[place[:, 2] > 5][:, 2] > 0.9).all()
    wide = begin_world(project, "count: 200, place: {along: way, radius: 10 mm, facing: out}")
    off = _distance_to_way(positions(wide))
    assert 5 < off.max() <= 10.01
    moved = positions(wide) + headings(wide)
    assert (_distance_to_way(moved) > off)[off > 0.5].mean() > 0.95


def test_at_the_edge_of_a_surface(project: Path) -> None:
    place = positions(begin_world(project, "count: 900"))
    half = np.abs(place[:, [0, 2]]).max()
    world = begin_world(project, "count: 60, place: {edge: ground, facing: in}")
    place, ahead = positions(world), headings(world)
    assert (np.abs(place[:, [0, 2]]).max(axis=1) > half * 0.97).all()
    assert ((place + ahead)[:, [0, 2]] ** 2).sum(axis=1).mean() < (place[:, [0, 2]] ** 2).sum(axis=1).mean()
    inner = np.abs((place + 5 * ahead)[:, [0, 2]]).max(axis=1)
    assert (inner < np.abs(place[:, [0, 2]]).max(axis=1)).all()


def test_in_a_box_and_in_a_ball(project: Path) -> None:
    place = positions(begin_world(project, "count: 50, place: {in: {from: [20, -30, 10], to: [50, 30, 40]}}"))
    assert (place[:, 0] > 15).all() and (place[:, 0] < 55).all() and (place[:, 2] > 5).all() and (place[:, 2] < 45).all()
    place = positions(begin_world(project, "count: 50, place: {in: {around: apple, radius: 30 mm}, facing: in}"))
    assert (np.hypot(place[:, 0] - 10, place[:, 2] - 10) < 33).all()


def test_ranks(project: Path) -> None:
    line = "count: 10, place: {ranks: {columns: 4, spacing: [10 mm, 20 mm]}, around: [0, 0, 0], facing: {direction: [0, 0, 1]}}"
    place = positions(begin_world(project, line))
    assert np.allclose(np.unique(np.round(place[:, 2], 3)), [-20, 0, 20])
    assert (place[:4, 2] > 19).all() and np.allclose(np.abs(np.diff(place[:4, 0])), 10, atol=1e-3)
    assert (place[8:, 2] < -19).all()
    assert np.allclose(place.mean(axis=0)[0], place[8:].mean(axis=0)[0] * 0.2, atol=5)
    ahead = headings(begin_world(project, line))
    assert (ahead[:, 2] > 0.9).all()
    side = begin_world(project, line.replace("{direction: [0, 0, 1]}", "[500, 0, 0]"))
    assert (positions(side)[:4, 0] > 15).all() and (headings(side)[:, 0] > 0.9).all()


def test_clumps(project: Path) -> None:
    world = begin_world(project, "count: 60, place: {on: ground, clumps: {number: 3, radius: 12 mm}}")
    place = positions(world)[:, [0, 2]]
    for k in range(3):
        own = place[k::3]
        assert np.hypot(*(own - own.mean(axis=0)).T).max() < 24
    middles = np.array([place[k::3].mean(axis=0) for k in range(3)])
    assert np.hypot(*(middles - middles.mean(axis=0)).T).max() > 12
    larger = positions(begin_world(project, "count: 61, place: {on: ground, clumps: {number: 3, radius: 12 mm}}"))
    assert np.array_equal(larger[:60], positions(world))


# --- directions ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("facing", "sign"), [("out", 1), ("in", -1), ("apple", -1), ("[10, 0, 10]", -1)])
def test_facing_a_centre_or_away_from_it(project: Path, facing: str, sign: int) -> None:
    world = begin_world(project, f"count: 80, place: {{around: apple, radius: 40 mm, facing: {facing}}}")
    level = (positions(world) - [10, 0, 10])[:, [0, 2]]
    along = (headings(world)[:, [0, 2]] * level).sum(axis=1) / np.hypot(*level.T)
    assert (sign * along > 0.8)[np.hypot(*level.T) > 15].all()
    velocity = np.stack([by_id(world, f"velocity.{axis}") for axis in AXES], axis=1)
    assert np.allclose(velocity, headings(world) * np.sqrt((velocity**2).sum(axis=1))[:, None], atol=1e-3)


def test_agents_come_from_where_an_item_is_now(project: Path) -> None:
    world = begin_world(project, "frames: 11..21, count: 11, place: {around: pear, radius: 2 mm, facing: {direction: [1, 0, 0]}}")
    created: dict[int, float] = {}
    while world.frame < 21:
        step(world)
        population = world.populations["ant"]
        for row in np.flatnonzero(population.born == world.frame):
            created[world.frame] = float(population.position[row, 0])
            assert population.now["heading.x"][row] > 0.9
    assert len(created) == 11
    assert all(abs(x - 2 * (frame - 1)) < 2.1 for frame, x in created.items())


# --- findings --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "code", "words"),
    [
        ("each: {laod: 1}", "unknown-thing", "did you mean `load`?"),
        ("each: {size: 3}", "missing-unit", "write `3 mm`"),
        ("each: {size: 3 s}", "wrong-unit", "not a time"),
        ("each: {size: big}", "wrong-value", "is not a number"),
        ("each: {state: wlak}", "unknown-thing", "did you mean `walk`?"),
        ("each: {state: {choice: {wlak: 1}}}", "unknown-thing", "did you mean `walk`?"),
        ("each: {state: {uniform: [1, 2]}}", "wrong-value", "`{choice: {A: 3, B: 1}}`"),
        ("each: {moood.state: hot}", "unknown-thing", "did you mean `mood.state`?"),
        ("each: {angry: 3}", "unknown-thing", "known: `true`"),
        ("each: {size: {uniform: [3 mm, 2 mm]}}", "wrong-value", "write the lesser bound first"),
        ("each: {size: {normal: [3 mm, -2 mm]}}", "wrong-value", "a deviation above zero"),
        ("each: {size: {norml: [3 mm, 2 mm]}}", "unknown-key", "did you mean `normal`?"),
        ("each: {size: {painted: damp}}", "missing-key", "add `from` and `to`"),
        ("each: {load: {painted: dmap}}", "unknown-thing", "did you mean `damp`?"),
        ("place: {along: wya}", "unknown-thing", "did you mean `way`?"),
        ("place: {edge: grund}", "unknown-thing", "did you mean `ground`?"),
        ("place: {in: {around: aple, radius: 3}}", "unknown-thing", "did you mean `apple`?"),
        ("place: {in: {around: apple}}", "missing-key", "add `radius"),
        ("place: {along: way, around: apple, radius: 3}", "wrong-value", "by `along` or by `around`, not both"),
        ("place: {along: way, edge: ground}", "wrong-value", "by `along` or by `edge`, not both"),
        ("place: {in: {from: [0, 0, 0], to: [1, 1, 1]}, density: damp}", "wrong-value", "by `in` or by `density`"),
        ("place: {ranks: {columns: 3, spacing: 3}, clumps: {number: 3, radius: 3}}", "wrong-value", "leave `clumps` out"),
        ("place: {ranks: {columns: 3, spacing: 3}, apart: 3 mm}", "wrong-value", "leave `apart` out"),
        ("place: {ranks: {columns: 3, spacing: 3}, facing: out}", "wrong-value", "`facing: out` has no centre"),
        ("place: {facing: out}", "wrong-value", "`facing: out` has no centre"),
        ("place: {facing: along}", "wrong-value", "has no line to follow"),
        ("place: {facing: appel}", "unknown-thing", "did you mean `apple`?"),
        ("place: {facing: {direction: [0, 0, 0]}}", "wrong-value", "leads nowhere"),
    ],
)
def test_wrong_casting(project: Path, line: str, code: str, words: str) -> None:
    shot, report = opened(project, text(f"count: 3, {line}"))
    assert shot is None
    (error,) = report.errors
    assert error.code == code and words in f"{error.message} | {error.help}", (error.message, error.help)
    assert error.span is not None and error.span.source.path.endswith("scene.yaml")


def test_no_agents(project: Path) -> None:
    lines: tuple[Any, ...] = (
        "count: 0, each: {size: {normal: [3 mm, 0.9 mm]}, state: walk}",
        "count: 0, place: {along: way}",
        "count: 0, place: {ranks: {columns: 3, spacing: 3 mm}}",
        "count: 0, place: {clumps: {number: 3, radius: 3 mm}}",
        "count: 0, place: {edge: ground, facing: in}",
    )
    world = begin_world(project, *lines)
    step(world)
    assert len(world) == 0


@pytest.mark.parametrize(
    ("value", "place"),
    [
        ("size: 0 mm", "0 mm"),
        ("size: {uniform: [-1 mm, 4 mm]}", "-1 mm"),
        ("size: {normal: [3 mm, 1 mm]}", "3 mm"),
        ("size: {choice: {4 mm: 1, 0 mm: 2}}", "0 mm"),
        ("size: {painted: damp, from: 0 mm, to: 4 mm}", "0 mm"),
        ("max_speed: -3 mm/s", "-3 mm/s"),
        ("mass: 0 g", "0 g"),
        ("radius: -1 mm", "-1 mm"),
    ],
)
def test_values_that_an_attribute_cannot_have_are_errors(project: Path, value: str, place: str) -> None:
    (project / "scene.yaml").write_text(text(f"count: 3, each: {{{value}}}"))
    shot, report = open_scene(project / "scene.yaml")
    assert shot is None and [each.code for each in report.errors] == ["out-of-range"], report.errors
    error = report.errors[0]
    assert f"`{value.partition(':')[0]}` cannot be `{place}`" in error.message and (error.help or "").startswith("write ")
    assert error.span is not None and place.split()[0] in error.span.text
