"""How a heap comes apart: equal shares, shares by how locked in agents are, and the order of the roach crowd sim (document 003,
R10), in which one after the other is frozen, from the most locked-in outward.

`python tests/benchmarks/contacts.py --agents 1000 --radius 20` prints for each method the frames until nobody is deeper than a
thousandth of its width in another, who is deep after one and two seconds, and processor milliseconds of a step."""

from __future__ import annotations

import argparse
import sys
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests"), str(ROOT / "tests" / "runtime"), str(ROOT / "tests" / "program")]

from test_contacts import CrowdData, heap, world  # noqa: E402

from antdsl.runtime import World, step  # noqa: E402
from antdsl.runtime.moving import contacts  # noqa: E402
from antdsl.runtime.moving.capsules import Near, depths  # noqa: E402

FREE, DEEP = 1e-3, 0.05


def outward_from_the_most_locked_in(near: Near, agents: Any, *rest: Any) -> np.ndarray:
    """R10: who has most contacts is frozen first, then those about it, and so on; each unfrozen one that overlaps a frozen one is
    moved along the line of both until it is free. Then nobody goes farther than it may walk."""
    count = len(near.rows)
    gone = np.zeros((3, count))
    inside = near.gap < 0
    contacts_of = np.bincount(near.i[inside], minlength=count) + np.bincount(near.j[inside], minlength=count)
    both, pair = np.concatenate([near.i, near.j]), np.tile(np.arange(len(near.i)), 2)
    by_row = np.split(pair[np.argsort(both, kind="stable")], np.cumsum(np.bincount(both, minlength=count))[:-1])
    frozen, queued = np.zeros(count, np.bool_), np.zeros(count, np.bool_)
    for first in np.lexsort((near.rows, -contacts_of)):
        if queued[first]:
            continue
        queue = deque([int(first)])
        queued[first] = True
        while queue:
            row = queue.popleft()
            frozen[row] = True
            pairs = by_row[row]
            other = near.i[pairs] + near.j[pairs] - row
            pairs, other = pairs[~frozen[other]], other[~frozen[other]]
            near.measure(gone, np.arange(count) == row)
            gap, way = near.gap[pairs], near.way[:, pairs]
            deep = np.flatnonzero(gap < 0)
            away = np.where(near.i[pairs[deep]] == row, -1.0, 1.0)
            gone[:, other[deep]] -= way[:, deep] * (gap[deep] * away)
            fresh = other[deep][~queued[other[deep]]]
            queued[fresh] = True
            queue.extend(fresh[np.argsort(-contacts_of[fresh], kind="stable")].tolist())
    return contacts._within(gone, rest[2], agents.reach)


def measured(made: World, most: int) -> str:
    """Frames until free, shares that are deep after 24 and 48 frames, and milliseconds a step."""
    shares, spent, free = {}, 0.0, None
    for frame in range(1, most + 1):
        begun = time.process_time()
        step(made)
        spent += time.process_time() - begun
        deep = depths(made)
        shares[frame] = float((deep > DEEP).mean())
        if deep.max() < FREE:
            free = frame
            break
    told = f"{free} frames" if free is not None else f"not in {most} frames (deepest {deep.max():.2f})"
    after = (f"{shares.get(frame, 0.0):.1%}" for frame in (24, 48))
    return " | ".join([told, *after, f"{spent / len(shares) * 1e3:.1f}"])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--agents", type=int, default=1000)
    parser.add_argument("--radius", type=float, default=20.0)
    parser.add_argument("--most", type=int, default=240)
    asked = parser.parse_args()
    kept: tuple[Callable[..., Any], float, float] = contacts._apart, contacts._OUTWARD, contacts._PRESSED
    print("| method | free after | deep after 1 s | after 2 s | ms a step |\n|---|---|---|---|---|")
    for name, solve, outward in (
        ("Jacobi, equal shares", kept[0], 0.0),
        ("Jacobi, shares by how locked in", kept[0], kept[1]),
        ("R10: frozen one by one, outward", outward_from_the_most_locked_in, kept[1]),
    ):
        contacts._apart, contacts._OUTWARD, contacts._PRESSED = solve, outward, min(outward, kept[2])  # type: ignore[assignment, misc]
        made = world(CrowdData("ant", asked.agents, heap(asked.agents, asked.radius)))
        print(f"| {name} | {measured(made, asked.most)} |", flush=True)
    contacts._apart, contacts._OUTWARD, contacts._PRESSED = kept  # type: ignore[misc]


if __name__ == "__main__":
    main()
