"""Turns of the programs in this folder: a line of the standard input asks for one, a line of JSON tells what it took."""

from __future__ import annotations

import json
import random
import sys
from collections.abc import Callable
from math import cos, pi, sin, sqrt, tau
from time import process_time

import numpy as np

WARM = 2  # steps after each beginning that are not counted
NEIGHBOURS = 9.0  # others that each is to have within its sight

Points = list[tuple[float, float]]


def read_arguments() -> tuple[int, int]:
    """AGENTS and STEPS of the command line."""
    agents, steps = map(int, sys.argv[1:3])
    return agents, steps


def turns(turn: Callable[[], tuple[float, float | None]]) -> None:
    """Take a turn for each line: seconds of a step, and neighbours in the mean if they matter."""
    for _ in sys.stdin:
        step, neighbours = turn()
        print(json.dumps({"step": step, "neighbours": neighbours}), flush=True)


def timed(step: Callable[[], object], steps: int, warm: int = WARM) -> float:
    """CPU seconds of a step, after `warm` that are not counted."""
    for _ in range(warm):
        step()
    start = process_time()
    for _ in range(steps):
        step()
    return (process_time() - start) / steps


def crowd(agents: int, sight: float) -> tuple[Points, Points]:
    """Places about zero that have NEIGHBOURS others within `sight`, a grid that is disturbed so that no two overlap; and a unit
    course for each."""
    draw = random.Random(1)
    cell = sight * sqrt(pi / (NEIGHBOURS + 1))  # the own cell has no other agent
    wide = int(sqrt(agents)) + 1
    shaken = [(draw.uniform(-0.3, 0.3), draw.uniform(-0.3, 0.3)) for _ in range(agents)]
    positions = [((k % wide - wide / 2 + x) * cell, (k // wide - wide / 2 + y) * cell) for k, (x, y) in enumerate(shaken)]
    courses = [(cos(angle), sin(angle)) for angle in (draw.uniform(0, tau) for _ in range(agents))]
    return positions, courses


def neighbours(positions: Points, sight: float) -> float:
    """How many others are within `sight`, in the mean."""
    from scipy.spatial import cKDTree

    tree = cKDTree(np.array(positions))
    return float(tree.count_neighbors(tree, sight) / tree.n - 1)
