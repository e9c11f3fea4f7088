"""Layer trees of clips: cases worked by hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from rigs import definition, matrix, still, turn

from antdsl.bodies.agents.blending import ADDITIVE_BLEND_MODE, INTERPOLATE_BLEND_MODE, ClipBlendTree, ClipPlayback, blend_poses
from antdsl.bodies.agents.clip_lists import build_playback
from antdsl.bodies.agents.definition import Channel, Clip, TransformGroup
from antdsl.bodies.agents.poses import WorldPoses, build_clip_table

REST = matrix((0, 5, 0), turn("z", 0), (1, 1, 1))
BODY = definition(
    {"body": "", "arm": "body"},
    still("low", {"body": {"t": (0, 0, 0)}, "arm": {"t": (0, 0, 0), "s": (2, 2, 2)}}, {"jaw": 0.0}),
    still("high", {"body": {"t": (8, 0, 0)}, "arm": {"t": (8, 0, 0), "r": turn("z", 90)}}, {"jaw": 1.0, "brow": 1.0}),
    still("nod", {"arm": {"t": (0, 7, 0), "r": turn("x", 60)}}, {"jaw": 0.5}),
    rest={"arm": REST},
    channels=(Channel("jaw"), Channel("brow", 0.25)),
)
LOW, HIGH, NOD = 0, 1, 2
GROUPS = {
    "arm": TransformGroup("arm", (("arm", 1.0),)),
    "half": TransformGroup("half", (("arm", 0.5),), ("jaw",)),
    "body": TransformGroup("body", (("body", 1.0),)),
}


def one(tree: ClipBlendTree, clips: Sequence[int], weights: Sequence[float], layers: Sequence[float] | None = None) -> WorldPoses:
    """The pose of one agent."""
    playing = ClipPlayback.make_with_shared_tree(
        tree, np.array([clips], np.int32), np.zeros((1, len(clips))), np.array([weights], np.float32),
        None if layers is None else np.array([layers], np.float32),
    )  # fmt: skip
    return blend_poses(build_clip_table(BODY), GROUPS, playing, needs_local=True)


def place(poses: WorldPoses, joint: int) -> list[float]:
    assert poses.local_transforms is not None
    return [round(float(k), 5) for k in poses.local_transforms[0, joint, :, 3]]


def linear_part(poses: WorldPoses, joint: int) -> np.ndarray:
    assert poses.local_transforms is not None
    return poses.local_transforms[0, joint, :, :3]


def test_weights_are_normalised() -> None:
    poses = one(ClipBlendTree.build_flat(2), [LOW, HIGH], [1, 3])
    assert place(poses, 0) == [6, 0, 0]
    assert place(poses, 1) == [6, 0, 0]
    assert poses.channels[0].tolist() == [0.75, 0.8125]  # a clip without a channel counts with its default
    again = one(ClipBlendTree.build_flat(2), [LOW, HIGH], [10, 30])
    assert np.allclose(poses.world_transforms, again.world_transforms, atol=1e-6)


def test_half_of_a_quarter_turn_is_an_eighth_and_scales_are_linear() -> None:
    linear = linear_part(one(ClipBlendTree.build_flat(2), [LOW, HIGH], [1, 1]), 1)
    assert np.allclose(linear, matrix(rotation=turn("z", 45), scale=(1.5, 1.5, 1.5))[:3, :3], atol=1e-6)


def test_a_clip_counts_by_its_weight_times_that_of_its_group_at_each_joint() -> None:
    poses = one(ClipBlendTree.build_flat(2, "", "half"), [LOW, HIGH], [1, 1])
    assert place(poses, 0) == [0, 0, 0]  # not in the group
    assert place(poses, 1) == [round(8 * 0.5 / 1.5, 5), 0, 0]
    assert poses.channels[0].tolist() == [0.5, 0.25]  # the jaw is in the group, the brow is not


def test_what_no_input_says_anything_about_is_at_rest() -> None:
    poses = one(ClipBlendTree.build_flat(2), [LOW, HIGH], [0, 0])
    assert place(poses, 1) == [0, 5, 0] and poses.channels[0].tolist() == [0, 0.25]
    assert place(one(ClipBlendTree.build_flat(1, "arm"), [HIGH], [1]), 0) == [0, 0, 0]
    assert place(one(ClipBlendTree.build_flat(2), [LOW, -1], [1, 3]), 1) == [0, 0, 0]  # no clip has no weight
    assert place(one(ClipBlendTree.build_flat(1), [-1], [1]), 1) == [0, 5, 0]
    assert place(one(ClipBlendTree((), ()), [], []), 1) == [0, 5, 0]


def test_weights_below_zero_or_no_number_count_as_none_and_huge_ones_as_large() -> None:
    for odd in (-1.0, np.nan, -np.inf, 1e-44):
        poses = one(ClipBlendTree.build_flat(2), [LOW, HIGH], [1, odd])
        assert place(poses, 1) == [0, 0, 0]
    assert place(one(ClipBlendTree.build_flat(2), [LOW, HIGH], [3e38, np.inf]), 1) == [4, 0, 0]
    assert place(one(ClipBlendTree.build_flat(1), [HIGH], [1e-44]), 1) in ([8, 0, 0], [0, 5, 0])


def test_a_layer_is_an_input_where_its_groups_are_and_the_topmost_weight_is_unused() -> None:
    """Walking with the whole body, and a layer of two clips for the arm alone that weighs three times as much."""
    tree = ClipBlendTree((0, 1, 1), ("", "arm", "arm"), (INTERPOLATE_BLEND_MODE, INTERPOLATE_BLEND_MODE), (-1, 0))
    poses = one(tree, [LOW, HIGH, LOW], [1, 3, 1], [1, 3])
    assert place(poses, 0) == [0, 0, 0]  # the layer says nothing of the body
    assert place(poses, 1) == [0.75 * 6, 0, 0]
    for topmost in (0.0, 7.0, np.nan):
        assert one(tree, [LOW, HIGH, LOW], [1, 3, 1], [topmost, 3]).world_transforms.tobytes() == poses.world_transforms.tobytes()
    assert place(one(tree, [LOW, HIGH, LOW], [1, 3, 1], [1, 0]), 1) == [0, 0, 0]


def test_a_layer_with_one_input_is_as_that_input() -> None:
    straight = one(ClipBlendTree.build_flat(2, "", "half"), [LOW, HIGH], [1, 0.5])
    wrapped = one(ClipBlendTree((0, 1), ("", "half"), (0, 0), (-1, 0)), [LOW, HIGH], [1, 7], [1, 0.5])
    assert np.allclose(straight.world_transforms, wrapped.world_transforms, atol=1e-6) and np.allclose(
        straight.channels, wrapped.channels
    )
    twice = one(ClipBlendTree((2,), ("",), (0, 1, 0), (-1, 0, 1)), [HIGH], [0.3], [0, 0.1, 0.2])
    assert np.allclose(twice.world_transforms, one(ClipBlendTree.build_flat(1), [HIGH], [1]).world_transforms, atol=1e-6)


def test_a_layer_of_several_inputs_is_there_as_much_as_their_groups_are_on_average() -> None:
    tree = ClipBlendTree((0, 1, 1), ("", "half", "half"), (INTERPOLATE_BLEND_MODE, INTERPOLATE_BLEND_MODE), (-1, 0))
    poses = one(tree, [LOW, HIGH, HIGH], [1, 2, 5], [1, 1])
    assert place(poses, 1) == [round(8 * 0.5 / 1.5, 5), 0, 0]
    mixed = one(ClipBlendTree((0, 1, 1), ("", "half", ""), (0, 0), (-1, 0)), [LOW, HIGH, HIGH], [1, 3, 1], [1, 1])
    share = (3 * 0.5 + 1 * 1) / 4
    assert place(mixed, 1) == [round(8 * share / (1 + share), 5), 0, 0]
    assert place(mixed, 0) == [round(8 * 0.25 / 1.25, 5), 0, 0]


def test_an_additive_layer_is_there_where_its_first_input_is_and_as_much_as_others_add() -> None:
    tree = ClipBlendTree((0, 1, 1), ("", "arm", "body"), (INTERPOLATE_BLEND_MODE, ADDITIVE_BLEND_MODE), (-1, 0))
    poses = one(tree, [LOW, HIGH, HIGH], [1, 1, 0.5], [1, 1])
    assert place(poses, 1) == [4, 0, 0]  # half of the first input
    assert place(poses, 0) == [round(4 * 0.5 / 1.5, 5), 0, 0]  # the rest pose's 0 and half of 8, there by a half


def test_additive_layers_take_the_first_whole_and_a_share_of_what_others_differ_from_rest() -> None:
    tree = ClipBlendTree((0, 0), ("", ""), (ADDITIVE_BLEND_MODE,), (-1,))
    poses = one(tree, [HIGH, NOD], [0.2, 0.5])
    assert place(poses, 0) == [8, 0, 0]  # `nod` does not have the body, which adds nothing
    assert place(poses, 1) == [8, 1, 0]  # half of 7 less the rest's 5
    expected = matrix(rotation=turn("x", 30))[:3, :3] @ matrix(rotation=turn("z", 90))[:3, :3]  # turned on the parent's side
    assert np.allclose(linear_part(poses, 1), expected, atol=1e-6)
    assert poses.channels[0].tolist() == [1.25, 1.0]


def test_additive_layers_keep_the_scale_of_the_first_and_do_not_normalise() -> None:
    tree = ClipBlendTree((0, 0, 0), ("", "half", ""), (ADDITIVE_BLEND_MODE,), (-1,))
    poses = one(tree, [LOW, NOD, NOD], [1, 1, 1])
    assert place(poses, 1) == [0, 0.5 * 2 + 2, 0]
    assert np.allclose(linear_part(poses, 1), 2 * matrix(rotation=turn("x", 90))[:3, :3], atol=1e-6)
    assert place(one(tree, [LOW, NOD, NOD], [1, 0, 0]), 1) == [0, 0, 0]


def test_the_first_input_of_an_additive_layer_may_be_a_layer() -> None:
    """A blend of two clips, and a layer of one clip that is added to it."""
    tree = ClipBlendTree(
        (1, 1, 2), ("", "", "arm"), (ADDITIVE_BLEND_MODE, INTERPOLATE_BLEND_MODE, INTERPOLATE_BLEND_MODE), (-1, 0, 0)
    )
    poses = one(tree, [LOW, HIGH, NOD], [1, 1, 1], [1, 1, 0.5])
    assert place(poses, 0) == [4, 0, 0]
    assert place(poses, 1) == [4, 1, 0]
    expected = matrix(rotation=turn("x", 30))[:3, :3] @ matrix(rotation=turn("z", 45), scale=(1.5, 1.5, 1.5))[:3, :3]
    assert np.allclose(linear_part(poses, 1), expected, atol=1e-6)


def test_an_added_rotation_is_measured_from_the_rest_pose() -> None:
    clips = still("base", {"a": {"r": turn("y", 20)}}), still("look", {"a": {"r": turn("z", 75)}})
    body = definition({"a": ""}, *clips, rest={"a": matrix(rotation=turn("x", 30))})
    playing = ClipPlayback.make_with_shared_tree(
        ClipBlendTree((0, 0), ("", ""), (ADDITIVE_BLEND_MODE,), (-1,)),
        np.array([[0, 1]], np.int32),
        np.zeros((1, 2)),
        np.ones((1, 2), np.float32),
    )
    poses = blend_poses(build_clip_table(body), {}, playing)
    added = matrix(rotation=turn("z", 75))[:3, :3] @ matrix(rotation=turn("x", -30))[:3, :3]
    expected = added @ matrix(rotation=turn("y", 20))[:3, :3]
    assert np.allclose(poses.world_transforms[0, 0, :, :3], expected, atol=1e-6)


def test_a_share_of_an_added_rotation_goes_the_shorter_way() -> None:
    """A clip that has gone round by 340 degrees is 20 degrees before the rest pose: half of that is 10."""
    rotation = np.array([[turn("z", 0)], [turn("z", 170)], [turn("z", 340)]], np.float32)
    round_it = Clip("round", 1.0, ("a",), np.zeros((3, 1, 3), np.float32), rotation, np.ones((3, 1, 3), np.float32), loop=False)
    body = definition({"a": ""}, still("base", {"a": {}}), round_it)
    tree = ClipBlendTree((0, 0), ("", ""), (ADDITIVE_BLEND_MODE,), (-1,))
    playing = ClipPlayback.make_with_shared_tree(
        tree, np.array([[0, 1]], np.int32), np.array([[0.0, 2.0]]), np.array([[1, 0.5]], np.float32)
    )
    poses = blend_poses(build_clip_table(body), {}, playing)
    assert np.allclose(poses.world_transforms[0, 0, :, :3], matrix(rotation=turn("z", -10))[:3, :3], atol=1e-6)


def test_three_rotations_are_blended_on_one_side_whatever_their_signs() -> None:
    body = definition({"a": ""}, *(still(name, {"a": {"r": r}}) for name, r in (
        ("a", turn("x", 170)), ("b", [-k for k in turn("x", 200)]), ("c", turn("x", 185)))))  # fmt: skip
    playing = ClipPlayback.make_with_shared_tree(
        ClipBlendTree.build_flat(3), np.array([[0, 1, 2]], np.int32), np.zeros((1, 3)), np.ones((1, 3), np.float32)
    )
    assert np.allclose(
        blend_poses(build_clip_table(body), {}, playing).world_transforms[0, 0, :, :3],
        matrix(rotation=turn("x", 185))[:3, :3],
        atol=1e-6,
    )


def test_nothing_jumps_while_clips_go_round_and_fade_into_each_other() -> None:
    """Two clips that loop, of samples with quaternions of any sign, faded from one to the other over their seams: steps half
    as long change half as much, everywhere."""
    random = np.random.default_rng(5)
    clips = []
    for name, count in (("a", 9), ("b", 7)):
        rotation = np.array(
            [[turn("x", 40 * np.sin(k)), turn("y", 80 * np.cos(2 * k))] for k in np.linspace(0, 2 * np.pi, count)]
        )
        rotation *= random.choice([-1, 1], (count, 2, 1))
        flat = np.zeros((count, 2, 3), np.float32)
        clips.append(Clip(name, 8.0, ("root", "tip"), flat, rotation.astype(np.float32), flat + 1))
    table = build_clip_table(definition({"root": "", "tip": "root"}, *clips))

    def largest(steps: int) -> float:
        share = np.linspace(0, 1, steps + 1).astype(np.float32)
        times = np.linspace(0.6, 2.6, steps + 1)
        playing = ClipPlayback.make_with_shared_tree(
            ClipBlendTree.build_flat(2), np.tile(np.array([[0, 1]], np.int32), (steps + 1, 1)),
            np.stack([times, times * 1.3], axis=1),
            np.stack([1 - share, share], axis=1),
        )  # fmt: skip
        return float(np.abs(np.diff(blend_poses(table, {}, playing).world_transforms, axis=0)).max())

    assert 0 < largest(4000) < 0.55 * largest(2000) < 0.55 * 0.03


def test_agents_of_different_trees_are_each_as_alone() -> None:
    trees = (
        ClipBlendTree.build_flat(2),
        ClipBlendTree((0, 0), ("", "arm"), (ADDITIVE_BLEND_MODE,), (-1,)),
        ClipBlendTree((1,), ("",), (0, 0), (-1, 0)),
    )
    rows = [
        (0, [LOW, HIGH], [1, 3], [1, 9]),
        (1, [HIGH, NOD], [1, 0.5], [1, 9]),
        (2, [HIGH, 77], [1, 5], [1, 0.5]),
        (0, [NOD, HIGH], [1, 1], [1, 1]),
    ]
    playing = ClipPlayback(
        trees, np.array([row[0] for row in rows], np.int32), np.array([row[1] for row in rows], np.int32), np.zeros((4, 2)),
        np.array([row[2] for row in rows], np.float32), np.array([row[3] for row in rows], np.float32),
    )  # fmt: skip
    poses = blend_poses(build_clip_table(BODY), GROUPS, playing)
    for k, (tree, clips, weights, layers) in enumerate(rows):
        count = len(trees[tree].layers)
        alone = one(trees[tree], clips[:count], weights[:count], layers[: len(trees[tree].modes)])
        assert alone.world_transforms[0].tobytes() == poses.world_transforms[k].tobytes()
    with pytest.raises(ValueError, match=r"`weights` of 4 agents has the shape \(4, 1\); it must be \[4, 2 or more\]"):
        blend_poses(build_clip_table(BODY), GROUPS, replace(playing, weights=playing.weights[:, :1]))
    with pytest.raises(IndexError, match="blend trees are numbered from 0 to 2"):
        blend_poses(build_clip_table(BODY), GROUPS, replace(playing, tree_indices=np.array([0, 1, 2, 3], np.int32)))


def test_lists_of_each_agent_become_arrays_and_trees_that_are_shared() -> None:
    """The second and the fourth agent have two layers; the third plays nothing."""
    table = build_clip_table(BODY)
    counts, layer_counts = np.array([2, 2, 0, 2]), np.array([1, 2, 1, 2])
    playing = build_playback(
        table, counts, np.array(["low", "high", "low", "high", "high", "nod"]), np.zeros(6), np.array([1, 3, 1, 2, 1, 1]),
        np.array(["", "", "", "arm", "", "arm"]), np.array([0, 0, 0, 1, 0, 1]),
        layer_counts, np.array([0, 0, 0, 0, 0, 0]), np.array([1, 1, 3, 1, 1, 1]), np.array([-1, -1, 0, -1, -1, 0]),
    )  # fmt: skip
    assert len(playing.trees) == 3 and playing.tree_indices[1] == playing.tree_indices[3]
    poses = blend_poses(table, GROUPS, playing, needs_local=True)
    assert poses.local_transforms is not None and poses.local_transforms[:, 1, 0, 3].tolist() == [6, 6, 0, 4]
    assert poses.local_transforms[:, 0, 0, 3].tolist() == [6, 0, 0, 8]
    plain = build_playback(table, np.array([2, 1]), np.array(["low", "high", "nod"]), np.zeros(3), np.array([1, 3, 1]))
    assert sorted(len(tree.layers) for tree in plain.trees) == [1, 2]
    assert blend_poses(table, GROUPS, plain).world_transforms[0].tobytes() == poses.world_transforms[0].tobytes()


def test_lists_that_do_not_fit_are_refused_by_the_agent() -> None:
    table, two = build_clip_table(BODY), np.array([1, 1])
    names, zeros = np.array(["low", "high"]), np.zeros(2)
    with pytest.raises(KeyError, match="fly"):
        build_playback(table, two, np.array(["low", "fly"]), zeros, zeros)
    with pytest.raises(ValueError, match="3 clip times, but the agents need 2"):
        build_playback(table, two, names, np.zeros(3), zeros)
    with pytest.raises(ValueError, match="agent 1: 0 layers have the parent -1"):
        build_playback(table, two, names, zeros, zeros, None, None, two, np.zeros(2, int), zeros, np.array([-1, 0]))
    with pytest.raises(ValueError, match="pass all three or none of them"):
        build_playback(table, two, names, zeros, zeros, None, None, two, np.zeros(2, int))


@pytest.mark.parametrize("tree, why", [
    (dict(layers=(0,), groups=("",), parents=(0,)), "0 layers have the parent -1"),
    (dict(layers=(0,), groups=("",), modes=(0, 0), parents=(-1, -1)), "2 layers have the parent -1"),
    (dict(layers=(0,), groups=("",), modes=(0, 0, 0), parents=(-1, 2, 1)), "layer 1 is above itself"),
    (dict(layers=(0,), groups=("",), modes=(0, 0), parents=(-1, 2)), "a number from 0 to 1"),
    (dict(layers=(1,), groups=("",)), "layer that does not exist"),
    (dict(layers=(0,), groups=("",), modes=(3,)), "1 \\(additive\\) or 2"),
    (dict(layers=(0,), groups=()), "each clip needs a layer"),
])  # fmt: skip
def test_what_is_no_tree_is_refused(tree: dict[str, tuple[int, ...]], why: str) -> None:
    with pytest.raises(ValueError, match=why):
        ClipBlendTree(**tree)  # type: ignore[arg-type]


def test_a_group_that_there_is_not_is_refused() -> None:
    with pytest.raises(KeyError, match="wings"):
        one(ClipBlendTree.build_flat(1, "wings"), [LOW], [1])
