"""This tree beside another one: CPU time of set-up and of a step, as ratios with their uncertainty.

`python tests/benchmarks/pairs.py OTHER examples/foraging/many.yaml --pairs 20 --steps 12` runs each scene in both trees in turn,
each time in a separate process on one thread, and prints this tree's CPU time as a ratio of the other's: the mean of the pairs
and where it lies with 95 % (`antdsl/bench/ratios.py`). `--agents 100000` takes so many agents, and a world scaled about its zero
so that they stand as densely. With OTHER `.` a tree is held against itself, which shows how far ratios stray by chance. With
`--most 1.1` it leaves with 1 where a step surely takes more than 1.1 times as long as the other tree's."""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import subprocess
import sys
import time
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from statistics import mean
from typing import Any

from antdsl.pipeline import open_scene
from antdsl.runtime import Options, bind, step

ROOT = Path(__file__).resolve().parents[2]


def of_this_tree(name: str) -> Any:
    """A module of this tree's `antdsl/bench`, whichever tree the package comes from: another one may not have it."""
    spec = importlib.util.spec_from_file_location(f"bench_{name}", ROOT / "antdsl" / "bench" / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


scale_setting = of_this_tree("scaling").scale_setting
ratios = of_this_tree("ratios")


@dataclass(frozen=True, slots=True)
class Cost:
    """CPU seconds: of binding with the first step, and of one step after it in the mean."""

    setup: float
    step: float


def measure_scene(scene: Path, steps: int, agents: int | None) -> Cost:
    """What a scene costs in this process."""
    shot, report = open_scene(scene)
    if shot is None:
        raise SystemExit("\n".join(diagnostic.message for diagnostic in report.errors))
    setting = shot.setting if agents is None else scale_setting(shot.setting, agents)
    start_time = time.process_time()
    waits: dict[str, Any] = {"wait_for_code": True} if "wait_for_code" in {each.name for each in fields(Options)} else {}
    world = bind(shot.plan, setting, Options(threads=1, **waits))  # an older tree may have no machine code to wait for
    step(world)
    ready = time.process_time()
    for _ in range(steps):
        step(world)
    return Cost(ready - start_time, (time.process_time() - ready) / steps)


def in_tree(tree: Path, scene: str, steps: int, agents: int | None) -> Cost:
    """What a scene of a tree costs in a process that imports the package from that tree."""
    words = [sys.executable, __file__, str(tree), str(tree / scene), "--steps", str(steps), "--once"]
    words += [] if agents is None else ["--agents", str(agents)]
    process = subprocess.run(words, env={**os.environ, "PYTHONPATH": str(tree)}, cwd=tree, capture_output=True, text=True)
    if process.returncode:
        raise SystemExit(f"{tree}: {scene}\n{process.stderr[-2000:]}")
    return Cost(**json.loads(process.stdout))


def main() -> None:
    """Print a line for each scene."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("other", type=Path, help="the tree to compare with")
    parser.add_argument("scenes", nargs="+", help="scenes, by their paths in either tree")
    parser.add_argument("--pairs", type=int, default=20)
    parser.add_argument("--steps", type=int, default=12)
    parser.add_argument("--agents", type=int, default=None)
    parser.add_argument("--most", type=float, default=None, help="leave with 1 above this ratio")
    parser.add_argument("--once", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.once:
        cost = measure_scene(Path(options.scenes[0]), options.steps, options.agents)
        print(json.dumps({"setup": cost.setup, "step": cost.step}))
        return
    trees, slower = (options.other.resolve(), ROOT), []
    for scene in options.scenes:
        measure = partial(in_tree, scene=scene, steps=options.steps, agents=options.agents)
        turns = ratios.measure_in_turn(lambda tree, measure=measure: measure(trees[tree]), 2, options.pairs)
        steps = ratios.compute_bootstrap_interval([this.step / other.step for other, this in turns])
        setups = ratios.compute_bootstrap_interval([this.setup / other.setup for other, this in turns])
        milliseconds = 1000 * mean(this.step for _, this in turns)
        print(f"{scene}: a step {milliseconds:.2f} ms, {steps} of the other tree's; set-up {setups}", flush=True)
        slower += [scene] if options.most is not None and steps.is_above(options.most) else []
    if slower:
        raise SystemExit(f"a step takes more than {options.most:g} times as long: {', '.join(slower)}")


if __name__ == "__main__":
    main()
