"""`antdsl edit --settle`: agents that edits affect are simulated again, and all others keep their bits."""

from __future__ import annotations

import shutil
from pathlib import Path

import edit_scenes
import numpy as np
import pytest
import settling_scene
from edit_scenes import fail, run
from settling_scene import find_track

from antdsl.outputs.cache.cache_reader import Cache, open_cache
from antdsl.outputs.edits.edited_cache import open_edited_cache
from antdsl.outputs.edits.frame_rows import SPECIES_PER_KEY
from antdsl.outputs.edits.side_effects import find_overlaps, iterate_capsules, make_trunks

COUNT = 24


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("settling")
    settling_scene.simulate(folder, count=COUNT)
    return folder


@pytest.fixture
def cache(original: Path, tmp_path: Path) -> Cache:
    """A copy of the scene and its cache that a test may change."""
    shutil.copytree(original, tmp_path / "shot")
    return open_cache(tmp_path / "shot" / "cache")


def edit(cache: Cache, *lines: str, flags: tuple[object, ...] = ("--settle",)) -> tuple[Cache, str]:
    """The cache with edits, and what the command printed."""
    path = cache.folder.parent / "edits.yaml"
    path.write_text("edits:\n" + "".join(f"- {{{line}}}\n" for line in lines))
    said = run("edit", cache.folder, "--edits", path, *flags)
    return open_edited_cache(cache.folder), said


def count_overlaps(cache: Cache, number: int) -> int:
    """The number of pairs that overlap by a fifth of the smaller width."""
    trunks = make_trunks(cache, cache.frame(number), list(iterate_capsules(cache)))
    return len(list(find_overlaps(trunks, np.ones(len(trunks.keys), np.bool_), 0.2)))


def put_onto(cache: Cache, agent: int, other: int, frame: int) -> str:
    """An edit that puts an agent onto another one in a frame, and keeps the displacement."""
    at = find_track(cache, other) - find_track(cache, agent)
    x, y, z = at[cache.frames().index(frame)].tolist()
    return f"move: guards.{agent}, by: [{x:.3f}, {y:.3f}, {z:.3f}], frames: {frame - 2}..48"


def test_an_agent_makes_way_for_one_that_is_moved_onto_it(cache: Cache) -> None:
    line = put_onto(cache, 0, 5, 30)
    plain, _ = edit(cache, line, flags=())
    assert [count_overlaps(plain, number) for number in (28, 29, 30)] == [1, 1, 1]
    view, said = edit(cache, line)
    assert "settled 1 agent in frames 17 to 48, from the checkpoint of frame 13" in said and "overlap" not in said
    assert sum(count_overlaps(view, number) for number in view.frames()) == 0
    assert "1 agent in frames 17 to 48  settled" in run("info", cache.folder)
    old, new = find_track(plain, 5), find_track(view, 5)
    changed = np.flatnonzero((old != new).any(axis=1))
    assert changed[0] == plain.frames().index(17)
    assert np.linalg.norm(old - new, axis=1).max() > 2
    assert np.linalg.norm(np.diff(new, axis=0), axis=1).max() <= 1.005  # mm, its greatest speed
    others = np.array([k * SPECIES_PER_KEY for k in range(COUNT) if k != 5], np.int64)
    for number in plain.frames():
        assert edit_scenes.take_agents(plain, number, others) == edit_scenes.take_agents(view, number, others)


def test_settled_agents_are_stored_and_written_and_taken_away(cache: Cache) -> None:
    line = put_onto(cache, 0, 5, 30)
    view, _ = edit(cache, line)
    written = cache.folder.parent / "written"
    run("edit", cache.folder, "--to", written)
    edit_scenes.assert_same_frames(view, open_cache(written))
    again, said = edit(cache, line, flags=("--settle", "--to", cache.folder.parent / "again"))
    assert "settled 1 agent" in said
    edit_scenes.assert_same_frames(open_cache(written), open_cache(cache.folder.parent / "again"))
    run("edit", cache.folder, "--remove")
    assert not list(cache.folder.glob("edits.*.npz"))
    assert "write" not in said and again is not None


