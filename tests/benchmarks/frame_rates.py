"""Is a shot the same at any frame rate? Time until the near source of `examples/foraging` is empty, over seeds and rates.

`python tests/benchmarks/frame_rates.py` prints a table; `--seeds 3` takes fewer seeds, `--jobs 2` two processes."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from fractions import Fraction
from pathlib import Path

import numpy as np

from antdsl.pipeline import RunChoices, open_scene
from antdsl.runtime import Options, bind, step

SCENE = Path(__file__).resolve().parents[2] / "examples" / "foraging" / "scene.yaml"
RATES = ((24, 1), (25, 1), (48, 1), (24, 2))  # frames a second, substeps
SEEDS = 10
_LONGEST = 120.0  # s of the shot


def seconds_until_empty(fps: int, substeps: int, seed: int, left: float = 0.0) -> float:
    """Seconds of the shot until the first item of food holds no more than `left`; infinite when it takes two minutes."""
    shot, report = open_scene(SCENE, RunChoices(seed=seed))
    assert shot is not None, report.sort_by_place()
    world = bind(shot.plan, dataclasses.replace(shot.setting, fps=Fraction(fps), substeps=substeps), Options())
    load = world.items["food"].amounts["load"]
    start = world.frame
    while load[0] > left:
        if (world.frame - start) / fps >= _LONGEST:
            return float("inf")
        step(world)
    return (world.frame - start) / fps


def table(
    seeds: Sequence[int], rates: Sequence[tuple[int, int]] = RATES, left: float = 0.0, jobs: int = 1
) -> dict[tuple[int, int], list[float]]:
    """Seconds until empty for each rate, in the order of the seeds."""
    runs = [(fps, substeps, seed, left) for fps, substeps in rates for seed in seeds]
    if jobs == 1:
        durations = [seconds_until_empty(*each) for each in runs]
    else:
        with ProcessPoolExecutor(jobs) as pool:
            durations = list(pool.map(seconds_until_empty, *zip(*runs, strict=True)))
    return {rate: durations[k * len(seeds) : (k + 1) * len(seeds)] for k, rate in enumerate(rates)}


def spread(times_by_rate: dict[tuple[int, int], list[float]]) -> float:
    """How far the greatest median lies above the least, as a share."""
    medians = [float(np.median(times)) for times in times_by_rate.values()]
    return max(medians) / min(medians) - 1


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=SEEDS, help="how many")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    options = parser.parse_args()
    times_by_rate = table(range(1, options.seeds + 1), jobs=options.jobs)
    print("fps  substeps  median s  least  most")
    for (fps, substeps), times in times_by_rate.items():
        print(f"{fps:3d}  {substeps:8d}  {np.median(times):8.1f}  {min(times):5.1f}  {max(times):5.1f}")
    print(f"the medians lie within {100 * spread(times_by_rate):.1f} % of each other")


if __name__ == "__main__":
    main()
