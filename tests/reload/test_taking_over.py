"""One world goes on in another: with nothing edited to the same bits, with edits as the page on previews says."""

from __future__ import annotations

import re
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from digging_shots import folder as digging
from meshes import grid
from sampling import sampled

from antdsl.pipeline import Shot, open_scene
from antdsl.plan.registers import list_slot_register_names
from antdsl.reload import Migration, describe_migration, migrate_world
from antdsl.runtime import BindError, BindingCache, World, bind, state_hash, step

EXAMPLES = Path(__file__).parents[2] / "examples"

PROGRAM = """ant 1
use steering
world { surface ground; items food { load = 0 } }
field trail on ground { cell 20 mm; half_life 8 s }
species ant {
  param quick = 30 mm/s in 1 mm/s .. 90 mm/s
  size      uniform(3 mm, 5 mm)
  max_speed quick
  target = none of food
  way    = vector(0, 0, 0)
  load   = 1
  start search
  state search {
    steer wander(swing: 40 deg)
    target = nearest(food)
    way    = velocity / max_speed
    when after 0.2 s -> rest
  }
  state rest {
    steer heading * 0
    load += 1 /s
    when after 0.2 s -> search
  }
}
"""
SCENE = """antdsl: 1
units: mm
fps: 24
frames: 1..100
seed: 3
world:
  ground: {mesh: ground.obj}
  food:
    apple: {at: [60, 0, 5], load: 50}
    bread: {at: [-60, 0, 5], load: 20}
crowd:
  - {species: ant, from: life.ant, count: 20, place: {on: ground}}
"""


def save_ground(folder: Path, cells: int = 6, size: float = 300.0, lift: float = 0.0) -> None:
    vertices, faces = grid(size, cells)
    lines = [f"v {x} {y + lift} {z}" for x, y, z in vertices] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    (folder / "ground.obj").write_text("\n".join(lines) + "\n")


def opened(scene: Path) -> Shot:
    shot, report = open_scene(scene)
    assert shot is not None, [d.message for d in report.errors]
    return shot


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    save_ground(tmp_path)
    (tmp_path / "life.ant").write_text(PROGRAM)
    (tmp_path / "scene.yaml").write_text(SCENE)
    return tmp_path / "scene.yaml"


def started(scene: Path, steps: int = 9) -> World:
    shot = opened(scene)
    world = bind(shot.plan, shot.setting)
    for _ in range(steps):
        step(world)
    return world


def taken(world: World, main: Path, **texts: str) -> tuple[World, Migration]:
    """Edit files of the scene (`life`, `scene`: old -> new, as `old => new`) and take over; the old world must stay as it was."""
    for name, change in texts.items():
        path = main.with_name({"life": "life.ant", "scene": "scene.yaml"}[name])
        old, new = change.split(" => ")
        assert old in path.read_text()
        path.write_text(path.read_text().replace(old, new))
    old_hash = state_hash(world)
    shot = opened(main)
    now, what = migrate_world(world, shot.plan, shot.setting)
    assert state_hash(world) == old_hash
    return now, what


@pytest.mark.parametrize(
    "name",
    sampled(
        ["foraging/scene.yaml", "moods/scene.yaml", "alarm/scene.yaml", "flow/scene.yaml", "tunnel/led.yaml", "digging"],
        ["moods/scene.yaml", "alarm/scene.yaml", "flow/scene.yaml", "digging"],
    ),
)
def test_with_nothing_edited_a_world_goes_on_to_the_same_bits(name: str, tmp_path: Path) -> None:
    shot = opened(digging(tmp_path) if name == "digging" else EXAMPLES / name)
    built = BindingCache()
    world = bind(shot.plan, shot.setting, binding_cache=built)
    for _ in range(20 if name == "digging" else 5):
        step(world)
    if name == "digging":
        assert world.solids["hill"].removed_volume > 0
    other, what = migrate_world(world, shot.plan, shot.setting, built)
    assert describe_migration(what) == f"kept {len(world):,} agents"
    for _ in range(4):
        assert state_hash(other) == state_hash(world)
        step(world)
        step(other)
    assert state_hash(other) == state_hash(world)
    assert other.transitions == world.transitions
    assert other.motion.summarise() == world.motion.summarise()


