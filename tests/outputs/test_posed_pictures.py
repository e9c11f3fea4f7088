"""Bodies posed in pictures: of the cache alone, each frame alone, and where the agents are."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from antdsl.bodies.agents.definition import Binding, Layer
from antdsl.bodies.agents.deformers import deform_binding
from antdsl.bodies.agents.driving import PoseAdjustments
from antdsl.bodies.agents.machine_clips import MachineClips
from antdsl.bodies.agents.varied_bodies import VariationDraws
from antdsl.bodies.body import build_rotation_matrices
from antdsl.bodies.library import load_library_body
from antdsl.bodies.posed_body import PosedBody
from antdsl.outputs.agent_paths import match_agents
from antdsl.outputs.cache.cache_reader import Cache, open_cache
from antdsl.outputs.edits.frame_rows import SPECIES_PER_KEY
from antdsl.outputs.gallery import Gallery, PictureUnavailable
from antdsl.outputs.pictures.blur.shutter import Shutter
from antdsl.outputs.pictures.camera import make_view
from antdsl.outputs.pictures.model import Camera, Crowd
from antdsl.outputs.pictures.moving_bodies import make_actors
from antdsl.outputs.recording import begin_recording, record_frames
from antdsl.pipeline import RunChoices, open_scene
from antdsl.runtime import Options
from antdsl.scene.values import FrameRange

EXAMPLE = Path(__file__).parents[2] / "examples" / "walker"
FRAMES = 40


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Cache:
    """40 frames of the example, in a folder, with the scene removed afterwards."""
    folder = tmp_path_factory.mktemp("walker")
    for path in filter(Path.is_file, EXAMPLE.iterdir()):
        shutil.copy(path, folder / path.name)
    shot, report = open_scene(folder / "scene.yaml", RunChoices(frames=FrameRange(1, FRAMES)))
    assert shot is not None, str(report)
    for _ in record_frames(begin_recording(shot, folder / "out", Options(), resume=False, force=False)):
        pass
    for name in ("scene.yaml", "walker.json", "parts.glb"):
        (folder / name).unlink()
    return open_cache(folder / "out")


def crowd_at(cache: Cache, frame: int) -> Crowd:
    return Gallery(cache).make_picture(frame).crowds[0]


def vertices(crowd: Crowd) -> np.ndarray:
    assert crowd.body is not None
    return crowd.body.pose_vertices(crowd.machine_clips, len(crowd.position))[0]


def test_frames_say_what_each_machine_plays(cache: Cache) -> None:
    (species,) = cache.manifest.species
    assert [(clip.name, clip.on) for clip in species.clips] == [("walk", ""), ("run", ""), ("idle", ""), ("wave", "arms")]
    assert species.playing == ("legs", "arms") and species.definition == 0
    assert cache.manifest.bodies[0].name == "walker.json"
    arrays = cache.frame(FRAMES)
    assert arrays["clips.walker.legs.clip"].dtype == np.int16 and set(arrays["clips.walker.legs.clip"]) <= {0, 1, 2}
    assert set(arrays["clips.walker.arms.clip"]) == {-1, 3}
    size = sum(array.nbytes for name, array in arrays.items() if name.startswith("clips."))
    assert size == 2 * 24 * len(arrays["P"])  # bytes: an agent, a machine


def test_what_is_in_a_cache_says_the_body_and_the_clips(cache: Cache) -> None:
    from antdsl.cli.commands.info import describe_cache

    lines = describe_cache(cache)
    assert "clips        walker: walk, run, idle, wave on arms" in lines and "body         walker: walker.json" in lines


def test_a_picture_is_made_of_its_own_frame_alone(cache: Cache) -> None:
    gallery = Gallery(cache)
    for frame in range(1, FRAMES):
        gallery.make_picture(frame)
    assert np.array_equal(vertices(gallery.make_picture(FRAMES).crowds[0]), vertices(crowd_at(cache, FRAMES)))


def test_bodies_are_where_agents_are_and_look_where_they_head(cache: Cache) -> None:
    crowd = crowd_at(cache, FRAMES)
    above = make_view(Camera((0.0, 30.0, 30.0), (0.0, 0.0, 0.0)), 2560, 1440, (0.0, 1.0, 0.0))
    picture = replace(Gallery(cache).make_picture(FRAMES), items=())
    drawn_actors = make_actors(picture, Shutter(above, above, above))
    count = len(crowd.body.tint_weights) if crowd.body else 0
    assert len(drawn_actors.mesh.vertices) == count * len(crowd.position) and len(drawn_actors.rays) == 1
    turn = build_rotation_matrices(crowd.orient)
    own = np.einsum("nji,nvj->nvi", turn, drawn_actors.mesh.vertices.reshape(-1, count, 3) - crowd.position[:, None])
    own /= crowd.scale[:, None, None]  # x ahead, y up, in body lengths, which are heights here
    assert own[:, :, 1].max(axis=1).min() > 0.9 and own[:, :, 1].max() < 1.15  # a hand that waves is higher
    assert own[:, :, 1].min() > -0.03 and own[:, :, 1].min(axis=1).max() < 0.04  # a runner is off the ground at times
    top = own[np.arange(len(own)), own[:, :, 1].argmax(axis=1)]
    assert np.median(np.abs(top[:, 2])) < 0.05 and np.abs(own[:, :, 2]).max() < 0.3
    feet = np.where(own[:, :, 1] < 0.08, own[:, :, 0], 0)
    assert (feet.max(axis=1) > 0.05).mean() > 0.9  # toes point ahead; of one who runs the only foot on the ground may be behind
    normals = drawn_actors.mesh.normal.reshape(-1, 3)
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1, abs=1e-3)


def test_the_frame_after_is_that_of_the_same_agents(cache: Cache) -> None:
    now, then = (
        Gallery(cache, has_motion_blur=True).make_picture(FRAMES - 1).crowds[0],
        Gallery(cache).make_picture(FRAMES).crowds[0],
    )
    assert now.next_crowd is not None and np.array_equal(now.ids, then.ids)
    assert np.array_equal(now.next_crowd.position, then.position) and np.array_equal(now.next_crowd.orient, then.orient)
    assert np.array_equal(vertices(replace(now.next_crowd, body=then.body)), vertices(then)) and not np.array_equal(
        vertices(now), vertices(then)
    )
    assert Gallery(cache, has_motion_blur=True).make_picture(FRAMES).crowds[0].next_crowd is None  # the last has none
    few = Gallery(cache, has_motion_blur=True).make_picture(FRAMES - 1, agents=frozenset([3 * SPECIES_PER_KEY])).crowds[0]
    assert few.next_crowd is not None and np.array_equal(few.next_crowd.position, then.position[np.asarray(then.ids) == 3])


def test_clips_move_bodies_and_only_their_group(cache: Cache) -> None:
    crowd = crowd_at(cache, FRAMES)
    assert crowd.body is not None
    legs, arms = crowd.machine_clips
    waving = (arms.clip == 3) & (arms.turns > 0.3) & (arms.turns < 0.7)
    assert waving.any()
    with_arms, without = (crowd.body.pose_vertices(plays, len(legs.clip))[0] for plays in ((legs, arms), (legs,)))
    moved = np.abs(with_arms - without).max(axis=2) > 1e-3
    assert moved[waving].any(axis=1).all() and not moved[(arms.clip == -1) & (arms.fade == 0)].any()
    assert not moved[:, crowd.body.material_colours[:, 0] == np.float32(0.06)].any()  # trousers
    assert with_arms[waving][..., 1].max() > 1.0  # a hand above the head


def test_materials_have_their_colour_and_the_state_the_rest(cache: Cache) -> None:
    crowd = crowd_at(cache, FRAMES)
    assert crowd.body is not None
    own = {tuple(round(float(x), 2) for x in colour) for colour in crowd.body.material_colours[crowd.body.tint_weights == 0]}
    assert own == {(0.52, 0.30, 0.20), (0.06, 0.08, 0.13), (0.05, 0.03, 0.02)}
    assert 0.1 < crowd.body.tint_weights.mean() < 0.6


def test_small_bodies_have_fewer_triangles_and_the_same_pose(cache: Cache) -> None:
    crowd = crowd_at(cache, FRAMES)
    assert crowd.body is not None
    fine, rough = (
        body.pose_vertices(crowd.machine_clips, len(crowd.position))[0] for body in (crowd.body, crowd.body.coarse_body)
    )
    assert len(crowd.body.coarse_body.faces) < len(crowd.body.faces) / 3
    for k in range(3):
        for end in (np.min, np.max):
            assert np.abs(end(fine[:, :, k], axis=1) - end(rough[:, :, k], axis=1)).max() < 0.05
    far = make_view(Camera((0.0, 90.0, 90.0), (0.0, 0.0, 0.0)), 320, 180, (0.0, 1.0, 0.0))
    drawn_actors = make_actors(replace(Gallery(cache).make_picture(FRAMES), items=()), Shutter(far, far, far))
    assert len(drawn_actors.mesh.faces) == len(crowd.body.coarse_body.faces) * len(crowd.position)


def test_a_planted_foot_stays_as_the_body_goes_over_it() -> None:
    """The clips of the example: what is on the ground goes back as far as the body goes ahead."""
    from antdsl.bodies.agents.blending import ClipBlendTree, ClipPlayback, blend_poses
    from antdsl.bodies.agents.poses import build_clip_table
    from antdsl.bodies.files.reading import read_definition

    body, _ = read_definition(EXAMPLE / "walker.json")
    assert body is not None
    table, turns = build_clip_table(body), np.arange(49) / 48
    for name in ("walk", "run"):
        clip = body.clips[name]
        playing = ClipPlayback.make_with_shared_tree(
            ClipBlendTree.build_flat(1), np.full((49, 1), table.find_clip(name), np.int32), (turns * clip.duration)[:, None],
            np.ones((49, 1), np.float32),
        )  # fmt: skip
        world = blend_poses(table, body.groups, playing).world_transforms
        for foot in ("foot_l", "foot_r"):
            matrices = world[:, body.rig.find_joint(foot)].astype(np.float64)
            for spot in ((0.14, -0.06, 0.0, 1.0), (-0.07, -0.06, 0.0, 1.0)):  # toe and heel
                place = matrices @ np.array(spot)
                down = place[:, 1] < 0.0015
                assert place[:, 1].min() > -0.005 and down.sum() > 5
                ground = place[:, 0] + clip.stride * turns
                planted = down[3:] & down[2:-1] & down[1:-2] & down[:-3]  # without the samples about its coming and lifting
                assert planted.any() and np.abs(np.diff(ground))[1:-1][planted].max() < 0.006  # m; a step is 1.2


def test_a_body_that_was_changed_is_not_drawn(cache: Cache, tmp_path: Path) -> None:
    shutil.copytree(cache.folder, tmp_path / "out")
    path = tmp_path / "out" / "manifest.json"
    manifest = json.loads(path.read_text(encoding="utf-8"))
    manifest["bodies"][0]["digest"] = "0" * 32
    path.write_text(json.dumps(manifest), encoding="utf-8")
    with pytest.raises(PictureUnavailable, match="has changed since it was written"):
        crowd_at(open_cache(tmp_path / "out"), 1)


def test_a_cache_without_stored_bodies_is_drawn_with_the_default_body(cache: Cache, tmp_path: Path) -> None:
    shutil.copytree(cache.folder, tmp_path / "out")
    path = tmp_path / "out" / "manifest.json"
    manifest = json.loads(path.read_text(encoding="utf-8"))
    del manifest["bodies"]
    for key in ("definition", "clips", "playing"):
        del manifest["species"][0][key]
    path.write_text(json.dumps(manifest), encoding="utf-8")
    crowd = crowd_at(open_cache(tmp_path / "out"), 1)
    assert crowd.body is not None and crowd.body.name == "ant"


def test_bodies_that_differ_by_id_are_followed_into_the_frame_after() -> None:
    ids = np.array([4, 9, 2])
    upright = np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))
    now, later = (
        Crowd(
            "ant",
            at,
            upright,
            np.ones(3),
            np.ones((3, 3)),
            agent_ids,
            driven_pose=PoseAdjustments(variation_draws=VariationDraws(agent_ids, 5, "ant")),
        )
        for at, agent_ids in ((np.zeros((3, 3)), ids), (np.arange(9.0).reshape(3, 3), ids[::-1]))
    )
    next_crowd = match_agents(now, later)
    draws = next_crowd.driven_pose.variation_draws
    assert draws is not None and (draws.seed, draws.species) == (5, "ant") and np.array_equal(draws.ids, ids)
    assert np.array_equal(next_crowd.position, later.position[::-1])


@pytest.mark.parametrize("deformer", ["linearskinning", "dualquatskinning"])
def test_pictures_draw_by_the_deformer_that_a_layer_names(deformer: str) -> None:
    rabbit, count = load_library_body("rabbit"), 9
    binding = Binding("", "rabbit", deformer=deformer)
    body = PosedBody(replace(rabbit, layers={"body": Layer("body", deforming=(binding,))}), [("look", "")])
    share, ones, none = np.linspace(0, 0.9, count, dtype=np.float32), np.ones(count, np.float32), np.zeros(count, np.float32)
    plays = (MachineClips(np.zeros(count, np.int16), share, ones, np.full(count, -1, np.int16), none, none, none),)
    turned = np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))
    crowd = Crowd("rabbit", np.zeros((count, 3)), turned, np.ones(count), np.ones((count, 3)), body=body, machine_clips=plays)
    drawn = crowd.pose_vertices(body, np.arange(count))[0]
    named, other = (
        deform_binding(rabbit, replace(binding, deformer=name), crowd.compute_poses()).points
        for name in (deformer, "dualquatskinning" if deformer == "linearskinning" else "linearskinning")
    )
    assert np.abs(named - other).max() > 1e-3
    nearest = cKDTree(named[4]).query(drawn[4])[0].max()
    assert nearest < 1e-5 < cKDTree(other[4]).query(drawn[4])[0].max()
