"""Caches, pictures and checkpoints of periodic worlds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from periodic_scenes import FLOCK, HALF, open_world, read_vector, run, wrapped, write_points

from antdsl.numerics.periodic_box import PeriodicBox
from antdsl.outputs.cache.cache_reader import open_cache
from antdsl.outputs.gallery import Gallery
from antdsl.outputs.pictures import Camera, render_frame
from antdsl.outputs.pictures.model import Crowd
from antdsl.outputs.pictures.seam_images import add_seam_images
from antdsl.outputs.recording import begin_recording, record_frames
from antdsl.runtime import Options, bind, restore_checkpoint, state_hash, step
from antdsl.runtime.checkpoints import take_checkpoint

LARGE = FLOCK.replace("size 0.1 mm", "size 4 mm")


def record(folder: Path, crowd: str, program: str = LARGE) -> Gallery:
    """The pictures of a cache of three frames."""
    folder.mkdir(exist_ok=True)
    shot = open_world(folder, program, crowd, body="ball")
    shot = replace(shot, scene=shot.scene.replace_values(frames=shot.frames._replace(last=2)))
    for _ in record_frames(begin_recording(shot, folder / "out", Options(), resume=False, force=True)):
        pass
    return Gallery(open_cache(folder / "out"))


def test_frames_have_wrapped_and_unwrapped_positions(tmp_path: Path) -> None:
    gallery = record(tmp_path, "count: 50, place: {on: ground}", FLOCK)
    assert gallery.manifest.periodic_box == PeriodicBox((-HALF, 0.0, -HALF), (2 * HALF, 0.0, 2 * HALF))
    last = gallery.cache.frame(2)
    assert last["unwrapped"].shape == last["P"].shape == (50, 3)
    assert np.abs(last["P"]).max() <= HALF < np.abs(last["unwrapped"]).max()
    assert np.abs(wrapped(last["unwrapped"] - last["P"])).max() < 1e-5


def test_a_body_at_the_seam_is_drawn_on_both_sides(tmp_path: Path) -> None:
    """The picture of a ball at a corner of the box, moved by half a width in each direction, is that of a ball in the middle."""
    width, still = 400, LARGE.replace("max_speed 1 mm/step", "max_speed 0.001 mm/step")
    pictures = []
    for number, place in enumerate(([0.0, 0, 0], [HALF, 0, HALF])):
        gallery = record(tmp_path / str(number), write_points_of(tmp_path / str(number), place), still)
        camera = Camera((0.0, 1000.0, 0.0), (0.0, 0.0, 0.0), up=(0.0, 0.0, -1.0), focal=36.0 * 1000 / (2 * HALF))
        pictures.append(np.asarray(render_frame(gallery.make_picture(0), camera, width, width), np.float64)[..., :3])
    middle, corner = pictures
    moved = np.roll(corner, (width // 2, width // 2), (0, 1))
    across = np.stack(np.meshgrid(*[np.arange(width) - width / 2 + 0.5] * 2))
    ball = np.sqrt((across**2).sum(axis=0)) < 0.45 * 2 / (2 * HALF) * width  # its radius is 2 mm
    assert middle[ball].mean() > 1.2 * middle[:80].mean(), "the ball is bright and the ground is not"
    assert np.abs(moved - middle)[ball].mean() < 12, "the four quarters are the ball"


def write_points_of(folder: Path, place: list[float]) -> str:
    folder.mkdir(exist_ok=True)
    return write_points(folder, np.array([place]))


def test_images_continue_the_motion_of_their_agents() -> None:
    box = PeriodicBox((-HALF, 0.0, -HALF), (2 * HALF, 0.0, 2 * HALF))

    def crowd(*positions: tuple[float, float, float]) -> Crowd:
        n = len(positions)
        return Crowd("bird", np.array(positions), np.tile([0.0, 0, 0, 1], (n, 1)), np.ones(n), np.ones((n, 3)), np.arange(n))

    first = replace(crowd((7.5, 0, 0), (0, 0, 0)), next_crowd=crowd((-7.5, 0, 0), (1, 0, 0)))
    drawn = add_seam_images((first,), box)
    assert len(drawn) == 2 and add_seam_images((first,), None) == (first,)
    np.testing.assert_array_equal(drawn[0].next_crowd.position, [[8.5, 0, 0], [1, 0, 0]])  # type: ignore[union-attr]
    np.testing.assert_array_equal(drawn[1].position, [[-8.5, 0, 0]])
    np.testing.assert_array_equal(drawn[1].next_crowd.position, [[-7.5, 0, 0]])  # type: ignore[union-attr]


def test_a_restored_run_continues(tmp_path: Path) -> None:
    shot = open_world(tmp_path, FLOCK, "count: 40, place: {on: ground}")
    world = run(shot, 6)
    arrays = take_checkpoint(world)
    again = bind(shot.plan, shot.setting)
    restore_checkpoint(again, arrays)
    for each in (world, again):
        for _ in range(3):
            step(each)
    assert state_hash(world) == state_hash(again)
    np.testing.assert_array_equal(read_vector(world, "unwrapped"), read_vector(again, "unwrapped"))
