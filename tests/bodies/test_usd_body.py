"""Bodies in USD files: what UsdSkel makes of a skeleton, a skin and an animation is what the definition says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pxr")

import usd_bodies

from antdsl.bodies.agents.definition import Binding, Channel, Definition
from antdsl.bodies.agents.transforms import compose_matrix, compute_world_matrices
from antdsl.bodies.files.reading import read_definition


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("usd") / "body.usda"
    usd_bodies.write(path)
    return path


@pytest.fixture(scope="module")
def body(file: Path) -> Definition:
    definition, report = read_definition(file)
    assert definition is not None and not report.diagnostics, report.diagnostics
    return definition


def test_joints_shapes_layers_and_colours(body: Definition) -> None:
    assert body.rig.names == ("Rig", "hip", "spine", "head", "Hat") and body.rig.parents.tolist() == [-1, 0, 1, 2, -1]
    assert body.rig.channels == (Channel("smile"),) and body.unit == pytest.approx(10)
    layer = body.layers["body"]
    assert layer.static == (Binding("Hat", "Hat"),)
    assert layer.deforming == (Binding("", "Skin", deformer="blendshape+linearskinning"),)
    skin = body.shapes["Skin"]
    assert (len(skin.points), len(skin.faces), skin.uvs is not None, skin.materials) == (11, 5, True, ("Red",))
    assert body.materials == {"Red": (0.75, 0.125, 0.125), "Hat_colour": (0.0, 1.0, 0.0)}


def test_blend_shapes_have_their_in_betweens(body: Definition) -> None:
    skin, smile = body.shapes["Skin"], body.shapes["Skin.smile"]
    assert skin.blend is not None and (skin.blend.shapes, skin.blend.channels) == (("Skin.smile",), ("smile",))
    assert smile.in_betweens is not None and (smile.in_betweens.shapes, smile.in_betweens.weights) == (
        ("Skin.smile.half",),
        (0.5,),
    )
    moved = {int(number): row for number, row in zip(skin.attributes["vertex"], smile.points - skin.points, strict=True)}
    assert np.abs(moved[2] - (0, 0.5, 0)).max() < 1e-6 and np.abs(moved[3]).max() == 0
    half = body.shapes["Skin.smile.half"].points - skin.points
    assert np.abs(half[list(moved).index(5)] - (0.1, 0.2, 0)).max() < 1e-6


def test_an_animation_that_no_skeleton_names_is_a_clip_too(body: Definition) -> None:
    assert [(clip.name, clip.sample_count, clip.joints) for clip in body.clips.values()] == [
        ("Walk", 12, ("head", "spine")), ("Nod", 1, ("head",)),
    ]  # fmt: skip
    assert body.clips["Walk"].rate == 24.0 and body.clips["Walk"].values[5, 0] == pytest.approx(0.5)


def with_custom_data(file: Path, custom_data: str) -> Path:
    text = file.read_text(encoding="utf-8")
    path = file.with_name("custom.usda")
    path.write_text(text.replace('def SkelAnimation "Walk"', f'def SkelAnimation "Walk" (customData = {{{custom_data}}})'))
    return path


def test_custom_data_of_an_animation_holds_the_settings_of_its_clip(file: Path) -> None:
    settings = "bool loop = 0; double stride = 1.5; bool feet = 0; dictionary marks = {double up = 0.25}"
    definition, report = read_definition(with_custom_data(file, f"dictionary antdsl = {{{settings}}}"))
    assert definition is not None and not report.diagnostics, report.diagnostics
    walk, nod = definition.clips["Walk"], definition.clips["Nod"]
    assert (walk.loop, walk.stride, walk.marks, walk.feet) == (False, 1.5, {"up": 0.25}, False)
    assert (nod.loop, nod.stride, nod.marks, nod.feet) == (True, 0.0, {}, True)


@pytest.mark.parametrize(
    "custom_data",
    ["double antdsl = 7", 'dictionary antdsl = {string stride = "far"}', "dictionary antdsl = {double stride = nan}"],
)
def test_other_custom_data_is_an_error(file: Path, custom_data: str) -> None:
    definition, report = read_definition(with_custom_data(file, custom_data))
    assert definition is None and [each.code for each in report.errors] == ["bad-body"]
    assert "unknown customData `antdsl` in the clip `Walk`" in report.errors[0].message


def test_points_are_where_usd_skins_them(body: Definition, file: Path) -> None:
    from pxr import Usd, UsdGeom, UsdSkel

    stage = Usd.Stage.Open(str(file))
    cache, root = UsdSkel.Cache(), UsdSkel.Root(stage.GetPrimAtPath("/Body"))
    cache.Populate(root, Usd.TraverseInstanceProxies())
    (binding,) = cache.ComputeSkelBindings(root, Usd.TraverseInstanceProxies())
    query, (target,) = cache.GetSkelQuery(binding.GetSkeleton()), binding.GetSkinningTargets()
    clip, skin = body.clips["Walk"], body.shapes["Skin"]
    assert skin.capture is not None
    for sample in range(clip.sample_count):
        code = 1 + sample
        points = UsdGeom.Mesh(target.GetPrim()).GetPointsAttr().Get()
        target.ComputeSkinnedPoints(query.ComputeSkinningTransforms(code), points, code)
        place = np.array(UsdGeom.XformCache(code).GetLocalToWorldTransform(query.GetSkeleton().GetPrim()))
        expected = (np.c_[np.array(points), np.ones(len(points))] @ place)[skin.attributes["vertex"], :3]
        local = body.rig.rest_matrices.copy()
        parts = (clip.translation, clip.rotation, clip.scale)
        for number, joint in enumerate(clip.joints):
            local[body.rig.find_joint(joint)] = compose_matrix(*(part[sample, number].astype(np.float64) for part in parts))
        world = compute_world_matrices(body.rig.parents, local)
        joint_worlds = np.array([world[body.rig.find_joint(name)] for name in skin.capture.names])
        joint_matrices = joint_worlds @ skin.capture.inverse_matrices
        homogeneous_points = np.c_[skin.points, np.ones(len(skin.points))]
        skinned_points = np.einsum(
            "pk,pkij,pj->pi", skin.capture.weights, joint_matrices[skin.capture.joints], homogeneous_points
        )
        assert np.abs(skinned_points[:, :3] - expected).max() < 1e-6


def test_a_prim_is_read_alone_and_a_missing_one_is_reported(file: Path) -> None:
    definition, report = read_definition(file, prim="/Body/Hat")
    assert definition is not None and definition.rig.names == ("Hat",), report.diagnostics
    definition, report = read_definition(file, prim="/Body/Hut")
    assert definition is None and [each.help for each in report.errors] == ["did you mean `/Body/Hat`?"]


def test_other_rates_and_damaged_files(file: Path, tmp_path: Path) -> None:
    definition, _ = read_definition(file, rate=96.0)
    assert definition is not None and definition.clips["Walk"].sample_count == 45
    text = file.read_text(encoding="utf-8")
    for number, (old, new) in enumerate(
        [
            ("point3f[] points = [(", "point3f[] points = [(nan, 1, 1), ("), ("elementSize = 2", "elementSize = 5"),
            ('uniform token[] joints = ["hip", ', 'uniform token[] joints = ["hop", '),
            ("pointIndices = [2, 5]", "pointIndices = [2, 500]"), ("[0, 1, 2, 3,", "[0, 1, 2, 300,"), ("def Mesh", "deaf Mesh"),
        ]
    ):  # fmt: skip
        assert old in text, old
        path = tmp_path / f"damaged{number}.usda"
        path.write_text(text.replace(old, new), encoding="utf-8")
        definition, report = read_definition(path)
        assert (definition is None) == bool(report.errors), (old, report.diagnostics)
        assert definition is None or old.startswith("uniform"), old
