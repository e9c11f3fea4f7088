"""Distances of all pairs refreshed by how far apart they were, beside the search of cells that antdsl does in every step.

`python tests/benchmarks/refreshes.py` prints the document's bands (R08), and a table for `examples/roaches` with 500 and 5,000:
it runs the scene, stores all positions, and does both on the same positions. They have to find the same pairs each time."""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from statistics import median

import numpy as np
from numpy.typing import NDArray

from antdsl.pipeline import open_scene
from antdsl.runtime import Options, bind, step
from antdsl.senses.neighbours import CellGrid, NeighbourPairs

ROACHES = Path(__file__).resolve().parents[2] / "examples" / "roaches"
SIGHT = {"scene": 120.0, "many": 90.0}  # mm, `roach.sight` of the two scenes

Floats = NDArray[np.float32]
Numbers = NDArray[np.int64]


def band(distance: NDArray[np.floating], sight: float, closing: float) -> Numbers:
    """After how many frames pairs at these distances have to be measured again, at least 1.

    `closing` is by how much two can come nearer in a frame: what is further off than sight + (k - 1) · closing is out of sight
    for k - 1 frames at least."""
    return np.maximum(np.ceil((distance - sight) / closing), 1).astype(np.int64)


def refreshed(frame: int, bands: int, sight: float, closing: float) -> list[tuple[float, float]]:
    """The ranges of distance that are refreshed in a frame, for a number of bands; ranges that touch are one."""
    intervals: list[tuple[float, float]] = []
    for k in range(1, bands + 1):
        if frame % k == 0:
            low, high = (0.0 if k == 1 else sight + (k - 1) * closing), sight + k * closing
            intervals = (
                [*intervals[:-1], (intervals[-1][0], high)]
                if intervals and intervals[-1][1] == low
                else [*intervals, (low, high)]
            )
    return intervals


@dataclass
class Refreshes:
    """Pairs of n agents by the frame in which they are measured again: `due` has for a frame lists of pairs, rows (2, k)."""

    sight: float
    closing: float
    due: dict[int, list[NDArray[np.int32]]]
    measured: int = 0

    @classmethod
    def of(cls, agents: int, sight: float, closing: float) -> Refreshes:
        """All n·(n - 1)/2 pairs, to be measured in frame 0."""
        return cls(sight, closing, {0: [np.stack(np.triu_indices(agents, 1)).astype(np.int32)]})

    def step(self, frame: int, place: Floats) -> NDArray[np.int32]:
        """The pairs within sight (2, k) of agents at places (3, n)."""
        lists = self.due.pop(frame, [])
        if not lists:
            return np.empty((2, 0), np.int32)
        pairs = np.concatenate(lists, axis=1)
        distance = np.zeros(pairs.shape[1], np.float32)
        for axis in place:
            off = axis.take(pairs[1]) - axis.take(pairs[0])
            distance += off * off
        distance = np.sqrt(distance)
        self.measured += len(distance)
        wait = band(distance, self.sight, self.closing).astype(np.uint16)
        order = np.argsort(wait, kind="stable")
        lasts, starts = np.unique(wait.take(order), return_index=True)
        pairs = pairs.take(order, axis=1)
        for last, due_pairs in zip(lasts.tolist(), np.split(pairs, starts[1:], axis=1), strict=True):
            self.due.setdefault(frame + last, []).append(due_pairs)
        return pairs[:, distance.take(order) <= self.sight]


def searched(place: Floats, sight: float) -> NeighbourPairs:
    """The same by a new grid of cells, each pair from both sides."""
    return CellGrid(*place, np.arange(place.shape[1]), sight).find_pairs(None, sight)


def walked(scene: str, frames: int) -> list[Floats]:
    """Where the roaches of a scene are in each frame, float32 (3, n), in order of ids."""
    shot, report = open_scene(ROACHES / f"{scene}.yaml")
    assert shot is not None, [positions.message for positions in report.errors]
    world = bind(shot.plan, shot.setting, Options(threads=1))
    roaches, positions = world.populations["roach"], []
    for _ in range(frames):
        positions.append(np.ascontiguousarray(roaches.position[roaches.get_rows_by_id()].T, np.float32))
        step(world)
    return positions


def keys(one: NDArray[np.integer], two: NDArray[np.integer], agents: int) -> Numbers:
    """One number for each pair, ascending, in either order of the two."""
    return np.sort(np.minimum(one, two).astype(np.int64) * agents + np.maximum(one, two))


def row(scene: str, frames: int) -> str:
    """A line of the table, in Markdown."""
    positions, sight = walked(scene, frames), SIGHT[scene]
    agents = positions[0].shape[1]
    stride = max(float(np.sqrt(((b - a) ** 2).sum(axis=0)).max()) for a, b in pairwise(positions))
    searched(positions[0], sight)  # whatever is compiled is compiled now
    schedule = Refreshes.of(agents, sight, 2 * stride * 1.0001)
    ours: list[float] = []
    theirs: list[float] = []
    for frame, place in enumerate(positions):
        start_time = time.process_time()
        scheduled_pairs = schedule.step(frame, place)
        between = time.process_time()
        search_pairs = searched(place, sight)
        theirs.append(1000 * (between - start_time))
        ours.append(1000 * (time.process_time() - between))
        twice = keys(search_pairs.i, search_pairs.j, agents)
        assert np.array_equal(np.repeat(keys(*scheduled_pairs, agents), 2), twice), f"frame {frame}: not the same pairs"
    pairs = agents * (agents - 1) // 2
    share = (schedule.measured - pairs) / (pairs * (len(positions) - 1))
    schedule_ms, search_ms = sum(theirs[1:]) / len(theirs[1:]), sum(ours[1:]) / len(ours[1:])
    return (
        f"| {agents:,} | {pairs:,} | {sight:g} mm | {stride:.1f} mm | {share:.1%} | {schedule_ms:.1f} ({max(theirs[1:]):.1f}) | "
        f"{search_ms:.1f} ({median(ours[1:]):.1f}) | {schedule_ms / search_ms:.1f} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=120)
    options = parser.parse_args()
    for name, closing in (("one of the two moves", 0.1), ("both move", 0.2)):
        ranges = ", ".join(f"{low:.1f} to {high:.1f}" for low, high in refreshed(6, 6, 1.0, closing))
        print(f"frame 6, {name}: {ranges}")
    print("| roaches | pairs | sight | longest step | measured a frame | schedule, CPU ms (most) | search (median) | ratio |")
    print("|---|---|---|---|---|---|---|---|")
    for scene in SIGHT:
        print(row(scene, options.frames), flush=True)


if __name__ == "__main__":
    main()
