"""Changes to meshes on import, and reports about these changes.

Vertices that are nearer to each other than a tolerance are welded. Reports name what was omitted, cut or joined, and why a solid
is not closed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from antdsl.program.tables.things import KIND_BY_WORD
from antdsl.scene import setting as setting_data
from antdsl.scene.geometry.closed_meshes import count_border_edges, count_open_solid_edges, find_edges_with_odd_faces
from antdsl.scene.geometry.import_notes import MeshImport
from antdsl.scene.geometry.live_faces import has_any_face_with_area, has_nonzero_area, number_connected_components
from antdsl.scene.geometry.matrices import find_distinct_points
from antdsl.scene.geometry.mesh_files import RawMesh
from antdsl.scene.setting import compute_world_origin
from antdsl.scene.thing_models import HeightThing, MeshThing, ThingModel, UsdThing
from antdsl.source import Span

if TYPE_CHECKING:
    from antdsl.scene.staging.stage_scene import SceneStaging

Floats = NDArray[np.float64]
Index = NDArray[np.int64]
Faces = NDArray[np.int32]

# maximum number of pairs of near positions, and their maximum mean per position
_MAX_WELD_PAIRS, _MAX_PAIRS_PER_VERTEX = 1 << 21, 32
_FLAT_BODY_RATIO = 1e-9  # share of the extent; thinner bodies have no volume
_MAX_CLOSING_TRIES = 4  # tolerances for closing gaps; each is twice the previous


_FAR_FROM_ORIGIN_MM = 2.0**23  # mm from the origin of the world; beyond it, float32 has steps of a millimetre
_MIN_REPORTED_REMOVED_FACES = 20  # welding causes a warning if it removes more than one in this number of faces
_DEFAULT_WELD_VOXELS = 0.01  # share of a voxel; voxels lose finer detail in any case


def report_import_losses(staging: SceneStaging, display_name: str, raw: RawMesh, span: Span | None) -> None:
    """Warn about parts of a mesh file that the staged mesh lacks."""
    report, notes = staging.report, raw.notes
    if raw.dropped_faces:
        faces = "face" if raw.dropped_faces == 1 else "faces"
        words = f"{raw.dropped_faces:,} {faces} of `{display_name}` without area or duplicated were omitted"
        report.warning("degenerate-faces", words, span, "merge duplicate points and faces in the program that made the mesh")
    if notes.crossing_polygons:
        faces = "face crosses itself" if notes.crossing_polygons == 1 else "faces intersect themselves"
        words = f"{notes.crossing_polygons:,} {faces} in `{display_name}`, the first is face {notes.crossing_face:,}"
        report.warning("crossing-face", words, span, "cut it into triangles in the program that made the mesh")
    skipped = notes.describe_skipped()
    if skipped:
        remainder = f" and {len(skipped) - 8} more" if len(skipped) > 8 else ""
        words = f"`{display_name}` has content that is not read: {', '.join(skipped[:8])}{remainder}"
        report.warning("unread-content", words, span, "export everything that agents should touch as triangles or polygons")


def check_origin_distances(staging: SceneStaging, setting: setting_data.WorldSetting) -> None:
    """Warn about meshes that reach very far from the world's origin. float32 positions are imprecise there."""
    origin = compute_world_origin(setting)
    walked = {**setting.surfaces, **{name: solid.mesh for name, solid in setting.solids.items()}}
    for name, mesh in (walked or setting.obstacles).items():  # agents do not come near obstacles beyond all surfaces
        away = max(float(np.abs(edge(mesh.vertices, axis=0) - origin).max()) for edge in (np.min, np.max))
        if away > _FAR_FROM_ORIGIN_MM:
            words = f"`{name}` reaches {away / 1e6:,.0f} km from the middle of the world, where positions have steps of 1 mm"
            help = "move its parts closer together with `at`, or check its `units`"
            staging.report.warning("far-away", words, find_mesh_location(staging, name)[1], help)


