"""Poses: clips at times of each agent's own, the transforms that follow, and how matrices are put together and taken apart."""

from __future__ import annotations

import numpy as np
import pytest
from rigs import definition, matrix, still, turn, wild

from antdsl.bodies.agents import affine, blending
from antdsl.bodies.agents.blending import ClipBlendTree, ClipPlayback, blend_poses
from antdsl.bodies.agents.definition import Channel, Clip, Definition, Rig
from antdsl.bodies.agents.poses import (
    WorldPoses,
    build_clip_table,
    sample_poses,
    to_local_transforms,
    to_square_matrices,
    to_world_transforms,
)


def alone(definition: Definition, clips: list[int], times: list[float]) -> WorldPoses:
    """Each agent with its own clip."""
    table = build_clip_table(definition)
    playing = ClipPlayback.make_with_shared_tree(
        ClipBlendTree.build_flat(1),
        np.array(clips, np.int32)[:, None],
        np.array(times)[:, None],
        np.ones((len(clips), 1), np.float32),
    )
    return blend_poses(table, definition.groups, playing, needs_local=True)


def swing(loop: bool = True) -> Definition:
    """An arm with a shoulder that turns by 0, 90 and 180 degrees in a second, with the elbow 2 away along x; a jaw opens by
    then."""
    rotation = np.array([[turn("z", 0)], [turn("z", 90)], [turn("z", 180)]], np.float32)
    clip = Clip("swing", 2.0, ("shoulder",), np.zeros((3, 1, 3), np.float32), rotation, np.ones((3, 1, 3), np.float32),
                channels=("jaw",), values=np.array([[0], [1], [4]], np.float32), loop=loop)  # fmt: skip
    return definition(
        {"shoulder": "", "elbow": "shoulder"}, clip, rest={"elbow": matrix((2, 0, 0))},
        channels=(Channel("jaw", 0.5), Channel("brow", 0.75)),
    )  # fmt: skip


def test_clips_are_sampled_at_a_time_of_each_agent() -> None:
    poses = alone(swing(), [0, 0, 0, -1], [0.0, 0.25, 0.75, 0.75])
    half = np.sqrt(0.5) * 2
    assert np.allclose(poses.world_transforms[:, 1, :, 3], [[2, 0, 0], [half, half, 0], [-half, half, 0], [2, 0, 0]], atol=1e-6)
    assert np.allclose(poses.channels, [[0, 0.75], [0.5, 0.75], [2.5, 0.75], [0.5, 0.75]])
    assert poses.local_transforms is not None and np.allclose(poses.local_transforms[:, 1, :, 3], [2, 0, 0])


def test_clips_that_loop_begin_again_and_others_hold_their_ends() -> None:
    at = [1.25, -0.75, 7.25, 1.0, np.nan]
    round_again = alone(swing(), [0] * 5, at).channels[:, 0]
    assert round_again.tolist() == [0.5, 0.5, 0.5, 0.0, 0.0]
    assert alone(swing(loop=False), [0] * 5, at).channels[:, 0].tolist() == [4, 0, 4, 4, 0]


def test_a_clip_of_one_sample_and_a_rig_without_joints_are_sampled_too() -> None:
    one = definition({"a": ""}, still("up", {"a": {"t": (0, 3, 0)}}))
    assert alone(one, [0, 0], [0.0, 9.0]).world_transforms[:, 0, 1, 3].tolist() == [3, 3]
    bare = Definition("bare", Rig((), np.zeros(0, np.int32), np.zeros((0, 4, 4))))
    assert alone(bare, [-1], [0.0]).world_transforms.shape == (1, 0, 3, 4)


def test_numbers_of_no_clip_are_refused() -> None:
    for number in (1, -2):
        with pytest.raises(IndexError, match="numbered from 0 to 0"):
            alone(swing(), [number], [0.0])


@pytest.mark.parametrize("far, most", [(10.0, 0.0013), (90.0, 0.93)])
def test_rotations_go_the_shorter_way_and_near_to_slerp(far: float, most: float) -> None:
    """By the angles that the docstring tells; the second sample is given by its other sign, which is the same rotation."""
    rotation = np.array([[turn("y", 5)], [[-k for k in turn("y", 5 + far)]]], np.float32)
    clip = Clip("c", 1.0, ("a",), np.zeros((2, 1, 3), np.float32), rotation, np.ones((2, 1, 3), np.float32))
    times = np.linspace(0, 0.999, 500)
    pose = sample_poses(build_clip_table(definition({"a": ""}, clip)), np.zeros(500, np.int32), times)
    angles = np.degrees(2 * np.arctan2(pose.rotation[1, 0].astype(np.float64), pose.rotation[3, 0].astype(np.float64)))
    worst = np.abs(angles - (5 + far * times)).max()
    assert most / 2 < worst < most


