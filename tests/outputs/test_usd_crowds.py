"""Crowds in USD: skeletons and banks of poses, what moves them between frames, values in files of their own."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pxr = pytest.importorskip("pxr")

from antdsl.bodies.agents.definition import (  # noqa: E402
    Binding,
    BlendTargets,
    Channel,
    Definition,
    InBetweens,
    Layer,
    Rig,
    SkinShape,
    SkinWeights,
)
from antdsl.bodies.agents.poses import WorldPoses  # noqa: E402
from antdsl.bodies.body import build_rotation_matrices  # noqa: E402
from antdsl.bodies.posed_body import PosedBody  # noqa: E402
from antdsl.outputs.cache.cache_reader import Cache, open_cache  # noqa: E402
from antdsl.outputs.edits.frame_rows import SPECIES_PER_KEY  # noqa: E402
from antdsl.outputs.exports import AgentSubset  # noqa: E402
from antdsl.outputs.gallery import Gallery  # noqa: E402
from antdsl.outputs.pictures.model import Picture  # noqa: E402
from antdsl.outputs.recording import begin_recording, record_frames  # noqa: E402
from antdsl.outputs.usd.stage import UsdOptions, export_instances, export_xforms  # noqa: E402
from antdsl.outputs.usd.time_samples import compute_rotation_vectors, rotate_orientations  # noqa: E402
from antdsl.pipeline import RunChoices, open_scene  # noqa: E402
from antdsl.runtime import Options  # noqa: E402
from antdsl.scene.values import FrameRange  # noqa: E402

WALKER = Path(__file__).parents[2] / "examples" / "walker"
FRAMES, PEOPLE = 9, 8
BREEDERS = """ant 1
use steering
world { surface hill }
species breeder {
  max_speed 2 m/s
  size 1 m
  start go
  state go amber { steer wander(); when chance 600 %/s -> split; when age > 0.15 s and id < 3 -> gone }
  state split red { enter { spawn breeder }; steer wander(); when after 0.1 s -> go }
  state gone { enter { die } }
  layers { state }
}
"""
CARRIERS = """ant 1
use steering
world { surface hill }
species carrier {
  max_speed 2 m/s
  size 1 m
  start go
  state go amber { steer wander(); when age > 0.04 s + id * 0.04 s -> carry }
  state carry red { wear load; steer wander(); when after 0.1 s -> go }
  layers { state }
}
"""


def recorded(folder: Path, frames: int) -> Cache:
    shot, report = open_scene(folder / "scene.yaml", RunChoices(frames=FrameRange(1, frames)))
    assert shot is not None, str(report)
    for _ in record_frames(begin_recording(shot, folder / "out", Options(), resume=False, force=False)):
        pass
    return open_cache(folder / "out")


@pytest.fixture(scope="module")
def people(tmp_path_factory: pytest.TempPathFactory) -> Cache:
    """Some people of the example, who play clips and have a body of their own."""
    folder = tmp_path_factory.mktemp("walker")
    for path in WALKER.iterdir():
        shutil.copy(path, folder / path.name)
    text = (folder / "scene.yaml").read_text().replace("count: 60", f"count: {PEOPLE}").replace("radius: 11 m", "radius: 6 m")
    (folder / "scene.yaml").write_text(text)
    return recorded(folder, FRAMES)


@pytest.fixture(scope="module")
def breeders(tmp_path_factory: pytest.TempPathFactory) -> Cache:
    """Ants of which some are born and some die."""
    folder = tmp_path_factory.mktemp("breeders")
    shutil.copy(WALKER / "hill.ply", folder / "hill.ply")
    (folder / "breed.ant").write_text(BREEDERS)
    (folder / "scene.yaml").write_text(
        "antdsl: 1\nunits: m\nframes: 1..8\nworld:\n  hill: {mesh: hill.ply}\n"
        "crowd:\n  - {species: breeder, from: breed.ant, count: 6, place: {on: hill, radius: 8 m}}\n"
    )
    return recorded(folder, 8)


@pytest.fixture(scope="module")
def carriers(tmp_path_factory: pytest.TempPathFactory) -> Cache:
    """Ants that take up a load, each in a different frame."""
    folder = tmp_path_factory.mktemp("carriers")
    shutil.copy(WALKER / "hill.ply", folder / "hill.ply")
    (folder / "carry.ant").write_text(CARRIERS)
    (folder / "scene.yaml").write_text(
        "antdsl: 1\nunits: m\nframes: 1..6\nworld:\n  hill: {mesh: hill.ply}\n"
        "crowd:\n  - {species: carrier, from: carry.ant, count: 5, place: {on: hill, radius: 8 m}}\n"
    )
    return recorded(folder, 6)


def exported(cache: Cache, path: Path, *, xforms: bool = False, states: bool = False, **options: object):  # type: ignore[no-untyped-def]
    from pxr import Usd

    export = export_xforms if xforms else export_instances
    notes = export(Gallery(cache, shows_states=states), cache.frames(), path, UsdOptions(**options))  # type: ignore[arg-type]
    assert notes == []
    return Usd.Stage.Open(str(path))


def found_by_validators(stage) -> list[tuple[str, str]]:  # type: ignore[no-untyped-def]
    UsdValidation = pytest.importorskip("pxr.UsdValidation")
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    return [(e.GetName(), e.GetMessage()) for e in UsdValidation.ValidationContext(validators).Validate(stage)]


def skinned(stage, path: str, time: float) -> np.ndarray:  # type: ignore[no-untyped-def]
    """The points of an agent in the world, by USD's own skinning."""
    from pxr import Usd, UsdGeom, UsdSkel

    root, cache, parts = UsdSkel.Root(stage.GetPrimAtPath(path)), UsdSkel.Cache(), []
    cache.Populate(root, Usd.TraverseInstanceProxies())
    transforms = UsdGeom.XformCache(time)
    for binding in cache.ComputeSkelBindings(root, Usd.TraverseInstanceProxies()):
        joints = cache.GetSkelQuery(binding.GetSkeleton()).ComputeSkinningTransforms(time)
        world = np.array(transforms.GetLocalToWorldTransform(binding.GetSkeleton().GetPrim()))
        for target in binding.GetSkinningTargets():
            points = UsdGeom.Mesh(target.GetPrim()).GetPointsAttr().Get()
            if target.IsRigidlyDeformed():
                matrix = np.array(target.ComputeSkinnedTransform(joints, time))
                points = np.array(points) @ matrix[:3, :3] + matrix[3, :3]
            else:
                assert target.ComputeSkinnedPoints(joints, points, time)
            parts.append(np.array(points) @ world[:3, :3] + world[3, :3])
    return np.concatenate(parts)