def weld_thing_mesh(
    staging: SceneStaging, name: str, value: MeshThing | HeightThing | UsdThing, mesh: setting_data.MeshData
) -> setting_data.MeshData:
    """Return the mesh with welded vertices if the scene has `weld`. On an error, report it and return the mesh unchanged."""
    if isinstance(value, HeightThing) or value.weld is None:
        return mesh
    if name in staging.moves_by_mesh:
        words, span = f"`{name}` moves, but only static meshes can be welded", staging.scene.find_span("world", name, "weld")
        staging.report.error("wrong-value", words, span, "delete `weld`, and weld it in the program that made the mesh")
        return mesh
    tolerance, span = value.weld.to_millimetres(staging.scene.model.unit_mm), staging.scene.find_span("world", name, "weld")
    written = f"`weld: {span.text if span is not None else f'{tolerance:g} mm'}`"
    lengths = compute_edge_lengths(mesh.vertices, mesh.faces)
    shortest = float(lengths[lengths > 0].min())
    words, welding = f"{written} moves corners of every face of `{name}` to one position", None
    if (lengths > tolerance).any():
        try:
            welding = _weld_mesh(mesh, tolerance)
        except WeldError as error:
            words = f"{written} {error} of `{name}`"
    is_dug = KIND_BY_WORD[staging.program.world[name].kind].is_dug
    if welding is not None and is_dug and is_flat(welding.mesh.vertices, welding.mesh.faces):
        words, welding = f"{written} leaves the solid `{name}` without a volume", None
    if welding is None:
        help = f"write less than {shortest:.3g} mm, its shortest edge"
        staging.report.error("wrong-value", words, span, help)
        return mesh
    removed_count, median = int((~welding.is_retained_face).sum()), float(np.median(lengths))
    if removed_count * _MIN_REPORTED_REMOVED_FACES > len(mesh.faces) or tolerance > median / 2:
        words = f"{written} removes {removed_count:,} of {len(mesh.faces):,} triangles of `{name}`"
        words = words if removed_count else f"{written} is more than half of the median edge of `{name}`, {median:.3g} mm"
        staging.report.warning("degenerate-faces", words, span, f"write `weld: {round_down_digit(median / 4):g} mm` or less")
    return _record_welding(staging, name, welding)


@dataclass(frozen=True, slots=True, eq=False)
class _WeldedMesh:
    """The result of welding a mesh.

    `moved_count`: the number of moved vertices.
    `is_retained_face`: whether each face of the original mesh still has three different corners."""

    mesh: setting_data.MeshData
    moved_count: int
    is_retained_face: NDArray[np.bool_]


def _weld_mesh(mesh: setting_data.MeshData, tolerance: float) -> _WeldedMesh | None:
    """Return the mesh with welded vertices, without faces that lose a corner. Return None if no face with an area remains.

    Raises WeldError if the tolerance is much too large."""
    vertices, count = weld_vertices(mesh.vertices, tolerance)
    if not count:
        return _WeldedMesh(mesh, 0, np.ones(len(mesh.faces), np.bool_))
    keep = has_distinct_corners(vertices, mesh.faces)
    welded_mesh = setting_data.MeshData(vertices, mesh.faces[keep])
    return (
        _WeldedMesh(welded_mesh, count, keep)
        if has_nonzero_area(*(vertices[welded_mesh.faces[:, k]] for k in range(3))).any()
        else None
    )


def _record_welding(staging: SceneStaging, name: str, welding: _WeldedMesh) -> setting_data.MeshData:
    """Record the changes by welding, and return the welded mesh. Painted values are reduced to those of the remaining faces."""
    raw = staging.raw_meshes[name]
    if welding.moved_count:
        staging.weld_counts[name] = staging.weld_counts.get(name, 0) + welding.moved_count
    if not welding.is_retained_face.all():
        dropped = raw.dropped_faces + int((~welding.is_retained_face).sum())
        staging.raw_meshes[name] = replace(
            raw,
            faces=raw.faces[welding.is_retained_face],
            file_face_indices=raw.file_face_indices[welding.is_retained_face],
            dropped_faces=dropped,
        )
    return welding.mesh


def close_solid(
    staging: SceneStaging, name: str, value: MeshThing | UsdThing, solid: setting_data.SolidData
) -> setting_data.SolidData:
    """Return the solid with welded vertices if it is not closed and the scene has no `weld`. Otherwise, return it unchanged.

    Report an error if the solid still has no inside."""
    display_name, place = find_mesh_location(staging, name)
    if is_flat(solid.mesh.vertices, solid.mesh.faces):
        words, help = f"the solid `{name}` has no volume: `{display_name}` is flat", "give it a thickness, or declare a `surface`"
        staging.report.error("bad-mesh", words, place, help)
        return solid
    loose = count_open_solid_edges(solid)
    if not loose:
        return solid
    if value.weld is None:
        try:
            welding = _weld_mesh(solid.mesh, _DEFAULT_WELD_VOXELS * solid.voxel)
        except WeldError:
            welding = None
        if welding is not None and not is_flat(welding.mesh.vertices, welding.mesh.faces):
            closed = replace(solid, mesh=welding.mesh)
            if not count_open_solid_edges(closed):
                _record_welding(staging, name, welding)
                return closed
    edges = "1 edge belongs" if loose == 1 else f"{loose:,} edges belong"
    words = f"the mesh of the solid `{name}` is not closed: {edges} to only one face"
    gaps = measure_openings(solid.mesh.vertices, solid.mesh.faces, solid.voxel)
    if gaps.closing_tolerance:
        help = f"its gaps are up to {gaps.width:.2g} mm wide: write `weld: {gaps.closing_tolerance:g} mm`"
    else:
        holes = "it has a hole" if gaps.hole_count == 1 else f"it has {gaps.hole_count:,} holes, the largest"
        help = (
            f"{holes} of {gaps.largest_hole_edges:,} edges, up to {gaps.longest_edge:.3g} mm long: "
            "close it in the program that made the mesh"
        )
    staging.report.error("bad-mesh", words, place, help)
    return solid


