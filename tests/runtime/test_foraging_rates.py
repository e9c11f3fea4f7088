"""The same shot at 24, 25 and 48 frames a second, and at 24 with two substeps: the source near the nest is empty as soon."""

from __future__ import annotations

import sys
from pathlib import Path

import foraging_shots
import pytest

from antdsl.runtime import step

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))

import frame_rates


def taken(fps: int, substeps: int) -> float:
    """Crumbs taken in five seconds by a crowd around the apple."""
    crowd = foraging_shots.world(count=300, around=foraging_shots.APPLE, radius=110.0, fps=fps, substeps=substeps, load=1e4)
    for _ in range(5 * fps):
        step(crowd)
    return 2e4 - foraging_shots.crumbs(crowd)[0]


@pytest.mark.slow
def test_a_crowd_takes_as_much_at_any_rate() -> None:
    amounts = [taken(fps, substeps) for fps, substeps in ((24, 1), (48, 1), (24, 2))]
    assert min(amounts) > 50
    assert max(amounts) < 1.2 * min(amounts)


@pytest.mark.slow
def test_the_near_source_is_empty_as_soon_at_any_rate() -> None:
    times = frame_rates.table(range(1, frame_rates.SEEDS + 1), jobs=2)
    print(times)
    assert frame_rates.spread(times) <= 0.15
