"""Staging of things that are more than one static file: parts of USD files, files per frame, and things with keys.

They are converted to mm, the scene's axes and positions at every simulated frame."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.scene import setting as setting_data
from antdsl.scene.crowds.crowd_model import UsdPositions
from antdsl.scene.document import PathKey
from antdsl.scene.geometry.import_notes import ImportNotes
from antdsl.scene.geometry.matrices import apply_transforms, has_inverse
from antdsl.scene.geometry.mesh_files import RawMesh, check_mesh, read_mesh_arrays, rotate_points, rotate_up_axis
from antdsl.scene.geometry.mesh_text import MeshError
from antdsl.scene.paths import PathRefused
from antdsl.scene.quantities import Quantity
from antdsl.scene.staging.motion import MeshMotion
from antdsl.scene.thing_models import (
    UNIT_MM,
    CurveThing,
    ItemThing,
    LampThing,
    MeshThing,
    PaintedThing,
    PlacedThing,
    UsdThing,
    convert_point,
    convert_rotation,
)
from antdsl.scene.values import PointValue, PositionKey

if TYPE_CHECKING:
    from antdsl.scene.geometry.usd import UsdPoints, UsdStage
    from antdsl.scene.staging.stage_scene import SceneStaging

Floats = NDArray[np.float64]
RotationAngles = tuple[Quantity, Quantity, Quantity]
T = TypeVar("T")


# ---- frames


def list_simulated_frames(staging: SceneStaging) -> range:
    """Return the simulated frames, including the preroll. In the first of these frames, meshes are at rest."""
    model = staging.scene.model
    return range(model.frames.first - model.preroll, model.frames.last + 1)


def find_frame_files(staging: SceneStaging, text: str, *path: PathKey) -> list[str] | None:
    """Return the file for each frame if a path contains `####`, else None.

    Frames before the first existing file get the first file. Frames after the last existing file get the last file."""
    files = staging.find_sequence(text, *path)
    if files is None:
        return None
    numbers = list(files)
    frames = list_simulated_frames(staging)
    used = [files.get(min(max(frame, numbers[0]), numbers[-1])) for frame in frames]
    if None in used:
        frame = frames[used.index(None)]
        staging.report.error(
            "no-such-file", f"`{text}` has no file for frame {frame}", staging.scene.find_span(*path), "write all frames out"
        )
        return None
    return [file for file in used if file is not None]


# ---- keys


def interpolate_keys(
    keys: Mapping[int, PositionKey],
    own_at: PointValue | None,
    own_rotation: RotationAngles | None,
    frames: Sequence[int],
    unit_mm: float,
) -> tuple[Floats, Floats] | None:
    """Return the position (frames, 3) in mm and the rotation (frames, 3) in radians at each frame, or None without keys.

    If no key defines a position or a rotation, `own_at` or `own_rotation` of the thing is used."""
    if not keys:
        return None
    at = {f: convert_point(key.at, unit_mm) for f, key in keys.items() if key.at is not None}
    turn = {f: tuple(a.number for a in key.rotate) for f, key in keys.items() if key.rotate is not None}
    if not at:
        at = {0: convert_point(own_at, unit_mm)}
    if not turn:
        turn = {0: tuple(a.number for a in own_rotation) if own_rotation else (0.0, 0.0, 0.0)}
    return interpolate_values(at, frames), interpolate_values(turn, frames)


def interpolate_values(keys: Mapping[int, tuple[float, ...]], frames: Sequence[int]) -> Floats:
    """Return values (frames, k) that are interpolated linearly between keys."""
    times = sorted(keys)
    values = np.array([keys[time] for time in times], np.float64)
    return np.stack([np.interp(np.array(frames, np.float64), times, column) for column in values.T], axis=1)


def _make_key_transforms(staging: SceneStaging, value: PlacedThing | CurveThing, factor: float, own_up: str) -> Floats | None:
    """Return the transforms (frames, 3, 4) from points in a file to mm and the scene's axes; None for a thing without keys."""
    model, frames = staging.scene.model, list_simulated_frames(staging)
    placed = interpolate_keys(value.keys, value.at, getattr(value, "rotate", None), frames, model.unit_mm)
    if placed is None:
        return None
    axes = rotate_up_axis(np.eye(3) * factor, own_up, model.up)
    transforms = np.empty((len(frames), 3, 4))
    for k, (at, turn) in enumerate(zip(*placed, strict=True)):
        transforms[k, :, :3] = rotate_points(axes, (float(turn[0]), float(turn[1]), float(turn[2]))).T
        transforms[k, :, 3] = at
    return transforms


