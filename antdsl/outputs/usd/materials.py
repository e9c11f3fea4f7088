"""Materials as UsdPreviewSurface: colours of their own, and one that takes the colour of what it is on."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from antdsl.bodies.agents.definition import STATE
from antdsl.outputs.usd.values import Array, identifier, integers
from antdsl.scene.geometry.usd import pxr

_ROUGHNESS = 0.55
_GREY = (0.35, 0.35, 0.35)  # where nothing says a colour


class Looks:
    """Materials below one prim, each made when it is first bound."""

    def __init__(self, stage: Any, path: str, colours: Mapping[str, tuple[float, float, float]]) -> None:
        self._stage, self._path, self._colours = stage, path, colours
        for scope in (path.rpartition("/")[0], path):
            pxr("UsdGeom").Scope.Define(stage, scope)
        self._made: dict[str, Any] = {}

    def bind(self, prim: Any, name: str) -> bool:
        """Bind a material by its name; one that has no colour, as `state`, takes the primvar displayColor, which is told."""
        own = name in self._colours and name != STATE
        known = name if own else STATE
        if known not in self._made:
            colour = self._colours[name] if own else None
            self._made[known] = _surface(self._stage, f"{self._path}/{identifier(known)}", colour)
        pxr("UsdShade").MaterialBindingAPI.Apply(prim).Bind(self._made[known])
        return not own

    def bind_faces(self, mesh: Any, names: tuple[str, ...], material: Array) -> bool:
        """Bind materials to the faces of a mesh: `material` int[m] counts `names`; of one alone to all of it. Gives whether some
        take the primvar displayColor."""
        used = np.unique(material).tolist() if len(material) else [0]
        if len(used) == 1:
            return self.bind(mesh.GetPrim(), names[used[0]])
        shade, tinted = pxr("UsdShade").MaterialBindingAPI.Apply(mesh.GetPrim()), False
        for each in used:
            faces = integers(np.flatnonzero(material == each))
            subset = shade.CreateMaterialBindSubset(identifier(names[each] or STATE), faces, "face")
            tinted = self.bind(subset.GetPrim(), names[each]) or tinted
        shade.SetMaterialBindSubsetsFamilyType("partition")
        return tinted


def _surface(stage: Any, path: str, colour: tuple[float, float, float] | None) -> Any:
    """A material of one colour (linear), or of that of the primvar displayColor."""
    shade, types, gf = pxr("UsdShade"), pxr("Sdf").ValueTypeNames, pxr("Gf")
    made = shade.Material.Define(stage, path)
    surface = shade.Shader.Define(stage, f"{path}/surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    surface.CreateInput("roughness", types.Float).Set(_ROUGHNESS)
    diffuse = surface.CreateInput("diffuseColor", types.Color3f)
    if colour is not None:
        diffuse.Set(gf.Vec3f(*colour))
    else:
        reader = shade.Shader.Define(stage, f"{path}/colour")
        reader.CreateIdAttr("UsdPrimvarReader_float3")
        reader.CreateInput("varname", types.String).Set("displayColor")
        reader.CreateInput("fallback", types.Float3).Set(gf.Vec3f(*_GREY))
        diffuse.ConnectToSource(reader.CreateOutput("result", types.Float3))
    made.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", types.Token))
    return made
