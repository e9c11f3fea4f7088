"""What importing meshes changed: vertices are welded here, and what was left out, cut up or joined is reported."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from antdsl.scene import setting as stage_of
from antdsl.scene.geometry.closed import border_edges, open_solid_edges
from antdsl.scene.geometry.import_notes import MeshImport
from antdsl.scene.geometry.live_faces import has_area, has_live_face
from antdsl.scene.geometry.meshes import RawMesh
from antdsl.scene.geometry.welding import (
    WeldError,
    edge_lengths,
    has_three_places,
    is_flat,
    one_digit_down,
    openings,
    welded,
)
from antdsl.scene.model import HeightThing, MeshThing, UsdThing
from antdsl.scene.origin import world_origin
from antdsl.source import Span

if TYPE_CHECKING:
    from antdsl.scene.staging.stage_scene import Staging

_FAR = 2.0**23  # mm from the origin of the world: beyond it a float32 has steps of a millimetre
_MANY = 20  # one of so many faces removed by welding is worth a warning
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
    origin = world_origin(setting)
    walked = {**setting.surfaces, **{name: solid.mesh for name, solid in setting.solids.items()}}
    for name, mesh in (walked or setting.obstacles).items():  # no agent comes near an obstacle beyond all surfaces
        away = max(float(np.abs(edge(mesh.vertices, axis=0) - origin).max()) for edge in (np.min, np.max))
        if away > _FAR:
            words = f"`{name}` reaches {away / 1e6:,.0f} km from the middle of the world, where positions have steps of 1 mm"
            help = "move its parts closer together with `at`, or check its `units`"
            staging.report.warning("far-away", words, mesh_place(staging, name)[1], help)


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
    tolerance, span = value.weld.length(staging.scene.model.unit_mm), staging.scene.span("world", name, "weld")
    written = f"`weld: {span.text if span is not None else f'{tolerance:g} mm'}`"
    lengths = edge_lengths(mesh.vertices, mesh.faces)
    shortest = float(lengths[lengths > 0].min())
    words, made = f"{written} moves corners of every face of `{name}` to one place", None
    if (lengths > tolerance).any():
        try:
            made = _weld(mesh, tolerance)
        except WeldError as why:
            words = f"{written} {why} of `{name}`"
    if made is not None and staging.program.world[name].kind == "solid" and is_flat(made.mesh.vertices, made.mesh.faces):
        words, made = f"{written} leaves the solid `{name}` without a volume", None
    if made is None:
        help = f"write less than {shortest:.3g} mm, its shortest edge"
        staging.report.error("wrong-value", words, span, help)
        return mesh
    gone, median = int((~made.keep).sum()), float(np.median(lengths))
    if gone * _MANY > len(mesh.faces) or tolerance > median / 2:
        words = f"{written} removes {gone:,} of {len(mesh.faces):,} triangles of `{name}`"
        words = words if gone else f"{written} is more than half of the median edge of `{name}`, {median:.3g} mm"
        staging.report.warning("degenerate-faces", words, span, f"write `weld: {one_digit_down(median / 4):g} mm` or less")
    return _take(staging, name, made)


@dataclass(frozen=True, slots=True, eq=False)
class _Welded:
    """A mesh after welding; how many of its vertices were moved; and which of the faces before have three corners still."""

    mesh: stage_of.MeshData
    moved: int
    keep: NDArray[np.bool_]


def _weld(mesh: stage_of.MeshData, tolerance: float) -> _Welded | None:
    """The mesh with its vertices welded, without faces that lose a corner by it; None where no face with an area is left.
    WeldError where the tolerance is much too large."""
    vertices, count = welded(mesh.vertices, tolerance)
    if not count:
        return _Welded(mesh, 0, np.ones(len(mesh.faces), np.bool_))
    keep = has_three_places(vertices, mesh.faces)
    made = stage_of.MeshData(vertices, mesh.faces[keep])
    return _Welded(made, count, keep) if has_area(*(vertices[made.faces[:, k]] for k in range(3))).any() else None


def _take(staging: Staging, name: str, made: _Welded) -> stage_of.MeshData:
    """Put down what welding changed. Values painted on faces go on with those that are left."""
    raw = staging.raw[name]
    if made.moved:
        staging.welds[name] = staging.welds.get(name, 0) + made.moved
    if not made.keep.all():
        dropped = raw.dropped + int((~made.keep).sum())
        staging.raw[name] = replace(raw, faces=raw.faces[made.keep], own_faces=raw.own_faces[made.keep], dropped=dropped)
    return made.mesh


def close_solid(staging: Staging, name: str, value: MeshThing | UsdThing, solid: stage_of.SolidData) -> stage_of.SolidData:
    """The solid, its vertices welded if it is not closed without; an error where it has no inside all the same."""
    shown, place = mesh_place(staging, name)
    if is_flat(solid.mesh.vertices, solid.mesh.faces):
        words, help = f"the solid `{name}` has no volume: `{shown}` is flat", "give it a thickness, or declare a `surface`"
        staging.report.error("bad-mesh", words, place, help)
        return solid
    loose = open_solid_edges(solid)
    if not loose:
        return solid
    if value.weld is None:
        try:
            made = _weld(solid.mesh, _DEFAULT_WELD * solid.voxel)
        except WeldError:
            made = None
        if made is not None and not is_flat(made.mesh.vertices, made.mesh.faces):
            closed = replace(solid, mesh=made.mesh)
            if not open_solid_edges(closed):
                _take(staging, name, made)
                return closed
    edges = "1 edge borders" if loose == 1 else f"{loose:,} edges border"
    words = f"the mesh of the solid `{name}` is not closed: {edges} on nothing"
    found = openings(solid.mesh.vertices, solid.mesh.faces, solid.voxel)
    if found.gap:
        help = f"its gaps are up to {found.width:.2g} mm wide: write `weld: {found.gap:g} mm`"
    else:
        holes = "it has a hole" if found.holes == 1 else f"it has {found.holes:,} holes, the largest"
        help = f"{holes} of {found.edges:,} edges, up to {found.longest:.3g} mm long: close it in the program that made the mesh"
    staging.report.error("bad-mesh", words, place, help)
    return solid


def check_live(staging: Staging, surfaces: Mapping[str, stage_of.MeshData]) -> None:
    """An error for each surface of which no face is ground, as the ground itself has it: no agent could stand on it."""
    if not surfaces:
        return
    used = [mesh.vertices[mesh.faces].reshape(-1, 3) for mesh in surfaces.values()]
    low, high = (edge([edge(places, axis=0) for places in used], axis=0) for edge in (np.min, np.max))
    extent = float((high - low).max())
    for name, mesh in surfaces.items():
        if has_live_face(mesh.vertices, mesh.faces, extent):
            continue
        shown, span = mesh_place(staging, name)
        if has_area(*(mesh.vertices[mesh.faces[:, k]] for k in range(3))).any():
            words = f"the mesh `{shown}` is less than a millionth as wide as all surfaces together ({extent:.3g} mm)"
            help = "check its `units` and `scale`, or leave it out"
        else:
            words = f"the mesh `{shown}` has only faces that are as thin as lines, on which no agent can stand"
            help = "make it wider in the program that made the mesh"
        staging.report.error("bad-mesh", words, span, help)


def mesh_place(staging: Staging, name: str) -> tuple[str, Span | None]:
    """What messages call the mesh of a thing, and where the scene names it."""
    value = staging.scene.model.world[name]
    key = next(key for key in ("mesh", "height", "prim") if hasattr(value, key))
    return str(value.path if isinstance(value, UsdThing) else getattr(value, key)), staging.scene.span("world", name, key)


def mesh_imports(staging: Staging, meshes: Mapping[str, stage_of.MeshData]) -> dict[str, MeshImport]:
    """The report on each mesh, in scene units."""
    found, unit = {}, staging.scene.model.unit_mm
    for name, mesh in meshes.items():
        raw, value = staging.raw[name], staging.scene.model.world[name]
        notes = raw.notes
        corners = mesh.vertices[mesh.faces].reshape(-1, 3)
        low, high = (edge(corners, axis=0) / unit for edge in (np.min, np.max))
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
            left=len(mesh.faces),
            border_edges=border_edges(mesh),
            skipped=tuple(notes.skipped_words()),
            low=(float(low[0]), float(low[1]), float(low[2])),
            high=(float(high[0]), float(high[1]), float(high[2])),
        )
    return found