def test_copies_that_overlap_from_the_first_frame_on_are_separated(cache: Cache) -> None:
    lines = "duplicate: guards.3, by: [0, 0, 1 mm], count: 2"
    plain, _ = edit(cache, lines, flags=())
    assert count_overlaps(plain, 1) > 1
    view, said = edit(cache, lines)
    assert "from the checkpoint of frame 1" in said
    assert sum(count_overlaps(plain, number) for number in view.frames()) > 30
    assert sum(count_overlaps(view, number) for number in view.frames()) < 4 and count_overlaps(view, 1) == 0
    first = [k for k in (3, 3 + COUNT, 3 + 2 * COUNT) if (find_track(plain, k)[0] == find_track(view, k)[0]).all()]
    assert first == [3 + COUNT]  # the last copy and the original made way


def test_agents_that_touched_one_that_is_killed_are_simulated_again(tmp_path: Path) -> None:
    cache = settling_scene.simulate(tmp_path, count=60, last=30, radius=24)
    trunks = make_trunks(cache, cache.frame(1), list(iterate_capsules(cache)))
    pairs = find_overlaps(trunks, np.ones(len(trunks.keys), np.bool_), -0.04)
    killed, left = (key // SPECIES_PER_KEY for key in next(pairs))
    view, said = edit(cache, f"kill: guards.{killed}")
    assert "settled" in said and np.isnan(find_track(view, killed)).all()
    assert (find_track(view, left) != find_track(cache, left)).any()


def test_nothing_is_settled_if_no_agent_is_affected(cache: Cache) -> None:
    _, said = edit(cache, "scale: guards.1, by: 101 %")
    assert "nothing to settle" in said and not list(cache.folder.glob("edits.*.npz"))


def test_bodies_are_separated_also_in_a_scene_without_contacts(tmp_path: Path) -> None:
    cache = settling_scene.simulate(tmp_path, count=8, last=30, contacts="off")
    view, _ = edit(cache, put_onto(cache, 0, 5, 24))
    assert count_overlaps(view, 24) == 0


def test_what_is_missing_is_said_with_what_to_do(cache: Cache) -> None:
    line = put_onto(cache, 0, 5, 30)
    written = cache.folder.parent / "written"
    edit(cache, line, flags=("--to", written))
    (cache.folder.parent / "more.yaml").write_text("edits: [{expand: guards, by: 20 %}]")
    said = fail("edit", written, "--edits", cache.folder.parent / "more.yaml", "--settle")
    assert "has no checkpoints" in said and "settle the cache of a run" in said
    program = cache.folder.parent / "a.ant"
    program.write_text(program.read_text().replace("24 mm/s", "25 mm/s"))
    said = fail("edit", cache.folder, "--edits", cache.folder.parent / "edits.yaml", "--settle")
    assert "made from other inputs: `a.ant`" in said and "settling needs the original texts of the run" in said
    (cache.folder.parent / "scene.yaml").unlink()
    said = fail("edit", cache.folder, "--edits", cache.folder.parent / "edits.yaml", "--settle")
    assert "is not near it" in said and "--scene FILE" in said
    assert "`--settle` needs a file of edits" in fail("edit", cache.folder, "--settle")
    assert "have no effect without `--settle`" in fail("edit", cache.folder, "--remove", "--root", "A=/tmp")


def test_damaged_settled_agents_are_reported(cache: Cache) -> None:
    edit(cache, put_onto(cache, 0, 5, 30))
    (path,) = cache.folder.glob("edits.*.npz")
    arrays = dict(np.load(path))
    arrays["settled.counts.P"] = arrays["settled.counts.P"][:-1]
    with path.open("wb") as file:
        np.savez(file, **arrays)
    assert "damaged" in fail("info", cache.folder)
