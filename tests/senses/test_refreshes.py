"""The schedule of refreshes by distance (R08), as the benchmark runs it: the document's bands, and that it finds every pair."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))

from refreshes import Refreshes, band, keys, refreshed, searched  # lies beside the tests


def test_detail_bands_equal_the_documentation() -> None:
    limits = [1.1, 1.2, 1.3, 1.4, 1.5]  # after 1, 2, … frames, sight 1, 0.1 a frame
    assert band(np.array(limits) - 0.05, 1.0, 0.1).tolist() == [1, 2, 3, 4, 5] and band(
        np.array([0.0, 1.0]), 1.0, 0.1
    ).tolist() == [1, 1]
    for closing, ranges in ((0.1, [(0, 1.3), (1.5, 1.6)]), (0.2, [(0, 1.6), (2.0, 2.2)])):
        assert np.allclose(refreshed(6, 6, 1.0, closing), ranges)


def test_approaching_pairs_need_the_speed_of_both() -> None:
    """1.55 apart and 0.1 a frame each: in sight after three frames; their band is the sixth by the speed of one."""
    first = {}
    for closing in (0.1, 0.2):
        schedule = Refreshes.of(2, 1.0, closing * 1.0001)
        positions_by_frame = [np.array([[0.1 * k, 1.55 - 0.1 * k], [0, 0], [0, 0]], np.float32) for k in range(8)]
        first[closing] = [schedule.step(k, place).shape[1] for k, place in enumerate(positions_by_frame)].index(1)
        assert searched(positions_by_frame[3], 1.0).i.size == 2 and searched(positions_by_frame[2], 1.0).i.size == 0
    assert first == {0.1: 6, 0.2: 3}


def test_pairs_of_one_distance_are_all_found() -> None:
    """On a lattice 1 apart: 2·6·5 pairs, where a dictionary by distance would keep one."""
    x, y = np.meshgrid(np.arange(6.0), np.arange(6.0))
    place = np.stack([x.ravel(), y.ravel(), np.zeros(36)]).astype(np.float32)
    pairs = searched(place, 1.0)
    assert (
        Refreshes.of(36, 1.0, 0.2).step(0, place).shape[1] == 60 and pairs.i.size == 120 and set(pairs.distance.tolist()) == {1.0}
    )


@pytest.mark.parametrize("seed", range(4))
def test_the_schedule_finds_the_same_pairs_as_the_cells_in_every_frame(seed: int) -> None:
    rng = np.random.default_rng(seed)
    agents, sight, stride = 60, 10.0, 0.7
    place = rng.uniform(-40, 40, (3, agents)).astype(np.float32)
    place[2] *= 0.1
    schedule, pair_count = Refreshes.of(agents, sight, 2 * stride * 1.001), 0
    for frame in range(80):
        pairs = searched(place, sight)
        schedule_pairs = schedule.step(frame, place)
        assert np.array_equal(np.repeat(keys(*schedule_pairs, agents), 2), keys(pairs.i, pairs.j, agents)), frame
        pair_count += schedule_pairs.shape[1]
        direction = rng.normal(size=(3, agents)) - 0.02 * place
        place = (place + stride * direction / np.linalg.norm(direction, axis=0)).astype(np.float32)
    assert pair_count > 500 and schedule.measured < 0.8 * 80 * agents * (agents - 1) / 2
