"""Stills of a cache as tasks, a few frames each: the frames of a cache are independent."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from antdsl.executors import Refused, Task, Worker
from antdsl.outputs.cache.cache_reader import CacheError, open_cache
from antdsl.outputs.cache.manifest import ManifestError
from antdsl.outputs.drawing import Drawer, Drawn, NoAgent, Stills
from antdsl.outputs.gallery import NoPicture
from antdsl.shots.placing import Destination

CHUNK = 4  # frames of a task


def tasks(cache: Path, wanted: Drawn, frames: Sequence[int], together: Sequence[int], to: Destination) -> Iterator[Task]:
    """Yield tasks that draw all frames. `cache`: an absolute path without links; `together`: the frames for which the camera is
    chosen."""
    about = {"cache": str(cache), "wanted": wanted.document(), "all": list(together), "folder": to.folder, "token": to.token}
    head = hashlib.blake2b(json.dumps(about).encode(), digest_size=8).hexdigest()
    for start in range(0, len(frames), CHUNK):
        chunk = list(frames[start : start + CHUNK])
        yield Task(f"{head}-{chunk[0]}-{chunk[-1]}", stills, {**about, "frames": chunk, "key": f"{head}-{chunk[0]}"})


def stills(document: Mapping[str, Any], worker: Worker) -> dict[str, Any]:
    """Draw some frames. The drawer of earlier frames is cached for the next task of the same pictures."""
    to = Destination(document["folder"], document["token"])
    drawn = json.dumps([document["cache"], document["wanted"], document["all"]])
    try:
        kept = worker.kept.get("drawer")
        if kept is None or kept[0] != drawn:
            wanted = Drawn.of(document["wanted"])
            gallery = wanted.gallery(open_cache(worker.here(document["cache"])))
            kept = worker.kept["drawer"] = drawn, Drawer(gallery, wanted, document["all"], worker.threads)
        place = to.place(worker, document["key"])
        drawer: Drawer = kept[1]
        made = Stills.of(place, drawer.gallery.cache, drawer.wanted, document["all"])
        for frame in document["frames"]:
            made.put(frame, drawer.draw(frame))
            worker.told(frame)
    except (ManifestError, CacheError, NoPicture, NoAgent, ValueError) as why:
        raise Refused(str(why)) from None
    return {**to.made(worker, place, document["key"]), "frames": document["frames"]}
