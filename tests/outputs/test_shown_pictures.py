"""What states and the scene show of bodies in pictures, from a cache alone: layers that are worn, channels, heads that turn."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from antdsl.bodies.agents.driving import PoseAdjustments
from antdsl.outputs.cache.cache_reader import Cache, open_cache
from antdsl.outputs.cache.cache_writer import read_checkpoint
from antdsl.outputs.gallery import Gallery
from antdsl.outputs.pictures.model import Crowd
from antdsl.outputs.recording import begin_recording, record_frames
from antdsl.pipeline import RunChoices, open_scene
from antdsl.runtime import Options, bind, restore_checkpoint, state_hash, step
from antdsl.scene.values import FrameRange

PROGRAM = """ant 1
use steering
world { surface ground; items food }
species bug {
  size 10 mm
  load = 0
  start empty
  state empty { steer wander(); look head(at: nearest(food)); when after 0.2 s -> full { load = 1 } }
  state full {
    steer wander()
    wear crumb when load > 0
    channel mouth_open = 0.5
    look head(at: nearest(food))
    when after 9 s -> empty
  }
  layers { state }
}
"""
SCENE = """antdsl: 1
units: mm
frames: 1..10
seed: 7
world:
  ground: {mesh: ground.obj}
  food:
    seed: {at: [0, 0, 300], radius: 2 mm}
crowd:
  - {species: bug, from: bug.ant, count: 90, body: bug.json, wear: [WEAR], place: {on: ground, radius: 200 mm, around: [0, 0, 0]}}
