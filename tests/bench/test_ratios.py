"""The statistics of benchmarks, their scaled worlds, and that what is slower is seen."""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
from pairs import Cost, main, measure_scene

from antdsl.bench.ratios import RatioInterval, compute_bootstrap_interval, measure_in_turn
from antdsl.bench.scaling import compress_crowds, scale_setting
from antdsl.pipeline import open_scene
from antdsl.runtime import bind

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def test_the_interval_holds_the_mean_and_grows_with_the_spread() -> None:
    draw = np.random.default_rng(4)
    narrow, wide = (compute_bootstrap_interval((1.1 + spread * draw.normal(size=20)).tolist()) for spread in (0.01, 0.1))
    for estimate in (narrow, wide):
        assert estimate.low < estimate.mean < estimate.high
    assert narrow.high - narrow.low < 0.02 < wide.high - wide.low
    assert compute_bootstrap_interval([1.0] * 20) == compute_bootstrap_interval([1.0] * 5)


def noisy(slower: float, seed: int) -> RatioInterval:
    """The ratio of costs as a noisy machine gives them: both of a pair are slowed down together by up to two, and each by up to a
    tenth alone, now and then by a half more."""
    draw = np.random.default_rng(seed)
    order: list[int] = []
    noise = 1.0

    def measure(tree: int) -> float:
        nonlocal noise
        if len(order) % 2 == 0:
            noise = float(draw.uniform(1.0, 2.0))
        order.append(tree)
        return noise * (slower if tree else 1.0) * float(draw.uniform(1.0, 1.1)) * (1.5 if draw.random() < 0.05 else 1.0)

    quotients = [this / other for other, this in measure_in_turn(measure, 2, 20)]
    assert order.count(0) == order.count(1) == 21 and order[2:6] == [1, 0, 0, 1]
    return compute_bootstrap_interval(quotients)


@pytest.mark.parametrize("machines", [8, pytest.param(100, marks=pytest.mark.slow)])
def test_what_takes_a_third_longer_is_caught_and_what_is_equal_is_not(machines: int) -> None:
    """All machines see 1.3 times as slower than 1.05, and as many as 95 % promises let what is equal pass."""
    assert all(noisy(1.3, seed).is_above(1.05) for seed in range(machines))
    assert sum(noisy(1.0, seed).is_above(1.05) for seed in range(machines)) <= machines // 20


@pytest.mark.slow
def test_a_step_made_longer_by_a_third_is_caught() -> None:
    """Real CPU time, bounds so wide that a busy machine does not matter."""
    work = np.random.default_rng(1).random(20_000)

    def cost(runner: int) -> float:
        started = time.process_time()
        for _ in range((100, 130, 100)[runner]):
            np.sort(work)
        return time.process_time() - started

    costs = measure_in_turn(cost, 3, 40)
    assert compute_bootstrap_interval([slow / plain for plain, slow, _ in costs]).is_above(1.05)
    assert not compute_bootstrap_interval([same / plain for plain, _, same in costs]).is_above(1.2)


def test_three_take_turns_and_each_is_first_as_often() -> None:
    order: list[int] = []
    turns = measure_in_turn(lambda runner: order.append(runner) or runner, 3, 6, warm_up_runs=0)
    assert turns == [(0, 1, 2)] * 6
    assert [order[0], order[3], order[6]] == [1, 2, 0] and all(sorted(order[k : k + 3]) == [0, 1, 2] for k in range(0, 18, 3))


def test_nothing_has_no_interval() -> None:
    with pytest.raises(ValueError, match="no ratios"):
        compute_bootstrap_interval([])


def test_the_script_leaves_with_words_where_a_tree_is_slower(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import pairs

    monkeypatch.setattr(pairs, "in_tree", lambda tree, **_: Cost(1.0, 1.3 if tree == pairs.ROOT else 1.0))
    monkeypatch.setattr(sys, "argv", ["pairs.py", "elsewhere", "scene.yaml", "--most", "1.2"])
    with pytest.raises(SystemExit, match=r"more than 1\.2 times as long: scene\.yaml"):
        main()
    monkeypatch.setattr(sys, "argv", ["pairs.py", "elsewhere", "scene.yaml", "--most", "1.4"])
    main()
    assert "1.300 (1.300 to 1.300) of the other tree's" in capsys.readouterr().out


@pytest.mark.parametrize("agents", [125, 2000])
def test_a_scaled_crowd_stands_as_densely(agents: int) -> None:
    shot, _ = open_scene(EXAMPLES / "foraging" / "scene.yaml")
    assert shot is not None
    world = bind(shot.plan, scale_setting(shot.setting, agents))
    place, by = world.populations["forager"].position, np.sqrt(agents / 500)
    assert len(place) == agents and world.overcrowded_lines == []
    reach = np.percentile(np.hypot(place[:, 0], place[:, 2]), 95)
    assert reach == pytest.approx(70 * by * np.sqrt(0.95), rel=0.06)
    assert world.items["food"].position[0] == pytest.approx(np.array([120, 0, 90]) * by, abs=20 * by)


@pytest.mark.parametrize(("agents", "counts"), [(3, [1, 0, 1, 0, 1]), (5, [1] * 5), (12, [2, 3, 2, 3, 2]), (1, [0, 0, 1, 0, 0])])
def test_however_a_crowd_of_parts_is_scaled_the_total_is_the_requested_one(agents: int, counts: list[int]) -> None:
    shot, _ = open_scene(EXAMPLES / "foraging" / "scene.yaml")
    assert shot is not None
    crowd = replace(shot.setting.crowds[0], count=1)
    scaled_setting = scale_setting(replace(shot.setting, crowds=(crowd,) * 5), agents)
    assert [each.count for each in scaled_setting.crowds] == counts


def test_what_cannot_be_scaled_is_refused() -> None:
    shot, _ = open_scene(EXAMPLES / "tunnel" / "scene.yaml")
    assert shot is not None
    with pytest.raises(ValueError, match="fixed meshes"):
        scale_setting(shot.setting, 10)


def test_costs_are_of_processor_time() -> None:
    cost = measure_scene(EXAMPLES / "minimal" / "scene.yaml", 3, None)
    assert 0 < cost.step < cost.setup


def test_a_crowd_that_is_gathered_keeps_its_ground() -> None:
    shot, _ = open_scene(EXAMPLES / "flocking" / "scene.yaml")
    assert shot is not None
    narrow = compress_crowds(scale_setting(shot.setting, 100), 0.5)
    assert narrow.crowds[0].place.radius == pytest.approx(150 * np.sqrt(100 / 400) * np.sqrt(0.5))
    assert np.ptp(narrow.surfaces["ground"].vertices[:, 0]) == pytest.approx(500)
