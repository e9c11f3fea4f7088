"""Walking on a mesh of forty closed parts that cut into each other beside a closed mesh of the same size: CPU time of binding the
surface with the first step, and of a step, as ratios. `python tests/benchmarks/parts.py [--agents N] [--spread MM]`."""

from __future__ import annotations

import argparse
import sys
import time
from collections import deque
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
from meshes import Mesh, ball
from torture_walks import crowd, wander

from antdsl.ground.mesh.surface import MeshGround

STEPS = 20


def lump(rings: int, size: float, number: int) -> Mesh:
    """A closed ball with waves on it."""
    vertices, faces = ball(1.0, rings=rings)
    waves = 1 + 0.1 * np.sin(5 * vertices[:, [1]] + number) * np.sin(4 * vertices[:, [0]])
    return vertices * waves * size, faces


def forty(spread: float) -> Mesh:
    """120,960 faces: parts of 12 mm with their middles at random in a cube of twice `spread` (mm)."""
    rng = np.random.default_rng(1)
    parts = [lump(28, 12.0, number) for number in range(40)]
    points = np.concatenate([vertices + rng.uniform(-spread, spread, 3) for vertices, _ in parts])
    count = len(parts[0][0])
    return points, np.concatenate([faces + count * number for number, (_, faces) in enumerate(parts)]).astype(np.int32)


def measured(mesh: Mesh, agents: int) -> tuple[float, float]:
    """Seconds of CPU of the binding with the first step, and of each of the steps after it."""
    start = time.process_time()
    ground, rng = MeshGround({"mesh": mesh}), np.random.default_rng(4)
    bound = time.process_time() - start
    steps = wander(ground, crowd(ground, [mesh], agents, rng), 1 + STEPS, rng)
    start = time.process_time()
    next(steps)
    first = time.process_time() - start
    start = time.process_time()
    deque(steps, 0)
    return bound + first, (time.process_time() - start) / STEPS


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--agents", type=int, default=2000)
    parser.add_argument("--spread", type=float, default=30.0)
    options = parser.parse_args()
    measured(forty(8.0), 200)  # what compiles does so here
    one, many = lump(174, 50.0, 0), forty(options.spread)
    single, parts = measured(one, options.agents), measured(many, options.agents)
    print(f"faces: one {len(one[1]):,}, forty parts {len(many[1]):,}; {options.agents:,} walkers")
    for words, a, b in zip(("set-up and first step", "a step"), single, parts, strict=True):
        print(f"{words:22} one {1e3 * a:9.1f} ms   forty {1e3 * b:9.1f} ms   ratio {b / a:.2f}")


if __name__ == "__main__":
    main()