"""
BLOCK = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
OPEN = BLOCK.replace("v 0 1 0", "v 0 3 0")
BODY = {
    "antdsl_body": 1, "name": "bug", "front": "+x", "up": "+y", "units": "mm", "length": 10,
    "rig": {
        "rig_version": 1, "transforms": {"root": ["neck"], "neck": []},
        "channels": {"Mouth.Open": {"default_value": 0, "transform": ""}},
        "antdsl_rest": {"neck": [[1, 0, 0, 5], [0, 1, 0, 2], [0, 0, 1, 0], [0, 0, 0, 1]]},
    },
    "shapes": [
        {"file": "block.obj", "name": "trunk"}, {"file": "open.obj", "name": "wide"}, {"file": "block.obj", "name": "extra"},
        {"file": "block.obj", "name": "face", "blendshape_shapenames": ["wide"], "blendshape_channels": ["Mouth.Open"]},
    ],
    "layers": [
        {"version": 2, "name": "body", "static": [{"transform": "root", "shape": "trunk"}],
         "deforming": [{"transform": "neck", "shape": "face", "deformer": "blendshape"}]},
        *({"version": 2, "name": name, "static": [{"transform": at, "shape": "extra"}], "deforming": []}
          for name, at in (("hat", "neck"), ("Cap-1", "neck"), ("crumb", "root"))),
    ],
    "groups": [{"version": 2, "name": "head", "members": [{"name": "neck"}]}],
}  # fmt: skip


def folder_with(folder: Path, wear: str, program: str = PROGRAM) -> Path:
    (folder / "ground.obj").write_text("v -400 0 -400\nv 400 0 -400\nv 400 0 400\nv -400 0 400\nf 1 3 2\nf 1 4 3\n")
    for name, text in (("block.obj", BLOCK), ("open.obj", OPEN), ("bug.json", json.dumps(BODY)), ("bug.ant", program)):
        (folder / name).write_text(text, encoding="utf-8")
    (folder / "scene.yaml").write_text(SCENE.replace("WEAR", wear), encoding="utf-8")
    return folder / "scene.yaml"


def recorded(folder: Path, wear: str, options: Options | None = None) -> Cache:
    shot, report = open_scene(folder_with(folder, wear), RunChoices(frames=FrameRange(1, 10)))
    assert shot is not None and not report.sort_by_place(), str(report)
    for _ in record_frames(begin_recording(shot, folder / "out", options or Options(), resume=False, force=False)):
        pass
    return open_cache(folder / "out")


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Cache:
    return recorded(tmp_path_factory.mktemp("shown"), "{any: [hat, cap_1, none]}")


def ids(crowds: tuple[Crowd, ...]) -> list[list[int]]:
    return [sorted(crowd.ids.tolist()) if crowd.ids is not None else [] for crowd in crowds]


def test_the_scene_mixes_parts_by_id_and_seed(cache: Cache, tmp_path: Path) -> None:
    (species,) = cache.manifest.species
    assert species.wears == ("crumb", "hat", "cap_1")
    first, last = (cache.frame(frame)["wears.bug"] for frame in (1, 10))
    assert first.dtype == np.uint64 and set(first.tolist()) == {0, 2, 4} and (first & 6 == last & 6).all()
    assert np.bincount(first.astype(int), minlength=5)[[0, 2, 4]].min() > 15
    again = recorded(tmp_path, "{any: [hat, cap_1, none]}", Options(chunk=16, shuffle_rows=3))
    assert (again.frame(10)["wears.bug"] == last).all()


def test_who_wears_the_same_is_a_crowd_and_is_drawn_with_it(cache: Cache) -> None:
    crowds = Gallery(cache).make_picture(1).crowds
    assert len(crowds) == 3 and all(crowd.body is not None for crowd in crowds)
    mask = cache.frame(1)["wears.bug"]
    assert ids(crowds) == [np.flatnonzero(mask == worn).tolist() for worn in (0, 2, 4)]
    bare, hat, _ = crowds
    assert bare.body is not None and hat.body is not None
    assert len(hat.body.faces) == len(bare.body.faces) + 4 and hat.body.layers == ("hat",)
    points = hat.body.pose_vertices(hat.machine_clips, len(hat.position), driven_pose=hat.driven_pose)[0]
    without = bare.body.pose_vertices(hat.machine_clips, len(hat.position), driven_pose=hat.driven_pose)[0]
    assert np.array_equal(points[:, : without.shape[1]], without), "the same body, and a hat on it"


def test_a_state_shows_a_layer_and_a_channel_as_long_as_it_lasts(cache: Cache) -> None:
    early_frame, late_frame = cache.frame(3), cache.frame(9)
    assert not (early_frame["wears.bug"] & 1).any() and (late_frame["wears.bug"] & 1).all()
    assert np.isnan(early_frame["channels.bug.mouth_open"]).all() and (late_frame["channels.bug.mouth_open"] == 0.5).all()
    crowd = Gallery(cache).make_picture(9).crowds[0]
    assert crowd.body is not None and crowd.body.layers == ("crumb",)
    still = PoseAdjustments(look_directions=crowd.driven_pose.look_directions)
    opened, shut = (
        crowd.body.pose_vertices(crowd.machine_clips, len(crowd.position), driven_pose=each)[0]
        for each in (crowd.driven_pose, still)
    )
    moved = np.abs(opened - shut).max(axis=(0, 2)) > 1e-4
    assert moved.sum() == 1 and np.linalg.norm(opened - shut, axis=2).max() == pytest.approx(0.1, abs=1e-5)  # half of 2 mm of 10


def test_a_head_turns_with_all_that_is_on_it_and_nothing_else(cache: Cache) -> None:
    arrays = cache.frame(10)
    look = arrays["looks.bug.head"]
    assert look.shape == (90, 3) and np.linalg.norm(look, axis=1) == pytest.approx(1, abs=1e-5)
    crowd = Gallery(cache).make_picture(10).crowds[1]  # with a hat
    assert crowd.body is not None and crowd.ids is not None
    own = look[crowd.ids]
    turned, ahead = (
        crowd.body.pose_vertices(crowd.machine_clips, len(crowd.position), driven_pose=each)[0]
        for each in (crowd.driven_pose, PoseAdjustments(crowd.driven_pose.channels))
    )
    pivot = np.array([0.5, 0.2, 0.0], np.float32)
    still = np.abs(turned - ahead).max(axis=(0, 2)) < 1e-6
    assert 0 < still.sum() < len(still)
    nose = int(np.flatnonzero(np.abs(ahead[0] - pivot - [0.1, 0, 0]).max(axis=1) < 1e-5)[0])
    assert turned[:, nose] - pivot == pytest.approx(own * 0.1, abs=1e-5)
    assert own[:, 0].min() > 0.5 and own[:, 0].min() < 0.66, "60 degrees at most, and somebody looks that far aside"


def test_a_run_goes_on_from_a_checkpoint_with_what_is_shown(cache: Cache) -> None:
    folder = cache.folder.parent
    shot, _ = open_scene(folder / "scene.yaml", RunChoices(frames=FrameRange(1, 10)))
    assert shot is not None
    world = bind(shot.plan, shot.setting, Options())
    restore_checkpoint(world, read_checkpoint(cache, 1)[0])
    for _ in range(9):
        step(world)
    assert state_hash(world) == cache.lines()[10].hash


@pytest.mark.parametrize(
    ("wear", "program", "message", "help"),
    [
        ("het", PROGRAM, "the body of `bug` has no layer `het`",
         "did you mean `hat`? its layers are `body`, `hat`, `cap_1`, `crumb`"),
        ("{any: [hat, cat]}", PROGRAM, "the body of `bug` has no layer `cat`", "did you mean `hat`?"),
        ("hat", PROGRAM.replace("wear crumb", "wear load"), "`bug.json` has no layer `load`", "its layers are `body`"),
        ("hat", PROGRAM.replace("mouth_open", "mouth_op"), "`bug.json` has no channel `mouth_op`", "did you mean `mouth_open`?"),
        ("hat", PROGRAM.replace("look head", "look heed"), "`bug.json` has no transform group `heed`", "did you mean `head`?"),
    ],
)  # fmt: skip
def test_missing_parts_of_a_body_are_reported(wear: str, program: str, message: str, help: str, tmp_path: Path) -> None:
    shot, report = open_scene(folder_with(tmp_path, wear, program))
    assert shot is None and report.errors[0].message == message and help in (report.errors[0].help or "")


def test_a_body_of_the_library_is_checked_as_well(tmp_path: Path) -> None:
    scene = folder_with(tmp_path, "hat")
    scene.write_text(scene.read_text().replace("body: bug.json, ", ""))
    _, report = open_scene(scene)
    assert "the body of `bug` has no layer `hat`" in [each.message for each in report.errors]
