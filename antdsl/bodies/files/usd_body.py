"""Converts a USD file to an agent definition, using UsdSkel. Skeletons become joints, meshes become shapes, animations become
clips. Blend shapes and in-betweens stay blend shapes.

The prim of a skeleton becomes a joint above the skeleton's joints, with the same name and transform. A mesh that is not skinned
gets a joint with the mesh's transform. Units and axes are those of the stage. This module runs in the reader's process, at the
request of `usd_definition`.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.bodies.agents.definition import Binding, BodyError, Clip, Definition, Layer, Rig
from antdsl.bodies.agents.packed import pack_definition
from antdsl.bodies.agents.transforms import align_signs, compose_transforms, normalise_quaternion
from antdsl.bodies.files.gltf.gltf_clips import EXTRAS_KEY, compute_even_times
from antdsl.bodies.files.gltf.gltf_shapes import build_rigid_capture, make_unused_name
from antdsl.bodies.files.usd_shapes import Skin, UsdBody, read_usd_shape
from antdsl.reader.protocol import RefusalError
from antdsl.scene.geometry.matrices import has_inverse, invert_transforms
from antdsl.scene.geometry.usd.child.guard import ReaderAnswer, wrap_refusals
from antdsl.scene.geometry.usd.child.stage import OpenStage, open_stage
from antdsl.scene.geometry.usd.errors import import_pxr_module

if TYPE_CHECKING:
    from antdsl.reader.protocol import ReaderMessage

Floats = NDArray[np.float64]
BASE_LAYER = "body"


@dataclass(slots=True)
class _Skeleton:
    """A skeleton with its joints. `paths`: the path of each joint in the skeleton. `names`: the name of each joint in the rig."""

    prim: Any
    query: Any
    paths: list[str]
    names: list[str]


@wrap_refusals
def read_body(request: ReaderMessage) -> ReaderAnswer:
    """Read a definition in the reader's process. Return an answer with the arrays of `pack_definition`.

    The answer also has `left_out`, sentences about the parts of the file that are not read. Its `settings` are a JSON text with
    the custom data of animations by clip name."""
    said = request.document
    try:
        definition, body = _read_definition(open_stage(request), str(said["prim"]), str(said["name"]), float(said["rate"]))
    except BodyError as error:
        raise RefusalError(error.code, str(error), error.help, "prim", "body") from error
    return {"left_out": list(body.omissions), "settings": json.dumps(body.settings, default=str)}, pack_definition(definition)


def _read_definition(stage: OpenStage, prim: str, name: str, rate: float) -> tuple[Definition, UsdBody]:
    """Return the definition at and below a prim, and the state of the import. Raises BodyError if there is no definition.

    `rate`: samples per second of animations; 0 means the stage's own rate."""
    body = UsdBody(stage)
    bindings = list(_iterate_skeleton_bindings(stage))
    skeletons = [_read_skeleton(body, skeleton, query) for skeleton, query, _ in bindings]
    static, deforming = [], []
    skins = {
        str(target.GetPrim().GetPath()): (number, target) for number, (*_, targets) in enumerate(bindings) for target in targets
    }
    for mesh in stage.find_visible_prims(stage.prim):
        if not mesh.IsA(import_pxr_module("UsdGeom").Mesh):
            continue
        path = str(mesh.GetPath())
        skin = None
        if path in skins and skins[path][1].HasJointInfluences():
            number, target = skins[path]
            skin = _read_skin(skeletons[number], mesh, target)
        shape = read_usd_shape(body, mesh, skin)
        if shape is None:
            continue
        if skin is None:
            own = body.joint_names[body.add_joint(mesh.GetName(), -1, _read_rest_matrix(stage, mesh))]
            if shape.blend is None:
                static.append(Binding(own, shape.name))
                continue
            body.shapes[shape.name] = replace(shape, capture=build_rigid_capture(own, len(shape.points)))
        deforming.append(
            Binding("", shape.name, deformer="linearskinning" if shape.blend is None else "blendshape+linearskinning")
        )
    if not body.joint_names:
        raise BodyError(f"has no skeleton and no mesh at or below `{prim}`", "write the path of the body's prim")
    rig = Rig(
        tuple(body.joint_names),
        np.array(body.joint_parents, np.int32),
        np.array(body.rest_matrices).reshape(-1, 4, 4),
        tuple(body.channels.values()),
    )
    layer = Layer(BASE_LAYER, tuple(static), tuple(deforming))
    geom = import_pxr_module("UsdGeom")
    z_up = str(geom.GetStageUpAxis(stage.stage)).lower() == "z"
    front, up = ((0.0, -1.0, 0.0), (0.0, 0.0, 1.0)) if z_up else ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0))
    clips = {clip.name: clip for clip in _read_clips(body, skeletons, rate)}
    layers = {BASE_LAYER: layer} if body.shapes else {}
    unit = float(geom.GetStageMetersPerUnit(stage.stage)) * 1000.0
    definition = Definition(name, rig, body.shapes, layers, clips, materials=body.materials, front=front, up=up, unit=unit)
    return definition, body


