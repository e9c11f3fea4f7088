"""Full runs of another tree and of this one, as `antdsl run` makes them: CPU and wall time of a frame, set-up subtracted.

`python tests/benchmarks/full_runs.py ../other foraging/many.yaml --frames 8 40` runs the example in each tree for 8 and for 40
frames and divides the difference by 32. Trees take turns, `--pairs` times, and each has its own environment (`.venv`). Without
another tree (`.`), this tree is measured alone; `--threads 1 2` compares numbers of threads instead. Printed are medians, and
the mean of the ratios with its 95 % interval (bootstrap)."""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from statistics import median

from antdsl.bench.ratios import compute_bootstrap_interval, measure_in_turn

ROOT = Path(__file__).resolve().parents[2]


def run(tree: Path, scene: str, frames: int, threads: int) -> tuple[float, float]:
    """CPU and wall seconds of a run. Raises CalledProcessError where it fails."""
    with tempfile.TemporaryDirectory() as folder:
        command = [str(tree / ".venv" / "bin" / "antdsl"), "run", str(tree / "examples" / scene), "--frames", f"1..{frames}"]
        command += ["--out", str(Path(folder, "cache")), "--threads", str(threads), "--quiet"]
        start_usage, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        subprocess.run(command, check=True, cwd=folder, env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"})
        usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime - start_usage.ru_utime - start_usage.ru_stime, time.perf_counter() - start


def frame_cost(tree: Path, scene: str, frames: Sequence[int], threads: int) -> tuple[float, float, float]:
    """CPU and wall seconds of a frame, and CPU seconds of the longer run."""
    few, many = (run(tree, scene, count, threads) for count in frames)
    return *((b - a) / (frames[1] - frames[0]) for a, b in zip(few, many, strict=True)), many[0]  # type: ignore[return-value]


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("other", type=Path)
    parser.add_argument("scene", help="below `examples`")
    parser.add_argument("--frames", type=int, nargs=2, default=(8, 40))
    parser.add_argument("--threads", type=int, nargs="+", default=[1])
    parser.add_argument("--pairs", type=int, default=5)
    options = parser.parse_args()
    other = options.other.resolve()
    variants = [(tree, threads) for tree in dict.fromkeys((other, ROOT)) for threads in options.threads]
    turns = measure_in_turn(
        lambda k: frame_cost(variants[k][0], options.scene, options.frames, variants[k][1]),
        len(variants),
        options.pairs,
        warm_up_runs=0,
    )
    for k, (tree, threads) in enumerate(variants):
        cpu, wall, total = (median(turn[k][part] for turn in turns) for part in range(3))
        line = (
            f"{tree.name}, {threads} thread(s): {1000 * cpu:.1f} ms CPU and {1000 * wall:.1f} ms wall a frame; {total:.2f} s CPU"
        )
        if k:
            ratios = (compute_bootstrap_interval([turn[k][part] / turn[0][part] for turn in turns]) for part in range(2))
            line += "; CPU and wall over the first: " + ", ".join(map(str, ratios))
        print(line)


if __name__ == "__main__":
    main()
