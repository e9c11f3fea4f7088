"""Materials as UsdPreviewSurface. A material has one colour, or takes the colour of the prim to which it is bound."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.definition import STATE_MATERIAL
from antdsl.bodies.agents.machine_clips import MachineClips
from antdsl.bodies.posed_body import PosedBody
from antdsl.outputs.usd.values import Array, to_identifier, to_integer_array
from antdsl.scene.geometry.usd import import_pxr_module

Floats = NDArray[np.float32]
_EXTENT_SAMPLES = 8  # samples of each clip to measure an extent
_EXTENT_MARGIN = 1.25  # factor of an extent, for poses between samples and blends
_MATERIAL_ROUGHNESS = 0.55
_DEFAULT_COLOUR = (0.35, 0.35, 0.35)  # for surfaces without a colour


class MaterialBinder:
    """The materials below one prim, each created at first use.

    `colours`: linear colours by name. `finishes`: roughness and metalness by name, for materials that differ from those of
    bodies."""

    def __init__(
        self,
        stage: Any,
        path: str,
        colours: Mapping[str, tuple[float, float, float]],
        finishes: Mapping[str, tuple[float, float]] = MappingProxyType({}),
    ) -> None:
        self._stage, self._path, self._colour_by_material, self._finishes = stage, path, colours, finishes
        for scope in (path.rpartition("/")[0], path):
            import_pxr_module("UsdGeom").Scope.Define(stage, scope)
        self._materials: dict[str, Any] = {}

    def bind_material(self, prim: Any, name: str) -> bool:
        """Bind the material `name` to a prim. Return whether the material has no colour, and so uses the primvar displayColor."""
        own = name in self._colour_by_material and name != STATE_MATERIAL
        known = name if own else STATE_MATERIAL
        if known not in self._materials:
            colour = self._colour_by_material[name] if own else None
            finish = self._finishes.get(known, (_MATERIAL_ROUGHNESS, 0.0))
            self._materials[known] = _make_material(self._stage, f"{self._path}/{to_identifier(known)}", colour, *finish)
        import_pxr_module("UsdShade").MaterialBindingAPI.Apply(prim).Bind(self._materials[known])
        return not own

    def bind_faces(self, mesh: Any, names: tuple[str, ...], material: Array) -> bool:
        """Bind materials to the faces of a mesh. Return whether any of them uses the primvar displayColor.

        `material` int[m]: for each face, the index in `names`. If all faces have the same material, it is bound to the mesh
        itself."""
        used = np.unique(material).tolist() if len(material) else [0]
        if len(used) == 1:
            return self.bind_material(mesh.GetPrim(), names[used[0]])
        shade, tinted = import_pxr_module("UsdShade").MaterialBindingAPI.Apply(mesh.GetPrim()), False
        for each in used:
            faces = to_integer_array(np.flatnonzero(material == each))
            subset = shade.CreateMaterialBindSubset(to_identifier(names[each] or STATE_MATERIAL), faces, "face")
            tinted = self.bind_material(subset.GetPrim(), names[each]) or tinted
        shade.SetMaterialBindSubsetsFamilyType("partition")
        return tinted


def _make_material(stage: Any, path: str, colour: tuple[float, float, float] | None, roughness: float, metalness: float) -> Any:
    """Return a material with one linear colour. If `colour` is None, it uses the primvar displayColor."""
    shade, types, gf = import_pxr_module("UsdShade"), import_pxr_module("Sdf").ValueTypeNames, import_pxr_module("Gf")
    material = shade.Material.Define(stage, path)
    surface = shade.Shader.Define(stage, f"{path}/surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    surface.CreateInput("roughness", types.Float).Set(roughness)
    surface.CreateInput("metallic", types.Float).Set(metalness)
    diffuse = surface.CreateInput("diffuseColor", types.Color3f)
    if colour is not None:
        diffuse.Set(gf.Vec3f(*colour))
    else:
        reader = shade.Shader.Define(stage, f"{path}/colour")
        reader.CreateIdAttr("UsdPrimvarReader_float3")
        reader.CreateInput("varname", types.String).Set("displayColor")
        reader.CreateInput("fallback", types.Float3).Set(gf.Vec3f(*_DEFAULT_COLOUR))
        diffuse.ConnectToSource(reader.CreateOutput("result", types.Float3))
    material.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", types.Token))
    return material


class MaterialBodyMesh:
    """The mesh of a posed body, with a material per triangle, normals and texture coordinates.

    `faces`: int32[m, 3]. `material`: int64[m], indices of `names`. `uvs`: float32[v, 2], texture coordinates; None if no shape
    has any."""

    def __init__(self, body: PosedBody) -> None:
        self.body = body
        shapes = [body.drawn_definition.shapes[binding.shape] for binding in body.bindings]
        starts = np.cumsum([0, *(len(shape.points) for shape in shapes)])
        none = np.zeros((0, 3), np.int32)
        self.faces = np.concatenate([none, *(s.faces + np.int32(a) for s, a in zip(shapes, starts, strict=False))])
        self.names = tuple(dict.fromkeys(name for shape in shapes for name in (*(shape.materials or ("",)),))) or ("",)
        material = [np.zeros(0, np.int64)]
        for shape in shapes:
            own = np.array([self.names.index(name) for name in shape.materials or ("",)])
            material.append(np.full(len(shape.faces), own[0]) if shape.material is None else own[shape.material])
        self.material = np.concatenate(material)
        mapped = [np.zeros((len(s.points), 2), np.float32) if s.uvs is None else s.uvs for s in shapes]
        self.uvs = np.concatenate(mapped) if any(shape.uvs is not None for shape in shapes) else None

    def compute_extent(self) -> NDArray[np.float64]:
        """Return a box (2, 3) that contains the body in all its clips, with some margin, in body lengths."""
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for machines in self._iterate_clips():
            points = self.body.compute_shape_points(self.body.compute_poses(machines, len(machines[0].clip) if machines else 1))[
                0
            ].reshape(-1, 3)
            if len(points):
                low, high = np.minimum(low, points.min(axis=0)), np.maximum(high, points.max(axis=0))
        if not np.isfinite(low).all():
            return np.zeros((2, 3))
        middle, half = (low + high) / 2, (high - low) / 2 * _EXTENT_MARGIN
        return np.stack([middle - half, middle + half])

    def _iterate_clips(self) -> Iterator[tuple[MachineClips, ...]]:
        """Yield no clips (the rest pose) first, then each clip of the body at evenly spaced times."""
        yield ()
        for number in range(len(self.body.clips)):
            yield (make_single_clips(np.full(_EXTENT_SAMPLES, number), np.arange(_EXTENT_SAMPLES) / _EXTENT_SAMPLES),)


def make_single_clips(clip: NDArray[np.integer], turns: NDArray[np.floating]) -> MachineClips:
    """Return the clips of agents that play one clip each (-1 for none), with full weight and without a fade. `turns`: played
    cycles."""
    chosen = np.asarray(clip, np.int16)
    none, one = np.zeros(len(clip), np.float32), np.ones(len(clip), np.float32)
    return MachineClips(chosen, np.asarray(turns, np.float32), one, np.full(len(clip), -1, np.int16), none, none, none)
