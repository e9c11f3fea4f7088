"""Stills of a cache as tasks, a few frames each: a cache's frames are independent."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from antdsl.executors import Refused, Task, Worker
from antdsl.outputs.cache.cache_reader import CacheError, open_cache
from antdsl.outputs.cache.manifest import ManifestError
from antdsl.outputs.cache.npz import write_whole
from antdsl.outputs.drawing import Drawer, Drawn, NoAgent
from antdsl.outputs.gallery import NoPicture
from antdsl.shots.placing import Destination

CHUNK = 4  # frames of a task


def still_path(folder: Path, frame: int) -> Path:
    """Where the picture of a frame is kept."""
    return folder / f"picture.{frame:04d}.png"


def png(image: Any) -> bytes:
    """A picture (height, width, 3) of uint8 as a PNG file."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "png", compress_level=4)
    return buffer.getvalue()


def tasks(cache: Path, wanted: Drawn, frames: Sequence[int], to: Destination) -> Iterator[Task]:
    """Tasks that draw all frames. `cache`: whole, without links."""
    about = {"cache": str(cache), "wanted": wanted.document(), "all": list(frames), "folder": to.folder, "token": to.token}
    head = hashlib.blake2b(json.dumps(about).encode(), digest_size=8).hexdigest()
    for start in range(0, len(frames), CHUNK):
        chunk = list(frames[start : start + CHUNK])
        yield Task(f"{head}-{chunk[0]}-{chunk[-1]}", stills, {**about, "frames": chunk, "key": f"{head}-{chunk[0]}"})


def stills(document: Mapping[str, Any], worker: Worker) -> dict[str, Any]:
    """Draw some frames. What a drawer has made for the frames before is kept for the next task of the same pictures."""
    to = Destination(document["folder"], document["token"])
    drawn = json.dumps([document["cache"], document["wanted"], document["all"]])
    try:
        kept = worker.kept.get("drawer")
        if kept is None or kept[0] != drawn:
            wanted = Drawn.of(document["wanted"])
            gallery = wanted.gallery(open_cache(worker.here(document["cache"])))
            kept = worker.kept["drawer"] = drawn, Drawer(gallery, wanted, document["all"], worker.threads)
        place = to.place(worker, document["key"])
        for frame in document["frames"]:
            write_whole(still_path(place, frame), png(kept[1].draw(frame)), sync=False)
            worker.told(frame)
    except (ManifestError, CacheError, NoPicture, NoAgent, ValueError) as why:
        raise Refused(str(why)) from None
    return {**to.made(worker, place, document["key"]), "frames": document["frames"]}
