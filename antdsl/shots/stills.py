"""Stills of a cache as tasks of a few frames each. The frames of a cache are independent, so any worker can draw any frame."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from antdsl.executors import Task, WorkerContext, raise_as_task_rejected
from antdsl.outputs.cache.cache_reader import CacheError
from antdsl.outputs.cache.manifest import ManifestError
from antdsl.outputs.drawing import AgentMissing, DrawRequest, FrameDrawer, StillStore
from antdsl.outputs.edits.edited_cache import open_edited_cache
from antdsl.outputs.gallery import PictureUnavailable
from antdsl.shots.task_destination import Destination

FRAMES_PER_TASK = 4  # frames per task


def make_still_tasks(
    cache: Path, picture_request: DrawRequest, frames: Sequence[int], camera_frames: Sequence[int], destination: Destination
) -> Iterator[Task]:
    """Yield tasks that together draw all frames. `cache`: an absolute path without links. `camera_frames`: the frames from which
    an automatic camera is chosen."""
    pictures = {"cache": str(cache), "wanted": asdict(picture_request), "all": list(camera_frames)}
    return destination.make_frame_tasks(draw_stills, {"pictures": pictures}, frames, FRAMES_PER_TASK)


def draw_stills(document: Mapping[str, Any], worker: WorkerContext) -> dict[str, Any]:
    """Draw some frames, as the function of a task from `make_still_tasks`. Return the task's answer.

    The drawing state stays in the process for the next task with the same picture settings."""
    to, pictures = Destination.from_document(document), document["pictures"]
    with raise_as_task_rejected(ManifestError, CacheError, PictureUnavailable, AgentMissing, ValueError):
        if worker.cached_values.get("pictures") != pictures:
            picture_request = TypeAdapter(DrawRequest).validate_python(pictures["wanted"])
            gallery = picture_request.gallery(open_edited_cache(worker.find_local_path(pictures["cache"])))
            drawer = FrameDrawer(gallery, picture_request, pictures["all"], worker.threads)
            worker.cached_values |= {"pictures": pictures, "drawer": drawer}
        drawer = worker.cached_values["drawer"]
        place = to.choose_task_folder(worker, document["key"])
        output = StillStore.build(place, drawer.gallery.cache, drawer.wanted, pictures["all"])
        for frame in document["frames"]:
            output.write_still(frame, drawer.draw(frame))
            worker.report_frame(frame)
    return {**to.describe_files(worker, place, document["key"]), "frames": document["frames"]}