# ---- meshes


def read_moving_mesh(staging: SceneStaging, name: str, value: MeshThing) -> tuple[RawMesh, MeshMotion | None] | None:
    """Return the mesh in a sequence of files, and the motion of its vertices, in the file's own units and axes."""
    files = find_frame_files(staging, value.mesh, "world", name, "mesh")
    if files is None:
        return None
    span = staging.scene.find_span("world", name, "mesh")
    read: dict[str, Floats] = {}
    raw, first, positions = None, None, None
    for k, file in enumerate(files):
        if file in read and positions is not None:
            positions[k] = read[file]
            continue
        data = staging.read_file(file, limits.MAX_MESH_BYTES, "world", name, "mesh")
        if data is None:
            return None
        try:
            notes = ImportNotes()
            vertices, faces = read_mesh_arrays(data, file, value.group, staging.make_sibling_reader(file), notes)
            if raw is None or positions is None or first is None:
                raw, first = check_mesh(vertices, faces, notes), faces
                size = len(files) * len(raw.vertices) * 48
                if size > limits.MAX_MOTION_BYTES:
                    words = f"{len(files):,} frames of `{value.mesh}` would take {size / limits.GIB:.1f} GiB"
                    staging.report.error("too-large", words, span, "simulate fewer frames at a time, or use a lighter mesh")
                    return None
                positions = np.empty((len(files), *raw.vertices.shape))
            if not np.array_equal(first, faces):
                words = f"`{file}` has other faces than `{files[0]}`"
                staging.report.error("moving-topology", words, span, "write all frames with the same faces in the same order")
                return None
            positions[k] = vertices[raw.file_vertex_indices]
            if not (np.isfinite(positions[k]).all() and (np.abs(positions[k]) < 1e30).all()):
                raise MeshError("has a vertex that is not a finite point")
        except MeshError as why:
            staging.report.error("bad-mesh", f"the mesh `{file}` {why}", span, why.help)
            return None
        except PathRefused as error:
            staging.report.error(error.code, f"the mesh `{file}` names a buffer: {error}", span, error.help)
            return None
        read = {file: positions[k]}
    assert raw is not None and positions is not None
    return raw, None if (positions == positions[0]).all() else MeshMotion.from_positions(positions)


def stage_usd_mesh(staging: SceneStaging, name: str, value: UsdThing) -> tuple[RawMesh, MeshMotion | None] | None:
    """Return the meshes below a prim and their motion, in mm and the scene's axes."""
    from antdsl.scene.geometry.usd import read_usd_mesh

    mesh = read_usd(staging, value.usd, value.prim_path, value.purpose, ("world", name), read_usd_mesh)
    if mesh is None:
        return None
    if mesh.unread_shape_types:
        words = f"shapes of the types {', '.join(mesh.unread_shape_types)} below `{value.prim_path}` are not read"
        staging.report.warning("usd-left-out", words, staging.scene.find_span("world", name, "prim"), "turn them into meshes")
    return mesh.raw_mesh, mesh.motion


def place_motion(
    staging: SceneStaging, value: PlacedThing, raw: RawMesh, file_motion: MeshMotion | None, factor: float, own_up: str
) -> tuple[Floats, MeshMotion | None] | None:
    """Return the vertices at rest and the motion of a mesh that moves in its file or by keys. Return None for a static mesh."""
    transforms = _make_key_transforms(staging, value, factor, own_up)
    if file_motion is None and transforms is None:
        return None
    if transforms is None:  # a single key: the thing has the same position at all frames
        transforms = _make_key_transforms(staging, value.model_copy(update={"keys": {0: PositionKey()}}), factor, own_up)
    assert transforms is not None and has_inverse(transforms[0])
    rest = apply_transforms(transforms[0], raw.vertices)
    if file_motion is not None:
        return rest, file_motion.transform_motion(transforms)
    return rest, None if (transforms == transforms[0]).all() else MeshMotion.from_transforms(transforms, len(rest))


def find_first_rotation(staging: SceneStaging, value: PlacedThing) -> tuple[float, float, float]:
    """Return the rotation of a mesh at the first frame, in radians about x, then y, then z."""
    placed = interpolate_keys(value.keys, value.at, value.rotate, list_simulated_frames(staging)[:1], staging.scene.model.unit_mm)
    if placed is not None:
        x, y, z = placed[1][0].tolist()
        return x, y, z
    return convert_rotation(value)


