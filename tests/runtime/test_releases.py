"""Crowd lines that create agents during the run: how many, in which frames, with which ids, and from which places."""

from __future__ import annotations

import tracemalloc
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from test_crowd_lines import ranges, shot_of, world_of
from test_scene_files import SCENE, folder, opened  # noqa: F401
from typer.testing import CliRunner

from antdsl.cli import app
from antdsl.outputs.cache.cache_reader import open_cache
from antdsl.outputs.recording import begin_recording, record_frames
from antdsl.reload import migrate_world
from antdsl.runtime import Options, bind, restore_checkpoint, state_hash, step, take_checkpoint
from antdsl.runtime.world import World
from antdsl.scene.crowds.crowd_data import CrowdData, ReleaseData

HEAD = SCENE[: SCENE.index("crowd:\n")].replace("frames: 1..3", "frames: 1..120")
HOLE = "place: {around: apple, radius: 20 mm}"


def scene(*lines: str, fps: str = "24", head: str = HEAD) -> str:
    texts = [f"  - {{species: ant, from: ant.ant, {line}}}\n" for line in lines]
    return head.replace("world:", f"fps: {fps}\nworld:", 1) + "crowd:\n" + "".join(texts)


def run(world: World, frame: int) -> dict[int, int]:
    """Step to a frame; return the number of agents in each frame."""
    counts = {world.frame: len(world)}
    while world.frame < frame:
        step(world)
        counts[world.frame] = len(world)
    return counts


# --- how many -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fps", ["24", "25", "23.976", "29.97", "30", "60", "12", "7"])
def test_a_rate_gives_the_same_number_at_any_fps(folder: Path, fps: str) -> None:  # noqa: F811
    shot = shot_of(folder, scene(f"rate: 20 /s, seconds: 2 s .. 4 s, {HOLE}", fps=fps))
    (crowd,) = shot.setting.crowds
    rate = shot.setting.fps
    first, last = int(1 + 2 * rate), int(1 + 4 * rate)
    assert crowd.count == 40
    assert crowd.count_created(first - 1) == 0 and crowd.count_created(first) >= 1
    assert crowd.count_created(first) < 5 and crowd.count_created(int(1 + 3.9 * rate) - 1) < 40
    assert crowd.count_created(last) == 40 == crowd.count_created(10_000)
    drift = [abs(crowd.count_created(f) - 20 * (f + 1 - 1 - 2 * rate) / rate) for f in range(first, last)]
    assert max(drift) <= 1


def test_forty_of_the_brief_by_frames_in_a_run(folder: Path) -> None:  # noqa: F811
    world = world_of(shot_of(folder, scene("count: 3", f"name: guards, frames: 49..96, rate: 20 /s, {HOLE}", "count: 2")))
    counts = run(world, 110)
    assert counts[48] == 5 and counts[49] == 6 and counts[72] == 5 + 20 and counts[96] == counts[110] == 45
    assert ranges(world)["guards"] == ((3, 40),)
    population = world.populations["ant"]
    rows = population.get_rows_by_id()
    born = dict(zip(population.ids[rows].tolist(), population.born[rows].tolist(), strict=True))
    assert born[3] == 49 and born[42] == 95 and born[43] == born[44] == 1
    assert population.next_id == 45


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("count: 4, frames: 3", {2: 0, 3: 4}),
        ("count: 4, frames: 3..6", {2: 0, 3: 1, 4: 2, 5: 3, 6: 4, 9: 4}),
        ("count: 3, frames: -5..1", {1: 3, 5: 3}),
        ("rate: 120 /min, frames: 1..48", {1: 1, 12: 1, 13: 2, 48: 4, 60: 4}),
        ("rate: 2 /step, frames: 1..3", {1: 2, 2: 4, 3: 6, 9: 6}),
        ("rate: 0.4 /s, seconds: 0 s .. 4 s", {1: 1, 60: 1, 61: 2, 110: 2}),
        ("count: 0, frames: 3..6", {9: 0}),
    ],
)
def test_when_agents_are_created(folder: Path, line: str, expected: dict[int, int]) -> None:  # noqa: F811
    counts = run(world_of(shot_of(folder, scene(line))), max(expected))
    assert {frame: counts[frame] for frame in expected} == expected


def test_every_number_is_created_once_in_order() -> None:
    rng = np.random.default_rng(5)
    for _ in range(200):
        count, fps = int(rng.integers(1, 90)), Fraction(int(rng.integers(1, 60)), int(rng.integers(1, 4)))
        interval = fps / int(rng.integers(1, 50))
        crowd = CrowdData("ant", count, release=ReleaseData(Fraction(int(rng.integers(-9, 9)), 7), interval))
        created = [crowd.count_created(frame) for frame in range(-20, 200)]
        assert created == sorted(created) and created[0] == 0
        begins = _frames_of(crowd)
        assert created == [sum(begin <= frame for begin in begins) for frame in range(-20, 200)]


