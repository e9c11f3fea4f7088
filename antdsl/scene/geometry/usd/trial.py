"""A process of its own in which USD files are opened first: a file that makes USD's own code overflow its stack, run for ever or
take all memory ends this process, and not the one that asked. Run by its path; needs usd-core alone.

Each line that comes in is a JSON list, `["layer", PATH]` or `["stage", PATH, PRIM]`; each is answered by a line, a JSON text:
what is wrong, empty where nothing is. Where no answer comes, the file is to blame."""

from __future__ import annotations

import json
import os
import sys

A_SECOND = 2 << 20  # bytes of files that are given one second more each
MEMORY = 8 << 30
STACK = 4 << 20  # bytes: half of what the process that asked has as a rule
LEVELS = 256  # of prims below each other
PRIMS = 1_000_000


def main() -> None:
    """Answer until nobody asks."""
    sys.path[:] = json.loads(sys.argv[1])
    seconds, size = float(sys.argv[2]), 0
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    nothing = os.open(os.devnull, os.O_WRONLY)
    for terminal in (1, 2):  # USD's own warnings
        os.dup2(nothing, terminal)
    _limit()
    for line in sys.stdin:
        asked = json.loads(line)
        try:
            size += os.path.getsize(asked[1]) if asked[0] == "layer" else 0
            _more_time(int(seconds + size / A_SECOND))
            answer = _layer(asked[1]) if asked[0] == "layer" else _stage(asked[1], asked[2])
        except MemoryError:
            answer = "it takes too much memory"
        except Exception:  # told in words when it is opened where it is wanted
            answer = ""
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


def _layer(path: str) -> str:
    from pxr import Sdf

    layer = Sdf.Layer.FindOrOpen(path)
    if layer is None:
        return ""
    layer.Reload()
    deepest = 0

    def look(place: object) -> None:
        nonlocal deepest
        deepest = max(deepest, place.pathElementCount)  # type: ignore[attr-defined]

    layer.Traverse(Sdf.Path.absoluteRootPath, look)
    return f"it has prims more than {LEVELS} levels deep" if deepest > LEVELS else ""


def _stage(path: str, prim: str) -> str:
    from pxr import Sdf, Usd

    stage = Usd.Stage.OpenMasked(Sdf.Layer.FindOrOpen(path), Usd.StagePopulationMask([Sdf.Path(prim)]))
    stage.ExpandPopulationMask()
    for number, found in enumerate(Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies())):
        if number >= PRIMS:
            return f"it comes to more than {PRIMS:,} prims"
        if found.GetPath().pathElementCount > LEVELS:
            return f"it comes to prims more than {LEVELS} levels deep"
    return ""


def _limit() -> None:
    try:
        import resource
    except ImportError:  # Windows
        return
    for what, most in ((resource.RLIMIT_AS, MEMORY), (resource.RLIMIT_STACK, STACK), (resource.RLIMIT_CORE, 0)):
        _, hard = resource.getrlimit(what)
        resource.setrlimit(what, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


def _more_time(seconds: int) -> None:
    """Seconds of CPU for the next answer."""
    try:
        import resource
    except ImportError:
        return
    used = resource.getrusage(resource.RUSAGE_SELF)
    _, hard = resource.getrlimit(resource.RLIMIT_CPU)
    until = int(used.ru_utime + used.ru_stime) + seconds
    resource.setrlimit(resource.RLIMIT_CPU, (until if hard == resource.RLIM_INFINITY else min(until, hard), hard))


if __name__ == "__main__":
    main()