def test_a_joint_that_a_clip_lacks_has_its_rest_pose_and_a_channel_its_default() -> None:
    rest = matrix((1, 2, 3), turn("x", 40), (1, 2, 0.5), (0.1, 0.2, 0.3))
    poses = alone(definition({"a": "", "b": "a"}, still("c", {"a": {}, "unknown": {}}), rest={"b": rest}), [0, -1], [0.0, 0.0])
    assert poses.local_transforms is not None and np.allclose(poses.local_transforms[:, 1], rest[:3], atol=1e-6)
    assert alone(swing(), [0], [0.5]).channels[0, 1] == 0.75


def test_a_clip_that_tells_of_a_joint_and_of_no_shears_says_that_it_has_none() -> None:
    rest = matrix((1, 2, 3), turn("x", 40), (1, 2, 0.5), (0.1, 0.2, 0.3))
    poses = alone(definition({"a": ""}, still("c", {"a": {"s": (3, 1, 1)}}), rest={"a": rest}), [0, -1], [0.0, 0.0])
    assert np.allclose(poses.world_transforms[0, 0, :, :3], np.diag([3, 1, 1]), atol=1e-6)
    assert np.allclose(poses.world_transforms[1, 0], rest[:3], atol=1e-6)


def test_local_transforms_are_scaled_then_sheared_then_turned_then_moved() -> None:
    parts = {"t": (1, 2, 3), "r": turn("y", 70), "s": (2, 3, -4), "h": (0.5, -0.25, 0.75)}
    poses = alone(definition({"a": ""}, still("c", {"a": parts})), [0], [0.0])
    assert np.allclose(poses.world_transforms[0, 0], matrix(parts["t"], parts["r"], parts["s"], parts["h"])[:3], atol=1e-5)
    hand = alone(definition({"a": ""}, still("c", {"a": {"s": (1, 2, 1), "h": (0.5, 0, 0), "r": turn("z", 90)}})), [0], [0.0])
    assert np.allclose(hand.world_transforms[0, 0] @ [0, 1, 0, 1], [-2, 1, 0])  # y doubled, x grown by half of it, a quarter turn


def test_matrices_are_taken_apart_and_put_together_again() -> None:
    random = np.random.default_rng(3)
    any_of_them = [random.normal(size=(3, 4)) for _ in range(300)]
    flat = [np.diag([0.0, 0, 0, 1])[:3], np.diag([1.0, 0, 2, 1])[:3], np.array([[1.0, 2, 0, 0], [1, 2, 0, 0], [1, 2, 0, 5]])]
    mirror = [np.diag([1.0, -1, 1, 1])[:3], np.diag([-1.0, -1, -1, 1])[:3]]
    matrices = np.concatenate([np.stack(any_of_them + flat + mirror), np.tile([[[0, 0, 0, 1.0]]], (305, 1, 1))], 1)
    t, r, s, h = affine.decompose_matrices(matrices)
    back = affine.compose_matrices(t, r, s, h, np.empty((3, 4, 305)))
    assert np.allclose(np.moveaxis(back, -1, 0), matrices[:, :3], atol=1e-5)
    assert np.allclose(np.moveaxis(back, -1, 0)[:300], matrices[:300, :3], atol=1e-9)
    assert np.allclose((r * r).sum(axis=0), 1)


def test_the_nearest_rotation_is_that_of_the_polar_decomposition() -> None:
    random = np.random.default_rng(4)
    turns = [matrix(rotation=q)[:3, :3] for q in random.normal(size=(6, 4))]
    flat = [turns[k] @ np.diag(s) @ turns[k + 3] for k, s in enumerate(([1, 1, 1e-9], [1e5, 1, 1e-5], [1, 1e-7, -1e-7]))]
    matrices = np.stack(
        [*random.normal(size=(200, 3, 3)), np.diag([1000.0, 1, 1]), np.diag([1e-6, 2e-6, 1e-6]), np.eye(3) * 1e9, *flat]
    )
    rotations = np.moveaxis(affine.extract_rotation_matrices(np.moveaxis(matrices, 0, -1)), -1, 0)
    for m, r in zip(matrices, rotations, strict=True):
        u, _, v = np.linalg.svd(m)
        assert np.allclose(r, u @ v * np.sign(np.linalg.det(m)), atol=1e-5)
    turned = np.stack(
        [matrix(rotation=q)[:3, :3] for q in random.normal(size=(100, 4))] + [np.diag([1.0, -1, -1]), np.diag([-1.0, -1, 1])]
    )
    q = affine.matrices_to_quaternions(np.moveaxis(turned, 0, -1))
    assert np.allclose([matrix(rotation=each)[:3, :3] for each in q.T], turned)


