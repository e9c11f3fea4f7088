"""Bounding boxes of agents: static shapes by their joints, deforming ones by those that they follow, collision layers first."""

from __future__ import annotations

import numpy as np
import pytest

from antdsl.bodies.agents.boxes import compute_agent_boxes, compute_layer_boxes
from antdsl.bodies.agents.definition import Binding, BlendTargets, Definition, Layer, Rig, SkinShape, SkinWeights

RIG = Rig(("root", "arm", "hand"), np.array([-1, 0, 1], np.int32), np.tile(np.eye(4), (3, 1, 1)))
BLOCK = np.array([[x, y, z] for x in (1.0, 3.0) for y in (0.0, 1.0) for z in (0.0, 2.0)], np.float32)
FACES = np.array([[0, 1, 2]], np.int32)
FOLLOWING = SkinWeights(
    ("hand", "arm", "root"),
    np.tile(np.array([[0, 1]], np.int32), (8, 1)),
    np.full((8, 2), 0.5, np.float32),
    np.tile(np.eye(4), (3, 1, 1)),
)  # no vertex follows the root
SHAPES = {
    "block": SkinShape("block", BLOCK, FACES),
    "skin": SkinShape("skin", BLOCK * 100, FACES, capture=FOLLOWING),
    "head": SkinShape("head", BLOCK, FACES, blend=BlendTargets(("grin",), ("smile",))),
    "grin": SkinShape("grin", BLOCK + np.float32(5), FACES),
}
LAYERS = {
    "plain": Layer("plain", static=(Binding("hand", "block"),)),
    "wide": Layer("wide", static=(Binding("hand", "block", (2.0, 1.0, 3.0)),)),
    "skin": Layer("skin", deforming=(Binding("", "skin", (1.0, 2.0, 1.0), "linearskinning"),)),
    "face": Layer("face", deforming=(Binding("arm", "head", deformer="blendshape"),)),
    "none": Layer("none"),
}
BODY = Definition("body", RIG, SHAPES, LAYERS)


def poses(count: int, seed: int = 0) -> np.ndarray:
    """World matrices of joints that turn, stretch, shear and mirror."""
    matrices = np.random.default_rng(seed).normal(size=(count, 3, 4, 4))
    matrices[..., 3, :] = (0, 0, 0, 1)
    return matrices


def boxed(points: np.ndarray) -> tuple[list[float], list[float]]:
    return points.min(axis=0).tolist(), points.max(axis=0).tolist()


def test_a_static_shapes_box_is_scaled_and_then_turned_by_its_joint() -> None:
    worlds = poses(50)
    for name, scale in (("plain", (1, 1, 1)), ("wide", (2, 1, 3))):
        least, most = compute_layer_boxes(BODY, worlds, [name])
        corners = (BLOCK - BLOCK.mean(axis=0)) * scale + BLOCK.mean(axis=0)
        for agent in range(50):
            expected_box = boxed(corners @ worlds[agent, 2, :3, :3].T + worlds[agent, 2, :3, 3])
            assert least[agent] == pytest.approx(expected_box[0]) and most[agent] == pytest.approx(expected_box[1])


def test_a_deforming_shapes_box_is_that_of_the_joints_it_follows() -> None:
    worlds = poses(20)
    least, most = compute_layer_boxes(BODY, worlds, ["skin"])
    for agent in range(20):
        low, high = np.array(boxed(worlds[agent, 1:, :3, 3]))
        margin = (high - low) / 2 * (0, 1, 0)
        assert least[agent] == pytest.approx(low - margin) and most[agent] == pytest.approx(high + margin)


def test_a_blend_shapes_box_holds_all_that_it_may_be_blended_with() -> None:
    worlds = np.tile(np.eye(4), (1, 3, 1, 1))
    assert [part[0].tolist() for part in compute_layer_boxes(BODY, worlds, ["face"])] == [[1, 0, 0], [8, 6, 7]]


def test_a_deforming_shape_of_a_single_joint_moves_with_it_as_a_static_one() -> None:
    inverse = poses(3, 5)[0]
    follows = SkinWeights(("root", "arm", "hand"), np.full((8, 1), 2, np.int32), np.ones((8, 1), np.float32), inverse)
    layers = {"one": Layer("one", deforming=(Binding("", "block", (1.0, 2.0, 1.0), "linearskinning"),))}
    body = Definition("body", RIG, {"block": SkinShape("block", BLOCK, FACES, capture=follows)}, layers)
    worlds = poses(9)
    least, most = compute_layer_boxes(body, worlds, ["one"])
    corners = (BLOCK - BLOCK.mean(axis=0)) * (1, 2, 1) + BLOCK.mean(axis=0)
    for agent in range(9):
        matrix = worlds[agent, 2] @ inverse[2]
        expected_box = boxed(corners @ matrix[:3, :3].T + matrix[:3, 3])
        assert least[agent] == pytest.approx(expected_box[0]) and most[agent] == pytest.approx(expected_box[1])


def test_collision_layers_go_first_and_several_layers_are_put_together() -> None:
    worlds = poses(30)
    wears, collides = np.arange(30) % 2, np.arange(30) % 3 % 2
    least, most = compute_agent_boxes(BODY, worlds, [("plain", "skin"), ("none",)], [(), ("wide",)], wears, collides)
    both, wide = compute_layer_boxes(BODY, worlds, ["plain", "skin"]), compute_layer_boxes(BODY, worlds, ["wide"])
    for agent in range(30):
        if collides[agent]:
            assert (least[agent] == wide[0][agent]).all() and (most[agent] == wide[1][agent]).all()
        elif wears[agent] == 0:
            assert (least[agent] == both[0][agent]).all() and (most[agent] == both[1][agent]).all()
        else:
            assert np.isnan(least[agent]).all() and np.isnan(most[agent]).all()


def test_agents_do_not_depend_on_each_other_and_float32_stays_so() -> None:
    worlds = poses(40).astype(np.float32)
    least, most = compute_layer_boxes(BODY, worlds, ["plain", "skin"])
    assert least.dtype == most.dtype == np.float32
    order = np.random.default_rng(1).permutation(40)
    again = compute_layer_boxes(BODY, worlds[order], ["plain", "skin"])
    assert (again[0] == least[order]).all() and (again[1] == most[order]).all()
    exact = compute_layer_boxes(BODY, worlds.astype(np.float64), ["plain", "skin"])
    assert np.abs(exact[0] - least).max() < 1e-5


def test_no_agents_and_unknown_layers() -> None:
    assert compute_layer_boxes(BODY, poses(0), ["plain"])[0].shape == (0, 3)
    with pytest.raises(KeyError):
        compute_layer_boxes(BODY, poses(1), ["hat"])
