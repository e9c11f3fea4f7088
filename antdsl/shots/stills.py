"""Stills of a cache as tasks of a few frames each. This is possible because the frames of a cache are independent."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from antdsl.executors import Task, Worker, refuse_task
from antdsl.outputs.cache.cache_reader import CacheError, open_cache
from antdsl.outputs.cache.manifest import ManifestError
from antdsl.outputs.drawing import AgentMissing, DrawRequest, FrameDrawer, StillStore
from antdsl.outputs.gallery import PictureUnavailable
from antdsl.shots.placing import Destination

CHUNK = 4  # frames of a task


def still_tasks(
    cache: Path, picture_request: DrawRequest, frames: Sequence[int], together: Sequence[int], to: Destination
) -> Iterator[Task]:
    """Yield tasks that draw all frames. `cache`: an absolute path without links. `together`: the frames for which the camera is
    chosen."""
    pictures = {"cache": str(cache), "wanted": asdict(picture_request), "all": list(together)}
    return to.frame_tasks(draw_stills, {"pictures": pictures}, frames, CHUNK)


def draw_stills(document: Mapping[str, Any], worker: Worker) -> dict[str, Any]:
    """Draw some frames. The drawing state is cached in the process for the next task with the same picture settings."""
    to, pictures = Destination.of(document), document["pictures"]
    with refuse_task(ManifestError, CacheError, PictureUnavailable, AgentMissing, ValueError):
        if worker.cached_values.get("pictures") != pictures:
            picture_request = TypeAdapter(DrawRequest).validate_python(pictures["wanted"])
            gallery = picture_request.gallery(open_cache(worker.local_path(pictures["cache"])))
            drawer = FrameDrawer(gallery, picture_request, pictures["all"], worker.threads)
            worker.cached_values |= {"pictures": pictures, "drawer": drawer}
        drawer = worker.cached_values["drawer"]
        place = to.place(worker, document["key"])
        output = StillStore.of(place, drawer.gallery.cache, drawer.wanted, pictures["all"])
        for frame in document["frames"]:
            output.put(frame, drawer.draw(frame))
            worker.report_frame(frame)
    return {**to.describe_files(worker, place, document["key"]), "frames": document["frames"]}
