"""Named lines of a crowd: the ids of their agents in a world, in checkpoints, after edits of the scene, and in a cache."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from test_scene_files import SCENE, folder, opened  # noqa: F401

from antdsl.outputs.cache.manifest import read_manifest
from antdsl.outputs.recording import begin_recording, record_frames
from antdsl.pipeline import Shot
from antdsl.reload import migrate_world
from antdsl.runtime import Options, bind, restore_checkpoint, step, take_checkpoint
from antdsl.runtime.sensing.selectable_agents import collect_selectable_frame
from antdsl.runtime.world import World
from antdsl.scene.notes.selection import select_ids
from antdsl.scene.notes.selectors import AgentName

LINE = "  - {{name: {name}, species: ant, from: ant.ant, count: {count}, place: {{on: ground}}}}\n"


def crowd(*lines: tuple[str, int]) -> str:
    """A scene with crowd lines of these names and counts. A line with an empty name has none."""
    texts = [LINE.format(name=name, count=count).replace("name: , ", "") for name, count in lines]
    return SCENE[: SCENE.index("crowd:\n")] + "crowd:\n" + "".join(texts)


def shot_of(folder: Path, scene: str) -> Shot:  # noqa: F811
    shot, report = opened(folder, scene)
    assert shot is not None, [each.message for each in report.errors]
    return shot


def world_of(shot: Shot) -> World:
    return bind(shot.plan, shot.setting, Options(backend="numpy"))


def ranges(world: World) -> dict[str, tuple[tuple[int, int], ...]]:
    return {crowd.name: line.ranges for crowd, line in zip(world.setting.crowds, world.crowd_lines, strict=True)}


def test_a_name_selects_the_agents_of_its_line(folder: Path) -> None:  # noqa: F811
    world = world_of(shot_of(folder, crowd(("", 3), ("guards", 4), ("late", 0), ("scouts", 2))))
    assert ranges(world) == {"": ((0, 3),), "guards": ((3, 4),), "late": (), "scouts": ((7, 2),)}
    assert world.populations["ant"].next_id == 9
    frame = collect_selectable_frame(world)
    assert select_ids(AgentName("guards"), frame)["ant"].tolist() == [3, 4, 5, 6]
    assert select_ids(AgentName("scouts", 1, 1), frame)["ant"].tolist() == [8]
    assert frame.item_points["apple"].tolist() == frame.item_points["food"].tolist()
    assert {name for column in frame.agents["ant"].states.values() for name in column.names} == {"go"}


def test_names_change_no_agent_and_no_count_above_shifts_a_number(folder: Path) -> None:  # noqa: F811
    plain = world_of(shot_of(folder, crowd(("", 3), ("", 4))))
    named = world_of(shot_of(folder, crowd(("guards", 3), ("scouts", 4))))
    for key, array in take_checkpoint(plain).items():
        if not key.startswith("lines."):
            assert np.array_equal(array, take_checkpoint(named)[key]), key
    larger = world_of(shot_of(folder, crowd(("guards", 30), ("scouts", 4))))
    assert ranges(larger)["scouts"] == ((30, 4),)  # other ids; numbers 0 to 3 name the same line


def test_checkpoints_and_edits_retain_the_numbers(folder: Path) -> None:  # noqa: F811
    first = world_of(shot_of(folder, crowd(("guards", 3), ("scouts", 4))))
    step(first)
    edited = shot_of(folder, crowd(("guards", 5), ("scouts", 2), ("new", 1)))
    second, migration = migrate_world(first, edited.plan, edited.setting)
    assert ranges(second) == {"guards": ((0, 3), (7, 2)), "scouts": ((3, 2),), "new": ((9, 1),)}
    assert migration.added_counts == {"ant": 3} and migration.removed_counts == {"ant": 2}
    restored = world_of(edited)
    assert ranges(restored)["guards"] == ((0, 5),)
    restore_checkpoint(restored, take_checkpoint(second))
    assert ranges(restored) == ranges(second)
    swapped = shot_of(folder, crowd(("scouts", 2), ("guards", 5), ("", 1)))
    third, migration = migrate_world(second, swapped.plan, swapped.setting)
    assert ranges(third) == {"scouts": ((3, 2),), "guards": ((0, 3), (7, 2)), "": ((9, 1),)}
    assert not migration.added_counts and not migration.removed_counts
    assert sorted(third.populations["ant"].now["group"].tolist()) == [0] * 2 + [1] * 5 + [2]


def test_invalid_tables_of_a_checkpoint_are_errors(folder: Path) -> None:  # noqa: F811
    world = world_of(shot_of(folder, crowd(("guards", 3))))
    arrays = take_checkpoint(world)
    for row in ([1, 0, 3], [0, -1, 3], [0, 0, 0]):
        with pytest.raises(ValueError, match="inconsistent"):
            restore_checkpoint(world, arrays | {"lines.ranges": np.array([row])})
    older = {name: array for name, array in arrays.items() if not name.startswith("lines.")}
    restore_checkpoint(world, older)
    assert ranges(world) == {"guards": ((0, 3),)}


def test_a_cache_lists_the_named_lines(folder: Path) -> None:  # noqa: F811
    shot = shot_of(folder, crowd(("", 3), ("guards", 4), ("scouts", 0)))
    out = folder / "out"
    recording = begin_recording(shot, out, Options(backend="numpy"), resume=False, force=False)
    for _ in record_frames(recording):
        pass
    entries = read_manifest(out).lines
    assert [(each.name, each.species, each.ranges) for each in entries] == [("guards", "ant", ((3, 4),)), ("scouts", "ant", ())]


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ((("guards", 1), ("guards", 2)), "two lines of the crowd are named `guards`"),
        ((("ant", 1),), "`ant` is the name of a species"),
        ((("apple", 1),), "`apple` is the name of an item"),
        ((("food", 1),), "`food` is the name of an item"),
    ],
)
def test_names_that_mean_something_else(folder: Path, lines: tuple[tuple[str, int], ...], words: str) -> None:  # noqa: F811
    shot, report = opened(folder, crowd(*lines))
    assert shot is None
    (error,) = report.errors
    assert error.code == "duplicate-name" and words in error.message and error.span is not None
    assert error.span.text == lines[-1][0] and error.help
