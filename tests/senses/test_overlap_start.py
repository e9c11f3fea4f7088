"""`overlap_start`: who stands in another where the crowd begins, of whatever species, before anybody has moved."""

from __future__ import annotations

import numpy as np
import pytest
from test_placing_apart import world

from antdsl.runtime import Options, bind, restore_checkpoint, step, take_checkpoint
from antdsl.runtime.world import World
from antdsl.scene.setting import CrowdData, PlacementData
from antdsl.senses import overlaps
from antdsl.senses.overlaps import measure_worst_overlaps

TEXT = """ant 1
use steering
world { surface hill }
species ant { size 4 mm; state go { steer coast() } }
species giant { size 20 mm; state go { steer coast() } }
species ghost { radius 0 mm; state go { steer coast() } }
"""
SPOTS = np.array([[0.0, 0, 0], [60.0, 0, 0], [-60.0, 0, 0], [0, 0, 60.0]])


def bind_crowds(*crowds: CrowdData, options: Options | None = None) -> World:
    return world(*crowds, text=TEXT, options=options, obstacles={}, maps={})


def at(species: str, count: int, group: int = 0, spots: np.ndarray = SPOTS) -> CrowdData:
    return CrowdData(species, count, PlacementData(points=spots), group)


def share(bound_world: World) -> float:
    return bound_world.motion.summarise()["overlap_start"]


def test_start_overlaps_are_known_before_the_first_step() -> None:
    assert share(bind_crowds(at("ant", 4))) == 0
    assert share(bind_crowds(at("ant", 6))) == pytest.approx(4 / 6)


def test_all_species_are_counted_and_an_agent_without_size_overlaps_none() -> None:
    assert share(bind_crowds(at("ant", 4), at("giant", 1, 1))) == pytest.approx(2 / 5)
    assert share(bind_crowds(at("ant", 4), at("ghost", 4, 1))) == 0


def test_start_overlaps_are_measured_before_the_preroll() -> None:
    bound_world = bind_crowds(at("ant", 8))
    for _ in range(30):
        step(bound_world)
    bound_world.motion.reset_step_measures()
    assert share(bound_world) == 1 and bound_world.motion.steps == 0
    other = bind(bound_world.plan, bound_world.setting)
    restore_checkpoint(other, take_checkpoint(bound_world))
    step(other)
    assert share(other) == 1


@pytest.mark.parametrize("spread", [5.0, 50.0, 400.0])
def test_overlaps_of_very_different_sizes_are_exact(spread: float) -> None:
    draw = np.random.default_rng(5)
    place = (draw.random((400, 3)) * spread).astype(np.float32)
    radius = np.concatenate([0.05 + 0.05 * draw.random(300), 20 * draw.random(60), np.full(40, 200.0)]).astype(np.float32)
    away = np.sqrt(((place[:, None] - place[None]) ** 2).sum(axis=2))
    expected = np.clip(1 - away / (radius[:, None] + radius[None]), 0, 1)
    np.fill_diagonal(expected, 0)
    assert measure_worst_overlaps(*place.T.copy(), radius) == pytest.approx(expected.max(axis=1), abs=1e-6)


def test_small_agents_among_large_ones_are_fast(monkeypatch: pytest.MonkeyPatch) -> None:
    measured, inside = [0], overlaps._compute_overlap_share

    def counted(distance: np.ndarray, *radii: np.ndarray) -> np.ndarray:
        measured[0] += distance.size
        return inside(distance, *radii)

    monkeypatch.setattr(overlaps, "_compute_overlap_share", counted)
    n = 4000
    place = (np.random.default_rng(6).random((3, 2 * n)) * 200).astype(np.float32)
    radius = np.repeat([0.1, 200.0], n).astype(np.float32)
    assert measure_worst_overlaps(*place, radius)[:n].min() > 0.8
    assert measured[0] < 100 * n
