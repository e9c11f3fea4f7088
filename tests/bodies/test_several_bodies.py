"""Species with several bodies: each agent has one by weight and id, for its size, clips, feet, pictures and exports."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import run
from compilers import need_llvmlite

from antdsl.bodies.library import load_library_body
from antdsl.outputs.cache.cache_reader import open_cache
from antdsl.outputs.exports.poses_export import export_poses
from antdsl.outputs.gallery import Gallery
from antdsl.pipeline import Shot, check_path, open_scene
from antdsl.preview.agent_columns import make_reduced_frame
from antdsl.preview.viewing.action_arrays import collect_actions, make_action_arrays
from antdsl.preview.viewing.body_packets import collect_outfits
from antdsl.runtime import Options, World, bind, feet_hash, restore_checkpoint, state_hash, step, take_checkpoint
from antdsl.runtime.clip_values import read_clip_value
from antdsl.runtime.moving.contacts.capsules import CapsuleCrowd
from antdsl.scene.crowds.body_choice import choose_body_numbers
from antdsl.scene.library_bodies import CAPSULE_BY_BODY

HILL = Path(__file__).parents[2] / "examples" / "walker" / "hill.ply"
MIXED = "{person: 3, hunter: 1, roach: 1}"
WORDS, WEIGHTS = ("person", "hunter", "roach"), (3.0, 1.0, 1.0)
PROGRAM = """ant 1
use steering
world { surface hill }
species walker {
  size 0.5 m
  max_speed 1.5 m/s
  start stroll
  state stroll {
    steer wander(pace: 0.6)
    play walk
    when chance 40 %/s -> run over 0.3 s
    when chance 20 %/s -> rest { spawn walker }
  }
  state rest { steer halt(); play idle }
  state run { steer wander(); play run; when after 1 s -> stroll over 0.3 s }
  layers { state }
}
"""


def written(folder: Path, body: str = MIXED, *, lines: int = 1, program: str = PROGRAM) -> Path:
    shutil.copy(HILL, folder / "hill.ply")
    (folder / "walker.ant").write_text(program, encoding="utf-8")
    line = f"  - {{species: walker, from: walker.ant, count: 40, body: {body}, place: {{on: hill, radius: 6 m}}}}\n"
    scene = folder / "scene.yaml"
    head = "antdsl: 1\nunits: m\nframes: 1..6\ncontacts: soft\nseed: 4\nworld: {hill: {mesh: hill.ply}}\ncrowd:\n"
    scene.write_text(head + line * lines, encoding="utf-8")
    return scene


def opened(folder: Path, body: str = MIXED) -> Shot:
    shot, report = open_scene(written(folder, body))
    assert shot is not None and not report.errors, str(report)
    return shot


def stepped(shot: Shot, steps: int = 12, **options: object) -> World:
    world = bind(shot.plan, shot.setting, replace(Options(backend="numpy", feet=True), **options))  # type: ignore[arg-type]
    for _ in range(steps):
        step(world)
    return world


def test_bodies_are_drawn_by_weight_and_id_alone() -> None:
    ids = np.arange(20_000, dtype=np.int64)
    numbers = choose_body_numbers(WEIGHTS, 7, "walker", ids)
    assert np.bincount(numbers) / len(ids) == pytest.approx([0.6, 0.2, 0.2], abs=0.01)
    subset = np.random.default_rng(0).permutation(ids)[:50]
    assert (choose_body_numbers(WEIGHTS, 7, "walker", subset) == numbers[subset]).all()
    assert (choose_body_numbers(WEIGHTS, 8, "walker", ids) != numbers).any()
    assert not choose_body_numbers((1.0,), 7, "walker", ids).any() and not len(choose_body_numbers(WEIGHTS, 7, "walker", ids[:0]))


def test_one_body_in_a_mapping_is_that_body(tmp_path: Path) -> None:
    for name in ("word", "mapping"):
        (tmp_path / name).mkdir()
    worlds = [stepped(opened(tmp_path / name, body)) for name, body in (("word", "person"), ("mapping", "{person: 2}"))]
    assert state_hash(worlds[0]) == state_hash(worlds[1])
    assert feet_hash(worlds[0].feet) == feet_hash(worlds[1].feet) != ""
    assert worlds[1].feet.keys() == {"walker"}


def test_a_run_is_the_same_for_any_rows_threads_and_chunks(tmp_path: Path) -> None:
    shot = opened(tmp_path)
    world = stepped(shot)
    assert world.populations["walker"].next_id > 40  # some were born
    for options in ({"shuffle_rows": 3}, {"threads": 2, "chunk": 16}):
        other = stepped(shot, **options)
        assert state_hash(other) == state_hash(world) and feet_hash(other.feet) == feet_hash(world.feet)


def test_a_run_is_the_same_in_machine_code(tmp_path: Path) -> None:
    need_llvmlite()
    shot = opened(tmp_path)
    native = stepped(shot, backend="native", wait_for_code=True)
    assert state_hash(native) == state_hash(stepped(shot))


def test_each_body_has_its_own_size_clips_and_feet(tmp_path: Path) -> None:
    world = stepped(opened(tmp_path), 2)
    walkers = world.populations["walker"]
    numbers = choose_body_numbers(WEIGHTS, 4, "walker", walkers.ids)
    assert set(numbers.tolist()) == {0, 1, 2}
    crowd, size = CapsuleCrowd(world), walkers.now["size"].astype(np.float64)
    assert crowd.radius == pytest.approx(size * np.array([CAPSULE_BY_BODY[word].width / 2 for word in WORDS])[numbers])
    walk = [clip.clip if hasattr(clip, "clip") else clip.name for clip in walkers.plan.clips].index("walk")
    strides = read_clip_value(world, walkers, "stride", np.full(len(walkers), walk))
    own = [load_library_body(word) for word in WORDS]
    assert strides == pytest.approx(np.array([body.clips["walk"].stride / body.length for body in own])[numbers])
    for k, body in enumerate(own):
        feet = world.feet[f"walker#{k}"]
        assert feet.legs == len(body.legs) and set(feet.ids.tolist()) == set(walkers.ids[numbers == k].tolist())


def test_a_checkpoint_continues_with_the_same_feet(tmp_path: Path) -> None:
    shot = opened(tmp_path)
    world = stepped(shot, 4)
    arrays = take_checkpoint(world)
    other = bind(shot.plan, shot.setting, world.options)
    restore_checkpoint(other, arrays)
    for _ in range(3):
        step(world)
        step(other)
    assert state_hash(other) == state_hash(world) and feet_hash(other.feet) == feet_hash(world.feet)


def test_pictures_exports_and_pages_have_the_body_of_each_agent(tmp_path: Path) -> None:
    scene = written(tmp_path)
    assert run("run", str(scene), "--out", str(tmp_path / "cache"), "--quiet", cwd=tmp_path).returncode == 0
    cache = open_cache(tmp_path / "cache")
    gallery = Gallery(cache)
    picture = gallery.make_picture(6)
    name_by_id = {int(one): crowd.body.name for crowd in picture.crowds for one in crowd.ids.tolist()}  # type: ignore[union-attr]
    numbers = choose_body_numbers(WEIGHTS, 4, "walker", np.array(sorted(name_by_id), np.int64))
    assert [name_by_id[one] for one in sorted(name_by_id)] == [load_library_body(WORDS[k]).name for k in numbers]
    assert {crowd.body_key: crowd.feet.P.shape[1] for crowd in picture.crowds if crowd.feet} == {  # type: ignore[union-attr]
        f"walker#{k}": len(load_library_body(word).legs) for k, word in enumerate(WORDS)
    }
    export_poses(gallery, [5, 6], tmp_path / "poses.npz")
    with np.load(tmp_path / "poses.npz") as poses:
        counts = [len(poses[f"walker#{k}.id"]) for k in range(3)]
    assert sum(counts) == sum(len(gallery.make_picture(frame).crowds[k].position) for frame in (5, 6) for k in range(3))
    world = stepped(opened(tmp_path), 3)
    population = world.populations["walker"]
    light = make_reduced_frame(population)
    arrays = make_action_arrays(collect_actions(world, opened(tmp_path), population, light))
    assert arrays["walker/body"].tolist() == choose_body_numbers(WEIGHTS, 4, "walker", light["id"].astype(np.int64)).tolist()
    assert len(collect_outfits(world, opened(tmp_path), population)) == 3
    for k, word in enumerate(WORDS):
        assert arrays[f"walker#{k}/feet"].shape == (int((arrays["walker/body"] == k).sum()), len(load_library_body(word).legs), 3)


@pytest.mark.parametrize(
    ("body", "code", "at", "words"),
    [
        ("{person: 0, hunter: 1}", "wrong-value", "0", "not between"),
        ("{persn: 1, hunter: 1}", "wrong-value", "persn", "none of"),
        ("{person: 1, gone.glb: 1}", "no-such-file", "gone.glb", "gone.glb"),
        ("{person: 1, rabbit: 1}", "unknown-name", "rabbit", "no clip `walk`"),
        ("{}", "wrong-value", "{}", ""),
        ("{person: 1, person: 2}", "duplicate-key", "person", ""),
    ],
)  # fmt: skip
def test_a_mistake_is_reported_at_its_body(tmp_path: Path, body: str, code: str, at: str, words: str) -> None:
    report = check_path(written(tmp_path, body))[1]
    errors = [each for each in report.sort_by_place() if each.code == code]
    assert errors, str(report)
    assert errors[0].span.text.strip() == at and words in errors[0].message + (errors[0].help or "")


def test_all_lines_of_a_species_have_the_same_bodies(tmp_path: Path) -> None:
    scene = written(tmp_path, lines=2)
    assert not check_path(scene)[1].errors
    scene.write_text(scene.read_text("utf-8").replace("hunter: 1", "hunter: 2", 1), encoding="utf-8")
    (error,) = check_path(scene)[1].errors
    assert error.code == "wrong-value" and "hunter: 2" in (error.help or "")
