"""Exports that write one file per frame, as tasks. Each task exports some of the frames."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from antdsl.executors import Task, TaskRejectedError, WorkerContext, raise_as_task_rejected
from antdsl.outputs.cache.cache_reader import CacheError
from antdsl.outputs.cache.manifest import ManifestError
from antdsl.outputs.edits.edited_cache import open_edited_cache
from antdsl.outputs.exports import AgentSubset, find_export
from antdsl.outputs.gallery import Gallery, PictureUnavailable
from antdsl.outputs.numbered_files import ExportUnavailable
from antdsl.shots.task_destination import Destination

FRAMES_PER_TASK = 8  # frames per task


def make_export_tasks(
    cache: Path,
    file_pattern: str,
    form: str,
    agents: frozenset[int] | None,
    frames: Sequence[int],
    destination: Destination,
    *,
    shows_states: bool = False,
) -> Iterator[Task]:
    """Yield tasks that together export all frames. `file_pattern`: the pattern of the file names. `cache`: an absolute path
    without links. `agents`: the keys of the agents to export; None for all. `shows_states`: whether agents have the colours
    of their states."""
    chosen = None if agents is None else sorted(agents)
    document = {"cache": str(cache), "name": file_pattern, "form": form, "agents": chosen, "states": shows_states}
    return destination.make_frame_tasks(export_frames, document, frames, FRAMES_PER_TASK)


def export_frames(document: Mapping[str, Any], worker: WorkerContext) -> dict[str, Any]:
    """Write the files of some frames, as the function of a task from `make_export_tasks`. Return the task's answer."""
    to, name = Destination.from_document(document), document["name"]
    export = find_export(Path(name))
    if export is None or document["form"] not in export.per_frame_forms:
        raise TaskRejectedError(f"`{name}` needs `####` for one file per frame")
    with raise_as_task_rejected(ManifestError, CacheError, PictureUnavailable, ExportUnavailable):
        cache = open_edited_cache(worker.find_local_path(document["cache"]))
        if document["agents"] is not None:
            cache = AgentSubset.of(cache, frozenset(document["agents"]))
        place = to.choose_task_folder(worker, document["key"])
        notes = export.forms[document["form"]](Gallery(cache, shows_states=document["states"]), document["frames"], place / name)
    worker.notes += notes or ()
    return to.describe_files(worker, place, document["key"])