# ---- joints


def _iterate_skeleton_bindings(stage: OpenStage) -> Iterator[tuple[Any, Any, list[Any]]]:
    """Yield, in file order, each skeleton prim, its UsdSkel query, and the UsdSkel queries of the meshes that are bound to it."""
    skel, usd = import_pxr_module("UsdSkel"), import_pxr_module("Usd")
    cache, visited = skel.Cache(), set()
    predicate = usd.TraverseInstanceProxies()
    for prim in stage.find_visible_prims(stage.prim):
        if prim.IsA(skel.Root):
            cache.Populate(skel.Root(prim), predicate)
            for binding in cache.ComputeSkelBindings(skel.Root(prim), predicate):
                skeleton = binding.GetSkeleton()
                if skeleton.GetPath() not in visited:
                    visited.add(skeleton.GetPath())
                    yield skeleton.GetPrim(), cache.GetSkelQuery(skeleton), list(binding.GetSkinningTargets())
    for prim in stage.find_visible_prims(stage.prim):
        if prim.IsA(skel.Skeleton) and prim.GetPath() not in visited:
            yield prim, cache.GetSkelQuery(skel.Skeleton(prim)), []


def _read_skeleton(body: UsdBody, prim: Any, query: Any) -> _Skeleton:
    """Add the joints of a skeleton to the body, below a joint for the skeleton's prim. Return the skeleton."""
    if not query:
        raise BodyError(f"has a skeleton `{prim.GetPath()}` with inconsistent data", "export it again")
    paths = [str(path) for path in query.GetJointOrder()]
    parents = list(query.GetTopology().GetParentIndices())
    rest = query.ComputeJointLocalTransforms(body.stage.first_time, True)
    bind = query.GetJointWorldBindTransforms()
    if rest is None or len(rest) != len(paths) or len(bind) != len(paths):
        raise BodyError(f"has a skeleton `{prim.GetPath()}` without a rest pose for each joint", "export it again")
    leaves = [path.rsplit("/", 1)[-1] for path in paths]
    top = body.add_joint(prim.GetName(), -1, _read_rest_matrix(body.stage, prim))
    names = []
    for number, path in enumerate(paths):
        if not -1 <= parents[number] < number:
            raise BodyError(
                f"has a skeleton `{prim.GetPath()}` that lists joints before their parents", "export it again", "bad-rig"
            )
        name = leaves[number] if leaves.count(leaves[number]) == 1 else path
        above = top if parents[number] < 0 else top + 1 + parents[number]
        names.append(body.joint_names[body.add_joint(name, above, to_column_matrix(rest[number]))])
    return _Skeleton(prim, query, paths, names)


def to_column_matrix(matrix: Any) -> Floats:
    """Convert a USD matrix, which is for row vectors, to float64[4, 4] for column vectors."""
    return np.ascontiguousarray(np.array(matrix, np.float64).reshape(4, 4).T)


def _read_rest_matrix(stage: OpenStage, prim: Any) -> Floats:
    """Return the world matrix float64[4, 4] of a prim at rest, which is at `stage.first_time`."""
    cache = import_pxr_module("UsdGeom").XformCache(stage.first_time)
    return to_column_matrix(cache.GetLocalToWorldTransform(prim))


def _read_skin(skeleton: _Skeleton, mesh: Any, target: Any) -> Skin:
    """Return the joints that a mesh follows. For each joint, also return the matrix from the mesh's space to the joint's space
    in the bind pose."""
    own = import_pxr_module("UsdSkel").BindingAPI(mesh).GetJointsAttr().Get()
    paths = [str(path) for path in own] if own is not None and len(own) else skeleton.paths
    number = {path: count for count, path in enumerate(skeleton.paths)}
    missing = next((path for path in paths if path not in number), None)
    if missing is not None:
        raise BodyError(
            f"has a mesh `{mesh.GetPath()}` that follows `{missing[:80]}`, which its skeleton does not have", "export it again"
        )
    bind = np.array([to_column_matrix(m) for m in skeleton.query.GetJointWorldBindTransforms()])[[number[path] for path in paths]]
    if not all(has_inverse(matrix[:3]) for matrix in bind):
        words = f"has a skeleton `{skeleton.prim.GetPath()}` with a bind transform that cannot be inverted"
        raise BodyError(words, "export it again")
    back = np.tile(np.eye(4), (len(bind), 1, 1))
    back[:, :3] = [invert_transforms(matrix[:3]) for matrix in bind]
    bind_inverses = compose_transforms(back, to_column_matrix(target.GetGeomBindTransform()))
    return Skin(tuple(skeleton.names[number[path]] for path in paths), bind_inverses, target)


# ---- clips


