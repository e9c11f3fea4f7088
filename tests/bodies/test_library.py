"""Bodies of the library: closed, textured, bound to joints; their legs, gaits and clips."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from antdsl import resources
from antdsl.bodies.agents.definition import Definition, SkinShape
from antdsl.bodies.agents.deformers import DEFORMER_BY_NAME
from antdsl.bodies.agents.machine_clips import MachineClips
from antdsl.bodies.files.definition_checks import LocatedDefinition, check_definition
from antdsl.bodies.library import load_library_body
from antdsl.bodies.posed_body import PosedBody
from antdsl.diagnostics import Report
from antdsl.scene.library_bodies import BODY_WORDS

ANTS = ("ant", "ant_queen", "ant_soldier")
ANT_CLIPS = ("antennate", "carry", "die", "dig", "drop", "groom", "idle", "look", "run", "take", "walk")


def shapes(word: str) -> list[SkinShape]:
    return list(load_library_body(word).shapes.values())


def open_edges(shape: SkinShape) -> int:
    """Edges of a shape that are not run along once in either direction, points at one place being one."""
    _, of = np.unique(shape.points, axis=0, return_inverse=True)
    corners = of.reshape(-1)[shape.faces]
    assert (corners != corners[:, [1, 2, 0]]).all()  # no triangle without area
    edges = np.concatenate([corners[:, [k, (k + 1) % 3]] for k in range(3)])
    ahead, counts = np.unique(edges, axis=0, return_counts=True)
    back = np.unique(edges[:, ::-1], axis=0)
    return int((counts > 1).sum()) + len({*map(tuple, ahead)} ^ {*map(tuple, back)})


@pytest.mark.parametrize("word", sorted(BODY_WORDS))
def test_shapes_are_closed_textured_and_follow_joints(word: str) -> None:
    body = load_library_body(word)
    report = Report()
    assert check_definition(LocatedDefinition(body), report) is not None and not report.sort_by_place(), str(report)
    for shape in shapes(word):
        assert open_edges(shape) == 0, shape.name
        corners = shape.points[shape.faces].astype(np.float64)
        assert np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) > 0  # seen from outside
        assert shape.normals is not None and np.allclose(np.linalg.norm(shape.normals, axis=1), 1, atol=1e-5)
        assert shape.uvs is not None and shape.uvs.min() >= 0 and shape.uvs.max() <= 1
        if any(binding.shape == shape.name for layer in body.layers.values() for binding in layer.deforming):
            assert shape.capture is not None and np.allclose(shape.capture.weights.sum(axis=1), 1)
        assert shape.material is not None and set(shape.materials) <= {*body.materials, "state"}
    drawn = body.shapes[next(iter((*body.layers["body"].static, *body.layers["body"].deforming))).shape]
    assert "state" in drawn.materials  # an agent's state is seen


@pytest.mark.parametrize("word", ANTS)
def test_ants_have_few_triangles_in_crowds_and_many_from_near(word: str) -> None:
    body = load_library_body(word)
    counts = {layer.name: sum(len(body.shapes[b.shape].faces) for b in layer.deforming) for layer in body.layers.values()}
    assert counts["body"] < 500 and 15_000 < counts["close"] < 25_000 and counts["load"] < 200
    assert {b.deformer for layer in body.layers.values() for b in layer.deforming} <= set(DEFORMER_BY_NAME)


def test_castes_have_the_same_joints_and_clips_and_other_proportions() -> None:
    worker, queen, soldier = (load_library_body(word) for word in ANTS)
    assert worker.rig.names == soldier.rig.names == queen.rig.names
    assert list(worker.clips) == list(soldier.clips) == list(queen.clips)
    wide = {b.name: b.shapes[b.name.replace(b.name, "ant")].points for b in (worker, queen, soldier)}

    def across(points: np.ndarray, ahead: bool) -> float:
        part = points[points[:, 0] > 0.28] if ahead else points[points[:, 0] < -0.2]
        return float(np.ptp(part[np.abs(part[:, 2]) < 0.2][:, 1]))

    assert across(wide["ant_soldier"], True) > across(wide["ant"], True) * 1.1
    assert wide["ant_queen"][:, 0].min() < wide["ant"][:, 0].min() - 0.1


@pytest.mark.parametrize("word", sorted(BODY_WORDS))
def test_clips_are_whole(word: str) -> None:
    body = load_library_body(word)
    assert not body.clips or body.idle in body.clips
    for clip in body.clips.values():
        moved = np.concatenate([clip.rotation.reshape(clip.sample_count, -1), clip.translation.reshape(clip.sample_count, -1)], 1)
        assert np.isfinite(moved).all() and np.allclose(np.linalg.norm(clip.rotation, axis=-1), 1, atol=1e-5)
        assert not clip.loop or (moved[0] == moved[-1]).all(), clip.name
        # Nothing jumps from one sample to the next.
        assert np.abs(np.diff(clip.rotation, axis=0)).max() < 0.45, clip.name
        assert np.abs(np.diff(clip.translation, axis=0)).max() < 0.06, clip.name
        assert all(0 <= at <= clip.duration for at in clip.marks.values())


def test_every_joint_of_the_ant_is_moved_by_a_clip_and_moves_points() -> None:
    ant = load_library_body("ant")
    moved = {name for clip in ant.clips.values() for name in clip.joints}
    feet = {leg.foot for leg in ant.legs}
    assert set(ant.rig.names) - moved == {"root", "load", *(f"coxa_{leg.name}" for leg in ant.legs)} | feet
    capture = ant.shapes["ant_close"].capture
    assert capture is not None
    followed = {capture.names[k] for k in np.unique(capture.joints[capture.weights > 0])}
    assert set(ant.rig.names) - followed == {"root", "load"} | feet
    assert set(ANT_CLIPS) <= set(ant.clips) and {name for name in ant.clips if not ant.clips[name].feet} == {
        "groom",
        "die",
        "dig",
    }


def test_every_body_has_its_files_and_nothing_else_is_there() -> None:
    files = {path.name for path in resources.body_file("bodies.json").parent.iterdir()}
    assert files == {"bodies.json", *(f"{word}.{kind}" for word in BODY_WORDS for kind in ("json", "glb"))}


def feet_in(body: Definition, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Where the feet are over a clip [samples, legs, 3], and how far the body has gone."""
    from antdsl.bodies.agents.blending import ClipBlendTree, ClipPlayback, blend_poses
    from antdsl.bodies.agents.poses import build_clip_table

    table = build_clip_table(replace(body, shapes={}, layers={}))
    clip = body.clips[name]
    times = np.linspace(0, clip.duration, clip.sample_count)[:, None]
    clips, ones = np.full((clip.sample_count, 1), table.find_clip(name), np.int32), np.ones((clip.sample_count, 1), np.float32)
    world = blend_poses(
        table, body.groups, ClipPlayback.make_with_shared_tree(ClipBlendTree.build_flat(1), clips, times, ones)
    ).world_transforms
    feet = [body.rig.find_joint(leg.foot) for leg in body.legs]
    return world[:, feet][..., 3], clip.stride * np.linspace(0, 1, clip.sample_count)


