"""Writes meshes as PLY (binary) and OBJ files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from antdsl.atomic_write import atomic_file

Floats = NDArray[np.floating]
_LINES_PER_BLOCK = 1 << 16  # lines that are made at once


@dataclass(frozen=True, slots=True, eq=False)
class MeshPart:
    """One of the meshes in a file.

    `points` (n, 3), `faces` (m, 3). `normals` (n, 3): unit vectors, or None. `colours` (n, 3): sRGB display values from 0 to 1,
    or None."""

    name: str
    points: NDArray[np.floating]
    faces: NDArray[np.integer]
    normals: NDArray[np.floating] | None = None
    colours: NDArray[np.floating] | None = None


def write_mesh(path: Path, parts: Sequence[MeshPart], origin: NDArray[np.float64]) -> None:
    """Write several meshes to one file. The suffix selects the format: `.ply`, or `.obj` with one object per mesh.

    Normals and colours are written if all parts have them (colours only in PLY). The file is not flushed to disk. `origin`: the
    point to which positions are relative. If it is not 0, positions are written in double precision."""
    starts = np.cumsum([0, *(len(part.points) for part in parts)])
    points: Floats = np.concatenate([np.zeros((0, 3)), *(part.points for part in parts)]).astype(np.float32)
    if origin.any():
        points = points + origin
    all_normals = [part.normals for part in parts if part.normals is not None]
    normals = np.concatenate(all_normals).astype(np.float32) if all_normals and len(all_normals) == len(parts) else None
    with atomic_file(path, sync=False) as file:
        if path.suffix.lower() == ".obj":
            _write_obj(file, parts, starts, points, normals)
        else:
            _write_ply(file, parts, starts, points, normals)


def _write_ply(
    file: IO[bytes], parts: Sequence[MeshPart], starts: NDArray[np.int64], points: Floats, normals: NDArray[np.float32] | None
) -> None:
    """Write a binary PLY file with all meshes. `starts`: the number of the first point of each mesh."""
    faces = np.concatenate([np.zeros((0, 3), np.int64), *(part.faces + s for part, s in zip(parts, starts, strict=False))])
    all_colours = [part.colours for part in parts if part.colours is not None]
    colours = (
        np.rint(np.clip(np.concatenate(all_colours), 0, 1) * 255) if all_colours and len(all_colours) == len(parts) else None
    )
    fields = [(axis, "<f8", "double") if points.dtype == np.float64 else (axis, "<f4", "float") for axis in "xyz"]
    fields += [(f"n{axis}", "<f4", "float") for axis in "xyz"] if normals is not None else []
    fields += [(name, "|u1", "uchar") for name in ("red", "green", "blue")] if colours is not None else []
    rows = np.empty(len(points), np.dtype([(name, kind) for name, kind, _ in fields]))
    columns = [points, *([normals] if normals is not None else []), *([colours] if colours is not None else [])]
    for (name, _, _), column in zip(fields, (c for each in columns for c in each.T), strict=True):
        rows[name] = column
    corners = np.empty(len(faces), np.dtype([("n", "|u1"), ("corners", "<i4", (3,))]))
    corners["n"], corners["corners"] = 3, faces
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    head += [f"property {word} {name}" for name, _, word in fields]
    head += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", ""]
    file.write("\n".join(head).encode("ascii") + rows.tobytes() + corners.tobytes())


def _write_obj(
    file: IO[bytes], parts: Sequence[MeshPart], starts: NDArray[np.int64], points: Floats, normals: NDArray[np.float32] | None
) -> None:
    """Write an OBJ file with one object per mesh. `starts`: the number of the first point of each mesh.

    Point numbers continue from one object to the next, as the format requires."""
    vertex = "v %.15g %.15g %.15g\n" if points.dtype == np.float64 else "v %.9g %.9g %.9g\n"
    for part, start in zip(parts, starts, strict=False):
        rows = slice(start, start + len(part.points))
        file.write(f"o {part.name}\n".encode())
        corner = "%d//%d" if normals is not None else "%d"
        for line, table in (
            (vertex, points[rows]),
            ("vn %.6g %.6g %.6g\n", None if normals is None else normals[rows]),
            (f"f {corner} {corner} {corner}\n", np.repeat(part.faces + start + 1, 2 if normals is not None else 1, axis=1)),
        ):
            for a in range(0, 0 if table is None else len(table), _LINES_PER_BLOCK):
                assert table is not None
                block = table[a : a + _LINES_PER_BLOCK]
                file.write((line * len(block) % tuple(block.ravel().tolist())).encode("ascii"))
