"""A cache as trajectories of people, in the text format of the Pedestrian Dynamics Data Archive (https://ped.fz-juelich.de/da),
which PedPy can read."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from antdsl.atomic_write import atomic_file
from antdsl.outputs.cache.frame_agents import IDENTITY_ARRAYS, get_agent_ids, get_species_numbers
from antdsl.outputs.gallery import Gallery
from antdsl.scene.thing_models import UNIT_MM

_ROW = "%d %d %.6f %.6f %.6f\n"  # micrometres


def export_trajectories(gallery: Gallery, frames: Iterable[int], path: Path) -> list[str]:
    """Write the positions of all agents in these frames, atomically: id, frame, x, y on the ground and the height, in metres.

    Seen from above, y is to the left of x. With several species, a person has the number `id * species + number of the species`,
    and a message says so.

    Raises CacheError for a damaged frame, OSError if writing fails."""
    manifest = gallery.manifest
    species_count = len(manifest.species)
    scale = UNIT_MM[manifest.units] / 1000  # metres
    with atomic_file(path) as file:
        file.write(f"# framerate: {1 / gallery.dt:.6g}\n# id frame x/m y/m z/m\n".encode())
        for frame in frames:
            arrays = gallery.cache.frame(frame, IDENTITY_ARRAYS | {"P"})
            ids = get_agent_ids(arrays) * species_count + get_species_numbers(arrays)
            order = np.argsort(ids, kind="stable")
            x, y, z = ((arrays["P"][order] + gallery.origin) * scale).T
            ahead, left, height = (x, -z, y) if manifest.up == "y" else (x, y, z)
            table = np.column_stack((ids[order], np.full(len(order), frame), ahead, left, height))
            file.write((_ROW * len(order) % tuple(table.ravel().tolist())).encode())
    if species_count < 2:
        return []
    names = ", ".join(f"{each.name} {number}" for number, each in enumerate(manifest.species))
    return [f"an id is the agent's id times {species_count}, plus the number of its species: {names}"]