@pytest.mark.parametrize("word", [word for word in sorted(BODY_WORDS) if word not in ("arrow", "ball")])
def test_feet_on_the_ground_stay_where_they_are(word: str) -> None:
    body = load_library_body(word)
    for name, clip in body.clips.items():
        if clip.stride:
            feet, distances = feet_in(body, name)
            assert feet[:, :, 1].min() > -0.02
            down = (feet[:-1, :, 1] < 3e-6) & (feet[1:, :, 1] < 3e-6)
            slid = np.abs(np.diff(feet[:, :, 0] + distances[:, None], axis=0))
            assert down.mean() > 0.15 and slid[down].max() < 1e-4, name


@pytest.mark.parametrize(
    ("word", "names", "least"),
    [
        ("ant", ("idle", "walk", "run", "carry", "take", "drop", "look", "die"), -0.03),
        ("ant_queen", ("idle", "walk", "run", "carry", "look", "groom"), -0.01),
        ("ant_soldier", ("take", "drop", "die"), -0.05),
        ("person", ("idle", "walk", "run", "die"), -0.04),
    ],
)
def test_bodies_stay_above_the_ground_in_their_clips(word: str, names: tuple[str, ...], least: float) -> None:
    for name in names:
        assert lowest(load_library_body(word), name) > least, name


def lowest(body: Definition, clip: str) -> float:
    """The lowest height of a body over 25 moments of a clip, in body lengths."""
    plays = np.linspace(0, 0.999, 25, dtype=np.float32)
    ones, none = np.ones(25, np.float32), np.zeros(25, np.float32)
    machine = MachineClips(np.zeros(25, np.int16), plays, ones, np.full(25, -1, np.int16), none, none, none)
    points, _ = PosedBody(body, [(clip, "")]).pose_vertices((machine,), 25)
    return float(points[:, :, 1].min())


@pytest.mark.parametrize("word", [word for word in sorted(BODY_WORDS) if load_library_body(word).legs])
def test_gaits_can_be_walked(word: str) -> None:
    body = load_library_body(word)
    rest = {name: body.rig.rest_matrices[body.rig.find_joint(name), :3, 3] for name in body.rig.names}
    for leg in body.legs:
        chain, at = [], leg.foot
        while at != leg.upper:
            chain.append(float(np.linalg.norm(rest[at])))
            at = body.rig.names[body.rig.parents[body.rig.find_joint(at)]]
        assert sum(chain) > 0
    for slow, fast in zip(body.gaits, body.gaits[1:], strict=False):
        assert slow.speed < fast.speed and slow.stride < fast.stride and slow.duty >= fast.duty
        assert slow.stride / slow.speed > fast.stride / fast.speed  # faster legs
    assert body.gaits and all(len(gait.phases) == len(body.legs) for gait in body.gaits)
    fastest = body.gaits[-1]
    assert fastest.speed / fastest.stride <= 8  # a second: three frames a cycle at 24 a second, so none goes backwards