def test_what_was_dug_stays_dug_while_the_mesh_is_the_same(tmp_path: Path) -> None:
    scene = digging(tmp_path)
    world = started(scene, 20)
    program = scene.with_name("dig.ant")
    program.write_text(program.read_text().replace("state dig", "state burrow").replace("-> dig", "-> burrow"))
    shot = opened(scene)
    other, what = migrate_world(world, shot.plan, shot.setting)
    assert other.solids["hill"].compute_digest() == world.solids["hill"].compute_digest()
    assert np.array_equal(other.fields["trail"].amounts, world.fields["trail"].amounts)
    assert re.search(r"\d of removed state `digger.dig` starts? again in `digger.go`", describe_migration(what))
    for _ in range(3):
        step(other)
    scene.write_text(scene.read_text().replace("voxel: 1 mm", "voxel: 1.25 mm"))
    shot = opened(scene)
    other, what = migrate_world(world, shot.plan, shot.setting)
    assert other.solids["hill"].removed_volume == 0
    assert "`solid hill` is whole" in describe_migration(what)
    for _ in range(3):
        step(other)


def test_what_only_birth_sets_follows_the_text_and_its_params(scene: Path) -> None:
    world = started(scene)
    size = world.populations["ant"].now["size"].copy()
    now, what = taken(world, scene, life="quick = 30 mm/s => quick = 45 mm/s")
    assert (now.populations["ant"].now["max_speed"] == 45).all()
    assert np.array_equal(now.populations["ant"].now["size"], size)  # drawn at birth, and not again
    assert describe_migration(what) == "kept 20 agents · `max_speed` has its new value"
    now, _ = taken(world, scene, life="uniform(3 mm, 5 mm) => uniform(7 mm, 9 mm)")
    assert now.populations["ant"].now["size"].min() >= 7


def test_a_value_of_another_dimension_starts_again(scene: Path) -> None:
    world = started(scene)
    assert world.populations["ant"].now["load"].max() > 1
    scene.with_name("life.ant").write_text(PROGRAM.replace("load   = 1", "load   = 3 g").replace("load += 1 /s", "load += 1 g/s"))
    now, what = taken(world, scene)
    assert (now.populations["ant"].now["load"] == 3).all()
    assert describe_migration(what) == "kept 20 agents · `load` has a different type and starts again"


COUNTING = """
behaviour counted() -> number {
  "How often it was asked."
  keep times = 5 then times + 1
  times
}
species ant {"""


def test_a_memory_goes_on_by_its_identity_and_starts_again_as_another_type(scene: Path) -> None:
    program = PROGRAM.replace("species ant {", COUNTING).replace("load += 1 /s", "load = counted()")
    program = program.replace("target = nearest(food)", "load = counted()").replace("after 0.2 s -> rest", "after 60 s -> rest")
    scene.with_name("life.ant").write_text(program)
    world = started(scene, 3)
    now, what = taken(world, scene, life="    way    = =>     # in another line\n    way    =")
    step(now)
    assert (now.populations["ant"].now["load"] == 8).all()
    assert describe_migration(what) == "kept 20 agents"
    scene.with_name("life.ant").write_text(program.replace("5 then times + 1\n  times", "5 s then times + 1 s\n  times / 1 s"))
    now, what = taken(world, scene)
    assert describe_migration(what) == "kept 20 agents · 2 memories forgotten"
    step(now)
    assert (now.populations["ant"].now["load"] == 5).all()


