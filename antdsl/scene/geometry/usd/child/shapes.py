"""Finds the mesh prims of a stage and every transform with which they appear: directly, as native instances, or by point
instancers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.reader.sandbox import raise_memory_limit
from antdsl.scene.geometry.matrices import compose_transforms
from antdsl.scene.geometry.usd.child.stage import Floats, OpenStage, to_column_matrix
from antdsl.scene.geometry.usd.errors import UsdError, import_pxr_module

_MAX_NESTED_INSTANCERS = 8  # maximum nesting of point instancers


@dataclass(frozen=True, slots=True, eq=False)
class PlacedUsdMesh:
    """A mesh prim and all transforms with which it appears. `transforms` (copies, frames, 3, 4): into the scene. There is a
    single frame if nothing moves."""

    prim: Any
    transforms: Floats


@dataclass(slots=True)
class PlacedMeshCounter:
    """Counter of the mesh copies that point instancers below `path` would create. For nested instancers, the counts are
    multiplied.

    It counts before any copy is made, so that a limit can be enforced."""

    path: str
    instances: int = 0
    meshes: int = 0

    def add_instances(self, count: int) -> None:
        """Count `count` further instances of an instancer, including those in all copies of it. Raises UsdError if the limit is
        exceeded."""
        self.instances += count
        self._check_limit(self.instances, "instances")

    def add_mesh(self, count: int) -> None:
        """Add the copies of one mesh. Raises UsdError if the limit is exceeded."""
        self.meshes += count
        self._check_limit(self.meshes, "instances of meshes")

    def _check_limit(self, total: int, noun: str) -> None:
        if total > limits.MAX_USD_INSTANCES:
            words = f"the point instancers below `{self.path}` produce {total:,} {noun}, more than {limits.MAX_USD_INSTANCES:,}"
            raise UsdError("too-large", words, "name a part of it, or scatter fewer instances")


def find_placed_meshes(stage: OpenStage) -> Iterator[PlacedUsdMesh]:
    """Yield every mesh at or below the stage's prim with its transforms, in the order of the file."""
    count = PlacedMeshCounter(str(stage.prim.GetPath()))
    for prim in stage.find_visible_prims(stage.prim):
        if prim.IsA(import_pxr_module("UsdGeom").Mesh):
            yield PlacedUsdMesh(prim, stage.compute_scene_transforms(prim, stage.is_moving(prim))[None])
        elif prim.IsA(import_pxr_module("UsdGeom").PointInstancer):
            yield from _find_placed_instances(
                stage, prim, stage.compute_scene_transforms(prim, stage.is_moving(prim))[None], count, 1
            )


def list_unread_types(stage: OpenStage) -> list[str]:
    """Return the types of the shapes at or below the prim that are not read, because they are not meshes."""
    geom = import_pxr_module("UsdGeom")
    read = (geom.Mesh, geom.PointInstancer, geom.Curves, geom.Points)
    type_names = {
        str(p.GetTypeName())
        for p in stage.find_visible_prims(stage.prim)
        if p.IsA(geom.Gprim) and not any(p.IsA(k) for k in read)
    }
    return sorted(type_names)


def _find_placed_instances(
    stage: OpenStage, prim: Any, transforms: Floats, count: PlacedMeshCounter, depth: int
) -> Iterator[PlacedUsdMesh]:
    """Return help text that explains why a prim has no readable meshes. There may be none, or they are invisible, or they have
    another purpose."""
    if depth > _MAX_NESTED_INSTANCERS:
        raise UsdError(
            "too-large", f"`{prim.GetPath()}` has point instancers nested more than {_MAX_NESTED_INSTANCERS} levels deep"
        )
    instancer = import_pxr_module("UsdGeom").PointInstancer(prim)
    index = np.array(instancer.GetProtoIndicesAttr().Get(stage.first_time) or [], np.int64)
    if not len(index):
        return
    chosen = _find_unmasked_instances(stage, instancer, len(index))
    roots = [prim.GetStage().GetPrimAtPath(path) for path in instancer.GetPrototypesRel().GetForwardedTargets()]
    if index.min() < 0 or index.max() >= len(roots):
        raise UsdError("bad-usd", f"`{prim.GetPath()}` refers to a missing prototype")
    count.add_instances(len(index) * len(transforms))
    own = _compute_instance_transforms(stage, instancer, len(index))
    for number, root in enumerate(roots):
        of_this = np.flatnonzero(chosen & (index == number))
        if root and len(of_this):
            inside = _compose_all_transform_pairs(transforms, own[of_this])
            for child, transform in _find_prototype_meshes(stage, root):
                child_transforms = _compose_all_transform_pairs(inside, transform[None])
                if child.IsA(import_pxr_module("UsdGeom").Mesh):
                    count.add_mesh(len(child_transforms))
                    yield PlacedUsdMesh(child, child_transforms)
                else:
                    yield from _find_placed_instances(stage, child, child_transforms, count, depth + 1)