def test_an_agent_with_a_skeleton_is_an_instance_posed_as_in_pictures(people: Cache, tmp_path: Path) -> None:
    stage = exported(people, tmp_path / "out.usdc", target="houdini")
    agents = [prim for prim in stage.GetPrimAtPath("/World/walker").GetChildren() if prim.GetName().startswith("agent_")]
    assert len(agents) == PEOPLE and all(prim.IsInstance() for prim in agents)
    assert len(stage.GetPrototypes()) == 1, "one definition"
    sources = {str(prim.GetRelationship("skel:animationSource").GetTargets()[0]) for prim in agents}
    assert len(sources) == PEOPLE
    for frame in (1, 5, FRAMES):
        crowd = Gallery(people).make_picture(frame).crowds[0]
        assert crowd.body is not None and crowd.ids is not None
        poses = crowd.body.compute_poses(crowd.machine_clips, PEOPLE, feet=crowd.select_feet(np.arange(PEOPLE)))

        points = crowd.body.compute_shape_points(poses)[0]
        for k in range(0, PEOPLE, 3):
            mine = points[k] * crowd.scale[k] @ build_rotation_matrices(crowd.orient[k : k + 1])[0].T + crowd.position[k]
            theirs = skinned(stage, f"/World/walker/agent_{crowd.ids[k]}", frame)
            assert np.abs(mine - theirs).max() < 1e-5 * crowd.scale[k]


def test_definitions_are_loaded_when_they_are_drawn(people: Cache, tmp_path: Path) -> None:
    from pxr import Usd

    for skeletons in (0, 100):
        path = tmp_path / f"out{skeletons}.usdc"
        full = exported(people, path, skeletons=skeletons)
        bare = Usd.Stage.Open(str(path), Usd.Stage.LoadNone)
        drawn = [str(prim.GetPath()) for prim in full.Traverse(Usd.TraverseInstanceProxies()) if prim.GetTypeName() == "Mesh"]
        assert len(drawn) > PEOPLE
        left = [prim for prim in bare.Traverse(Usd.TraverseInstanceProxies()) if prim.GetAttribute("points").HasValue()]
        assert [str(prim.GetPath()) for prim in left] == ["/World/hill"]