def check_live_faces(staging: SceneStaging) -> None:
    """Report surfaces on which agents cannot walk, because all of their faces are too small.

    The simulation uses the same rule to decide which faces are ground."""
    if not staging.surfaces:
        return
    used = [mesh.vertices[mesh.faces].reshape(-1, 3) for mesh in staging.surfaces.values()]
    low, high = (edge([edge(points, axis=0) for points in used], axis=0) for edge in (np.min, np.max))
    extent = float((high - low).max())
    for name, mesh in staging.surfaces.items():
        if has_any_face_with_area(mesh.vertices, mesh.faces, extent):
            continue
        display_name, span = find_mesh_location(staging, name)
        if has_nonzero_area(*(mesh.vertices[mesh.faces[:, k]] for k in range(3))).any():
            words = f"the mesh `{display_name}` is less than a millionth as wide as all surfaces together ({extent:.3g} mm)"
            help = "check its `units` and `scale`, or leave it out"
        else:
            words = f"the mesh `{display_name}` has only faces that are as thin as lines, on which no agent can stand"
            help = "make it wider in the program that made the mesh"
        staging.report.error("bad-mesh", words, span, help)


def find_mesh_location(staging: SceneStaging, name: str) -> tuple[str, Span | None]:
    """Return the name of a thing's mesh for messages, and the location at which the scene names this mesh."""
    value = staging.scene.model.world[name]
    assert isinstance(value, ThingModel)
    key = "prim" if isinstance(value, UsdThing) else value.find_form_key()
    return str(value.prim_path if isinstance(value, UsdThing) else getattr(value, key)), staging.scene.find_span(
        "world", name, key
    )


def collect_imports(staging: SceneStaging) -> dict[str, MeshImport]:
    """Return the import report of each mesh, with lengths in scene units."""
    imports, unit = {}, staging.scene.model.unit_mm
    solids = {name: solid.mesh for name, solid in staging.solids.items()}
    for name, mesh in {**staging.surfaces, **staging.obstacles, **solids}.items():
        raw, value = staging.raw_meshes[name], staging.scene.model.world[name]
        notes = raw.notes
        corners = mesh.vertices[mesh.faces].reshape(-1, 3)
        low, high = (edge(corners, axis=0) / unit for edge in (np.min, np.max))
        imports[name] = MeshImport(
            file=str(getattr(value, value.find_form_key())) if isinstance(value, ThingModel) else name,
            form=notes.form or ("USD" if isinstance(value, UsdThing) else "heights"),
            vertices=notes.vertices,
            triangles=notes.triangles,
            polygons=notes.cut_polygons,
            concave=notes.concave_polygons,
            crossing=notes.crossing_polygons,
            dropped=raw.dropped_faces,
            welded=staging.weld_counts.get(name, 0),
            left=len(mesh.faces),
            border_edges=count_border_edges(mesh),
            skipped=tuple(notes.describe_skipped()),
            low=(float(low[0]), float(low[1]), float(low[2])),
            high=(float(high[0]), float(high[1]), float(high[2])),
        )
    return imports


class WeldError(Exception):
    """Error for vertices that cannot be welded. The message is a reason that fits after the tolerance."""