def test_items_that_agents_hold_are_known_by_name(scene: Path) -> None:
    world = started(scene)
    names = world.items["food"].names
    held = [names[k] for k in world.populations["ant"].now["target"]]
    assert {"apple", "bread"} <= set(held)
    now, what = taken(world, scene, scene="    apple: => \n    donut: {at: [0, 0, 90], load: 7}\n    apple:")
    assert now.items["food"].names == ("donut", "apple", "bread")
    assert [now.items["food"].names[k] for k in now.populations["ant"].now["target"]] == held
    assert "`donut.load` has its amount from the scene" in describe_migration(what)
    now, _ = taken(world, scene, scene="    apple: {at: [60, 0, 5], load: 50}\n => ")
    assert set(now.populations["ant"].now["target"]) == {-1, 1}


def test_agents_follow_a_ground_with_moving_vertices(scene: Path) -> None:
    world = started(scene)
    old_positions = world.populations["ant"].position.copy()
    save_ground(scene.parent, lift=40.0)
    now, what = taken(world, scene)
    assert np.allclose(now.populations["ant"].position, old_positions + np.array([0, 40, 0]), atol=1e-9)
    assert describe_migration(what) == "kept 20 agents · 20 agents moved with the ground · `field trail` starts again"
    step(now)


def test_meshes_that_are_the_same_are_worked_out_once_and_others_forgotten(scene: Path) -> None:
    built, shot = BindingCache(), opened(scene)
    world = bind(shot.plan, shot.setting, binding_cache=built)
    built.drop_unused_values()
    now, _ = migrate_world(world, shot.plan, shot.setting, built)
    assert now.ground is world.ground
    assert now.fields["trail"].cells is world.fields["trail"].cells
    save_ground(scene.parent, lift=40.0)
    shot = opened(scene)
    other, _ = migrate_world(now, shot.plan, shot.setting, built)
    assert other.ground is not now.ground
    built.drop_unused_values()
    shot_before = world.setting
    assert migrate_world(other, shot.plan, shot.setting, built)[0].ground is other.ground
    built.drop_unused_values()
    assert migrate_world(other, shot.plan, shot_before, built)[0].ground is not world.ground


def test_agents_come_to_the_nearest_place_of_a_ground_of_other_faces(scene: Path) -> None:
    world = started(scene)
    old_positions = world.populations["ant"].position.copy()
    save_ground(scene.parent, cells=7, size=100.0)
    now, what = taken(world, scene)
    nearest = np.clip(old_positions, [-50, 0, -50], [50, 0, 50])
    assert np.abs(now.populations["ant"].position - nearest).max() < 0.05
    assert what.species[0].moved_count == np.count_nonzero((np.abs(old_positions) > 50.05).any(axis=1))
    step(now)


def test_newcomers_get_new_ids_and_who_came_last_goes(scene: Path) -> None:
    world = started(scene)
    larger, what = taken(world, scene, scene="count: 20 => count: 26")
    ants = larger.populations["ant"]
    assert sorted(ants.ids) == list(range(26))
    assert (ants.born[ants.ids >= 20] == world.frame).all()
    assert describe_migration(what) == "kept 20 agents · 6 `ant` added"
    for _ in range(3):
        step(larger)
    fewer, what = taken(larger, scene, scene="count: 26 => count: 9")
    assert sorted(fewer.populations["ant"].ids) == list(range(9))
    assert describe_migration(what) == "kept 9 agents · 17 `ant` removed"
    again, _ = taken(fewer, scene, scene="count: 9 => count: 11")
    assert sorted(again.populations["ant"].ids) == [*range(9), 26, 27]


def test_what_cannot_be_bound_leaves_the_old_world_alone(scene: Path) -> None:
    world = started(scene)
    scene.with_name("life.ant").write_text(PROGRAM.replace("half_life 8 s", "half_life 8 s; diffuse 300 mm^2/s"))
    shot = opened(scene)
    old_hash = state_hash(world)
    with pytest.raises(BindError, match="spreads faster than its cells"):
        migrate_world(world, shot.plan, replace(shot.setting, fps=Fraction(1)))
    assert state_hash(world) == old_hash
    step(world)


