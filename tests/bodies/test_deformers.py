"""Deformers: against UsdSkel, which is written by others, and by hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rigs import definition, matrix, still, turn, wild

from antdsl.bodies.agents import deformers
from antdsl.bodies.agents.blending import ClipBlendTree, ClipPlayback, blend_poses
from antdsl.bodies.agents.definition import Binding, BlendTargets, Channel, Definition, InBetweens, SkinShape, SkinWeights
from antdsl.bodies.agents.deformers import DEFORMER_BY_NAME, deform_binding, find_deformers, register_deformer
from antdsl.bodies.agents.poses import WorldPoses, build_clip_table
from antdsl.bodies.agents.skinning import DeformedShape

FACES = np.zeros((0, 3), np.int32)


def skinned(scales: bool, sheared: bool = False) -> tuple[Definition, WorldPoses]:
    """A shape of 120 points that follow four of nine joints each, and the poses of seven agents."""
    built, random = wild(9, 11, scales=scales, sheared=sheared), np.random.default_rng(12)
    points, normals = random.normal(size=(2, 120, 3)).astype(np.float32)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    names = tuple(random.permutation(built.rig.names))
    weights = random.uniform(size=(120, 4)) ** 3
    weights[::5, 1:] = 0
    weights = (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32)
    inverse = np.stack([matrix(random.normal(size=3), random.normal(size=4)) for _ in names])
    capture = SkinWeights(names, random.integers(0, 9, (120, 4)).astype(np.int32), weights, inverse)
    body = SkinShape("body", points, FACES, normals, attributes={"twist": random.uniform(size=120).astype(np.float32)},
                 capture=capture, dual_quaternion_blend="twist")  # fmt: skip
    built = replace(built, shapes={"body": body})
    playing = ClipPlayback.make_with_shared_tree(
        ClipBlendTree.build_flat(2),
        np.tile(np.array([[0, 1]], np.int32), (7, 1)),
        random.uniform(0, 1, (7, 2)),
        random.uniform(size=(7, 2)).astype(np.float32),
    )
    return built, blend_poses(build_clip_table(built), {}, playing)


def theirs(built: Definition, poses: WorldPoses, method: str) -> tuple[NDArray[Any], NDArray[Any]]:
    """Points and normals by UsdSkel, agent by agent."""
    skel, gf, vt = (pytest.importorskip(f"pxr.{name}") for name in ("UsdSkel", "Gf", "Vt"))
    shape = built.shapes["body"]
    capture = shape.capture
    assert capture is not None and shape.normals is not None
    at = [built.rig.names.index(name) for name in capture.names]
    result = []
    for world in poses.world_transforms.astype(np.float64):
        full = np.concatenate([world, np.tile([[[0, 0, 0, 1.0]]], (len(world), 1, 1))], 1)[at] @ capture.inverse_matrices
        points, normals = vt.Vec3fArray.FromNumpy(shape.points.copy()), vt.Vec3fArray.FromNumpy(shape.normals.copy())
        joints, weights = vt.IntArray(capture.joints.reshape(-1).tolist()), vt.FloatArray(capture.weights.reshape(-1).tolist())
        moves = vt.Matrix4dArray([gf.Matrix4d(each.T.tolist()) for each in full])
        turns = vt.Matrix3dArray([gf.Matrix3d(np.linalg.inv(each[:3, :3]).tolist()) for each in full])
        assert skel.SkinPoints(method, gf.Matrix4d(1), moves, joints, weights, 4, points)
        assert skel.SkinNormals(method, gf.Matrix3d(1), turns, joints, weights, 4, normals)
        result.append((np.array(points), np.array(normals)))
    points, normals = np.array(result).transpose(1, 0, 2, 3)
    return points, normals / np.linalg.norm(normals, axis=2, keepdims=True)


@pytest.mark.parametrize("scales", [False, True], ids=["rigid", "scaled"])
def test_linear_skinning_is_that_of_an_independent_implementation(scales: bool) -> None:
    built, poses = skinned(scales, sheared=scales)
    result = deform_binding(built, Binding("", "body", deformer="linearskinning"), poses)
    points, normals = theirs(built, poses, "classicLinear")
    assert np.abs(result.points - points).max() < 1e-5 * max(1, np.abs(points).max())
    assert result.normals is not None and np.abs(result.normals - normals).max() < 1e-5


def test_dual_quaternion_skinning_is_that_of_an_independent_implementation() -> None:
    built, poses = skinned(scales=False)
    result = deform_binding(built, Binding("", "body", deformer="dualquatskinning"), poses)
    points, normals = theirs(built, poses, "dualQuaternion")
    assert np.abs(result.points - points).max() < 1e-5 * max(1, np.abs(points).max())
    assert result.normals is not None and np.abs(result.normals - normals).max() < 1e-5


def test_dual_quaternions_take_scale_and_shear_as_an_independent_implementation_does() -> None:
    built, poses = skinned(scales=True, sheared=True)
    result = deform_binding(built, Binding("", "body", deformer="dualquatskinning"), poses)
    points, _ = theirs(built, poses, "dualQuaternion")
    assert np.abs(result.points - points).max() < 1e-5 * np.abs(points).max()


def twisted() -> tuple[Definition, WorldPoses]:
    """A ring of points half way along a bone that is twisted by 180 degrees at its end, scaled there or not."""
    rest = {"end": matrix((2, 0, 0))}
    built = definition(
        {"root": "", "end": "root"}, still("twist", {"root": {}, "end": {"t": (2, 0, 0), "r": turn("x", 170)}}), rest=rest
    )
    points = np.array([[1, 1, 0], [1, 0, 1], [1, -1, 0]], np.float32)
    capture = SkinWeights(("root", "end"), np.tile(np.array([[0, 1]], np.int32), (3, 1)), np.full((3, 2), 0.5, np.float32),
                      np.stack([np.eye(4), np.linalg.inv(rest["end"])]))  # fmt: skip
    shape = SkinShape("bone", points, FACES, points - [[1, 0, 0]], attributes={"dq": np.array([0, 0.5, 1], np.float32)},
                  capture=capture, dual_quaternion_blend="dq")  # fmt: skip
    built = replace(built, shapes={"bone": shape})
    playing = ClipPlayback.make_with_shared_tree(
        ClipBlendTree.build_flat(1), np.zeros((1, 1), np.int32), np.zeros((1, 1)), np.ones((1, 1), np.float32)
    )
    return built, blend_poses(build_clip_table(built), {}, playing)


def test_a_twist_collapses_linearly_and_keeps_its_volume_by_dual_quaternions() -> None:
    built, poses = twisted()
    radius = {}
    for name in ("linearskinning", "dualquatskinning", "dualquatblendskinning"):
        result = deform_binding(built, Binding("", "bone", deformer=name), poses)
        radius[name] = np.linalg.norm(result.points[0, :, 1:], axis=1)
    assert np.allclose(radius["linearskinning"], np.cos(np.radians(85)), atol=1e-6)
    assert np.allclose(radius["dualquatskinning"], 1, atol=1e-6)
    straight, turned = (
        deform_binding(built, Binding("", "bone", deformer=name), poses).points[0]
        for name in ("linearskinning", "dualquatskinning")
    )
    mixed = deform_binding(built, Binding("", "bone", deformer="dualquatblendskinning"), poses).points[0]
    assert np.allclose(mixed, [straight[0], (straight[1] + turned[1]) / 2, turned[2]], atol=1e-6)  # by the attribute: 0, 0.5, 1


def test_a_point_of_one_joint_goes_the_same_way_by_both_methods_whatever_the_joint_holds() -> None:
    built, poses = skinned(scales=True, sheared=True)
    straight, turned = (
        deform_binding(built, Binding("", "body", deformer=f"{name}skinning"), poses) for name in ("linear", "dualquat")
    )
    assert np.allclose(straight.points[:, ::5], turned.points[:, ::5], atol=1e-5 * np.abs(straight.points).max())
    assert straight.normals is not None and turned.normals is not None
    assert np.allclose(straight.normals[:, ::5], turned.normals[:, ::5], atol=1e-4)


FACE = SkinShape(
    "face", np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0]], np.float32), FACES, np.array([[0, 1, 0]] * 3, np.float32),
    attributes={"id": np.array([10, 20, 30]), "red": np.array([0, 0, 1], np.float32)},
    blend=BlendTargets(("smile", "open"), ("smile", "jaw")),
)  # fmt: skip


def moved(name: str, *points: tuple[float, float, float], ids: tuple[int, ...] = (), **fields: Any) -> SkinShape:
    return SkinShape(name, np.array(points, np.float32), FACES, attributes={"id": np.array(ids)} if ids else {}, **fields)


SMILE = moved("smile", (0, 1, 0), (1, 2, 0), (2, 3, 0))
OPEN = moved("open", (2, 0, 4), (0, 0, -4), ids=(30, 10), in_betweens=InBetweens(("ajar",), (0.25,)))
AJAR = moved("ajar", (2, 0, 4), (0, 0, -2), ids=(30, 10))


def face(shape: SkinShape, smile: list[float], jaw: list[float], *others: SkinShape) -> DeformedShape:
    built = definition({"head": ""}, channels=(Channel("smile"), Channel("jaw")))
    built = replace(built, shapes={each.name: each for each in (shape, SMILE, OPEN, AJAR, *others)})
    world = np.tile(np.eye(4, dtype=np.float32)[:3], (len(smile), 1, 1, 1))
    return deform_binding(
        built, Binding("", "face", deformer="blendshape"), WorldPoses(world, None, np.array([smile, jaw], np.float32).T)
    )


def test_blend_shapes_add_their_differences_by_weights_that_are_not_normalised() -> None:
    result = face(FACE, [0, 0.5, 1, 2, -1], [0, 0, 0, 0, 0])
    assert result.points[:, :, 1].tolist() == [[0, 0, 0], [0.5, 1, 1.5], [1, 2, 3], [2, 4, 6], [-1, -2, -3]]


def test_points_are_matched_by_id_and_those_without_one_stay() -> None:
    result = face(FACE, [0, 1], [1, 1])
    assert result.points[0].tolist() == [[0, 0, -4], [1, 0, 0], [2, 0, 4]]
    assert result.points[1].tolist() == [[0, 1, -4], [1, 2, 0], [2, 3, 4]]
    other = replace(
        FACE, blend=replace(FACE.blend, point_id="number"), attributes={**FACE.attributes, "number": np.array([3, 2, 1])}
    )
    result = face(other, [0], [1])  # the other shape does not have the attribute, so they are matched by number
    assert result.points[0].tolist() == [[2, 0, 4], [0, 0, -4], [2, 0, 0]]


def test_in_betweens_are_gone_through_at_their_weights() -> None:
    """The first point goes to -2 at 0.25 and to -4 at 1, the last one to 4 at 0.25 and stays there."""
    result = face(FACE, [0] * 6, [0.125, 0.25, 0.625, 1, 1.75, -0.25])
    assert result.points[:, 0, 2].tolist() == [-1, -2, -3, -4, -6, 2]
    assert result.points[:, 2, 2].tolist() == [2, 4, 4, 4, 4, -4]


def test_in_betweens_are_those_of_an_independent_implementation() -> None:
    skel, usd, vt = (pytest.importorskip(f"pxr.{name}") for name in ("UsdSkel", "Usd", "Vt"))
    geom = pytest.importorskip("pxr.UsdGeom")
    random = np.random.default_rng(2)
    base, primary, low, high = random.normal(size=(4, 8, 3)).astype(np.float32)
    stage = usd.Stage.CreateInMemory()
    mesh = geom.Mesh.Define(stage, "/mesh")
    shape = skel.BlendShape.Define(stage, "/mesh/shape")
    shape.CreateOffsetsAttr(vt.Vec3fArray.FromNumpy(primary - base))
    for name, weight, points in (("low", 0.3, low), ("high", 0.8, high)):
        between = shape.CreateInbetween(name)
        between.SetWeight(weight)
        between.SetOffsets(vt.Vec3fArray.FromNumpy(points - base))
    binding = skel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateBlendShapesAttr(["jaw"])
    binding.CreateBlendShapeTargetsRel().AddTarget("/mesh/shape")
    query = skel.BlendShapeQuery(binding)
    library = {
        "face": SkinShape("face", base, FACES, blend=BlendTargets(("one",), ("jaw",))),
        "one": SkinShape("one", primary, FACES, in_betweens=InBetweens(("high", "low"), (0.8, 0.3))),
        "low": SkinShape("low", low, FACES), "high": SkinShape("high", high, FACES),
    }  # fmt: skip
    built = replace(definition({"head": ""}, channels=(Channel("jaw"),)), shapes=library)
    weights = [0.0, 0.1, 0.3, 0.55, 0.8, 0.93, 1.0]
    world = np.tile(np.eye(4, dtype=np.float32)[:3], (len(weights), 1, 1, 1))
    result = deform_binding(
        built, Binding("", "face", deformer="blendshape"), WorldPoses(world, None, np.array(weights, np.float32)[:, None])
    )
    for weight, mine in zip(weights, result.points, strict=True):
        points = vt.Vec3fArray.FromNumpy(base.copy())
        shares = query.ComputeSubShapeWeights(vt.FloatArray([weight]))
        assert query.ComputeDeformedPoints(
            *shares, query.ComputeBlendShapePointIndices(), query.ComputeSubShapePointOffsets(), points
        )
        assert np.abs(np.array(points) - mine).max() < 1e-5


def test_normals_are_blended_and_unit_again_and_so_is_what_else_is_named() -> None:
    tilted = replace(
        SMILE, name="tilted", normals=np.array([[1, 0, 0]] * 3, np.float32), attributes={"red": np.array([1, 1, 1], np.float32)}
    )
    named = BlendTargets(("tilted",), ("smile",), ("P", "N", "red"))
    result = face(replace(FACE, blend=named), [0.5], [0], tilted)
    assert result.normals is not None and np.allclose(result.normals[0], [[np.sqrt(0.5), np.sqrt(0.5), 0]] * 3)
    assert result.attributes["red"].tolist() == [[0.5, 0.5, 1]]
    only = face(replace(FACE, blend=replace(named, attributes=("red",))), [0.5], [0], tilted)
    assert np.array_equal(only.points[0], FACE.points) and only.attributes["red"].tolist() == [[0.5, 0.5, 1]]


def test_an_in_between_without_normals_is_passed_by_them_alone() -> None:
    """Normals go straight to the primary shape's while the last point is at its in-between."""
    wide = replace(OPEN, name="wide", normals=np.array([[1, 0, 0]] * 2, np.float32))
    result = face(replace(FACE, blend=BlendTargets(("wide",), ("jaw",))), [0], [0.25], wide)
    assert result.points[0, 2].tolist() == [2, 0, 4]
    assert result.normals is not None and np.allclose(result.normals[0, 2], np.array([1, 3, 0]) / np.sqrt(10))