def _read_clips(body: UsdBody, skeletons: list[_Skeleton], rate: float) -> list[Clip]:
    """Return the animations as clips. Animations that are bound to a skeleton come first."""
    skel = import_pxr_module("UsdSkel")
    clips: dict[str, Clip] = {}
    known_paths: set[str] = set()
    cache = skel.Cache()
    left = limits.MAX_CLIP_BYTES
    waiting = [(each.query.GetAnimQuery(), each) for each in skeletons]
    for prim in body.stage.find_visible_prims(body.stage.stage.GetPseudoRoot()):
        if prim.IsA(skel.Animation):
            query = cache.GetAnimQuery(skel.Animation(prim))
            paths = {str(path) for path in query.GetJointOrder()} if query else set()
            fits = next((each for each in skeletons if paths <= set(each.paths)), None)
            if query and fits is None:
                body.omissions[f"the animation `{prim.GetPath()}` moves joints that no skeleton has"] = None
            elif query and fits is not None:
                waiting.append((query, fits))
    for query, skeleton in waiting:
        path = str(query.GetPrim().GetPath()) if query else ""
        if not path or path in known_paths:
            continue
        known_paths.add(path)
        clip = _read_clip(body, query, skeleton, make_unused_name(query.GetPrim().GetName(), clips), rate, left)
        if clip is not None:
            custom_data = query.GetPrim().GetCustomDataByKey(EXTRAS_KEY)
            if custom_data is not None:
                body.settings[clip.name] = custom_data
            left -= clip.translation.nbytes + clip.rotation.nbytes + clip.scale.nbytes + clip.values.nbytes
            clips[clip.name] = clip
    return list(clips.values())


def _read_clip(body: UsdBody, query: Any, skeleton: Any, name: str, rate: float, left: int) -> Clip | None:
    """Return an animation as a clip, or None if it moves nothing.

    `rate`: samples per second; 0 means the stage's own rate. `left`: the largest number of bytes for the samples. Raises
    BodyError if they need more."""
    number = {path: count for count, path in enumerate(skeleton.paths)}
    paths = [str(path) for path in query.GetJointOrder()]
    columns = [count for count, path in enumerate(paths) if path in number]
    order = [str(each) for each in query.GetBlendShapeOrder()]
    shares = [count for count, each in enumerate(order) if each in body.channels]
    per_second = float(body.stage.stage.GetTimeCodesPerSecond())
    codes = sorted({*query.GetJointTransformTimeSamples(), *query.GetBlendShapeWeightTimeSamples()})
    seconds = (codes[-1] - codes[0]) / per_second if codes else 0.0
    if not (columns or shares):
        return None
    if seconds * (rate or per_second) > limits.MAX_CLIP_SAMPLES:
        raise BodyError(f"has a clip `{name}` of {seconds:,.0f} seconds, longer than the limit", code="too-large")
    times, rate = compute_even_times(seconds, rate or per_second)
    if len(times) * (len(columns) * 13 + len(shares)) * 8 > left:
        raise BodyError(f"has clips of more than {limits.MAX_CLIP_BYTES:,} bytes after sampling", code="too-large")
    joints = tuple(skeleton.names[number[paths[count]]] for count in columns)
    translation, scale = (np.empty((len(times), len(joints), 3)) for _ in range(2))
    rotation = np.empty((len(times), len(joints), 4))
    weights = np.zeros((len(times), len(shares)))
    for count, time in enumerate(times):
        code = (
            import_pxr_module("Usd").TimeCode(codes[0] + float(time) * per_second)
            if codes
            else import_pxr_module("Usd").TimeCode.Default()
        )
        if joints:
            parts = query.ComputeJointLocalTransformComponents(code)
            if parts is None or any(len(part) != len(paths) for part in parts):
                raise BodyError(f"has an animation `{name}` without a transform for each of its joints", "export it again")
            translation[count], scale[count] = (np.array(parts[k], np.float64).reshape(-1, 3)[columns] for k in (0, 2))
            turns = [(*each.GetImaginary(), each.GetReal()) for each in parts[1]]
            rotation[count] = np.array(turns, np.float64)[columns]
        if shares:
            sample_weights = query.ComputeBlendShapeWeights(code)
            if sample_weights is None or len(sample_weights) != len(order):
                raise BodyError(f"has an animation `{name}` without a weight for each of its blend shapes", "export it again")
            weights[count] = np.array(sample_weights, np.float64)[shares]
    if not all(np.isfinite(each).all() for each in (translation, rotation, scale, weights)):
        raise BodyError(f"has an animation `{name}` with a value that is not finite", "export it again")
    return Clip(
        name, rate, joints, translation.astype(np.float32), align_signs(normalise_quaternion(rotation)).astype(np.float32),
        scale.astype(np.float32), None, tuple(order[count] for count in shares), weights.astype(np.float32),
    )  # fmt: skip
