"""This tree beside another one: CPU time of set-up and of a step, as ratios with their uncertainty.

`python tests/benchmarks/pairs.py OTHER examples/foraging/many.yaml --pairs 20 --steps 12` runs each scene in both trees in turn,
each time in a process of its own on one thread, and prints this tree's CPU time as a ratio of the other's: the mean of the pairs
and where it lies with 95 % (bootstrap: B. Efron, Annals of Statistics 7, 1979). Two runs side by side meet the same machine, so
that a ratio says something where a time does not. `--agents 100000` takes so many agents, and a world scaled about its zero so
that they stand as densely. With OTHER `.` a tree is held against itself, which shows how far ratios stray by chance."""

from __future__ import annotations

import argparse
import json
import os
import random
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import mean

import numpy as np

from antdsl.pipeline import open_scene
from antdsl.runtime import Options, bind, step
from antdsl.scene.setting import Point, Setting

ROOT = Path(__file__).resolve().parents[2]
_RESAMPLED = 10_000


@dataclass(frozen=True, slots=True)
class Cost:
    """CPU seconds: of binding with the first step, and of one step after it in the mean."""

    setup: float
    step: float


@dataclass(frozen=True, slots=True)
class Ratio:
    """The mean of ratios and its 95 % interval."""

    mean: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.mean:.3f} ({self.low:.3f} to {self.high:.3f})"


def interval(ratios: Sequence[float], seed: int = 1) -> Ratio:
    """The mean of some ratios, with the 2.5th and 97.5th percentile of means of as many drawn from them with replacement."""
    draw = random.Random(seed)
    means = sorted(mean(draw.choices(ratios, k=len(ratios))) for _ in range(_RESAMPLED))
    return Ratio(mean(ratios), means[round(0.025 * _RESAMPLED)], means[round(0.975 * _RESAMPLED)])


def scaled(setting: Setting, agents: int) -> Setting:
    """The setting with so many agents in all, lengths of the world scaled about its zero so that their density stays: meshes,
    places of items and crowds, curves. Sizes of agents and items, cells of fields and radii of behaviours stay.

    Raises ValueError for a world with solids, flows, maps or moving things."""
    if setting.solids or setting.flows or setting.maps or any((setting.moves.meshes, setting.moves.items, setting.moves.curves)):
        raise ValueError("only worlds of meshes, items and curves that stand still can be scaled")
    before = sum(crowd.count for crowd in setting.crowds)
    by = (agents / before) ** 0.5

    def point(place: Point) -> Point:
        return (place[0] * by, place[1] * by, place[2] * by)

    crowds, left = [], agents
    for number, crowd in enumerate(setting.crowds):
        last = number == len(setting.crowds) - 1
        count = left if last else round(crowd.count * agents / before)
        left -= count
        at = crowd.place
        radius = None if at.radius is None else at.radius * by
        points = None if at.points is None else at.points * by
        around, inside = (None if place is None else point(place) for place in (at.around, at.inside))
        place = replace(at, around=around, inside=inside, radius=radius, points=points)
        crowds.append(replace(crowd, count=count, place=place))
    items = {name: tuple(replace(item, position=point(item.position)) for item in those) for name, those in setting.items.items()}
    surfaces, obstacles = (
        {name: replace(mesh, vertices=mesh.vertices * by) for name, mesh in meshes.items()}
        for meshes in (setting.surfaces, setting.obstacles)
    )
    curves = {name: np.asarray(curve) * by for name, curve in setting.curves.items()}
    return replace(setting, crowds=tuple(crowds), surfaces=surfaces, obstacles=obstacles, items=items, curves=curves)


def once(scene: Path, steps: int, agents: int | None) -> Cost:
    """What a scene costs in this process."""
    shot, report = open_scene(scene)
    if shot is None:
        raise SystemExit("\n".join(found.message for found in report.errors))
    setting = shot.setting if agents is None else scaled(shot.setting, agents)
    begun = time.process_time()
    world = bind(shot.plan, setting, Options(threads=1))
    step(world)
    ready = time.process_time()
    for _ in range(steps):
        step(world)
    return Cost(ready - begun, (time.process_time() - ready) / steps)


def in_tree(tree: Path, scene: str, steps: int, agents: int | None) -> Cost:
    """What a scene of a tree costs in a process that imports the package from that tree."""
    words = [sys.executable, __file__, str(tree), str(tree / scene), "--steps", str(steps), "--once"]
    words += [] if agents is None else ["--agents", str(agents)]
    done = subprocess.run(words, env={**os.environ, "PYTHONPATH": str(tree)}, cwd=tree, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{tree}: {scene}\n{done.stderr[-2000:]}")
    return Cost(**json.loads(done.stdout))


def pairs(measure: Callable[[int], Cost], count: int) -> list[tuple[Cost, Cost]]:
    """Costs of tree 0 and tree 1, in turn; who is first changes from pair to pair. One run of each before is not counted: it
    fills the caches of kernels."""
    for tree in (0, 1):
        measure(tree)
    found = []
    for number in range(count):
        order = (0, 1) if number % 2 else (1, 0)
        costs = {tree: measure(tree) for tree in order}
        found.append((costs[0], costs[1]))
    return found


def main() -> None:
    """Print a line for each scene."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("other", type=Path, help="the tree to compare with")
    parser.add_argument("scenes", nargs="+", help="scenes, by their paths in either tree")
    parser.add_argument("--pairs", type=int, default=20)
    parser.add_argument("--steps", type=int, default=12)
    parser.add_argument("--agents", type=int, default=None)
    parser.add_argument("--once", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.once:
        cost = once(Path(given.scenes[0]), given.steps, given.agents)
        print(json.dumps({"setup": cost.setup, "step": cost.step}))
        return
    trees = (given.other.resolve(), ROOT)
    for scene in given.scenes:
        found = pairs(lambda tree, scene=scene: in_tree(trees[tree], scene, given.steps, given.agents), given.pairs)  # type: ignore[misc]
        steps = interval([this.step / other.step for other, this in found])
        setups = interval([this.setup / other.setup for other, this in found])
        milliseconds = 1000 * mean(this.step for _, this in found)
        print(f"{scene}: a step {milliseconds:.2f} ms, {steps} of the other tree's; set-up {setups}", flush=True)


if __name__ == "__main__":
    main()