@pytest.mark.parametrize(
    "options",
    [
        {"target": "blender", "chunk": 4},
        {"target": "houdini"},
        {"target": "usdview", "chunk": 4},
        {"skeletons": 0},
        {"shutter": (-0.5, 0.5), "samples": 2, "skeletons": 0, "chunk": 4},
    ],
    ids=["blender", "houdini", "usdview", "bank", "chunks"],
)
def test_validators_find_nothing(people: Cache, breeders: Cache, tmp_path: Path, options: dict[str, object]) -> None:
    for cache in (people, breeders):
        assert found_by_validators(exported(cache, tmp_path / "out.usdc", **options)) == []


def test_velocities_lead_to_the_next_frame(people: Cache, tmp_path: Path) -> None:
    """Equal to what the cache has, and half a frame on, or a whole one, instances are where the next frame has them."""
    from pxr import Gf, UsdGeom

    stage = exported(people, tmp_path / "out.usdc", skeletons=0)
    instancer = UsdGeom.PointInstancer(stage.GetPrimAtPath("/World/walker"))
    times = instancer.GetPositionsAttr().GetTimeSamples()
    for name in ("orientations", "orientationsf", "velocities", "angularVelocities"):
        assert instancer.GetPrim().GetAttribute(name).GetTimeSamples() == times == list(range(1, FRAMES + 1))
    previous_orient = None
    for frame in range(1, FRAMES):
        arrays, next_arrays = people.frame(frame), people.frame(frame + 1)
        fps = stage.GetTimeCodesPerSecond()
        moved = (next_arrays["P"].astype(np.float64) - arrays["P"]) * fps
        assert np.allclose(instancer.GetVelocitiesAttr().Get(frame), moved, atol=1e-5)
        turn = np.degrees(compute_rotation_vectors(unit(arrays["orient"]), unit(next_arrays["orient"]))) * fps
        assert np.allclose(instancer.GetAngularVelocitiesAttr().Get(frame), turn, atol=1e-3) and np.abs(turn).max() > 1
        full = np.array([[*q.GetImaginary(), q.GetReal()] for q in instancer.GetOrientationsfAttr().Get(frame)])
        assert np.abs(np.abs((full * unit(arrays["orient"])).sum(axis=1)) - 1).max() < 1e-6
        assert previous_orient is None or ((full * previous_orient).sum(axis=1) > 0).all(), "no sign flips"
        previous_orient = full
        for share in (0.5, 1.0):
            transforms = instancer.ComputeInstanceTransformsAtTime(frame + share, frame, UsdGeom.PointInstancer.ExcludeProtoXform)
            place = arrays["P"] + (next_arrays["P"].astype(np.float64) - arrays["P"]) * share
            orient = rotate_orientations(unit(arrays["orient"]), np.radians(turn) / fps * share)
            for k, matrix in enumerate(transforms):
                assert np.allclose(matrix.ExtractTranslation(), place[k], atol=1e-4)
                axes = np.array([matrix.TransformDir(Gf.Vec3d(*axis)).GetNormalized() for axis in np.eye(3).tolist()])
                assert np.abs(axes.T - build_rotation_matrices(orient[k : k + 1])[0]).max() < 2e-3, (
                    "orientations of half precision"
                )


@pytest.mark.parametrize("target", ["blender", "houdini"])
def test_velocities_of_agents_with_skeletons_lead_to_the_next_frame(people: Cache, tmp_path: Path, target: str) -> None:
    from pxr import UsdGeom

    stage = exported(people, tmp_path / "out.usdc", target=target, shutter=(0, 0.5), samples=2)
    fps = stage.GetTimeCodesPerSecond()
    for name in range(PEOPLE):
        prim = stage.GetPrimAtPath(f"/World/walker/agent_{name}")
        api, place = UsdGeom.PrimvarsAPI(prim), prim.GetAttribute("xformOp:translate")
        velocity, spin = (api.GetPrimvar(each).GetAttr() for each in ("velocity", "angularVelocity"))
        assert velocity.GetTimeSamples() == spin.GetTimeSamples() == place.GetTimeSamples()
        for frame in range(1, FRAMES):
            start, end = (np.array(place.Get(time)) for time in (frame, frame + 1))
            assert np.allclose(start + np.array(velocity.Get(frame)) / fps, end, atol=1e-5)
            first, second = (people.frame(each)["orient"][name : name + 1] for each in (frame, frame + 1))
            turn = np.radians([spin.Get(frame)]) / fps
            assert np.abs((rotate_orientations(unit(first), turn) * unit(second)).sum()) > 1 - 1e-6


