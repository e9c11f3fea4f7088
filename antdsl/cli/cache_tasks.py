"""Tasks on a cluster that read a cache: its workers see the folder that it lies in, or are sent its files."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from antdsl.cli.exits import Exit, Stop
from antdsl.cli.printing.messages import say
from antdsl.cli.scheduler import cluster
from antdsl.numerics.cores import cores

if TYPE_CHECKING:
    from antdsl.executors import Answered, Task
    from antdsl.shots.placing import Destination

Where = tuple[str, Path | None, bool]


def answers(where: Where, cache: Path, to: Path, tasks: Callable[[Path, Destination], Iterable[Task]]) -> Iterator[Answered]:
    """What became of tasks on the cluster `where` (its address, certificates, and whether it may go without), each once its files
    are in the folder `to`. `tasks` is given the cache, whole and without links, and where files go. Ends the command where one
    fails, once all are through, and where the scheduler is lost."""
    from antdsl.bounded import real_path
    from antdsl.executors import Lost
    from antdsl.executors.parcel import Seen
    from antdsl.outputs.cache.cache_reader import STATIC, frame_path, open_cache
    from antdsl.outputs.cache.hashes import HASHES
    from antdsl.outputs.cache.manifest import MANIFEST
    from antdsl.shots.placing import destination, fetched

    cache = real_path(cache)
    files = [*(cache / name for name in (MANIFEST, STATIC, HASHES)), *(frame_path(cache, f) for f in open_cache(cache).frames())]
    failed = 0
    try:
        with cluster(*where, cores(), 1, files, Seen.of(cache / HASHES)) as executors, destination(to) as place:
            for answered in fetched(tasks(cache, place), executors, lambda task: to, noted=lambda words: say(words, err=True)):
                if answered.answer is None:
                    failed += 1
                    first, last = (answered.task.document["frames"][number] for number in (0, -1))
                    say(f"failed: frames {first}..{last}: {answered.problem}", err=True)
                else:
                    yield answered
    except Lost as why:
        raise Stop(Exit.INPUT_OUTPUT, f"error: {why}", "the same command makes all frames again") from None
    if failed:
        raise Stop(Exit.FINDINGS, "error: the frames that failed are not written")
