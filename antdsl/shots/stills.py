"""Stills of a cache as tasks, a few frames each: the frames of a cache are independent."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from antdsl.executors import Task, TaskRefused, Worker
from antdsl.outputs.cache.cache_reader import CacheError, open_cache
from antdsl.outputs.cache.manifest import ManifestError
from antdsl.outputs.drawing import Drawer, DrawRequest, NoAgent, Stills
from antdsl.outputs.gallery import NoPicture
from antdsl.shots.placing import Destination

CHUNK = 4  # frames of a task


def still_tasks(
    cache: Path, picture_request: DrawRequest, frames: Sequence[int], together: Sequence[int], to: Destination
) -> Iterator[Task]:
    """Yield tasks that draw all frames. `cache`: an absolute path without links; `together`: the frames for which the camera is
    chosen."""
    document = {
        "cache": str(cache),
        "wanted": picture_request.document(),
        "all": list(together),
        "folder": to.folder,
        "token": to.token,
    }
    head = hashlib.blake2b(json.dumps(document).encode(), digest_size=8).hexdigest()
    for start in range(0, len(frames), CHUNK):
        chunk = list(frames[start : start + CHUNK])
        yield Task(f"{head}-{chunk[0]}-{chunk[-1]}", draw_stills, {**document, "frames": chunk, "key": f"{head}-{chunk[0]}"})


def draw_stills(document: Mapping[str, Any], worker: Worker) -> dict[str, Any]:
    """Draw some frames. The drawer of earlier frames is cached for the next task of the same pictures."""
    to = Destination(document["folder"], document["token"])
    drawn = json.dumps([document["cache"], document["wanted"], document["all"]])
    try:
        cached_drawer = worker.cached_values.get("drawer")
        if cached_drawer is None or cached_drawer[0] != drawn:
            picture_request = DrawRequest.of(document["wanted"])
            gallery = picture_request.gallery(open_cache(worker.local_path(document["cache"])))
            cached_drawer = worker.cached_values["drawer"] = (
                drawn,
                Drawer(gallery, picture_request, document["all"], worker.threads),
            )
        place = to.place(worker, document["key"])
        drawer: Drawer = cached_drawer[1]
        output = Stills.of(place, drawer.gallery.cache, drawer.wanted, document["all"])
        for frame in document["frames"]:
            output.put(frame, drawer.draw(frame))
            worker.report_frame(frame)
    except (ManifestError, CacheError, NoPicture, NoAgent, ValueError) as why:
        raise TaskRefused(str(why)) from None
    return {**to.describe_files(worker, place, document["key"]), "frames": document["frames"]}