LIKING = PROGRAM.replace("load   = 1", "load   = 1\n  likes  = 0 relax to 0 over 3 s for each ant, strongest 5").replace(
    "steer heading * 0", "steer heading * 0; likes[n in neighbours(200 mm)] += (n.id - 9) * distance(n) / 1 m * 1 /s"
)


def likings(world: World, count: int) -> dict[int, list[tuple[int, float]]]:
    """What each ant stores about which other, the strongest first."""
    ants, pairs_by_agent = world.populations["ant"], {}
    for row, agent in enumerate(ants.ids.tolist()):
        pairs = [
            (int(ants.now[who][row]), float(ants.now[value][row])) for who, value in list_slot_register_names("likes", count)
        ]
        pairs_by_agent[agent] = sorted((pair for pair in pairs if pair[0] >= 0), key=lambda pair: (-abs(pair[1]), pair[0]))
    return pairs_by_agent


def test_values_per_pair_go_on_by_name_and_type_the_strongest_where_fewer_fit(scene: Path) -> None:
    scene.with_name("life.ant").write_text(LIKING)
    world = started(scene, 12)
    old_pairs = likings(world, 5)
    assert sum(len(pairs) == 5 for pairs in old_pairs.values()) == 20
    fewer, what = taken(world, scene, life="strongest 5 => strongest 2")
    assert describe_migration(what) == "kept 20 agents"
    assert likings(fewer, 2) == {agent: pairs[:2] for agent, pairs in old_pairs.items()}
    larger, _ = taken(world, scene, life="strongest 2 => strongest 7")
    assert likings(larger, 7) == old_pairs
    for _ in range(9):
        step(larger)
        step(fewer)
    assert all(len(pairs) <= 2 for pairs in likings(fewer, 2).values())
    assert any(len(pairs) > 5 for pairs in likings(larger, 7).values())
    lengths = LIKING.replace("0 relax to 0", "0 mm relax to 0 mm").replace("strongest 5", "strongest 7").replace("/ 1 m *", "*")
    scene.with_name("life.ant").write_text(lengths)
    fresh, what = taken(world, scene)
    assert describe_migration(what) == "kept 20 agents · `likes` has a different type and starts again"
    assert not any(likings(fresh, 7).values())
    scene.with_name("life.ant").write_text(PROGRAM)
    _, what = taken(world, scene)
    assert describe_migration(what) == "kept 20 agents · `likes` is gone"


@pytest.mark.parametrize("rest", ["2", "calm"])
def test_the_strongest_are_those_farthest_from_what_they_return_to(scene: Path, rest: str) -> None:
    life = LIKING.replace("0 relax to 0 over", f"{rest} relax to {rest} over").replace("(n.id - 9)", "(n.id - 14)")
    life = life.replace("  load   = 1", "  param calm = 2 in 0 .. 9\n  load   = 1", 1)
    scene.with_name("life.ant").write_text(life)
    world = started(scene, 12)
    old_pairs = likings(world, 5)
    fewer, _ = taken(world, scene, life="strongest 5 => strongest 2")
    far = {
        agent: sorted(sorted(pairs), key=lambda pair: -abs(np.float32(pair[1]) - np.float32(2)))[:2]
        for agent, pairs in old_pairs.items()
    }
    assert {agent: sorted(pairs) for agent, pairs in likings(fewer, 2).items()} == {a: sorted(pairs) for a, pairs in far.items()}
    assert any(sorted(pairs[:2]) != sorted(far[agent]) for agent, pairs in old_pairs.items()), (
        "they are not those farthest from 0"
    )


def test_values_about_those_who_go_go_with_them(scene: Path) -> None:
    scene.with_name("life.ant").write_text(LIKING)
    world = started(scene, 12)
    assert any(other >= 10 for pairs in likings(world, 5).values() for other, _ in pairs)
    now, _ = taken(world, scene, scene="count: 20 => count: 10")
    step(now)
    pairs_by_agent = likings(now, 5)
    assert len(pairs_by_agent) == 10 and not any(other >= 10 for pairs in pairs_by_agent.values() for other, _ in pairs)