def test_what_a_blend_shape_cannot_be_is_refused() -> None:
    for weight in (0.0, 1.0):
        odd = replace(SMILE, name="odd", in_betweens=InBetweens(("ajar",), (weight,)))
        with pytest.raises(ValueError, match=f"has weight {weight:g}"):
            face(replace(FACE, blend=BlendTargets(("odd",), ("smile",))), [0], [0], odd)
    for blend, why in ((BlendTargets(("gone",), ("smile",)), "gone"), (BlendTargets(("smile",), ("tail",)), "tail")):
        with pytest.raises(KeyError, match=why):
            face(replace(FACE, blend=blend), [0], [0])
    with pytest.raises(ValueError, match="needs the names of its blend shapes"):
        face(replace(FACE, blend=None), [0], [0])
    with pytest.raises(ValueError, match="2 blend shapes, but 1 channels"):
        face(replace(FACE, blend=BlendTargets(("smile", "open"), ("jaw",))), [0], [0])


def test_blend_shapes_come_before_skinning() -> None:
    """A point is opened by 1 along y, and then its joint turns by 90 degrees about x; in the other order y would stay."""
    capture = SkinWeights(("head",), np.zeros((1, 1), np.int32), np.ones((1, 1), np.float32), np.eye(4)[None])
    shapes = {
        "skin": SkinShape("skin", np.array([[3, 0, 0]], np.float32), FACES, np.array([[0, 1, 0]], np.float32), capture=capture,
                      attributes={"dq": np.ones(1, np.float32)}, blend=BlendTargets(("up",), ("open",)),
                      dual_quaternion_blend="dq"),
        "up": SkinShape("up", np.array([[3, 1, 0]], np.float32), FACES),
    }  # fmt: skip
    built = replace(
        definition({"head": ""}, still("turn", {"head": {"r": turn("x", 90)}}, {"open": 1.0}), channels=(Channel("open"),)),
        shapes=shapes,
    )
    playing = ClipPlayback.make_with_shared_tree(
        ClipBlendTree.build_flat(1), np.zeros((1, 1), np.int32), np.zeros((1, 1)), np.ones((1, 1), np.float32)
    )
    poses = blend_poses(build_clip_table(built), {}, playing)
    for name in ("linearskinning", "dualquatskinning", "dualquatblendskinning"):
        result = deform_binding(built, Binding("", "skin", deformer=f"blendshape+{name}"), poses)
        assert np.allclose(result.points, [[[3, 0, 1]]], atol=1e-6) and result.normals is not None
        assert np.allclose(result.normals, [[[0, 0, 1]]], atol=1e-6)