def unit(orient: np.ndarray) -> np.ndarray:
    wide = orient.astype(np.float64)
    return wide / np.linalg.norm(wide, axis=1, keepdims=True)


def test_turns_between_orientations_are_those_that_lead_there() -> None:
    rng = np.random.default_rng(3)
    a, b = (unit(rng.normal(size=(50, 4))) for _ in range(2))
    b[:5] = -a[:5]  # the same orientation
    orientations = rotate_orientations(a, compute_rotation_vectors(a, b))
    assert np.abs(np.abs((orientations * b).sum(axis=1)) - 1).max() < 1e-12
    assert (
        np.abs(compute_rotation_vectors(a, b)[:5]).max() < 1e-7
        and np.linalg.norm(compute_rotation_vectors(a, b), axis=1).max() <= np.pi + 1e-9
    )


def test_prototypes_are_the_nearest_poses_in_the_colour_of_the_state(people: Cache, tmp_path: Path) -> None:
    from pxr import UsdGeom, UsdShade

    from antdsl.outputs.pictures.light import decode_srgb

    stage = exported(people, tmp_path / "out.usdc", skeletons=0, states=True)
    instancer = UsdGeom.PointInstancer(stage.GetPrimAtPath("/World/walker"))
    paths = instancer.GetPrototypesRel().GetTargets()
    states = people.manifest.species[0].machines[0].states
    used = set()
    for frame in (2, FRAMES):
        crowd = Gallery(people).make_picture(frame).crowds[0]
        assert crowd.body is not None
        numbers, state = instancer.GetProtoIndicesAttr().Get(frame), people.frame(frame)["state"]
        points = crowd.body.coarse_body.compute_shape_points(crowd.body.coarse_body.compute_poses(crowd.machine_clips, PEOPLE))[0]
        for k in range(PEOPLE):
            mesh = UsdGeom.Mesh(stage.GetPrimAtPath(paths[numbers[k]]))
            used.add(paths[numbers[k]])
            assert np.linalg.norm(np.array(mesh.GetPointsAttr().Get()) - points[k], axis=1).mean() < 0.03
            assert re.fullmatch(rf"walker(_[a-z]+_\d\d)*_{states[state[k]].name}", mesh.GetPrim().GetName())
            colour = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("displayColor").Get()
            assert np.allclose(colour[0], decode_srgb(np.array(states[state[k]].colour)), atol=1e-6)
            assert mesh.GetNormalsAttr().HasValue() and mesh.GetNormalsInterpolation() == "vertex"
        assert np.array_equal(
            UsdGeom.PrimvarsAPI(instancer).GetPrimvar("state").ComputeFlattened(frame), [states[s].name for s in state]
        )
    subsets = UsdGeom.Subset.GetGeomSubsets(mesh, "face", "materialBind")
    assert len(used) > 3 and {subset.GetPrim().GetName() for subset in subsets} == {"state", "skin", "cloth", "leather"}
    for subset in subsets:
        material = UsdShade.MaterialBindingAPI(subset.GetPrim()).ComputeBoundMaterial()[0]
        assert material.ComputeSurfaceSource()[0].GetIdAttr().Get() == "UsdPreviewSurface"


def test_a_shutter_has_samples_between_frames(people: Cache, tmp_path: Path) -> None:
    from pxr import UsdGeom

    bank = exported(people, tmp_path / "bank.usdc", skeletons=0, shutter=(-0.25, 0.25), samples=3)
    instancer = UsdGeom.PointInstancer(bank.GetPrimAtPath("/World/walker"))
    times = instancer.GetPositionsAttr().GetTimeSamples()
    assert times == [frame + part for frame in range(1, FRAMES + 1) for part in (-0.25, 0.0, 0.25)]
    four, five = (people.frame(frame)["P"].astype(np.float64) for frame in (4, 5))
    assert np.allclose(instancer.GetPositionsAttr().Get(4.25), four + (five - four) / 4, atol=1e-5)
    assert np.allclose(instancer.GetPositionsAttr().Get(4.75), five + (four - five) / 4, atol=1e-5)
    assert np.allclose(instancer.GetVelocitiesAttr().Get(4.25), instancer.GetVelocitiesAttr().Get(4))
    for frame in range(1, FRAMES + 1):
        poses = [list(instancer.GetProtoIndicesAttr().Get(frame + part)) for part in (-0.25, 0.0, 0.25)]
        assert poses[0] == poses[1] == poses[2], "one mesh while the shutter is open"
    one = people.frame(1)["P"] - np.array(instancer.GetVelocitiesAttr().Get(1)) / 24 / 4
    assert np.allclose(instancer.GetPositionsAttr().Get(0.75), one, atol=1e-5), "before the first frame its velocities lead back"
    limbs = exported(people, tmp_path / "limbs.usdc", shutter=(0, 0.5), samples=2)
    turns = limbs.GetPrimAtPath("/World/walker/motion/agent_0").GetAttribute("rotations")
    assert turns.GetTimeSamples() == [frame + part for frame in range(1, FRAMES + 1) for part in (0.0, 0.5)]
    eight, nine, on = (np.array([[*q.GetImaginary(), q.GetReal()] for q in turns.Get(time)]) for time in (8, 9, 9.5))
    assert np.abs(on - nine).max() > 0.003 and ((on - nine) * (nine - eight)).sum() > 0, "limbs go on beyond the last frame"
    a, b, c = (np.array([[*q.GetImaginary(), q.GetReal()] for q in turns.Get(time)]) for time in (3, 3.5, 4))
    assert np.abs(c - a).max() > 0.01 and np.allclose(b, unit(a + c), atol=1e-6)