def limit_vector_lengths(vectors: Floats) -> Floats:
    """Return vectors (n, 3). Vectors longer than 1 are shortened to length 1; others are unchanged."""
    return np.asarray(vectors / np.maximum(np.sqrt((vectors * vectors).sum(axis=1)), 1.0)[:, None])


def stage_usd_paint(staging: SceneStaging, name: str, thing: PaintedThing, mesh: UsdThing, width: int) -> Floats | None:
    """Return a primvar on the vertices of a surface, from the surface's USD file. `width`: 1 for numbers, 3 for vectors, which
    are in the scene's axes."""
    from antdsl.scene.geometry.usd import read_usd_mesh

    attribute = name if thing.attribute is None else thing.attribute
    span = staging.scene.find_span("world", name, "attribute")
    if not isinstance(attribute, str):
        staging.report.error("bad-paint", "a primvar has one name", span, f"write `attribute: {attribute[0]}`")
        return None
    painted_mesh = read_usd(
        staging, mesh.usd, mesh.prim_path, mesh.purpose, ("world", name), lambda stage: read_usd_mesh(stage, [attribute])
    )
    if painted_mesh is None:
        return None
    values = painted_mesh.values[attribute] * thing.strength
    if values.ndim != (1 if width == 1 else 2):
        has, expected = ("vectors", "numbers") if width == 1 else ("numbers", "vectors")
        staging.report.error("bad-paint", f"the primvar `{attribute}` contains {has}, but `{name}` needs {expected}", span)
        return None
    if not np.isfinite(values).all():
        staging.report.error("bad-paint", f"the primvar `{attribute}` has a value that is not finite", span)
        return None
    if width == 1:
        return values
    return limit_vector_lengths(rotate_points(values * (-1.0 if mesh.scale < 0 else 1.0), find_first_rotation(staging, mesh)))


# ---- curves


def stage_curve(staging: SceneStaging, name: str, value: CurveThing | UsdThing) -> Floats | None:
    """Return the points (frames, k, 3) of a curve. A static curve has a single frame."""

    model = staging.scene.model
    if isinstance(value, UsdThing):
        from antdsl.scene.geometry.usd import read_usd_curve

        positions = read_usd(staging, value.usd, value.prim_path, value.purpose, ("world", name), read_usd_curve)
        factor, own_up = value.scale, model.up
    else:
        files = (
            find_frame_files(staging, value.curve, "world", name, "curve")
            if staging.scene.roots.is_sequence(value.curve)
            else [value.curve]
        )
        if files is None:
            return None
        read = {file: staging.read_points(file, 2, "world", name, "curve") for file in dict.fromkeys(files)}
        lines = [read[file] for file in files]
        if any(line is None for line in lines):
            return None
        complete_lines = [line for line in lines if line is not None]
        other = next((k for k, line in enumerate(complete_lines) if line.shape != complete_lines[0].shape), None)
        if other is not None:
            words = f"`{files[other]}` has a different number of points from `{files[0]}`"
            span = staging.scene.find_span("world", name, "curve")
            staging.report.error("moving-topology", words, span, "write all frames with the same number of points")
            return None
        positions = np.stack(complete_lines)
        factor, own_up = UNIT_MM[value.units or model.units], value.up or model.up
    if positions is None:
        return None
    transforms = _make_key_transforms(staging, value, factor, own_up)
    if transforms is None:
        at = np.array(convert_point(value.at, model.unit_mm))
        turn = convert_rotation(value) if isinstance(value, UsdThing) else (0.0, 0.0, 0.0)
        return np.stack([rotate_points(rotate_up_axis(line * factor, own_up, model.up), turn) + at for line in positions])
    return _apply_transforms_by_frame(transforms, positions)


def _apply_transforms_by_frame(transforms: Floats, positions: Floats) -> Floats:
    """Return positions (frames, k, 3), transformed frame by frame. The input with fewer frames repeats its last frame."""
    count = max(len(positions), len(transforms))
    frames = [(min(k, len(transforms) - 1), min(k, len(positions) - 1)) for k in range(count)]
    return np.stack([apply_transforms(transforms[i], positions[j]) for i, j in frames])


# ---- items