def test_a_static_shape_goes_as_its_joint_goes() -> None:
    """A stick along x at a hand that is moved, turned by 90 degrees about z, and stretched to twice along its own x."""
    built = definition({"hand": ""}, still("hold", {"hand": {"t": (0, 0, 5), "r": turn("z", 90), "s": (2, 1, 1)}}))
    stick = SkinShape(
        "stick", np.array([[1, 0, 0], [1, 1, 0]], np.float32), FACES, np.array([[1, 0, 0], [0.6, 0.8, 0]], np.float32)
    )
    built = replace(built, shapes={"stick": stick})
    playing = ClipPlayback.make_with_shared_tree(
        ClipBlendTree.build_flat(1), np.array([[0], [-1]], np.int32), np.zeros((2, 1)), np.ones((2, 1), np.float32)
    )
    result = deform_binding(built, Binding("hand", "stick"), blend_poses(build_clip_table(built), {}, playing))
    assert np.allclose(result.points, [[[0, 2, 5], [-1, 2, 5]], [[1, 0, 0], [1, 1, 0]]], atol=1e-6)
    across = np.array([-0.8, 0.3, 0]) / np.hypot(0.8, 0.3)  # normals shrink where the shape is stretched
    assert result.normals is not None and np.allclose(
        result.normals, [[[0, 1, 0], across], [[1, 0, 0], [0.6, 0.8, 0]]], atol=1e-6
    )


