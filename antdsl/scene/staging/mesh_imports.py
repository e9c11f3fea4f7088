"""What importing meshes changed: vertices are welded here, and what was left out, cut up or joined is reported."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from antdsl.scene import setting as stage_of
from antdsl.scene.geometry.closed import border_edges, open_solid_edges
from antdsl.scene.geometry.import_notes import MeshImport
from antdsl.scene.geometry.meshes import RawMesh, welded
from antdsl.scene.model import HeightThing, MeshThing, UsdThing
from antdsl.scene.origin import world_origin
from antdsl.source import Span

if TYPE_CHECKING:
    from antdsl.scene.staging.stage_scene import Staging

_FAR = 2.0**23  # mm from the origin of the world: beyond it a float32 has steps of a millimetre
_DEFAULT_WELD = 0.01  # of a voxel: what is finer is lost in voxels anyway


def report_losses(staging: Staging, shown: str, raw: RawMesh, span: Span | None) -> None:
    """Warn of what of a mesh file is not in the scene."""
    report, notes = staging.report, raw.notes
    if raw.dropped:
        faces = "face" if raw.dropped == 1 else "faces"
        words = f"{raw.dropped:,} {faces} of `{shown}` without area or given twice left out"
        report.warning("degenerate-faces", words, span, "merge doubled points and faces in the program that made the mesh")
    if notes.crossing:
        faces = "face crosses itself" if notes.crossing == 1 else "faces cross themselves"
        words = f"{notes.crossing:,} {faces} in `{shown}`, the first is face {notes.crossing_face:,}"
        report.warning("crossing-face", words, span, "cut it into triangles in the program that made the mesh")
    skipped = notes.skipped_words()
    if skipped:
        more = f" and {len(skipped) - 8} more" if len(skipped) > 8 else ""
        words = f"`{shown}` has content that is not read: {', '.join(skipped[:8])}{more}"
        report.warning("unread-content", words, span, "export as triangles or polygons what agents should meet")


def report_distances(staging: Staging, setting: stage_of.Setting) -> None:
    """Warn of meshes that reach so far from the origin of their world that positions there are coarse."""
    origin, world = world_origin(setting), staging.scene.model.world
    walked = {**setting.surfaces, **{name: solid.mesh for name, solid in setting.solids.items()}}
    for name, mesh in (walked or setting.obstacles).items():  # no agent comes near an obstacle beyond all surfaces
        away = max(float(np.abs(edge(mesh.vertices, axis=0) - origin).max()) for edge in (np.min, np.max))
        if away > _FAR:
            key = next(key for key in ("mesh", "height", "prim") if hasattr(world[name], key))
            words = f"`{name}` reaches {away / 1e6:,.0f} km from the middle of the world, where positions have steps of 1 mm"
            help = "move its parts closer together with `at`, or check its `units`"
            staging.report.warning("far-away", words, staging.scene.span("world", name, key), help)


def weld_thing(
    staging: Staging, name: str, value: MeshThing | HeightThing | UsdThing, mesh: stage_of.MeshData
) -> stage_of.MeshData:
    """The mesh with its vertices welded where the scene says `weld`."""
    if isinstance(value, HeightThing) or value.weld is None:
        return mesh
    if name in staging.moves:
        words, span = f"`{name}` moves, and only what stands still is welded", staging.scene.span("world", name, "weld")
        staging.report.error("wrong-value", words, span, "delete `weld`, and weld it in the program that made the mesh")
        return mesh
    return _weld(staging, name, mesh, value.weld.length(staging.scene.model.unit_mm))


def _weld(staging: Staging, name: str, mesh: stage_of.MeshData, tolerance: float) -> stage_of.MeshData:
    vertices, count = welded(mesh.vertices, tolerance)
    if not count:
        return mesh
    staging.welds[name] = staging.welds.get(name, 0) + count
    return stage_of.MeshData(vertices, mesh.faces)


def close_solid(staging: Staging, name: str, value: MeshThing | UsdThing, solid: stage_of.SolidData) -> stage_of.SolidData:
    """The solid, its vertices welded if it is not closed without; an error where it has no inside all the same."""
    loose = open_solid_edges(solid)
    if not loose:
        return solid
    if value.weld is None:
        mesh = _weld(staging, name, solid.mesh, _DEFAULT_WELD * solid.voxel)
        if mesh is not solid.mesh and not open_solid_edges(replace(solid, mesh=mesh)):
            return replace(solid, mesh=mesh)
        staging.welds.pop(name, None)
    edges = "1 edge borders" if loose == 1 else f"{loose:,} edges border"
    words = f"the mesh of the solid `{name}` is not closed: {edges} on nothing"
    place = staging.scene.span("world", name, "mesh" if isinstance(value, MeshThing) else "prim")
    help = "close its holes, so that it has an inside; where only gaps between vertices are open, write `weld: 0.1 mm` or more"
    staging.report.error("bad-mesh", words, place, help)
    return solid


def mesh_imports(staging: Staging, meshes: Mapping[str, stage_of.MeshData]) -> dict[str, MeshImport]:
    """The report on each mesh, in scene units."""
    found, unit = {}, staging.scene.model.unit_mm
    for name, mesh in meshes.items():
        raw, value = staging.raw[name], staging.scene.model.world[name]
        notes = raw.notes
        low, high = (edge(mesh.vertices, axis=0) / unit for edge in (np.min, np.max))
        found[name] = MeshImport(
            file=next((str(getattr(value, key)) for key in ("mesh", "height", "usd") if hasattr(value, key)), name),
            form=notes.form or ("USD" if isinstance(value, UsdThing) else "heights"),
            vertices=notes.vertices,
            triangles=notes.triangles,
            polygons=notes.cut,
            concave=notes.concave,
            crossing=notes.crossing,
            dropped=raw.dropped,
            welded=staging.welds.get(name, 0),
            border_edges=border_edges(mesh),
            skipped=tuple(notes.skipped_words()),
            low=(float(low[0]), float(low[1]), float(low[2])),
            high=(float(high[0]), float(high[1]), float(high[2])),
        )
    return found
