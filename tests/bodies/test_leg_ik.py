"""Legs bent to their feet: goals are reached, bones keep their lengths, knees their side, and free clips their legs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import stick_bodies
from rigs import still

from antdsl.bodies.agents.blending import blend_poses
from antdsl.bodies.agents.definition import Definition
from antdsl.bodies.agents.leg_chains import build_legs_data
from antdsl.bodies.agents.leg_ik import BodySpaceFeet, LegIkSolver, PlacedFeet
from antdsl.bodies.agents.machine_clips import MachineClips, build_machine_playback
from antdsl.bodies.agents.poses import WorldPoses, build_clip_table
from antdsl.bodies.body import build_rotation_matrices
from antdsl.bodies.files.reading import read_definition
from antdsl.numerics.records import select_record_rows

N = 40


@pytest.fixture(scope="module", params=[2, 4, 6, 8])
def body(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Definition:
    definition, report = read_definition(stick_bodies.write_body(tmp_path_factory.mktemp("body"), request.param))
    assert definition is not None, report
    return definition


def rest(body: Definition, count: int = N) -> WorldPoses:
    table = build_clip_table(body)
    return blend_poses(table, body.groups, build_machine_playback(table, (), (), count))


def feet_near(body: Definition, spread: float, seed: int = 1, **other: np.ndarray) -> BodySpaceFeet:
    """Feet about where they rest, some higher and some lower, on level trunks that are a little lower than they rest."""
    legs = build_legs_data(body)
    rng = np.random.default_rng(seed)
    place = np.tile(legs.foot, (N, 1, 1)) + rng.uniform(-1, 1, (N, len(legs.foot), 3)) * spread * legs.length[:, None]
    place[..., 1] -= legs.foot[:, 1]
    level = np.tile(np.array([0, 0, 0, 1], np.float32), (N, 1))
    values = {"trunk_rise": np.full(N, -0.08 * legs.length.max(), np.float32), "trunk_tilt": level} | other
    return BodySpaceFeet(place.astype(np.float32), np.ones(place.shape[:2], np.bool_), **values)


def joints(body: Definition, poses: WorldPoses) -> np.ndarray:
    """Where joints are, [n, J, 3], in body lengths."""
    return np.ascontiguousarray(poses.world_transforms[..., 3]) @ body.compute_base_matrix()[:3, :3].T.astype(np.float32)


def test_feet_that_stand_are_where_they_are_to_be(body: Definition) -> None:
    rng = np.random.default_rng(4)
    lean = np.concatenate([rng.uniform(-0.12, 0.12, (N, 3)), np.ones((N, 1))], 1).astype(np.float32)
    tilt = lean / np.linalg.norm(lean, axis=1, keepdims=True)
    for feet in (feet_near(body, 0.12), feet_near(body, 0.1, trunk_tilt=tilt, trunk_rise=np.full(N, -0.1, np.float32))):
        legs, own = LegIkSolver(body), build_legs_data(body)
        bent_joints = joints(body, legs.bend_legs(rest(body), feet, np.ones(N, np.float32)))
        for k, leg in enumerate(body.legs):
            goal = feet.positions[:, k] + np.array([0, own.foot[k, 1], 0])
            foot = bent_joints[:, body.rig.find_joint(leg.foot)]
            assert np.abs(np.linalg.norm(foot - goal, axis=1)).max() < 1e-3 * own.length[k]


def test_bones_keep_their_lengths_knees_their_side_and_soles_their_turn(body: Definition) -> None:
    feet = feet_near(body, 0.25)
    rest_poses = rest(body)
    bent_poses = LegIkSolver(body).bend_legs(rest_poses, feet, np.ones(N, np.float32))
    was, now = joints(body, rest_poses), joints(body, bent_poses)
    for leg in body.legs:
        hip, knee, foot = (body.rig.find_joint(name) for name in (leg.upper, leg.lower, leg.foot))
        for a, b in ((hip, knee), (knee, foot)):
            assert np.allclose(
                np.linalg.norm(now[:, a] - now[:, b], axis=1), np.linalg.norm(was[:, a] - was[:, b], axis=1), atol=1e-5
            )
        bend_axes = [np.cross(p[:, hip] - p[:, knee], p[:, foot] - p[:, knee]) for p in (was, now)]
        sides = (bend_axes[0] * bend_axes[1]).sum(axis=1) / (
            np.linalg.norm(bend_axes[0], axis=1) * np.linalg.norm(bend_axes[1], axis=1)
        )
        assert sides.min() > 0.2  # no knee has gone through
        assert np.array_equal(rest_poses.world_transforms[:, foot, :, :3], bent_poses.world_transforms[:, foot, :, :3])


def test_a_goal_out_of_reach_is_gone_towards_and_a_straight_leg_bends_to_the_front(tmp_path: Path) -> None:
    definition, _ = read_definition(stick_bodies.write_body(tmp_path, 2))
    assert definition is not None
    far = feet_near(definition, 0.0, trunk_rise=np.zeros(N, np.float32))
    far = replace(far, positions=far.positions + np.array([2, -1, 0], np.float32), is_on_ground=np.zeros_like(far.is_on_ground))
    poses = LegIkSolver(definition).bend_legs(rest(definition), far, np.ones(N, np.float32))
    now = joints(definition, poses)
    hip, knee, foot = (now[0, definition.rig.find_joint(f"{part}_left_0")] for part in ("thigh", "shank", "foot"))
    bones = np.linalg.norm(knee - hip) + np.linalg.norm(foot - knee)
    assert 0.995 * bones < np.linalg.norm(foot - hip) <= bones and np.isfinite(now).all()
    assert np.dot(foot - hip, (2, -1.5, 0)) > 0.9 * bones * np.linalg.norm((2, -1.5, 0))
    # A rest pose with a straight leg: its knee goes ahead, the way that the body looks.
    straight = definition.rig.rest_matrices.copy()
    straight[definition.rig.find_joint("shank_left_0"), :3, 3] = (0, -0.25, 0)
    straight[definition.rig.find_joint("foot_left_0"), :3, 3] = (0, -0.25, 0)
    stiff = replace(definition, rig=replace(definition.rig, rest_matrices=straight))
    low = feet_near(stiff, 0.0, trunk_rise=np.full(N, -0.1, np.float32))
    now = joints(stiff, LegIkSolver(stiff).bend_legs(rest(stiff), low, np.ones(N, np.float32)))
    knee = now[0, stiff.rig.find_joint("shank_left_0")]
    assert knee[0] > now[0, stiff.rig.find_joint("thigh_left_0"), 0] + 0.05


def test_a_clip_that_leaves_feet_free_has_its_own_legs_as_much_as_it_weighs(body: Definition) -> None:
    standing = still("stand", {"root": {}})
    body = replace(body, clips={"stand": standing, "groom": replace(standing, name="groom", feet=False)})
    legs, played = LegIkSolver(body), (("stand", ""), ("groom", ""))

    def machine(clip: int, previous_clip: int, fade: float, weight: float = 1.0) -> MachineClips:
        ones, numbers = np.ones(N, np.float32), np.ones(N, np.int16)
        return MachineClips(
            numbers * np.int16(clip), ones * 0, ones * weight, numbers * np.int16(previous_clip), ones * 0, ones, ones * fade
        )

    for machines, expected in (
        ((), 1.0), ((machine(0, -1, 0),), 1.0), ((machine(1, -1, 0),), 0.0), ((machine(1, 0, 0.25),), 0.25),
        ((machine(0, -1, 0), machine(1, -1, 0, 0.5)), 0.5), ((machine(1, -1, 0), machine(0, -1, 0)), 1.0),
    ):  # fmt: skip
        assert np.allclose(legs.compute_stance_weights(played, machines, N), expected)
    feet = feet_near(body, 0.2)
    free = legs.bend_legs(rest(body), feet.scale_trunk_motion(np.zeros(N, np.float32)), np.zeros(N, np.float32))
    assert np.allclose(free.world_transforms, rest(body).world_transforms, atol=1e-5)


def test_feet_beside_bodies_are_as_placed_ones_seen_from_them() -> None:
    rng = np.random.default_rng(3)
    position, orient, scale = rng.normal(size=(5, 3)), rng.normal(size=(5, 4)), rng.uniform(1, 3, 5)
    local = rng.normal(size=(5, 6, 3))
    placed = position[:, None] + (local * scale[:, None, None]) @ np.swapaxes(build_rotation_matrices(orient), 1, 2)
    ones = np.ones(5, np.float32)
    placed_feet = PlacedFeet(
        placed.astype(np.float32), np.ones((5, 6), np.uint8), ones, ones, np.tile(np.float32([0, 0, 0, 1]), (5, 1))
    )
    beside = placed_feet.convert_to_body_space(position, orient, scale)
    assert np.allclose(beside.positions, local, atol=1e-5) and np.allclose(beside.trunk_rise, 1 / scale)
    assert np.array_equal(select_record_rows(placed_feet, np.array([2])).P, placed_feet.P[2:3])