def test_a_deformer_of_ones_own_is_used_by_its_name_alone_and_after_others(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(deformers, "DEFORMER_BY_NAME", dict(DEFORMER_BY_NAME))

    def swell(deformed: DeformedShape, shape: SkinShape, definition: Definition, poses: WorldPoses) -> DeformedShape:
        return DeformedShape(deformed.points * (1 + poses.channels[:, :1, None]), deformed.normals, deformed.attributes)

    register_deformer("swell", swell)
    built = replace(
        definition({"head": ""}, channels=(Channel("smile"), Channel("jaw"))),
        shapes={"face": FACE, "smile": SMILE, "open": OPEN, "ajar": AJAR},
    )
    poses = WorldPoses(np.tile(np.eye(4, dtype=np.float32)[:3], (2, 1, 1, 1)), None, np.array([[1, 0], [0, 0]], np.float32))
    assert deform_binding(built, Binding("", "face", deformer="swell"), poses).points[0].tolist() == (2 * FACE.points).tolist()
    assert (
        deform_binding(built, Binding("", "face", deformer="blendshape+swell"), poses).points[0].tolist()
        == (2 * SMILE.points).tolist()
    )
    for name in ("", "swell", "a+b"):
        with pytest.raises(ValueError, match="cannot be the name of a deformer"):
            register_deformer(name, swell)
    with pytest.raises(KeyError, match="no deformer `melt`; use one of linearskinning"):
        find_deformers("blendshape+melt")


def test_the_page_has_all_deformers() -> None:
    page = (Path(__file__).resolve().parents[2] / "docs" / "poses.md").read_text(encoding="utf-8")
    assert [name for name in DEFORMER_BY_NAME if f"\n| `{name}` | " not in page] == []


def test_shapes_without_what_a_deformer_needs_are_refused() -> None:
    built, poses = skinned(scales=False)
    body = built.shapes["body"]
    assert body.capture is not None
    astray = replace(body.capture, names=("tail", *body.capture.names[1:]))
    for odd, name, error, why in (
        (replace(body, capture=None), "linearskinning", ValueError, "capture"),
        (replace(body, dual_quaternion_blend="soft"), "dualquatblendskinning", ValueError, "needs the point attribute `soft`"),
        (replace(body, capture=astray), "linearskinning", KeyError, "follows joint `tail`"),
    ):  # fmt: skip
        with pytest.raises(error, match=why):
            deform_binding(replace(built, shapes={"body": odd}), Binding("", "body", deformer=name), poses)


@pytest.mark.parametrize("name", ["", "linearskinning", "dualquatskinning", "dualquatblendskinning"])
def test_an_agent_is_deformed_alike_whatever_other_agents_there_are(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    built, poses = skinned(scales=True)
    binding = Binding("" if name else "j3", "body", deformer=name)
    total = deform_binding(built, binding, poses)
    order = np.array([4, 2, 6, 0, 1, 3, 5])
    monkeypatch.setattr(deformers, "_POINTS_PER_CHUNK", 1)
    for rows in (order, order[:1]):
        subset = deform_binding(
            built, binding, WorldPoses(np.ascontiguousarray(poses.world_transforms[rows]), None, poses.channels[rows])
        )
        assert subset.points.tobytes() == total.points[rows].tobytes()
        assert (
            subset.normals is not None and total.normals is not None and subset.normals.tobytes() == total.normals[rows].tobytes()
        )


def test_a_blend_shape_at_a_joint_is_carried_by_it_and_skinned_points_are_not_carried_again() -> None:
    built = replace(
        definition({"head": ""}, channels=(Channel("smile"), Channel("jaw"))),
        shapes={"face": FACE, "smile": SMILE, "open": OPEN, "ajar": AJAR},
    )
    world = np.tile(np.eye(4, dtype=np.float32)[:3], (1, 1, 1, 1))
    world[0, 0, :, 3] = (0, 10, 0)
    poses = WorldPoses(world, None, np.array([[1, 0]], np.float32))
    current, target = (
        deform_binding(built, Binding(joint, "face", deformer="blendshape"), poses).points[0] for joint in ("", "head")
    )
    assert (target - current).tolist() == [[0, 10, 0]] * len(current)
