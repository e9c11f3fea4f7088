"""Solids as dug in each frame: meshes of their surfaces, and volumes of signed distances."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.atomic_write import write_atomically
from antdsl.outputs.cache.dug_solids import DugSolids
from antdsl.outputs.cache.npz import encode_npz
from antdsl.outputs.exports.mesh_files import MeshPart, write_mesh
from antdsl.outputs.gallery import Gallery
from antdsl.outputs.numbered_files import ExportUnavailable, make_numbered_path
from antdsl.scene.scene_model import UNIT_MM

_NO_SOLIDS_ERROR = ExportUnavailable("the scene has no solid for agents to dig", "add a mesh with `kind: solid` to `world`")


def export_solids(gallery: Gallery, frames: Iterable[int], path: Path) -> None:
    """Write the surfaces of all solids as one mesh per frame, in scene units. The frame number is inserted into the name of
    `path`.

    Raises ExportUnavailable if the cache has no solids, CacheError for a damaged frame, OSError if writing fails."""
    dug = DugSolids(gallery.cache, gallery.static)
    for frame in frames:
        solids = dug.at(frame)
        if not solids:
            raise _NO_SOLIDS_ERROR
        write_mesh(
            make_numbered_path(path, frame), [MeshPart(each.name, each.vertices, each.faces) for each in solids], gallery.origin
        )


def export_volumes(gallery: Gallery, frames: Iterable[int], path: Path) -> list[str]:
    """Write the solids as dense volumes, in scene units, for the last of the frames only. Return a message that names this frame.

    `NAME.distance` float32[x, y, z]: signed distances from the surface at lattice points, negative inside the solid, limited to
    the band. `NAME.origin` float64[3]: the position of the first lattice point. `NAME.cell` float64: the spacing. `NAME.band`
    float64[2]: the least and the greatest distance.

    Raises ExportUnavailable if there are no solids, or if a volume is too large. Raises CacheError for a damaged frame, OSError
    if writing fails."""
    last = list(frames)[-1]
    dug = DugSolids(gallery.cache, gallery.static)
    if not dug.at(last):
        raise _NO_SOLIDS_ERROR
    arrays: dict[str, NDArray[Any]] = {"frame": np.array(last, np.int64)}
    scale = 1.0 / UNIT_MM[gallery.manifest.units]
    for name, volume, offset in dug.iterate_volumes():
        bricks = volume.bricks
        points = int(np.prod([8 * int(n) for n in bricks.shape], dtype=np.float64))
        if points * 4 > limits.GIB:
            raise ExportUnavailable(
                f"the volume of `{name}` has {points:,} points, more than the limit", "export the solid as a mesh: `.ply`"
            )
        arrays |= {
            f"{name}.distance": volume.make_dense_distances() * np.float32(scale),
            f"{name}.origin": (np.asarray(bricks.origin, np.float64) + offset) * scale + gallery.origin,
            f"{name}.cell": np.array(bricks.voxel * scale),
            f"{name}.band": np.array([bricks.min_distance * scale, bricks.max_distance * scale]),
        }
    write_atomically(path, encode_npz(arrays))
    return [f"the volume is that of frame {last}"]
