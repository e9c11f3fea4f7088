"""An agent definition as UsdSkel: skeletons, and the shapes of a layer bound to them, with their materials.

A shape is static if all its points follow its joint. UsdSkel has one bind pose per skeleton. So shapes captured in another pose
get a separate skeleton with the same joints. UsdSkel first applies blend shapes, then skinning, either linear or with dual
quaternions. Other features of a definition are omitted and reported."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from antdsl.bodies.agents.blend_shapes import compute_attribute_offsets, get_point_attribute, list_blend_knots, match_points
from antdsl.bodies.agents.definition import Binding, Definition, SkinShape
from antdsl.bodies.posed_body import PosedBody
from antdsl.outputs.usd.materials import MaterialBinder, MaterialBodyMesh
from antdsl.outputs.usd.values import (
    Array,
    add_mesh,
    make_unique,
    to_identifier,
    to_integer_array,
    to_usd_matrices,
    to_usd_matrix,
    to_vector_array,
)
from antdsl.scene.geometry.usd import import_pxr_module

_SAME_POSE_TOLERANCE = 1e-5  # body lengths; bind poses that differ less are merged


@dataclass(slots=True)
class SkelDefinition:
    """A body that was written to the stage.

    `path`: the prim of which agents are instances. `joints`: the paths of the joints, in the order of the rig. `channels`: the
    channels that are weights of blend shapes. `tinted_meshes`: the meshes below `path` that have the colour of the agent.
    `notes`: messages about features that UsdSkel cannot represent. `number`: the index of the body among those of its species,
    from 1."""

    path: str
    joints: tuple[str, ...]
    channels: tuple[str, ...]
    tinted_meshes: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    number: int = 1


def write_definition(stage: Any, path: str, body: PosedBody, looks: MaterialBinder, close: bool = False) -> SkelDefinition:
    """Write a body as a SkelRoot at `path`, in the space of agents: a length of 1 along +x, with +y up.

    `looks`: the body's materials. A body with a `fine_body` has a variant set `detail` with the variants `crowd` and `close`.
    `close`: whether to select the variant `close`."""
    skel, definition = import_pxr_module("UsdSkel"), body.drawn_definition
    root = skel.Root.Define(stage, path)
    joints = make_joint_paths(definition)
    details = {"crowd": body} | ({"close": body.fine_body} if body.fine_body is not body else {})
    drawn = {
        name: [b for b in each.bindings if len(each.drawn_definition.shapes[b.shape].faces)] for name, each in details.items()
    }
    channels = dict.fromkeys(
        channel
        for name, each in details.items()
        for binding in drawn[name]
        if "blendshape" in binding.deformer and (blend := each.drawn_definition.shapes[binding.shape].blend)
        for channel in blend.channels
    )
    skel_definition = SkelDefinition(path, joints, tuple(channels))
    rig = import_pxr_module("UsdGeom").Xform.Define(stage, f"{path}/rig")
    rig.AddTransformOp().Set(to_usd_matrix(definition.compute_base_matrix()))
    skeletons = _SkeletonTable(stage, f"{path}/rig", definition, joints)
    for name, each in details.items():
        import_pxr_module("UsdGeom").Xform.Define(stage, f"{path}/rig/{name}")
        names: set[str] = set()
        for binding in drawn[name]:
            shape = make_unique(to_identifier(binding.shape), names)
            _write_shape(stage, f"{path}/rig/{name}/{shape}", each.drawn_definition, binding, skeletons, looks, skel_definition)
    root.CreateExtentAttr(to_vector_array(MaterialBodyMesh(body).compute_extent()))
    if len(details) > 1:
        chosen = "close" if close else "crowd"
        _add_variants(root.GetPrim(), list(details), chosen)
        skel_definition.tinted_meshes = [below for below in skel_definition.tinted_meshes if below.startswith(f"rig/{chosen}/")]
    return skel_definition


def _add_variants(prim: Any, names: list[str], selected_variant: str) -> None:
    """Add a variant set `detail`, in which each variant hides the prims of the others."""
    variants = prim.GetVariantSets().AddVariantSet("detail")
    for name in names:
        variants.AddVariant(name)
        variants.SetVariantSelection(name)
        with variants.GetVariantEditContext():
            for other in names:
                if other != name:
                    prim.GetStage().OverridePrim(f"{prim.GetPath()}/rig/{other}").SetActive(False)
    variants.SetVariantSelection(selected_variant)


def make_joint_paths(definition: Definition) -> tuple[str, ...]:
    """Return the joints of a rig as paths from its roots, with names that are valid in USD. Equal names get numbers."""
    paths: list[str] = []
    taken: set[str] = set()
    for name, parent in zip(definition.rig.names, definition.rig.parents.tolist(), strict=True):
        above = f"{paths[parent]}/" if parent >= 0 else ""
        paths.append(make_unique(above + to_identifier(name), taken))
    return tuple(paths)


def compute_rest_matrices(definition: Definition) -> Array:
    """Return the world matrices float64[J, 4, 4] of the joints in the rest pose."""
    world = np.array(definition.rig.rest_matrices, np.float64)
    for joint, parent in enumerate(definition.rig.parents.tolist()):
        if parent >= 0:
            world[joint] = world[parent] @ world[joint]
    return world


class _SkeletonTable:
    """The skeletons of a definition, one for each bind pose in which shapes were captured."""

    def __init__(self, stage: Any, path: str, definition: Definition, joints: tuple[str, ...]) -> None:
        self._stage, self._path, self._definition, self._joints = stage, path, definition, joints
        self._rest_matrices, self._skeletons = compute_rest_matrices(definition), list[tuple[str, Array, Array, Any]]()

    def find_or_add(self, shape: SkinShape) -> str:
        """Return the path of a skeleton with the bind pose of a shape. If no skeleton fits, add one.

        Joints that have no bind pose yet in an existing skeleton get the pose of this shape."""
        capture = shape.capture
        numbers = [self._definition.rig.find_joint(name) for name in capture.names] if capture else []
        target = np.linalg.inv(capture.inverse_matrices) if capture else np.zeros((0, 4, 4))
        for path, bind, known, attribute in self._skeletons:
            deviation = np.abs(bind[numbers] - target)[known[numbers]]
            if deviation.max(initial=0.0) <= _SAME_POSE_TOLERANCE * self._definition.length:
                bind[numbers], known[numbers] = target, True
                attribute.Set(to_usd_matrices(bind))
                return path
        bind, known = self._rest_matrices.copy(), np.zeros(len(self._joints), np.bool_)
        bind[numbers], known[numbers] = target, True
        number = len(self._skeletons) + 1
        path = f"{self._path}/skeleton" + (f"_{number}" if number > 1 else "")
        skeleton = import_pxr_module("UsdSkel").Skeleton.Define(self._stage, path)
        skeleton.CreateJointsAttr(import_pxr_module("Vt").TokenArray(list(self._joints)))
        skeleton.CreateRestTransformsAttr(to_usd_matrices(np.asarray(self._definition.rig.rest_matrices)))
        self._skeletons.append((path, bind, known, skeleton.CreateBindTransformsAttr(to_usd_matrices(bind))))
        import_pxr_module("UsdSkel").BindingAPI.Apply(skeleton.GetPrim())
        return path

    def find_bind_pose(self, path: str, joint: int) -> Array:
        """Return the bind pose of a joint, which must not change from then on."""
        _, bind, known, _ = next(each for each in self._skeletons if each[0] == path)
        known[joint] = True
        pose: Array = bind[joint]
        return pose


def _write_shape(
    stage: Any,
    path: str,
    definition: Definition,
    binding: Binding,
    skeletons: _SkeletonTable,
    looks: MaterialBinder,
    skel_definition: SkelDefinition,
) -> None:
    """Write the shape of a binding as a mesh below `path`, bound to its skeleton."""
    shape = definition.shapes[binding.shape]
    drawn = add_mesh(stage, path, shape.points, shape.faces, shape.normals, shape.uvs)
    material = np.zeros(len(shape.faces), np.int64) if shape.material is None else shape.material
    if looks.bind_faces(drawn, shape.materials or ("",), material):
        skel_definition.tinted_meshes.append(path.removeprefix(f"{skel_definition.path}/"))
    api = import_pxr_module("UsdSkel").BindingAPI.Apply(drawn.GetPrim())
    steps = binding.deformer.split("+") if binding.deformer else []
    skinned = [step for step in steps if step.endswith("skinning")]
    _add_difference_notes(skel_definition, binding, shape, steps)
    skeleton = skeletons.find_or_add(shape if skinned else SkinShape(shape.name, shape.points, shape.faces))
    api.CreateSkeletonRel().SetTargets([skeleton])
    if skinned and shape.capture is not None:
        _write_capture(api, definition, shape)
        api.CreateSkinningMethodAttr("classicLinear" if skinned[0] == "linearskinning" else "dualQuaternion")
        api.CreateGeomBindTransformAttr(import_pxr_module("Gf").Matrix4d(1))
    else:
        joint = definition.rig.find_joint(binding.transform) if binding.transform else 0
        api.CreateJointIndicesPrimvar(True, 1).Set(to_integer_array(np.array([joint])))
        api.CreateJointWeightsPrimvar(True, 1).Set(import_pxr_module("Vt").FloatArray([1.0]))
        api.CreateGeomBindTransformAttr(
            to_usd_matrix(skeletons.find_bind_pose(skeleton, joint) if binding.transform else np.eye(4))
        )
    if "blendshape" in steps and shape.blend is not None:
        _write_blend_shapes(stage, path, api, definition, shape)


def _add_difference_notes(skel_definition: SkelDefinition, binding: Binding, shape: SkinShape, steps: list[str]) -> None:
    """Add messages about differences between a binding and its form in UsdSkel."""
    if "dualquatblendskinning" in steps:
        skel_definition.notes.append(
            f"`{shape.name}` blends linear and dual quaternion skinning, but UsdSkel has no blend: it gets dual quaternions"
        )
    known = {"blendshape", "linearskinning", "dualquatskinning", "dualquatblendskinning"}
    others = [step for step in steps if step not in known]
    if others:
        skel_definition.notes.append(
            f"`{shape.name}` is deformed by `{others[0]}`, which UsdSkel does not support: it is left out"
        )
    if "blendshape" in steps and steps[0] != "blendshape":
        skel_definition.notes.append(f"`{shape.name}` is blended after skinning, but UsdSkel blends first")


def _write_capture(api: Any, definition: Definition, shape: SkinShape) -> None:
    """Write which joints the points of a shape follow, with weights."""
    capture = shape.capture
    assert capture is not None
    numbers = np.array([definition.rig.find_joint(name) for name in capture.names], np.int32)
    used = int(np.flatnonzero((capture.weights != 0).any(axis=0)).max(initial=0)) + 1
    api.CreateJointIndicesPrimvar(False, used).Set(to_integer_array(numbers[capture.joints[:, :used]].ravel()))
    weights = np.ascontiguousarray(capture.weights[:, :used], np.float32).ravel()
    api.CreateJointWeightsPrimvar(False, used).Set(import_pxr_module("Vt").FloatArray.FromNumpy(weights))


def _write_blend_shapes(stage: Any, path: str, api: Any, definition: Definition, shape: SkinShape) -> None:
    """Write each input of a blend shape as a USD BlendShape. Its weight is the channel of the same name."""
    blend, skel = shape.blend, import_pxr_module("UsdSkel")
    assert blend is not None
    targets: list[Any] = []
    taken = {"st"}
    for name in blend.shapes:
        each = f"{path}/{make_unique(to_identifier(name), taken)}"
        blend_shape = skel.BlendShape.Define(stage, each)
        shapes, weights = list_blend_knots(definition, name)
        for target, weight in zip(shapes, weights.tolist(), strict=True):
            into = blend_shape if weight == 1.0 else blend_shape.CreateInbetween(to_identifier(target.name))
            rows, other = match_points(shape, target, blend.point_id)
            offsets = _compute_blend_offsets(shape, target, "P", rows, other, blend.attributes)
            normals = _compute_blend_offsets(shape, target, "N", rows, other, blend.attributes)
            if weight == 1.0:
                blend_shape.CreateOffsetsAttr(to_vector_array(offsets))
                blend_shape.CreateNormalOffsetsAttr(to_vector_array(normals))
            else:
                into.SetWeight(weight)
                into.SetOffsets(to_vector_array(offsets))
                into.CreateNormalOffsetsAttr(to_vector_array(normals))
        targets.append(blend_shape.GetPath())
    api.CreateBlendShapesAttr(import_pxr_module("Vt").TokenArray([to_identifier(channel) for channel in blend.channels]))
    api.CreateBlendShapeTargetsRel().SetTargets(targets)


def _compute_blend_offsets(
    base: SkinShape, target: SkinShape, name: str, rows: Array, other: Array, blended_attributes: tuple[str, ...]
) -> Array:
    """Return the differences of the attribute `name` between the points of `base` and `target`, float32[P, 3]."""
    offsets = np.zeros((len(base.points), 3), np.float32)
    if (
        name in blended_attributes
        and get_point_attribute(base, name) is not None
        and get_point_attribute(target, name) is not None
    ):
        offsets[rows] = compute_attribute_offsets(base, target, name, rows, other).T
    return offsets