def weld_vertices(vertices: Floats, tolerance: float) -> tuple[Floats, int]:
    """Return the vertices (n, 3) after welding, and the number of moved vertices. The indices of vertices do not change.

    Vertices that are connected by distances below `tolerance`, directly or through others, move to the position of the first of
    them. Raises WeldError if a list of such pairs would need far more memory than the mesh."""
    from scipy.spatial import KDTree

    order, new, which = find_distinct_points(vertices)
    points = vertices[order[new]]
    tree = KDTree(points)
    if int(tree.count_neighbors(tree, tolerance)) - len(points) > 2 * max(_MAX_WELD_PAIRS, _MAX_PAIRS_PER_VERTEX * len(points)):
        raise WeldError("is farther than from each vertex to dozens of others")
    pairs = tree.query_pairs(tolerance, output_type="ndarray")
    if not len(pairs):
        return vertices, 0
    number = number_connected_components(pairs, len(points))[which]
    first = np.full(int(number.max()) + 1, len(vertices))
    np.minimum.at(first, number, np.arange(len(vertices)))  # the first vertex in the file, independent of the library's numbers
    welded_vertices = vertices[first[number]]
    return welded_vertices, int((welded_vertices != vertices).any(axis=1).sum())


def compute_edge_lengths(vertices: Floats, faces: Faces) -> Floats:
    """Return the lengths of the three edges of each face (m, 3)."""
    corners = vertices[faces]
    edges = corners - np.roll(corners, -1, axis=1)
    return np.asarray(np.sqrt((edges * edges).sum(axis=2)))


def has_distinct_corners(vertices: Floats, faces: Faces) -> NDArray[np.bool_]:
    """Return whether each face has corners at three different positions."""
    return np.asarray((compute_edge_lengths(vertices, faces) > 0).all(axis=1))


def is_flat(vertices: Floats, faces: Faces) -> bool:
    """Return whether all faces lie in the plane of the largest face. A closed mesh of this kind has no volume."""
    corners = vertices[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.sqrt((across * across).sum(axis=1))
    largest = int(size.argmax())
    if not size[largest]:
        return True
    away = ((corners - corners[largest, 0]) * (across[largest] / size[largest])).sum(axis=2)
    return bool(np.abs(away).max() <= _FLAT_BODY_RATIO * np.ptp(corners.reshape(-1, 3), axis=0).max())


@dataclass(frozen=True, slots=True)
class MeshOpenings:
    """The openings of a mesh that is not closed.

    `closing_tolerance`: a welding distance in mm, with one digit, that closes the mesh; 0 if there is none.
    `width`: the width in mm of the widest gap that this welding closes; 0 if there is none.
    `hole_count`: the number of separate borders.
    `largest_hole_edges`: the number of edges around the largest hole.
    `longest_edge`: the length in mm of the longest edge around this hole."""

    closing_tolerance: float
    width: float
    hole_count: int
    largest_hole_edges: int
    longest_edge: float


def measure_openings(vertices: Floats, faces: Faces, tolerance: float) -> MeshOpenings:
    """Return the openings of a mesh. `tolerance`: the distance (mm) below which two positions count as one."""
    from scipy.spatial import KDTree

    edges, points = find_edges_with_odd_faces(vertices, faces, tolerance)
    ends = points[edges]
    lengths = np.sqrt(((ends[:, 0] - ends[:, 1]) ** 2).sum(axis=1))
    rim = np.unique(edges)
    near = KDTree(points[rim]).query(points[rim], k=min(2, len(rim)))[0]
    near = near[:, -1] if near.ndim == 2 else near
    most = float(np.median(compute_edge_lengths(vertices, faces))) / 4
    narrow = near[near < most]
    gap = width = float(narrow.max()) if len(narrow) else 0.0
    for _ in range(_MAX_CLOSING_TRIES if gap else 0):
        gap = round_up_digit(gap)
        if gap > most:
            break
        try:
            moved = weld_vertices(vertices, gap)[0]
        except WeldError:
            break
        if (
            has_distinct_corners(moved, faces).any()
            and not is_flat(moved, faces)
            and not len(find_edges_with_odd_faces(moved, faces, tolerance)[0])
        ):
            return MeshOpenings(gap, width, 0, 0, 0.0)
        gap *= 2
    _, piece, count = np.unique(
        number_connected_components(edges, len(points))[edges[:, 0]], return_inverse=True, return_counts=True
    )
    largest = int(count.argmax())
    return MeshOpenings(0.0, 0.0, len(count), int(count[largest]), float(lengths[piece == largest].max()))


def round_down_digit(x: float) -> float:
    """Return x rounded down to one significant digit, such as 0.1 for 0.17."""
    digits, _, power = f"{x:.15e}".partition("e")
    return float(f"{digits[0]}e{power}")


def round_up_digit(x: float) -> float:
    """Return the smallest number above x that has one significant digit, such as 0.2 for 0.17 and 0.3 for 0.2."""
    digits, _, power = f"{x:.15e}".partition("e")
    return float(f"{int(digits[0]) + 1}e{power}")
