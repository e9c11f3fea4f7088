"""A cache as keyframes in a text table, with one row per agent and frame: position, angles and scale."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from antdsl.atomic_write import atomic_file
from antdsl.outputs.cache.frame_agents import find_species_rows, get_agent_ids, list_special_arrays
from antdsl.outputs.csv_text import format_csv
from antdsl.outputs.euler_angles import EulerAngles
from antdsl.outputs.gallery import Gallery, choose_coordinate_format

HEADER_LINE = "id,frame,tx,ty,tz,rx,ry,rz,sx,sy,sz,species"


def export_csv(gallery: Gallery, frames: Iterable[int], path: Path) -> None:
    """Write the agents of these frames as CSV, atomically, in the scene's units and axes.

    Positions are relative to the scene's origin. Angles are degrees about x, then y, then z, without jumps between frames. Angles
    and scale (the body length) transform a body of length 1 that faces +x, with +y up.

    Raises CacheError for a damaged frame, OSError if writing fails."""
    row = "%d,%d" + f",{choose_coordinate_format(gallery)}" * 3 + ",%.9g" * 6  # nine digits restore a float32 exactly
    angles = [EulerAngles() for _ in gallery.manifest.species]
    with atomic_file(path) as file:
        file.write(f"{HEADER_LINE}\n".encode())
        names = [format_csv([("", each.name)]).replace("%", "%%") for each in gallery.manifest.species]
        for frame in frames:
            arrays = gallery.cache.frame(frame, list_special_arrays("csv"))
            numbers = get_agent_ids(arrays)
            for number, name in enumerate(names):
                rows = find_species_rows(arrays, number)
                rows = rows[np.argsort(numbers[rows], kind="stable")]
                table = np.empty((len(rows), 11))
                table[:, 0], table[:, 1], table[:, 2:5] = numbers[rows], frame, arrays["P"][rows] + gallery.origin
                table[:, 5:8] = angles[number].compute_angles(numbers[rows], arrays["orient"][rows])
                table[:, 8:] = arrays["pscale"][rows, None]
                text = (row + name) * len(rows) % tuple(table.ravel().tolist())
                file.write(text.encode())
