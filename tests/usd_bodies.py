"""A body in USD: a skeleton of three joints somewhere in a stage, a skinned mesh with a blend shape and an in-between, an
animation of some joints, and a mesh that follows no joint. Needs usd-core."""

from __future__ import annotations

from pathlib import Path

import numpy as np

JOINTS = ["hip", "hip/spine", "hip/spine/head"]


def write(path: Path) -> None:
    from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, UsdSkel

    draw = np.random.default_rng(3)
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    UsdGeom.SetStageUpAxis(stage, "Y")
    stage.SetTimeCodesPerSecond(24)
    root = UsdSkel.Root.Define(stage, "/Body")
    UsdGeom.Xformable(root).AddTranslateOp().Set((1, 2, 3))
    UsdGeom.Xformable(root).AddRotateYOp().Set(30)
    skeleton = UsdSkel.Skeleton.Define(stage, "/Body/Rig")
    skeleton.CreateJointsAttr(JOINTS)
    local = [
        Gf.Matrix4d(Gf.Rotation((0, 0, 1), 10), Gf.Vec3d(0, 1, 0)),
        Gf.Matrix4d(Gf.Rotation((1, 0, 0), 20), Gf.Vec3d(0, 1, 0)),
        Gf.Matrix4d(1).SetTranslate((0, 1, 0)),
    ]
    bind = [local[0], local[1] * local[0], local[2] * local[1] * local[0]]
    skeleton.CreateBindTransformsAttr(bind)
    skeleton.CreateRestTransformsAttr(local)
    walk = UsdSkel.Animation.Define(stage, "/Body/Walk")
    walk.CreateJointsAttr([JOINTS[2], JOINTS[1]])
    walk.CreateBlendShapesAttr(["smile"])
    for frame in range(1, 13):
        share = frame / 6
        turns = (Gf.Rotation((1, 0, 1), 30 * share), Gf.Rotation((0, 1, 0), 20 * share))
        walk.CreateTranslationsAttr().Set([(0, 1, 0.1 * share), (0, 1 + 0.2 * share, 0)], frame)
        walk.CreateRotationsAttr().Set([Gf.Quatf(turn.GetQuat()) for turn in turns], frame)
        walk.CreateScalesAttr().Set([(1, 1, 1), (1, 1.1, 1)], frame)
        walk.CreateBlendShapeWeightsAttr().Set([frame / 12], frame)
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets(["/Body/Walk"])
    nod = UsdSkel.Animation.Define(stage, "/Body/Nod")  # no skeleton names it
    nod.CreateJointsAttr([JOINTS[2]])
    for attribute, value in ((nod.CreateTranslationsAttr(), (0, 1, 0)), (nod.CreateScalesAttr(), (1, 1, 1))):
        attribute.Set([value])
    nod.CreateRotationsAttr().Set([Gf.Quatf(1, 0, 0, 0)])
    skin = UsdGeom.Mesh.Define(stage, "/Body/Skin")
    points = draw.uniform(-1, 1, (12, 3)) + np.array([0, 2, 0])
    skin.CreatePointsAttr(points.tolist())
    skin.CreateFaceVertexCountsAttr([4, 4, 3])
    skin.CreateFaceVertexIndicesAttr(list(range(11)))
    weights = draw.uniform(0, 1, (12, 2))
    binding = UsdSkel.BindingAPI.Apply(skin.GetPrim())
    binding.CreateJointIndicesPrimvar(False, 2).Set(draw.integers(0, 3, 24).tolist())
    binding.CreateJointWeightsPrimvar(False, 2).Set((weights / weights.sum(axis=1, keepdims=True)).ravel().tolist())
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d(Gf.Rotation((0, 1, 0), 40), Gf.Vec3d(0.1, 0.2, 0.3)))
    binding.CreateSkeletonRel().SetTargets(["/Body/Rig"])
    smile = UsdSkel.BlendShape.Define(stage, "/Body/Skin/Smile")
    smile.CreateOffsetsAttr([(0, 0.5, 0), (0.1, 0, 0)])
    smile.CreatePointIndicesAttr([2, 5])
    half = smile.CreateInbetween("half")
    half.SetWeight(0.5)
    half.SetOffsets([(0, 0.4, 0), (0.1, 0.2, 0)])
    binding.CreateBlendShapesAttr(["smile"])
    binding.CreateBlendShapeTargetsRel().SetTargets(["/Body/Skin/Smile"])
    uvs = UsdGeom.PrimvarsAPI(skin).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, "faceVarying")
    uvs.Set(draw.uniform(0, 1, (11, 2)).tolist())
    material = UsdShade.Material.Define(stage, "/Body/Red")
    shader = UsdShade.Shader.Define(stage, "/Body/Red/Surface")
    shader.CreateIdAttr("UsdPreviewSurface")
    shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).Set((0.75, 0.125, 0.125))
    material.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
    UsdShade.MaterialBindingAPI.Apply(skin.GetPrim()).Bind(material)
    hat = UsdGeom.Mesh.Define(stage, "/Body/Hat")
    hat.CreatePointsAttr([(0, 0, 0), (1, 0, 0), (0, 0, 1)])
    hat.CreateFaceVertexCountsAttr([3])
    hat.CreateFaceVertexIndicesAttr([0, 1, 2])
    UsdGeom.Xformable(hat).AddTranslateOp().Set((0, 3, 0))
    hat.CreateDisplayColorAttr([(0, 1, 0)])
    stage.GetRootLayer().Save()
