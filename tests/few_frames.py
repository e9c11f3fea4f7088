"""Run in a process of its own, perhaps as on another processor: state hashes of the first frames of examples, one line each.

`python few_frames.py FRAMES MOST SCENE...`: with MOST agents of each line of a crowd at the most, and with compiled kernels for
any number of agents where COMPILED=1 is in the environment."""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path

from antdsl.pipeline import open_scene
from antdsl.runtime import bind, compiled, state_hash, step


def main(frames: int, most: int, scenes: list[str]) -> None:
    if os.environ.get("COMPILED") == "1":
        compiled.wanted = lambda count: True
    for scene in scenes:
        shot, report = open_scene(Path(scene))
        assert shot is not None, str(report)
        crowds = tuple(replace(crowd, count=min(crowd.count, most)) for crowd in shot.setting.crowds)
        world = bind(shot.plan, replace(shot.setting, crowds=crowds))
        hashes = [state_hash(world)]
        for _ in range(frames):
            step(world)
            hashes.append(state_hash(world))
        print(Path(scene).parent.name, *hashes, flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3:])
