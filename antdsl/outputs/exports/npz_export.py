"""A cache as one NPZ file. Each array of the frames is concatenated, with the start of each frame.

frames          int64[F]: the frame numbers
rows            int64[F + 1]: the agents of frame k are the rows `rows[k]:rows[k + 1]` of `P`, `id` and all arrays of agents
NAME            any other array of the frames, concatenated
NAME.rows       int64[F + 1]: frame k has the rows `NAME.rows[k]:NAME.rows[k + 1]` of NAME
about           uint8, a JSON text: units, up, origin (the point that positions are relative to), fps, the names of arrays of
                agents, and the species with their states, clips and machines"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.atomic_write import atomic_file
from antdsl.outputs.cache.cache_reader import Cache
from antdsl.outputs.cache.frame_agents import ALWAYS_SAVED_ARRAYS
from antdsl.outputs.cache.npz import write_member
from antdsl.outputs.gallery import Gallery

Arrays = dict[str, NDArray[Any]]


def export_arrays(gallery: Gallery, frames: Iterable[int], path: Path) -> None:
    """Write all arrays of these frames to one NPZ file. Only one array of one frame is in memory at a time.

    Raises CacheError for a damaged frame, OSError if writing fails."""
    cache, frames = gallery.cache, list(frames)
    shapes: dict[str, tuple[np.dtype[Any], tuple[int, ...]]] = {}
    counts: dict[str, NDArray[np.int64]] = {}
    for number, frame in enumerate(frames):
        for name, array in cache.frame(frame).items():
            if array.ndim:
                shapes.setdefault(name, (array.dtype, array.shape[1:]))
                counts.setdefault(name, np.zeros(len(frames), np.int64))[number] = len(array)
    agents = [name for name in shapes if name in {*cache.manifest.attributes, *ALWAYS_SAVED_ARRAYS}]
    small: Arrays = {"frames": np.array(frames, np.int64), "rows": _compute_row_starts(counts["P"])}
    small |= {f"{name}.rows": _compute_row_starts(counts[name]) for name in shapes if name not in agents}
    small["about"] = np.frombuffer(json.dumps(_describe_arrays(gallery, agents)).encode("ascii"), np.uint8)
    with atomic_file(path) as output, zipfile.ZipFile(output, "w", zipfile.ZIP_STORED, allowZip64=True) as file:
        for name, array in small.items():
            write_member(file, name, array.dtype, array.shape, [array])
        for name, (kind, rest) in shapes.items():
            write_member(file, name, kind, (int(counts[name].sum()), *rest), _iterate_parts(cache, frames, name, counts[name]))


def _compute_row_starts(counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the first row of each frame and the total number of rows, int64[F + 1]. `counts`: the number of rows of each
    frame."""
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


def _iterate_parts(cache: Cache, frames: list[int], name: str, counts: NDArray[np.int64]) -> Iterator[NDArray[Any]]:
    """Yield the array `name` of each frame that has it."""
    for frame, count in zip(frames, counts, strict=True):
        if count:
            yield cache.frame(frame, frozenset([name]))[name]


def _describe_arrays(gallery: Gallery, agents: list[str]) -> dict[str, Any]:
    """Return the JSON value of `about`. `agents`: the names of the arrays with one row per agent."""
    manifest = gallery.manifest
    species = [each.model_dump(mode="json", include={"name", "machines", "clips", "playing"}) for each in manifest.species]
    return {
        "antdsl": manifest.antdsl, "scene": manifest.scene, "seed": manifest.seed, "units": manifest.units, "up": manifest.up,
        "origin": manifest.origin,
        "fps": manifest.fps, "agents": agents, "species": species,
    }  # fmt: skip
