"""Looks turn joints of a group, each by its share, and together by no more than the whole."""

from __future__ import annotations

import numpy as np
import pytest
from rigs import definition, matrix

from antdsl.bodies.agents.blending import blend_poses
from antdsl.bodies.agents.definition import TransformGroup
from antdsl.bodies.agents.driving import rotate_joints_to_look_directions
from antdsl.bodies.agents.machine_clips import build_machine_playback
from antdsl.bodies.agents.poses import build_clip_table

JOINTS = {"root": "", "neck": "root", "head": "neck", "jaw": "head", "tail": "root"}
REST = {"neck": matrix((1, 0, 0)), "head": matrix((1, 0, 0)), "jaw": matrix((1, 0, 0)), "tail": matrix((-1, 0, 0))}
DIRECTION = np.array([[np.cos(np.radians(40)), 0, np.sin(np.radians(40))]], np.float32)  # 40 degrees to the right


def turned(*members: tuple[str, float], look: np.ndarray = DIRECTION) -> dict[str, tuple[float, float, float]]:
    """Of each joint how far it looks aside in degrees, and its place along x and z."""
    body = definition(JOINTS, rest=REST)
    table = build_clip_table(body)
    poses = blend_poses(table, {}, build_machine_playback(table, (), [], 1))
    matrices = rotate_joints_to_look_directions(
        table, poses, {"part": look}, {"part": TransformGroup("part", members)}, np.eye(3)
    ).world_transforms[0]
    return {
        name: (float(np.degrees(np.arctan2(m[2, 0], m[0, 0]))), float(m[0, 3]), float(m[2, 3]))
        for name, m in zip(JOINTS, matrices, strict=True)
    }


def test_a_joint_turns_with_all_that_hangs_on_it_about_its_own_place() -> None:
    joint_states = turned(("head", 1.0))
    assert [joint_states[name][0] for name in JOINTS] == pytest.approx([0, 0, 40, 40, 0], abs=1e-4)
    assert joint_states["head"][1:] == (2, 0) and joint_states["tail"][1:] == (-1, 0)
    assert joint_states["jaw"][1:] == pytest.approx((2 + DIRECTION[0, 0], DIRECTION[0, 2]), abs=1e-6)


def test_joints_that_hang_on_each_other_share_the_way() -> None:
    joint_states = turned(("neck", 0.5), ("head", 0.5))
    assert [joint_states[name][0] for name in JOINTS] == pytest.approx([0, 20, 40, 40, 0], abs=0.2)
    half = turned(("neck", 0.25))
    assert 9 < half["head"][0] < 11


def test_what_hangs_on_a_joint_that_has_turned_the_whole_way_turns_no_further() -> None:
    assert turned(("head", 1.0), ("jaw", 1.0)) == turned(("head", 1.0))
    assert turned(("neck", 0.75), ("head", 1.0))["jaw"][0] == pytest.approx(40, abs=0.5)


def test_who_looks_straight_back_or_nowhere_is_left_alone() -> None:
    for direction in ((-1, 0, 0), (1, 0, 0)):
        assert turned(("head", 1.0), look=np.array([direction], np.float32))["jaw"] == (0, 3, 0)
