"""The benchmark that holds one tree against another: its statistics, its scaled worlds, and that it sees what is slower."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
from pairs import Cost, interval, once, pairs, scaled

from antdsl.pipeline import open_scene
from antdsl.runtime import bind

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def test_the_interval_holds_the_mean_and_grows_with_the_spread() -> None:
    draw = np.random.default_rng(4)
    narrow, wide = (interval((1.1 + spread * draw.normal(size=20)).tolist()) for spread in (0.01, 0.1))
    for found in (narrow, wide):
        assert found.low < found.mean < found.high
    assert narrow.high - narrow.low < 0.02 < wide.high - wide.low
    assert interval([1.0] * 20) == interval([1.0] * 5)


def test_a_slower_tree_is_seen_and_an_equal_one_is_not_called_slower() -> None:
    """Costs as a noisy machine gives them: both of a pair are slowed down together, and each a little by itself."""
    draw = np.random.default_rng(5)
    noise = 1.0

    def measured(slower: float) -> list[float]:
        order: list[int] = []

        def measure(tree: int) -> Cost:
            nonlocal noise
            if len(order) % 2 == 0:
                noise = float(draw.uniform(1.0, 2.0))
            order.append(tree)
            return Cost(1.0, noise * (slower if tree else 1.0) * float(draw.uniform(1.0, 1.05)))

        found = [this.step / other.step for other, this in pairs(measure, 20)]
        assert order.count(0) == order.count(1) == 21 and order[2:6] == [1, 0, 0, 1]
        return found

    assert interval(measured(1.3)).low > 1.05
    assert interval(measured(1.0)).high < 1.05


@pytest.mark.parametrize("agents", [125, 2000])
def test_a_scaled_crowd_stands_as_densely(agents: int) -> None:
    shot, _ = open_scene(EXAMPLES / "foraging" / "scene.yaml")
    assert shot is not None
    world = bind(shot.plan, scaled(shot.setting, agents))
    place, by = world.populations["forager"].position, np.sqrt(agents / 500)
    assert len(place) == agents and world.crowded == []
    reach = np.percentile(np.hypot(place[:, 0], place[:, 2]), 95)
    assert reach == pytest.approx(70 * by * np.sqrt(0.95), rel=0.06)
    assert world.items["food"].position[0] == pytest.approx(np.array([120, 0, 90]) * by, abs=20 * by)


def test_what_cannot_be_scaled_is_refused() -> None:
    shot, _ = open_scene(EXAMPLES / "tunnel" / "scene.yaml")
    assert shot is not None
    with pytest.raises(ValueError, match="stand still"):
        scaled(shot.setting, 10)


def test_costs_are_of_processor_time() -> None:
    cost = once(EXAMPLES / "minimal" / "scene.yaml", 3, None)
    assert 0 < cost.step < cost.setup