@pytest.mark.parametrize("skeletons", [0, 1000])
def test_values_in_files_of_their_own_are_the_same(breeders: Cache, people: Cache, tmp_path: Path, skeletons: int) -> None:
    """At frames, between them and on both sides of where a file ends; of agents too that come later and go."""
    for number, cache in enumerate((breeders, people)):
        one = exported(cache, tmp_path / f"one{number}.usda", skeletons=skeletons)
        many = exported(cache, tmp_path / f"many{number}.usda", skeletons=skeletons, chunk=3)
        names = sorted(path.name for path in tmp_path.glob(f"many{number}.values.*"))
        assert names == [f"many{number}.values.{k}" for k in ("0001.usdc", "0004.usdc", "0007.usdc", "manifest.usda")]
        assert ".timeSamples" not in (tmp_path / f"many{number}.usda").read_text()
        different = 0
        for prim in one.Traverse():
            other = many.GetPrimAtPath(prim.GetPath())
            for attribute in prim.GetAttributes():
                for time in (1, 2.5, 3, 3.5, 4, 6.75, 7, 8):
                    mine, theirs = attribute.Get(time), other.GetAttribute(attribute.GetName()).Get(time)
                    if prim.GetName() != "motion" and attribute.GetName() != "visibility" and hidden(prim, time):
                        continue
                    different += int(not same(mine, theirs))
        assert different == 0
    assert not list(tmp_path.glob(".*"))


def hidden(prim, time: float) -> bool:  # type: ignore[no-untyped-def]
    """Whether an agent, or what animates it, is not there."""
    from pxr import UsdGeom

    agent = prim.GetStage().GetPrimAtPath(str(prim.GetPath()).replace("/motion/", "/"))
    return bool(UsdGeom.Imageable(agent).ComputeVisibility(time) == "invisible")


def same(mine: object, theirs: object) -> bool:
    if mine == theirs:
        return True
    try:
        return np.allclose(np.asarray(mine, np.float64), np.asarray(theirs, np.float64), atol=1e-6)
    except (TypeError, ValueError):
        return False


def test_copies_have_their_colours_themselves(people: Cache, tmp_path: Path) -> None:
    from pxr import UsdGeom

    stage = exported(people, tmp_path / "out.usda", target="blender")
    prim = stage.GetPrimAtPath("/World/walker/agent_0")
    assert not prim.IsInstance()
    colours = [UsdGeom.PrimvarsAPI(prim).GetPrimvar("displayColor")]
    for name in ("trunk", "arm", "arm_2"):
        mesh = stage.GetPrimAtPath(f"/World/walker/agent_0/rig/crowd/{name}")
        colours.append(UsdGeom.PrimvarsAPI(mesh).GetPrimvar("displayColor"))
    assert all(np.allclose(colour.Get(4), colours[0].Get(4)) for colour in colours)
    assert (
        not UsdGeom.PrimvarsAPI(stage.GetPrimAtPath("/World/walker/agent_0/rig/crowd/head")).GetPrimvar("displayColor").HasValue()
    )


