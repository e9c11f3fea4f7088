"""The foraging example, shown: crumbs, scent, surface, stones, motion. Whole shots are marked slow; each has a short sample."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from foraging_shots import APPLE, EXAMPLE, Watched, counts, motion, watch, world
from numpy.typing import NDArray

from antdsl.runtime import World, step

# turn_p99 is degrees a step at 24 fps; max_turn of 400 deg/s allows 16.7 in the plane.
BOUNDS = dict(turn_p99=17.0, circling=0.01, standing=0.005, overlap_p99=0.6, straightness=0.75)
CROWDED = dict(turn_p99=17.0, circling=0.01, standing=0.02, overlap_p99=0.8, straightness=0.7)


def nothing_lost(measures: Watched) -> None:
    start = sum(measures.crumbs[0])
    assert all(sum(frame) == start for frame in measures.crumbs)
    assert (np.diff(measures.delivered) >= 0).all()
    assert (np.diff([left for left, _, _ in measures.crumbs]) <= 0).all()


def stays_on_the_ground(measures: Watched) -> None:
    assert measures.surface_error < 1e-3
    assert measures.in_stones < 0.5
    assert measures.world.faults.fault_count == 0


@pytest.fixture(scope="module")
def short() -> Watched:
    return watch(world(), 300)


def test_crumbs_are_neither_lost_nor_made(short: Watched) -> None:
    nothing_lost(short)
    assert short.delivered[-1] > 5


def test_all_agents_stay_on_the_ground_and_out_of_the_stones(short: Watched) -> None:
    stays_on_the_ground(short)


def test_the_motion_looks_alive(short: Watched) -> None:
    motion(short.world, **BOUNDS)


@pytest.mark.slow
def test_scent_is_concentrated_where_food_was_found(short: Watched) -> None:
    without = watch(world(reward=0.0), 300)
    assert short.concentration[-1] >= 3 * without.concentration[-1]


def test_many_ants_for_a_moment() -> None:
    measures = watch(world(count=1500, scene=EXAMPLE / "many.yaml"), 100, every=50)
    nothing_lost(measures)
    stays_on_the_ground(measures)
    motion(measures.world, **CROWDED)


def shifted(first: NDArray[np.int64], later: NDArray[np.int64]) -> float:
    """The share of a crowd by which its counts of states differ."""
    return float(np.abs(first - later).sum()) / 2 / float(first.sum())


def counts_at(crowd: World, *frames: int) -> list[NDArray[np.int64]]:
    count_arrays = []
    while len(count_arrays) < len(frames):
        if crowd.frame - crowd.setting.first_frame == frames[len(count_arrays)]:
            count_arrays.append(counts(crowd))
        step(crowd)
    return count_arrays


@pytest.mark.slow
def test_a_crowd_comes_to_rest_in_its_shares() -> None:
    """What a preroll is for. Here the crowd soon gives up searching, so that it is under way after 20 s."""
    crowd = world(count=400, load=1e5, patience=8.0, around=APPLE, radius=200.0)
    early, early_later, first, later = counts_at(crowd, 240, 290, 480, 530)
    assert shifted(early, early_later) > 0.1
    assert shifted(first, later) <= 0.1


@pytest.mark.slow
def test_five_hundred_ants_for_the_whole_shot() -> None:
    measures, without = watch(world(), 959), watch(world(reward=0.0), 959)
    nothing_lost(measures)
    stays_on_the_ground(measures)
    motion(measures.world, **BOUNDS)
    quarters = measures.delivered[240::240]
    assert all(later > earlier + 10 for earlier, later in pairwise(quarters))
    ratio = np.array(measures.concentration) / np.array(without.concentration)
    print(
        "concentration, with and without reward:",
        measures.concentration[-1],
        without.concentration[-1],
        "least ratio",
        ratio.min(),
    )
    assert (ratio[10:] >= 3).all()


@pytest.mark.slow
def test_fifteen_thousand_ants_for_the_whole_shot() -> None:
    measures = watch(world(scene=EXAMPLE / "many.yaml"), 479)
    without = watch(world(scene=EXAMPLE / "many.yaml", reward=0.0), 479, every=479)
    nothing_lost(measures)
    stays_on_the_ground(measures)
    motion(measures.world, **CROWDED)
    print("motion", measures.world.motion.summarise(), "delivered", measures.delivered[::120])
    print("concentration", measures.concentration[-1], without.concentration[-1])
    assert measures.delivered[-1] > measures.delivered[360] > measures.delivered[240] > 0
    assert measures.concentration[-1] >= 3 * without.concentration[-1]


@pytest.mark.slow
def test_a_prerolled_shot_is_under_way_at_its_first_frame() -> None:
    first, later = counts_at(world(load=1e5), 2000, 2050)
    print("counts of states", first, later)
    assert shifted(first, later) <= 0.1
