"""Boids of krABMaga (Rust, float32) beside those of antdsl, in the same run: million agent-steps a second of one core.

`python tests/benchmarks/peers.py` builds `peers/flockers` with cargo, which fetches krABMaga from crates.io, and prints a table:
the medians of twenty turns, and the ratio with where it lies with 95 %. Both see about nine others within their sight."""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from statistics import median

from antdsl.bench import Job, in_turn, measured
from antdsl.bench.tables import markdown, ratio_text

CRATE = Path(__file__).parent / "peers" / "flockers"
SIZES = (1_000, 15_000, 100_000)
TURNS = 20
STEPS = 6
HEADS = ("agents", "krABMaga, million agent-steps/s", "neighbours", "antdsl", "neighbours", "krABMaga's time over antdsl's")


def built(target: Path) -> Path:
    """The program, built in a folder. Raises OSError without cargo, CalledProcessError where it cannot be fetched or built."""
    cargo = shutil.which("cargo")
    if cargo is None:
        raise FileNotFoundError("cargo")
    environment = {**os.environ, "CARGO_TARGET_DIR": str(target)}
    subprocess.run([cargo, "build", "--release", "--locked", "--quiet"], cwd=CRATE, env=environment, check=True)
    return target / "release" / "flockers"


def flockers(program: Path, agents: int) -> tuple[float, float]:
    """CPU seconds of a step, and neighbours in the mean."""
    times = max(1, 60_000 // agents)
    done = subprocess.run([program, str(agents), str(STEPS), str(times)], check=True, capture_output=True, text=True)
    found = json.loads(done.stdout)
    return found["step"], found["neighbours"]


def boids(agents: int, backend: str) -> tuple[float, float]:
    """The same of antdsl, on one thread."""
    found = measured(Job("boids", agents, (backend,), turns=3, steps=max(1, 6_000 // agents)))
    assert found.neighbours is not None
    return median(found.costs[backend].cpu), found.neighbours


def rows(program: Path, backends: Sequence[str], turns: int = TURNS, sizes: Sequence[int] = SIZES) -> list[list[str]]:
    """A row for each number of agents and backend."""
    found = []
    for agents in sizes:
        for backend in backends:
            runners = (lambda agents=agents: flockers(program, agents), lambda agents=agents, b=backend: boids(agents, b))
            costs = in_turn(lambda runner, runners=runners: runners[runner](), 2, turns, warm=1)
            theirs, ours = (median(cost[k][0] for cost in costs) for k in (0, 1))
            seen = [median(cost[k][1] for cost in costs) for k in (0, 1)]
            ratio = ratio_text([their[0] / our[0] for their, our in costs])
            found.append([
                f"{agents:,}", f"{agents / theirs / 1e6:.2f}", f"{seen[0]:.1f}", f"{backend} {agents / ours / 1e6:.2f}",
                f"{seen[1]:.1f}", ratio,
            ])  # fmt: skip
    return found


def main() -> None:
    """Print the table."""
    from antdsl.runtime.backends import BACKENDS

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--target", type=Path, default=CRATE / "target", help="where cargo builds")
    parser.add_argument("--turns", type=int, default=TURNS)
    parser.add_argument("--agents", type=int, action="append")
    given = parser.parse_args()
    backends = [name for name in BACKENDS if name != "reference"]
    found = rows(built(given.target.resolve()), backends, given.turns, given.agents or SIZES)
    print(markdown(HEADS, found), end="")


if __name__ == "__main__":
    main()