def compute_item_positions(staging: SceneStaging, name: str, item: str | None, thing: ItemThing | LampThing) -> Floats:
    """Return the positions (frames, 3) in mm of an item or lamp. Without keys, there is a single frame. `item`: the name of the
    item in the group `name`, or None."""
    unit_mm = staging.scene.model.unit_mm
    placed = interpolate_keys(thing.keys, thing.at, None, list_simulated_frames(staging), unit_mm)
    if placed is None:
        return np.array([convert_point(thing.at, unit_mm)])
    if any(key.rotate is not None for key in thing.keys.values()):
        frame = next(f for f, key in thing.keys.items() if key.rotate is not None)
        span = staging.scene.find_span("world", name, *([] if item is None else [item]), "keys", str(frame), "rotate")
        staging.report.error(
            "wrong-value", f"the item `{item or name}` has no orientation, so it cannot rotate", span, "delete `rotate`"
        )
    return placed[0]


def stage_usd_items(staging: SceneStaging, name: str, value: UsdThing) -> UsdPoints | None:
    """Return the points below a prim, or the empties of a kind, with the scene's transforms applied; None after an error."""
    from dataclasses import replace

    from antdsl.scene.geometry.usd import read_usd_points

    kind = name if value.kind is None and value.prim is None else value.kind
    points = read_usd(
        staging, value.usd, value.prim_path, value.purpose, ("world", name), lambda stage: read_usd_points(stage, kind)
    )
    if points is None:
        return None
    transforms = _make_key_transforms(staging, value, value.scale, staging.scene.model.up)
    if transforms is None:
        transforms = _make_key_transforms(
            staging, value.model_copy(update={"keys": {0: PositionKey()}}), value.scale, staging.scene.model.up
        )
        assert transforms is not None
        transforms = transforms[:1]
    ahead = apply_transforms(np.concatenate([transforms[0][:, :3], np.zeros((3, 1))], axis=1), points.ahead) * np.sign(
        value.scale
    )
    return replace(
        points,
        positions=_apply_transforms_by_frame(transforms, points.positions),
        radius=points.radius * abs(value.scale),
        ahead=ahead,
    )


def stage_usd_places(staging: SceneStaging, value: UsdPositions, *path: PathKey) -> UsdPoints | None:
    """Return the points or empties at which a crowd line starts, in mm and the scene's axes."""
    from antdsl.scene.geometry.usd import read_usd_points

    species = staging.scene.model.crowd[int(path[1])].species
    kind = species if value.kind is None and value.prim is None else value.kind
    place = (*path, "points")
    return read_usd(staging, value.usd, value.prim or "/", "render", place, lambda stage: read_usd_points(stage, kind))


def follow_surface(mesh: setting_data.MeshData, mesh_moves: MeshMotion, point: setting_data.PointMm) -> Floats:
    """Return the positions (frames, 3) of a point that is attached to its triangle on a moving surface."""
    corners = mesh.vertices[mesh.faces]
    a, b, c = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(b, c)
    size = np.maximum((normal * normal).sum(axis=1), 1e-300)
    away = np.array(point) - a
    w2 = (np.cross(b, away) * normal).sum(axis=1) / size
    w1 = (np.cross(away, c) * normal).sum(axis=1) / size
    off = np.abs((away * normal).sum(axis=1)) / np.sqrt(size) + 1e6 * np.maximum(
        0, np.maximum.reduce([-w1, -w2, w1 + w2 - 1]) - 1e-9
    )
    face = int(off.argmin())
    positions = []
    for k in range(mesh_moves.frame_count):
        p = mesh_moves.compute_vertices(mesh.vertices, k)[mesh.faces[face]]
        positions.append(p[0] + w1[face] * (p[1] - p[0]) + w2[face] * (p[2] - p[0]))
    return np.array(positions)


# ---- USD


def read_usd(
    staging: SceneStaging, text: str, prim: str, purpose: str, path: tuple[PathKey, ...], read: Callable[[UsdStage], T]
) -> T | None:
    """Return the result of `read` at a prim. On failure, report an error at the location in the scene and return None."""
    from antdsl.scene.geometry.usd import UsdError, open_stage

    model = staging.scene.model
    try:
        stage = open_stage(
            staging.scene.roots,
            text,
            prim,
            up=model.up,
            frames=list_simulated_frames(staging),
            fps=model.fps,
            purpose=purpose,
            closures=staging.closures,
        )
        staging.hashes |= stage.hashes
        return read(stage)
    except UsdError as error:
        staging.report.error(error.code, str(error), staging.scene.find_span(*path, error.key), error.help)
    except MeshError as error:
        words = f"the mesh `{prim}` of `{text}` {error}"
        staging.report.error(
            "bad-mesh",
            words,
            staging.scene.find_span(*path, "prim"),
            "repair it in the program that made it, and export it again",
        )
    return None