def test_world_transforms_are_those_of_an_independent_implementation() -> None:
    skel = pytest.importorskip("pxr.UsdSkel")
    gf = pytest.importorskip("pxr.Gf")
    vt = pytest.importorskip("pxr.Vt")
    body = wild(23, 5, sheared=True)
    poses = alone(body, [0, 1, 0, -1], [0.1, 0.2, 0.33, 0.0])
    topology = skel.Topology(vt.IntArray(body.rig.parents.tolist()))
    assert poses.local_transforms is not None
    for local, world in zip(poses.local_transforms, poses.world_transforms, strict=True):
        full = [gf.Matrix4d(np.vstack([each, [0, 0, 0, 1]]).T.tolist()) for each in local.astype(np.float64)]
        theirs = vt.Matrix4dArray(len(full))
        assert skel.ConcatJointTransforms(topology, vt.Matrix4dArray(full), theirs)
        expected = np.array([np.array(each).T[:3] for each in theirs])
        assert np.allclose(world, expected, atol=1e-5 * np.abs(expected).max())


def test_transforms_may_be_changed_by_hand_and_the_others_follow() -> None:
    """The shoulder is turned further; and what local transforms world ones stand for is found again."""
    body = wild(12, 8, sheared=True)
    table, poses = build_clip_table(body), alone(body, [0, 1, -1], [0.1, 0.2, 0.0])
    assert poses.local_transforms is not None
    assert to_world_transforms(table, poses.local_transforms).tobytes() == poses.world_transforms.tobytes()
    assert np.allclose(to_local_transforms(table, poses.world_transforms), poses.local_transforms, atol=1e-3)
    arm = swing()
    local = np.array(alone(arm, [0], [0.5]).local_transforms)
    local[0, 0] = matrix((0, 0, 1), turn("z", 180))[:3]
    assert np.allclose(to_world_transforms(build_clip_table(arm), local)[0, 1, :, 3], [-2, 0, 1], atol=1e-6)
    full = to_square_matrices(poses.world_transforms)
    assert full.shape == (3, 12, 4, 4) and full.flags.c_contiguous
    assert np.array_equal(full[..., :3, :], poses.world_transforms) and full[1, 1, 3].tolist() == [0, 0, 0, 1]


def test_order_of_agents_chunks_and_threads_change_no_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    body, random, n = wild(9, 6, sheared=True), np.random.default_rng(7), 700
    table = build_clip_table(body)
    trees = (ClipBlendTree.build_flat(2), ClipBlendTree((0, 1, 1), ("", "", ""), (1, 0), (-1, 0)))
    playing = ClipPlayback(
        trees, random.integers(0, 2, n).astype(np.int32), random.integers(-1, 2, (n, 3)).astype(np.int32),
        random.uniform(-1, 3, (n, 3)), random.uniform(-0.2, 1, (n, 3)).astype(np.float32), np.ones((n, 2), np.float32),
    )  # fmt: skip
    plain = blend_poses(table, {}, playing, needs_local=True)
    order = random.permutation(n)
    shuffled = ClipPlayback(
        trees, *(getattr(playing, name)[order] for name in ("tree_indices", "clips", "times", "weights", "layer_weights"))
    )
    monkeypatch.setattr(blending, "_JOINTS_PER_CHUNK", 9 * 64)
    monkeypatch.setattr("antdsl.numerics.parallel.MIN_AGENTS_PER_THREAD", 100)
    for other, at in (
        (blend_poses(table, {}, playing, needs_local=True, threads=3), slice(None)),
        (blend_poses(table, {}, shuffled, needs_local=True), order),
    ):
        assert plain.local_transforms is not None and other.local_transforms is not None
        assert plain.world_transforms[at].tobytes() == other.world_transforms.tobytes()
        assert plain.local_transforms[at].tobytes() == other.local_transforms.tobytes()
        assert plain.channels[at].tobytes() == other.channels.tobytes()
