"""Edits are local: more ants, a far stone, a species that no other meets leave the others as they were, bit for bit."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from foraging_shots import EXAMPLE, by_id, setting, shot, world

from antdsl.pipeline import open_scene
from antdsl.runtime import MeshData, World, bind, state_hash, step

FRAMES = 15


def same(one: World, other: World, first: int | None = None) -> list[str]:
    """Names of registers in which the first so many ants of two worlds differ."""
    a, b = by_id(one), by_id(other)
    return [name for name in a if not np.array_equal(a[name][:first], b[name][:first], equal_nan=a[name].dtype.kind == "f")]


def test_a_hundred_more_leave_the_first_with_the_same_start_and_draws() -> None:
    few, many = world(), world(count=600)
    assert len(many.populations["forager"]) == 600
    assert same(few, many, 500) == []
    turning = [name for name in few.populations["forager"].plan.registers if "wander" in name and "turning" in name]
    assert turning
    deviations = []
    for _ in range(FRAMES):
        step(few)
        step(many)
        a, b = (by_id(each, [*turning, "main.state"]) for each in (few, many))
        searching = (a["main.state"] == 0) & (b["main.state"][:500] == 0)
        for name in turning:  # memory of nothing but its own draws
            assert np.array_equal(a[name][searching], b[name][:500][searching])
        deviations.append(a[turning[0]][searching].std())
    assert min(deviations) > 0.1
    assert same(few, many, 500) != []  # they do meet


def far_stone(mesh: MeshData) -> MeshData:
    """The stones and one more, beyond the ground's rim."""
    corner = np.array([[460, 5, -430], [469, 5, -430], [460, 14, -430], [460, 5, -421]], float)
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32) + len(mesh.vertices)
    return MeshData(np.concatenate([mesh.vertices, corner]), np.concatenate([mesh.faces, faces]).astype(np.int32))


def test_a_stone_far_from_every_path_changes_no_hash() -> None:
    plain_setting = setting(around=(90.0, 0.0, 70.0))
    stone = dataclasses.replace(plain_setting, obstacles={"stones": far_stone(plain_setting.obstacles["stones"])})
    plain, edited = bind(shot().plan, plain_setting), bind(shot().plan, stone)
    for _ in range(2 * FRAMES):  # until some have found food
        assert state_hash(plain) == state_hash(edited)
        step(plain)
        step(edited)
    assert plain.populations["forager"].now["load"].sum() > 0


STROLLER = """ant 1
use steering
world { surface ground }
species stroller {
  start stroll
  state stroll { steer wander() }
  layers { state; separate(radius: 10 mm) }
}
"""


def test_a_species_that_no_other_meets_changes_nothing_of_the_others(tmp_path: Path) -> None:
    for name in ("terrain.ply", "boulder.ply", "stones.ply", "forager.ant"):
        (tmp_path / name).write_bytes((EXAMPLE / name).read_bytes())
    (tmp_path / "stroller.ant").write_text(STROLLER)
    text = (EXAMPLE / "scene.yaml").read_text()
    line = "  - {species: stroller, from: stroller.ant, count: 60, place: {on: ground, around: [300, 0, -300], radius: 60 mm}}\n"
    (tmp_path / "scene.yaml").write_text(text.replace("crowd:\n", "crowd:\n" + line))
    opened, report = open_scene(tmp_path / "scene.yaml")
    assert opened is not None, [d.message for d in report.sort_by_place()]
    alone, beside = world(), bind(opened.plan, opened.setting)
    assert len(beside.populations["stroller"]) == 60
    for _ in range(FRAMES):
        step(alone)
        step(beside)
        assert set(same(alone, beside)) <= {"group"}  # which line of the crowd it came from
        assert np.array_equal(alone.fields["trail"].amounts, beside.fields["trail"].amounts)
