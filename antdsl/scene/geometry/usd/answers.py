"""The reader process's answers about USD files, as arrays of this process. Every count, shape, type and index is checked before
use."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import wraps
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.reader.protocol import ProtocolError, ReaderMessage
from antdsl.scene.geometry.mesh_files import RawMesh, check_mesh
from antdsl.scene.geometry.usd.errors import UsdError
from antdsl.scene.geometry.usd.points import UsdPoints
from antdsl.scene.geometry.usd.stage import UsdStage
from antdsl.scene.staging.motion import MeshMotion

Floats = NDArray[np.float64]
T = TypeVar("T")
_MAX_NAME_CHARACTERS = 256  # maximum length of a name in the file


@dataclass(frozen=True, slots=True, eq=False)
class UsdMesh:
    """A mesh of a USD file.

    `raw_mesh`: like the mesh of a mesh file, but in mm and the scene's axes.
    `motion`: None if the mesh is static.
    `values`: by the name of a primvar, numbers float64 (n,), or vectors (n, 3) rotated with their mesh.
    `unread_shape_types`: the types of shapes that were not read."""

    raw_mesh: RawMesh
    motion: MeshMotion | None
    values: Mapping[str, Floats]
    unread_shape_types: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class UsdCameraTracks:
    """A camera of a USD file. Positions are in mm. Each array has one row per frame, or a single row for a static camera.

    `up`: the direction to the top of the picture. `focal`: the focal length in mm for a sensor that is 36 mm wide."""

    at: Floats
    look_at: Floats
    up: Floats
    focal: Floats


def read_usd_mesh(stage: UsdStage, primvars: Iterable[str] = ()) -> UsdMesh:
    """Return all meshes at and below the stage's prim, joined into one. `primvars`: the names of the primvars to read.

    Raises UsdError if there are no meshes, and MeshError if they are unusable."""
    names = tuple(primvars)
    answer = stage.send_request("usd-mesh", {"primvars": names})
    try:
        vertices = answer.require_array("vertices", "f8", None, 3)
        faces = answer.require_array("faces", "i8", None, 3)
        if len(faces) > limits.MAX_MESH_FACES or len(vertices) > 3 * limits.MAX_MESH_FACES:
            words = f"the meshes below `{stage.prim}` have {len(faces):,} faces, more than {limits.MAX_MESH_FACES:,}"
            raise UsdError("too-large", words, "name a part of it")
        moves = _read_moves(answer, len(vertices), len(stage.frames)) if "moves:group" in answer.arrays else None
        values = {name: _read_values(answer, f"value:{number}", len(vertices)) for number, name in enumerate(names)}
        passed_over = tuple(text[:_MAX_NAME_CHARACTERS] for text in answer.require_texts("passed_over", 1000))
    except ProtocolError as error:
        raise stage.make_answer_error(error) from None
    raw = check_mesh(vertices, faces)  # `check_mesh` examines each index and each used vertex
    used_values = {name: value[raw.file_vertex_indices] for name, value in values.items()}
    return UsdMesh(raw, None if moves is None else moves.select_vertices(raw.file_vertex_indices), used_values, passed_over)


def _read_moves(answer: ReaderMessage, count: int, frames: int) -> MeshMotion:
    """Return the motion of `count` vertices over `frames` frames, after checks of the answer."""
    tracks = answer.require_array("moves:tracks", "f8", None, frames, 3, 4)
    deformed = answer.require_indices("moves:bent", "i8", count, None)
    offsets = answer.require_array("moves:offsets", "f8", frames if len(deformed) else 0, len(deformed), 3)
    if len(deformed) > 1 and not (np.diff(deformed) > 0).all():
        raise ProtocolError("`bent` is not ascending")
    return MeshMotion(answer.require_indices("moves:group", "i4", len(tracks), count), tracks, deformed, offsets)


def _read_values(answer: ReaderMessage, name: str, count: int) -> Floats:
    """Return the values of a primvar at `count` vertices, after checks of the answer: numbers (count,) or vectors (count, 3)."""
    array = answer.arrays.get(name)
    return (
        answer.require_array(name, "f8", count)
        if array is not None and array.ndim == 1
        else answer.require_array(name, "f8", count, 3)
    )


def wrap_usd_errors(read: Callable[[UsdStage], T]) -> Callable[[UsdStage], T]:
    """Return a reader that does the same as `read` but raises UsdError for an invalid answer."""

    @wraps(read)
    def read_or_raise_usd_error(stage: UsdStage) -> T:
        try:
            return read(stage)
        except ProtocolError as error:
            raise stage.make_answer_error(error) from None

    return read_or_raise_usd_error


def read_usd_points(stage: UsdStage, kind: str | None = None) -> UsdPoints:
    """Return the points of all Points prims at or below the stage's prim. If there are no Points prims, return one point for
    each child prim with a position.

    `kind`: if set, return instead all prims at any depth below the stage's prim that have this `userProperties:kind`."""
    answer = stage.send_request("usd-points", {"of_kind": kind})
    try:
        positions = answer.require_array("places", "f8", None, None, 3)
        frames, count = positions.shape[:2]
        if count > limits.MAX_AGENTS:
            raise UsdError("too-large", f"there are more than {limits.MAX_AGENTS:,} points below `{stage.prim}`")
        if frames not in (1, len(stage.frames)) or not np.isfinite(positions).all():
            raise ProtocolError("`places` has other frames, or a point that is not finite")
        keys, words = answer.require_texts("values", 10_000), answer.require_texts("texts", 10_000)
        return UsdPoints(
            names=answer.unpack_texts("names", count),
            positions=positions,
            radius=answer.require_array("radius", "f8", count),
            values={key: answer.require_array(f"value:{number}", "f8", count) for number, key in enumerate(keys)},
            texts={key: answer.unpack_texts(f"text:{number}", count) for number, key in enumerate(words)},
            ahead=answer.require_array("ahead", "f8", count, 3),
            unit=answer.require_number("unit"),
        )
    except ProtocolError as error:
        raise stage.make_answer_error(error) from None


@wrap_usd_errors
def read_usd_curve(stage: UsdStage) -> Floats:
    """Return the points (frames, k, 3) of the only BasisCurves prim at or below the stage's prim. A static curve has a single
    frame.

    Raises UsdError if there is no such prim, or more than one."""
    positions = stage.send_request("usd-curve").require_array("places", "f8", None, None, 3)
    if len(positions) not in (1, len(stage.frames)) or not positions.shape[1] >= 2 or not np.isfinite(positions).all():
        raise ProtocolError("`places` has other frames, too few points, or one that is not finite")
    return positions


@wrap_usd_errors
def read_usd_camera(stage: UsdStage) -> UsdCameraTracks:
    """Return the camera at the stage's prim, or the only camera below this prim."""
    answer = stage.send_request("usd-camera")
    at = answer.require_array("at", "f8", None, 3)
    if len(at) not in (1, len(stage.frames)):
        raise ProtocolError("`at` has the wrong frames")
    look_at, up = (answer.require_array(name, "f8", len(at), 3) for name in ("look_at", "up"))
    return UsdCameraTracks(at, look_at, up, answer.require_array("focal", "f8", len(at)))