def _frames_of(crowd: CrowdData) -> list[int]:
    assert crowd.release is not None
    return [int((crowd.release.begin + k * crowd.release.interval) // 1) for k in range(crowd.count)]


# --- nothing else changes ---------------------------------------------------------------------------------------------------


def test_a_line_below_changes_no_agent_above(folder: Path) -> None:  # noqa: F811
    one = world_of(shot_of(folder, scene(f"count: 5, {HOLE}", f"frames: 2..9, count: 6, {HOLE}")))
    far = "place: {around: [60, 0, 60], radius: 9 mm}"
    two = world_of(
        shot_of(folder, scene(f"count: 5, {HOLE}", f"frames: 2..9, count: 6, {HOLE}", f"frames: 3..8, count: 4, {far}"))
    )
    for _ in range(12):
        step(one), step(two)
        for name in ("position.x", "heading.z", "velocity.y"):
            a, b = (w.populations["ant"] for w in (one, two))
            rows = b.find_rows(a.ids)
            assert np.array_equal(a.now[name], b.now[name][rows])


@pytest.mark.parametrize(
    "options", [Options(backend="reference"), Options(backend="native", wait_for_code=True, threads=2, shuffle_rows=4)]
)
def test_all_backends_give_the_same_states(folder: Path, options: Options) -> None:  # noqa: F811
    shot = shot_of(folder, scene("count: 3, place: {on: ground}", f"frames: 2..6, rate: 30 /s, each: {{load: 1}}, {HOLE}"))
    worlds = [world_of(shot), bind(shot.plan, shot.setting, options)]
    for _ in range(8):
        assert state_hash(worlds[0]) == state_hash(worlds[1])
        for world in worlds:
            step(world)


# --- going on ---------------------------------------------------------------------------------------------------------------


def test_a_run_that_continues_from_a_checkpoint_creates_the_same_agents(folder: Path) -> None:  # noqa: F811
    shot = shot_of(folder, scene("count: 3", f"name: guards, frames: 3..12, rate: 30 /s, {HOLE}"))
    complete = world_of(shot)
    run(complete, 7)
    arrays = take_checkpoint(complete)
    run(complete, 15)
    continued = world_of(shot)
    restore_checkpoint(continued, arrays)
    run(continued, 15)
    assert state_hash(complete) == state_hash(continued) and ranges(complete) == ranges(continued)


def test_edits_of_a_running_scene(folder: Path) -> None:  # noqa: F811
    first = world_of(shot_of(folder, scene("count: 3", f"name: guards, frames: 3..12, count: 10, {HOLE}")))
    run(first, 6)
    assert len(first) == 7
    edited = shot_of(folder, scene("count: 2", f"name: guards, frames: 3..12, count: 20, {HOLE}", "count: 1"))
    second, migration = migrate_world(first, edited.plan, edited.setting)
    assert len(second) == 2 + 8 + 1 and migration.added_counts == {"ant": 5} and migration.removed_counts == {"ant": 1}
    assert ranges(second)["guards"] == ((3, 20),) or len(second.crowd_lines[1]) == 20
    run(second, 14)
    assert len(second) == 2 + 20 + 1
    ids = second.populations["ant"].ids
    assert len(set(ids.tolist())) == len(ids)
    assert set(second.crowd_lines[1].list_ids_between().tolist()) <= set(ids.tolist())
    plain = shot_of(folder, scene("count: 2", f"name: guards, frames: 3..12, count: 4, {HOLE}"))
    third, migration = migrate_world(second, plain.plan, plain.setting)
    assert (
        len(third) == 6
        and third.crowd_lines[1].list_ids_between().tolist() == second.crowd_lines[1].list_ids_between(0, 3).tolist()
    )


def test_a_scene_that_begins_with_a_cache_creates_new_agents(folder: Path) -> None:  # noqa: F811
    text = scene("count: 3", f"name: guards, frames: 3..12, count: 10, {HOLE}").replace("frames: 1..120", "frames: 1..6", 1)
    shot = shot_of(folder, text + "output: {checkpoint: 3}\n")
    for _ in record_frames(begin_recording(shot, folder / "one", Options(backend="numpy"), resume=False, force=False)):
        pass
    scouts = f"name: scouts, frames: 5..6, count: 4, {HOLE}"
    text = scene("count: 3", f"name: guards, frames: 4..5, count: 2, {HOLE}", scouts).replace("frames: 1..120", "frames: 1..9", 1)
    shot = shot_of(folder, text + "from: {cache: one, frame: 6}\n")
    recording = begin_recording(shot, folder / "two", Options(backend="numpy"), resume=False, force=False)
    assert len(recording.world) == 7
    for _ in record_frames(recording):
        pass
    world = recording.world
    assert len(world) == 7 + 2 + 4
    assert ranges(world) == {"": ((0, 3),), "guards": ((3, 4), (13, 2)), "scouts": ((15, 4),)}
    assert sorted(world.populations["ant"].ids.tolist()) == [*range(7), *range(13, 19)]
    assert [line.ranges for line in open_cache(folder / "two").manifest.lines] == [((3, 4), (13, 2)), ((15, 4),)]


# --- findings ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "code", "words"),
    [
        ("place: {on: ground}", "missing-key", "this line has no `count`"),
        ("count: 3, rate: 3 /s, frames: 1..3", "wrong-value", "`count` and `rate` both say"),
        ("rate: 3 /s", "wrong-value", "add `frames: 49..96` or `seconds: 2 s .. 4 s`"),
        ("rate: 3 mm/s, frames: 1..3", "wrong-value", "is not a"),
        ("count: 3, frames: 1..3, seconds: 1..2", "wrong-value", "both say when"),
        ("count: 3, seconds: 3 s .. 2 s", "wrong-value", "write `2 s .. 3 s`"),
        ("count: 3, seconds: soon", "wrong-value", "write two times"),
        ("rate: 0.1 /s, frames: 1..3", "wrong-value", "`0.1 /s` creates no agent in this time"),
        ("rate: 9000000 /s, frames: 1..100", "too-large", "write a smaller `count` or `rate`"),
        ("count: 3, frame: 4", "unknown-key", "did you mean `frames`?"),
    ],
)
def test_wrong_numbers_and_frames(folder: Path, line: str, code: str, words: str) -> None:  # noqa: F811
    shot, report = opened(folder, scene(line))
    assert shot is None
    (error,) = report.errors
    assert error.code == code and words in f"{error.message} | {error.help}" and error.span is not None


@pytest.mark.parametrize(
    ("line", "words"), [("frames: 300..400", "before any of these"), ("frames: -9..-2", "are there at once")]
)
def test_frames_outside_of_the_scene_are_a_warning(folder: Path, line: str, words: str) -> None:  # noqa: F811
    shot, report = opened(folder, scene(f"count: 3, {line}"))
    assert shot is not None
    (warning,) = [each for each in report.diagnostics if each.code == "out-of-range"]
    assert words in warning.message and warning.help


# --- births and deaths without end -------------------------------------------------------------------------------------------

MORTAL = """ant 1
use steering
world { surface ground }
species ant {
  start go
  state go { steer wander(); when after 0.25 s -> go { die } }
  layers { state }
}
"""


def _live_and_die(folder: Path, frames: int, rate: int) -> tuple[int, list[int]]:  # noqa: F811
    """Run a scene in which agents live for a quarter of a second. Return the number of ids, and the memory at some frames."""
    (folder / "ant.ant").write_text(MORTAL)
    head = f"antdsl: 1\nframes: 1..{frames}\nworld:\n  ground: {{mesh: ground.ply}}\n"
    world = world_of(shot_of(folder, scene(f"rate: {rate} /s, frames: 1..{frames}, place: {{on: ground}}", head=head)))
    known_ids: set[int] = set()
    sizes = []
    tracemalloc.start()
    while world.frame < frames:
        previous = set(world.populations["ant"].ids.tolist())
        step(world)
        new = set(world.populations["ant"].ids.tolist()) - previous
        assert not new & known_ids  # no id is used twice
        known_ids |= new | previous
        if world.frame % (frames // 4) == 0:
            sizes.append(tracemalloc.get_traced_memory()[0] - 100 * len(known_ids))
    tracemalloc.stop()
    return len(known_ids), sizes


def test_ids_are_used_once_and_memory_stays(folder: Path) -> None:  # noqa: F811
    count, sizes = _live_and_die(folder, 120, 240)
    assert count == 1200 and max(sizes) < sizes[1] + 400_000


@pytest.mark.slow
def test_twenty_thousand_births_and_deaths(folder: Path) -> None:  # noqa: F811
    count, sizes = _live_and_die(folder, 2000, 240)
    assert count == 20_000 and max(sizes) < sizes[0] + 1_000_000


def test_check_reports_the_maximum_number_of_agents(folder: Path) -> None:  # noqa: F811
    path = folder / "scene.yaml"
    path.write_text(scene("count: 5", f"frames: 49..96, rate: 20 /s, {HOLE}"))
    result = CliRunner().invoke(app, ["check", str(path)])
    assert result.exit_code == 0, result.output
    assert "at most 45 agents of the crowd, 40 of them created in given frames" in " ".join(result.output.split())
    path.write_text(scene("count: 5"))
    assert "at most" not in CliRunner().invoke(app, ["check", str(path)]).output