def test_close_bodies_are_a_variant(breeders: Cache, tmp_path: Path) -> None:
    from pxr import Usd

    stage = exported(breeders, tmp_path / "out.usdc")
    prim = stage.GetPrimAtPath("/World/breeder/agent_0")
    counts = {}
    for name in prim.GetVariantSets().GetVariantSet("detail").GetVariantNames():
        prim.GetVariantSets().GetVariantSet("detail").SetVariantSelection(name)
        meshes = [p for p in Usd.PrimRange(prim, Usd.TraverseInstanceProxies()) if p.GetTypeName() == "Mesh"]
        counts[name] = sum(len(p.GetAttribute("faceVertexCounts").Get()) for p in meshes)
    assert counts["crowd"] < 500 and counts["close"] > 10_000
    closer = exported(breeders, tmp_path / "close.usdc", close=True)
    assert closer.GetPrimAtPath("/World/breeder/agent_0").GetVariantSets().GetVariantSelection("detail") == "close"


def test_blended_and_skinned_shapes_are_those_of_usd(tmp_path: Path) -> None:
    """In-betweens, normals, several bind poses: UsdSkel gives the points that our deformers give."""
    from pxr import Sdf, Usd, UsdSkel

    from antdsl.outputs.usd.definitions import write_definition
    from antdsl.outputs.usd.materials import MaterialBinder

    rng = np.random.default_rng(5)
    rest = np.tile(np.eye(4), (3, 1, 1))
    rest[1, :3, 3], rest[2, :3, 3] = (0, 1, 0), (0.2, 1, 0)
    rig = Rig(("root", "arm", "hand"), np.array([-1, 0, 1], np.int32), rest, (Channel("smile"),))
    world = [np.linalg.inv(rest[0]), np.linalg.inv(rest[0] @ rest[1]), np.linalg.inv(rest[0] @ rest[1] @ rest[2])]
    weights = rng.uniform(0, 1, (12, 2)).astype(np.float32)
    weights /= weights.sum(axis=1, keepdims=True)
    faces = np.arange(12, dtype=np.int32).reshape(4, 3)
    points = rng.normal(size=(12, 3)).astype(np.float32)

    def captured(inverse: list[np.ndarray]) -> SkinWeights:
        return SkinWeights(("root", "arm", "hand"), rng.integers(0, 3, (12, 2)).astype(np.int32), weights, np.array(inverse))

    moved = [matrix @ np.diag([1, 1, 1, 1.0]) for matrix in world]
    moved[2] = moved[2].copy()
    moved[2][:3, 3] += 0.5
    face = SkinShape("face", points, faces, capture=captured(world), blend=BlendTargets(("smiles",), ("smile",)))
    shapes = {
        "face": face,
        "smiles": SkinShape(
            "smiles", points + rng.normal(size=(12, 3)).astype(np.float32), faces, in_betweens=InBetweens(("half",), (0.4,))
        ),
        "half": SkinShape("half", points + rng.normal(size=(12, 3)).astype(np.float32), faces),
        "coat": replace(face, name="coat", blend=None, capture=captured(moved)),
    }
    layer = Layer(
        "body", (), (Binding("", "face", deformer="blendshape+linearskinning"), Binding("", "coat", deformer="dualquatskinning"))
    )
    body = PosedBody(Definition("it", rig, shapes, {"body": layer}), ())
    stage = Usd.Stage.CreateInMemory()
    looks = MaterialBinder(stage, "/World/looks/it", {})
    usd_definition = write_definition(stage, "/it", body, looks)
    assert usd_definition.channels == ("smile",) and not usd_definition.notes
    assert [str(p.GetPath()) for p in stage.Traverse() if p.GetTypeName() == "Skeleton"] == [
        "/it/rig/skeleton",
        "/it/rig/skeleton_2",
    ]
    turns = np.array([[0.1, 0.2, 0.3, 0.9], [0.5, -0.1, 0.2, 0.8], [0, 0.3, -0.4, 0.8]])
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    local = np.tile(np.eye(4), (3, 1, 1))
    local[:, :3, :3], local[:, :3, 3] = build_rotation_matrices(turns), rng.normal(size=(3, 3))
    placed = np.stack([local[0], local[0] @ local[1], local[0] @ local[1] @ local[2]])
    moves = UsdSkel.Animation.Define(stage, "/moves")
    moves.CreateJointsAttr(list(usd_definition.joints))
    moves.SetTransforms([pxr.Gf.Matrix4d(*m.T.ravel().tolist()) for m in local])
    moves.CreateBlendShapesAttr(["smile"])
    UsdSkel.BindingAPI.Apply(stage.GetPrimAtPath("/it")).CreateAnimationSourceRel().SetTargets([Sdf.Path("/moves")])
    for weight in (0.0, 0.2, 0.4, 0.7, 1.0, 1.3):
        moves.CreateBlendShapeWeightsAttr([weight])
        poses = WorldPoses(placed[None, :, :3].astype(np.float32), None, np.array([[weight]], np.float32))
        from antdsl.bodies.agents.deformers import deform_binding

        root, cache = UsdSkel.Root(stage.GetPrimAtPath("/it")), UsdSkel.Cache()
        cache.Populate(root, Usd.PrimDefaultPredicate)
        for binding in cache.ComputeSkelBindings(root, Usd.PrimDefaultPredicate):
            query = cache.GetSkelQuery(binding.GetSkeleton())
            for target in binding.GetSkinningTargets():
                name = target.GetPrim().GetName()
                mine = deform_binding(body.drawn_definition, next(b for b in body.bindings if b.shape == name), poses).points[0]
                theirs = target.GetPrim().GetAttribute("points").Get()
                if name == "face":
                    theirs = blended(target, theirs, weight)
                assert target.ComputeSkinnedPoints(query.ComputeSkinningTransforms(0), theirs, 0)
                assert np.abs(np.array(theirs) - mine).max() < 1e-5


