"""Exports with one file per frame, as tasks. Each task exports some frames."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from antdsl.executors import Task, TaskRefused, Worker, refuse_task
from antdsl.outputs.cache.cache_reader import CacheError, open_cache
from antdsl.outputs.cache.manifest import ManifestError
from antdsl.outputs.exports import AgentSubset, export_for
from antdsl.outputs.gallery import Gallery, PictureUnavailable
from antdsl.outputs.numbered_files import ExportUnavailable
from antdsl.shots.placing import Destination

CHUNK = 8  # frames of a task


def export_tasks(
    cache: Path, name: str, form: str, ids: frozenset[int] | None, frames: Sequence[int], to: Destination
) -> Iterator[Task]:
    """Yield tasks that write all frames. `name`: the pattern of the file names. `cache`: an absolute path without links."""
    document = {"cache": str(cache), "name": name, "form": form, "ids": None if ids is None else sorted(ids)}
    return to.frame_tasks(export_frames, document, frames, CHUNK)


def export_frames(document: Mapping[str, Any], worker: Worker) -> dict[str, Any]:
    """Write the files of some frames."""
    to, name = Destination.of(document), document["name"]
    export = export_for(Path(name))
    if export is None or document["form"] not in export.each:
        raise TaskRefused(f"`{name}` has no file for each frame")
    with refuse_task(ManifestError, CacheError, PictureUnavailable, ExportUnavailable):
        cache = open_cache(worker.local_path(document["cache"]))
        if document["ids"] is not None:
            cache = AgentSubset(cache.folder, cache.manifest, frozenset(document["ids"]))
        place = to.place(worker, document["key"])
        notes = export.forms[document["form"]](Gallery(cache), document["frames"], place / name)
    worker.notes += notes or ()
    return to.describe_files(worker, place, document["key"])
