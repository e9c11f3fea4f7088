"""Feet in caches: what a frame says of them, their hashes, runs that are continued, and bodies that are drawn on them."""

from __future__ import annotations

import json
from dataclasses import replace
from hashlib import sha256
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
import stick_bodies

from antdsl.bodies.body import build_rotation_matrices
from antdsl.outputs.cache.cache_reader import Cache, open_cache
from antdsl.outputs.edits.frame_rows import SPECIES_PER_KEY
from antdsl.outputs.gallery import Gallery
from antdsl.outputs.recording import Recording, begin_recording, record_frames
from antdsl.pipeline import RunChoices, open_scene, simulate
from antdsl.runtime import Options, state_hash
from antdsl.scene.values import FrameRange

FEET = Options(backend="numpy", feet=True)


def ran(scene: Path, out: Path, last: int, options: Options = FEET, *, resume: bool = False) -> Recording:
    shot, report = open_scene(scene, RunChoices(frames=FrameRange(1, last)))
    assert shot is not None, report
    recording = begin_recording(shot, out, options, resume=resume, force=False)
    for _ in record_frames(recording):
        pass
    return recording


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return stick_bodies.write_scene(tmp_path_factory.mktemp("scene"), 6, "hill", count=8)


@pytest.fixture(scope="module")
def cache(scene: Path) -> Cache:
    ran(scene, scene.parent / "out", 16)
    return open_cache(scene.parent / "out")


def test_frames_have_feet_with_a_hash_of_their_own_and_the_same_state(scene: Path, cache: Cache) -> None:
    arrays = cache.frame(16)
    kinds = {name.rpartition(".")[2]: array.dtype.str[1:] for name, array in arrays.items() if name.startswith("feet.walker.")}
    assert kinds == {"P": "f4", "down": "u1", "phase": "f4", "rise": "f4", "tilt": "f4"}
    assert arrays["feet.walker.P"].shape == (8, 6, 3) and arrays["feet.walker.tilt"].shape == (8, 4)
    shot, _ = open_scene(scene)
    assert shot is not None
    plain = {world.frame: state_hash(world) for world in islice(simulate(shot, Options(backend="numpy")), 16)}
    for frame, line in cache.lines().items():
        assert line.hash == plain[frame] and line.feet


def test_a_run_that_is_continued_has_the_same_feet(scene: Path, cache: Cache, tmp_path: Path) -> None:
    ran(scene, tmp_path / "out", 7)
    assert ran(scene, tmp_path / "out", 16, resume=True).resumed_from == 7
    again = open_cache(tmp_path / "out")
    assert [line.feet for line in again.lines().values()] == [line.feet for line in cache.lines().values()]
    assert np.array_equal(again.frame(16)["feet.walker.P"], cache.frame(16)["feet.walker.P"])


def test_lines_with_other_feet_are_not_gone_on_from(scene: Path, tmp_path: Path) -> None:
    ran(scene, tmp_path / "out", 5)
    hashes = tmp_path / "out" / "hashes.jsonl"
    lines = [json.loads(line) for line in hashes.read_text().splitlines()]
    hashes.write_text("".join(json.dumps(line | {"feet": "0" * 32}) + "\n" for line in lines))
    recording = ran(scene, tmp_path / "out", 6, resume=True)
    assert recording.resumed_from is None and "frame.0001.npz` was changed or damaged after it was written" in recording.notes[0]


def test_a_checkpoint_with_other_feet_is_not_gone_on_from(scene: Path, tmp_path: Path) -> None:
    """In a cache of files with hashes of all their bytes, which know nothing of feet."""
    out = tmp_path / "out"
    ran(scene, out, 5)
    hashes = out / "hashes.jsonl"
    lines = []
    for line in map(json.loads, hashes.read_text().splitlines()):
        begin, number = f"{line['frame']} {line['hash']} ", f"{line['frame']:04d}.npz"
        files = {
            "file": (begin, f"frames/frame.{number}"),
            "checkpoint": (f"checkpoint {begin}", f"checkpoints/checkpoint.{number}"),
        }
        for name, (first, path) in files.items():
            if name in line:
                line[name] = sha256(first.encode() + (out / path).read_bytes()).hexdigest()[:32]
        lines.append(json.dumps(line | {"feet": "0" * 32}) + "\n")
    hashes.write_text("".join(lines))
    recording = ran(scene, out, 6, resume=True)
    assert recording.resumed_from is None and any("does not hold the feet of frame 5" in note for note in recording.notes)


def test_drawn_feet_are_where_frames_have_them_and_each_frame_stands_alone(cache: Cache) -> None:
    gallery = Gallery(cache)
    pictures = {frame: gallery.make_picture(frame).crowds[0] for frame in (10, 11, 16)}
    assert Gallery(cache).make_picture(16).crowds[0].feet is not None
    for frame, crowd in pictures.items():
        assert crowd.body is not None and crowd.feet is not None
        every = np.arange(len(crowd.position))
        points, normals = crowd.body.pose_vertices(crowd.machine_clips, len(every), crowd.select_feet(every))
        alone = Gallery(cache).make_picture(frame).crowds[0]
        assert np.array_equal(points, alone.body.pose_vertices(alone.machine_clips, len(every), alone.select_feet(every))[0])  # type: ignore[union-attr]
        turned = np.einsum("nij,nvj->nvi", build_rotation_matrices(crowd.orient), points * crowd.scale[:, None, None])
        world = turned + crowd.position[:, None]
        # Each foot that stands has a vertex of its shape within the shape's size of it, and no vertex of the body far below.
        for k in range(6):
            away = np.linalg.norm(world - crowd.feet.P[:, k, None], axis=2).min(axis=1)
            assert away[crowd.feet.is_on_ground[:, k] != 0].max() < 0.02 * stick_bodies.SIZE
        assert np.allclose(np.linalg.norm(normals, axis=2), 1, atol=1e-3)
        level = replace(crowd, feet=None)
        assert level.select_feet(every) is None


def test_some_agents_have_their_own_feet(cache: Cache) -> None:
    gallery = Gallery(cache)
    full_crowd = gallery.make_picture(16).crowds[0]
    named, others = gallery.make_picture(16, agents=frozenset([2 * SPECIES_PER_KEY, 5 * SPECIES_PER_KEY])).crowds
    assert full_crowd.feet is not None and named.feet is not None and others.feet is not None
    assert np.array_equal(named.feet.P, full_crowd.feet.P[[2, 5]]) and len(others.feet.P) == 6