def _compose_all_transform_pairs(outer: Floats, inner: Floats) -> Floats:
    """Return the product of each outer transform with each inner transform. The inner transform is applied first.

    `outer` (a, f, 3, 4) and `inner` (b, g, 3, 4), with f and g frames, give (a·b, max(f, g), 3, 4)."""
    check_motion_bytes(len(outer) * len(inner) * max(outer.shape[1], inner.shape[1]) * 96, "instances")
    composed = compose_transforms(outer[:, None], inner[None])
    return composed.reshape(-1, *composed.shape[2:])


def _find_unmasked_instances(stage: OpenStage, instancer: Any, count: int) -> NDArray[np.bool_]:
    mask = list(instancer.ComputeMaskAtTime(stage.first_time))
    return np.array(mask, np.bool_) if len(mask) == count else np.ones(count, np.bool_)


def _compute_instance_transforms(stage: OpenStage, instancer: Any, count: int) -> Floats:
    """Return the transforms (instances, frames, 3, 4) from all instances to the instancer's space.

    They include the transforms of the prototypes' roots."""
    usd, path = import_pxr_module("Usd"), instancer.GetPath()
    attributes = (instancer.GetPositionsAttr(), instancer.GetOrientationsAttr(), instancer.GetScalesAttr())
    roots = [instancer.GetPrim().GetStage().GetPrimAtPath(p) for p in instancer.GetPrototypesRel().GetForwardedTargets()]
    moved = any(a.ValueMightBeTimeVarying() for a in (*attributes, instancer.GetProtoIndicesAttr())) or any(
        r
        and import_pxr_module("UsdGeom").Xformable(r)
        and import_pxr_module("UsdGeom").Xformable(r).TransformMightBeTimeVarying()
        for r in roots
    )
    times = stage.times if moved else stage.times[:1]
    check_motion_bytes(count * len(times) * 96, f"the instances of `{path}`")
    transforms = np.empty((count, len(times), 3, 4))
    first = list(instancer.GetProtoIndicesAttr().Get(stage.first_time))
    for k, time in enumerate(times):
        code = usd.TimeCode(time)
        if k and list(instancer.GetProtoIndicesAttr().Get(code) or []) != first:
            words = "moving-topology"
            raise UsdError(words, f"the instances of `{path}` appear, disappear or change their shape over time", BAKE_HELP)
        matrices = instancer.ComputeInstanceTransformsAtTime(
            code,
            code,
            import_pxr_module("UsdGeom").PointInstancer.IncludeProtoXform,
            import_pxr_module("UsdGeom").PointInstancer.IgnoreMask,
        )
        if len(matrices) != count:
            raise UsdError("bad-usd", f"`{path}` does not have one position for each of its {count:,} instances")
        rows = np.array(matrices, np.float64).reshape(count, 4, 4)
        transforms[:, k] = rows[:, :, :3].transpose(0, 2, 1)
    return transforms


BAKE_HELP = "export it with one set of faces for all frames, or name a part that keeps its faces"


def _find_prototype_meshes(stage: OpenStage, root: Any) -> Iterator[tuple[Any, Floats]]:
    """Yield the meshes and instancers of a prototype, with transforms (frames, 3, 4) to the space of the prototype's root.

    The transform of the root itself is not included."""
    usd, geom = import_pxr_module("Usd"), import_pxr_module("UsdGeom")
    # `over` and `class` prims are not drawn on their own, but can be prototypes
    walk = iter(usd.PrimRange(root, usd.TraverseInstanceProxies(usd.PrimIsActive & usd.PrimIsLoaded)))
    for prim in walk:
        image = geom.Imageable(prim)
        if image and image.GetVisibilityAttr().Get(stage.first_time) == "invisible":
            walk.PruneChildren()
            continue
        inner = prim.IsA(geom.PointInstancer)
        if inner:
            walk.PruneChildren()
        if (inner or prim.IsA(geom.Mesh)) and image.ComputePurpose() in ("default", stage.purpose):
            yield prim, _compute_relative_transforms(stage, prim, root)


def _compute_relative_transforms(stage: OpenStage, prim: Any, root: Any) -> Floats:
    geom = import_pxr_module("UsdGeom")
    moved, above = False, prim
    while above and above != root:
        moved |= bool(geom.Xformable(above)) and geom.Xformable(above).TransformMightBeTimeVarying()
        above = above.GetParent()
    cache, matrices = geom.XformCache(), []
    for time in stage.times if moved else stage.times[:1]:
        cache.SetTime(import_pxr_module("Usd").TimeCode(time))
        matrix = import_pxr_module("Gf").Matrix4d(1.0) if prim == root else cache.ComputeRelativeTransform(prim, root)[0]
        matrices.append(to_column_matrix(matrix))
    return np.array(matrices)


def check_motion_bytes(size: int, noun: str) -> None:
    """Raise UsdError if motion of `size` bytes exceeds the limit. Otherwise, raise the memory limit of the process, so that the
    motion fits."""
    if size > limits.MAX_MOTION_BYTES:
        words = (
            f"the frames of {noun} would take {size / limits.GIB:.1f} GiB, more than {limits.MAX_MOTION_BYTES / limits.GIB:.0f}"
        )
        raise UsdError("too-large", words, "simulate fewer frames at a time, or name a lighter part")
    raise_memory_limit(4 * size)