def blended(target, points, weight: float):  # type: ignore[no-untyped-def]
    from pxr import UsdSkel

    query = UsdSkel.BlendShapeQuery(UsdSkel.BindingAPI(target.GetPrim()))
    weights, shapes, subs = query.ComputeSubShapeWeights([weight])
    assert query.ComputeDeformedPoints(
        weights, shapes, subs, query.ComputeBlendShapePointIndices(), query.ComputeSubShapePointOffsets(), points
    )
    return points


def test_feet_and_trunks_of_skeletons_are_where_pictures_have_them(breeders: Cache, tmp_path: Path) -> None:
    """UsdSkel has scales in half precision: a gaster that breathes is off by a few ten-thousandths of a body length."""

    stage = exported(breeders, tmp_path / "out.usdc")
    crowd = Gallery(breeders).make_picture(6).crowds[0]
    assert crowd.body is not None and crowd.feet is not None and crowd.ids is not None
    points = crowd.body.compute_shape_points(crowd.compute_poses())[0]
    flat = crowd.body.compute_shape_points(crowd.body.compute_poses(crowd.machine_clips, len(points)))[0]
    assert np.abs(points - flat).max() > 0.02, "feet matter"
    for k in range(0, len(points), 3):
        mine = points[k] * crowd.scale[k] @ build_rotation_matrices(crowd.orient[k : k + 1])[0].T + crowd.position[k]
        assert np.abs(mine - skinned(stage, f"/World/breeder/agent_{crowd.ids[k]}", 6)).max() < 4e-4 * crowd.scale[k]


def test_agents_without_a_place_are_invisible(people: Cache, tmp_path: Path) -> None:
    from pxr import Usd, UsdGeom

    from antdsl.outputs.usd.instancers import InstancerWriter
    from antdsl.outputs.usd.time_samples import TimeSamples
    from antdsl.outputs.usd.values import StageOutput

    gallery, stage = Gallery(people), Usd.Stage.CreateInMemory()
    writer = InstancerWriter(StageOutput(stage), people.manifest.species[0], 0)
    time_sample = TimeSamples(gallery).build_sample(2, 2)
    agents = time_sample.species[0]
    is_visible = agents.is_visible.copy()
    is_visible[3] = False
    writer.sample(replace(time_sample, species=(replace(agents, is_visible=is_visible),)))
    instancer = UsdGeom.PointInstancer(stage.GetPrimAtPath("/World/walker"))
    assert list(instancer.GetInvisibleIdsAttr().Get(2)) == [agents.ids[3]]
    assert list(instancer.ComputeMaskAtTime(2)) == is_visible.tolist()


def test_missing_features_of_usdskel_are_reported() -> None:
    from pxr import Usd

    from antdsl.bodies.agents.deformers import DEFORMER_BY_NAME, register_deformer
    from antdsl.outputs.usd.definitions import write_definition
    from antdsl.outputs.usd.materials import MaterialBinder

    rest = np.eye(4)[None]
    capture = SkinWeights(("root",), np.zeros((3, 1), np.int32), np.ones((3, 1), np.float32), rest)
    points, faces = np.eye(3, dtype=np.float32), np.array([[0, 1, 2]], np.int32)
    share = {"share": np.ones(3, np.float32)}
    skin = SkinShape("skin", points, faces, attributes=dict(share), capture=capture, dual_quaternion_blend="share")
    layer = Layer("body", (), (Binding("", "skin", deformer="dualquatblendskinning"), Binding("root", "fur", deformer="ruffled")))
    register_deformer("ruffled", lambda vertices, shape, definition, poses: vertices)
    try:
        shapes = {"skin": skin, "fur": SkinShape("fur", points, faces)}
        body = PosedBody(Definition("it", Rig(("root",), np.array([-1], np.int32), rest), shapes, {"body": layer}), ())
        stage = Usd.Stage.CreateInMemory()
        notes = write_definition(stage, "/it", body, MaterialBinder(stage, "/World/looks/it", {})).notes
    finally:
        del DEFORMER_BY_NAME["ruffled"]
    assert len(notes) == 2 and "dual quaternions" in notes[0] and "`ruffled`" in notes[1]


