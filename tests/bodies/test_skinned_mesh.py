"""A skinned mesh, moved by the matrices of its bones, is the body as deformers pose it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from rigs import matrix, wild

from antdsl.bodies.agents.blending import blend_poses
from antdsl.bodies.agents.definition import Binding, Definition, Layer, SkinShape, SkinWeights
from antdsl.bodies.agents.machine_clips import MachineClips, build_machine_playback
from antdsl.bodies.agents.poses import build_clip_table
from antdsl.bodies.posed_body import PosedBody
from antdsl.bodies.skinned_mesh import SkinnedMesh

PLAYS = (("c0", ""), ("c1", ""))


def dressed(joints_a_point: int, scales: bool = True) -> Definition:
    """A wild rig of nine joints with a static shape at two of them and a skinned one."""
    definition, random = wild(9, 21, scales=scales), np.random.default_rng(22)
    points, normals = random.normal(size=(2, 60, 3)).astype(np.float32)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    faces = random.integers(0, 60, (80, 3)).astype(np.int32)
    weights = random.uniform(size=(60, joints_a_point)) ** 3
    weights = (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32)
    names = tuple(random.permutation(definition.rig.names))
    inverse = np.stack([matrix(random.normal(size=3), random.normal(size=4)) for _ in names])
    capture = SkinWeights(names, random.integers(0, 9, (60, joints_a_point)).astype(np.int32), weights, inverse)
    shapes = {
        "skin": SkinShape("skin", points, faces, normals, capture=capture),
        "stone": SkinShape(
            "stone", points[:20] + 1, faces[:9] % 20, normals[:20], materials=("red",), material=np.zeros(9, np.int32)
        ),
    }
    first, last = definition.rig.names[0], definition.rig.names[-1]
    layer = Layer("body", (Binding(first, "stone"), Binding(last, "stone")), (Binding("", "skin", deformer="linearskinning"),))
    return replace(
        definition, shapes=shapes, layers={"body": layer}, materials={"red": (0.5, 0.1, 0.1)}, length=3.0, front=(0, 0, 1)
    )


def machine(count: int) -> MachineClips:
    """Agents in the middle of a change from one clip to another, each elsewhere."""
    random = np.random.default_rng(23)
    clips = random.integers(0, 2, (2, count)).astype(np.int16)
    turns = random.uniform(size=(5, count)).astype(np.float32)
    return MachineClips(clips[0], turns[0], turns[1], clips[1], turns[2], turns[3], turns[4])


def followed(mesh: SkinnedMesh, body: Definition, world: NDArray[np.float32]) -> NDArray[np.float64]:
    """The matrix [n, v, 4, 4] that each vertex goes by, in body lengths."""
    square = np.tile(np.eye(4), (len(world), len(mesh.bone_joints), 1, 1))
    square[:, :, :3] = world[:, mesh.bone_joints]
    inverse = np.tile(np.eye(4), (len(mesh.bone_joints), 1, 1))
    inverse[:, :3] = mesh.inverse_matrices
    matrices = body.compute_base_matrix()[None, None] @ square @ inverse[None]
    return np.asarray((matrices[:, mesh.bones] * mesh.weights[None, :, :, None, None]).sum(axis=2))


def moved(mesh: SkinnedMesh, by: NDArray[np.float64]) -> NDArray[np.float64]:
    points = np.concatenate([mesh.points, np.ones((len(mesh.points), 1), np.float32)], axis=1)
    return np.asarray((by @ points[None, :, :, None])[..., :3, 0])


def pose_definition(
    definition: Definition, count: int
) -> tuple[PosedBody, NDArray[np.float64], NDArray[np.float32], NDArray[np.float32]]:
    """The body of a definition; the matrices of its vertices; its vertices and normals as deformers have them."""
    body, machines = PosedBody(definition, PLAYS), [machine(count)]
    world = blend_poses(
        build_clip_table(definition), {}, build_machine_playback(build_clip_table(definition), PLAYS, machines, count)
    ).world_transforms
    return body, followed(body.mesh, definition, world), *body.pose_vertices(machines, count)


@pytest.mark.parametrize("joints_a_point", [1, 2, 4])
def test_it_is_the_body_as_deformers_pose_it(joints_a_point: int) -> None:
    body, by, points, _ = pose_definition(dressed(joints_a_point), 12)
    moved_points = moved(body.mesh, by)
    assert moved_points.shape == points.shape and np.abs(moved_points - points).max() < 1e-4 * np.abs(points).max()
    stones = body.tint_weights == 0
    assert stones.any() and not stones.all() and len(body.mesh.bone_joints) == 11  # nine of the capture, two in the rest pose


def test_normals_turn_with_a_static_shape_whatever_its_joint_scales() -> None:
    body, by, _, normals = pose_definition(dressed(1), 6)
    across = (np.linalg.inv(by[..., :3, :3]).swapaxes(-1, -2) @ body.mesh.normals[None, :, :, None])[..., 0]
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    unit_normals = normals / np.linalg.norm(normals, axis=-1, keepdims=True)
    assert np.abs(across - unit_normals)[:, body.tint_weights == 0].max() < 1e-3


def test_of_many_joints_the_four_of_most_weight_stay_and_add_up_to_one() -> None:
    mesh = PosedBody(dressed(7), PLAYS).mesh
    assert np.allclose(mesh.weights.sum(axis=1), 1, atol=1e-6) and mesh.weights.shape[1] == 4
    assert mesh.weights[-1].min() > 0 and (np.diff(mesh.weights[-1]) <= 0).all()


def test_a_shape_at_a_joint_that_is_flat_at_rest_is_drawn_all_the_same() -> None:
    definition = dressed(1)
    rest = definition.rig.rest_matrices.copy()
    rest[-1, :3, :3] = 0
    body, by, points, _ = pose_definition(replace(definition, rig=replace(definition.rig, rest_matrices=rest)), 5)
    assert np.isfinite(body.mesh.points).all() and np.isfinite(body.mesh.inverse_matrices).all()
    assert np.abs(moved(body.mesh, by) - points).max() < 1e-3
