"""Starts a run from one frame of another cache, with the agents, items and fields of this frame."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

import numpy as np

from antdsl.diagnostics import Report
from antdsl.numerics.records import select_by_prefix
from antdsl.outputs.cache.cache_reader import CacheError, make_checkpoint_path, open_cache
from antdsl.outputs.cache.manifest import ManifestError
from antdsl.outputs.cache.npz import MAX_FILE_BYTES
from antdsl.pipeline import Shot
from antdsl.runtime import CheckpointError, World, restore_checkpoint
from antdsl.runtime.line_tables import restore_line_tables
from antdsl.runtime.moving.moving_geometry import pose_geometry
from antdsl.safe_read import read_blocks
from antdsl.scene.paths import PathRefused
from antdsl.scene.scene_model import UNIT_MM

_COINCIDENT_DISTANCE_MM = 1e-6  # mm


class StartError(Exception):
    """Error if a run cannot start from the other cache. `report`: the reason, located in the scene."""

    def __init__(self, report: Report) -> None:
        super().__init__("; ".join(d.message for d in report.errors))
        self.report = report


def find_start_cache(shot: Shot) -> Path | None:
    """Return the folder of the cache from which the scene starts; None if it starts with its own crowd. Raises StartError if the
    path is not allowed."""
    start = shot.scene.model.start
    if start is None:
        return None
    try:
        return shot.scene.roots.resolve_path(start.cache)
    except PathRefused as error:
        raise _make_error(shot, error.code, str(error), "cache", error.help) from None


def hash_start_frame(shot: Shot) -> dict[str, str]:
    """Return a hash of the frame from which the scene starts, as an entry for the inputs of the new cache.

    Empty if the scene starts with its own crowd."""
    folder, start = find_start_cache(shot), shot.scene.model.start
    if folder is None or start is None:
        return {}
    hashed = hashlib.blake2b(digest_size=16)
    try:
        handle = shot.scene.roots.open_file(make_checkpoint_path(Path(start.cache), start.frame).as_posix())
    except PathRefused as error:
        if error.code == "no-such-file":
            raise _make_missing_error(shot, folder) from None
        raise _make_error(shot, error.code, str(error), "cache", error.help) from None
    try:
        for block in read_blocks(handle, MAX_FILE_BYTES):
            hashed.update(block)
    except OSError:
        raise _make_missing_error(shot, folder) from None
    finally:
        os.close(handle)
    return {"from": hashed.hexdigest()}


def start_from_cache(shot: Shot, world: World) -> None:
    """Restore the world from a frame of the other cache, as the first frame of this scene. Raises StartError if this is not
    possible."""
    folder, start = find_start_cache(shot), shot.scene.model.start
    if folder is None or start is None:
        return
    try:
        cache = open_cache(folder)
        arrays = cache.read_checkpoint(start.frame)
    except ManifestError as error:
        raise _make_error(
            shot, "no-such-file", str(error), "cache", ("write the path of a cache inside the scene's folder")
        ) from None
    except CacheError:
        raise _make_missing_error(shot, folder) from None
    source_origin = np.array(cache.manifest.origin) * UNIT_MM[cache.manifest.units]
    # older caches do not contain the origin
    if "origin" in cache.manifest.model_fields_set and (source_origin != world.origin).any():
        a, b = (" ".join(f"{x / 1000:.15g}" for x in each) for each in (source_origin, world.origin))
        words = f"the world of `{start.cache}` has its origin at {a} m, and this scene's world at {b} m"
        raise _make_error(shot, "wrong-value", words, "cache", "use the same meshes at the same positions for all surfaces")
    first, params, state = world.frame, dict(world.params), select_by_prefix(arrays, "world.")
    try:
        restore_checkpoint(world, state)
    except CheckpointError as error:
        words = f"frame {start.frame} of `{start.cache}` belongs to different programs: {error}"
        raise _make_error(
            shot, "wrong-value", words, "cache", ("start from a cache that was made with the same programs")
        ) from None
    shift = first - world.frame
    world.frame = first
    restore_line_tables(world, state, is_run_start=True)
    pose_geometry(world, first)
    world.params = params
    world.transitions.clear()
    world.motion.reset_step_measures()
    world.motion.begin_measuring(world)
    world.faults.fault_count = 0
    for population in world.populations.values():
        population.born = population.born + shift
        footed = world.ground.position(population.footing)
        if len(footed) and np.abs(footed - population.position).max() > _COINCIDENT_DISTANCE_MM:
            words = f"the agents of `{start.cache}` stand on other meshes than this scene has"
            raise _make_error(shot, "wrong-value", words, "cache", "use the same meshes for all surfaces, in the same order")


def _make_missing_error(shot: Shot, folder: Path) -> StartError:
    """Return the error for a folder that contains no cache, or for a frame that has no intact checkpoint."""
    start = shot.scene.model.start
    assert start is not None
    try:
        checkpoints = open_cache(folder).checkpoints()
    except ManifestError as error:
        return _make_error(shot, "no-such-file", str(error), "cache", "write the path of a cache inside the scene's folder")
    near = sorted(checkpoints, key=lambda frame: abs(frame - start.frame))[:3]
    help = "write one of " + ", ".join(map(str, sorted(near))) if near else "run the scene of this cache first"
    return _make_error(shot, "no-such-file", f"`{start.cache}` has no intact checkpoint at frame {start.frame}", "frame", help)


def _make_error(shot: Shot, code: str, message: str, key: str, help: str | None) -> StartError:
    """Return an error with this code and message, located at `key` in the scene's `from`."""
    report = Report()
    report.error(code, message, shot.scene.find_span("from", key), help)
    return StartError(report)