@pytest.mark.parametrize("chunk", [0, 2])
def test_who_takes_up_a_load_is_an_instance_of_the_body_that_has_one(carriers: Cache, tmp_path: Path, chunk: int) -> None:
    from pxr import Usd, UsdGeom

    stage = exported(carriers, tmp_path / "out.usdc", target="usdview", chunk=chunk)
    turns = 0
    for frame in carriers.frames():
        wears = carriers.frame(frame)["wears.carrier"].astype(bool)
        for number, loaded in enumerate(wears.tolist()):
            prims = [stage.GetPrimAtPath(f"/World/carrier/agent_{number}{end}") for end in ("", "_1", "_2")]
            visible_prims = [p for p in prims if p and UsdGeom.Imageable(p).ComputeVisibility(frame) == "inherited"]
            assert len(visible_prims) == 1 and visible_prims[0].IsInstance(), (frame, number)
            below = {prim.GetName() for prim in Usd.PrimRange(visible_prims[0], Usd.TraverseInstanceProxies())}
            assert ("crumb" in below) == loaded, (frame, number, below)
        turns += int((wears != carriers.frame(1)["wears.carrier"].astype(bool)).sum())
    assert turns, "somebody takes up a load"
    assert [prim.GetName() for prim in stage.GetPrimAtPath("/bodies").GetAllChildren()] == ["carrier", "carrier_with_load"]
    assert not found_by_validators(stage)


def test_some_agents_wear_what_they_wear_among_all(carriers: Cache) -> None:
    subset_cache = AgentSubset.of(carriers, frozenset([1 * SPECIES_PER_KEY, 3 * SPECIES_PER_KEY]))
    worn = set()
    for frame in carriers.frames():
        all_layers = layers_by_id(Gallery(carriers).make_picture(frame))
        assert layers_by_id(Gallery(subset_cache).make_picture(frame)) == {name: all_layers[name] for name in (1, 3)}
        worn |= {all_layers[1], all_layers[3]}
    assert len(worn) == 2


def layers_by_id(picture: Picture) -> dict[int, tuple[str, ...]]:
    return {int(name): crowd.body.layers for crowd in picture.crowds for name in crowd.ids}


def test_things_of_one_name_and_a_field_that_is_gone_keep_apart() -> None:
    from pxr import Usd

    from antdsl.outputs.pictures.model import Item, Trail
    from antdsl.outputs.usd.values import StageOutput
    from antdsl.outputs.usd.world import WorldWriter
    from antdsl.scene.light_model import LightSettings

    out = StageOutput(Usd.Stage.CreateInMemory())
    assert [out.name("species", "camera"), out.name("mesh", "ant"), out.name("species", "ant")] == ["camera_2", "ant", "ant_2"]
    assert out.name("mesh", "ant") == "ant"

    class Nothing:
        manifest = type("Manifest", (), {"up": "y", "units": "mm", "named_cameras": {}})
        light = LightSettings()
        static = None

    writer = WorldWriter(out, Nothing(), [1, 2, 3])  # type: ignore[arg-type]
    items = tuple(Item("it", (float(x), 0.0, 0.0), 1.0, 1.0, "apple") for x in (0, 5))
    trail = Trail("trail", np.zeros((2, 3)), np.ones(2), 1.0, (1.0, 0.0, 0.0), 1.0)
    for frame, trails in ((1, ()), (2, (trail,)), (3, ())):
        writer.frame(frame, Picture((), (), items, trails))
    positions = [p.GetAttribute("xformOp:translate").Get(1)[0] for p in out.stage.GetPrimAtPath("/World/items").GetChildren()]
    assert positions == [0, 5]
    points = out.stage.GetPrimAtPath("/World/fields/trail").GetAttribute("points")
    assert [len(points.Get(frame)) for frame in (1, 2, 3)] == [0, 2, 0]
