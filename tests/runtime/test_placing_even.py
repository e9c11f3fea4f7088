"""Crowds that begin evenly spaced: how far apart, which agents share a spot, and seeds of their own."""

from __future__ import annotations

from dataclasses import replace

import meshes
import numpy as np
import pytest
from meaning import crowd
from plan_text import plan_of
from scipy.spatial import cKDTree

from antdsl.passes import optimise_plan
from antdsl.runtime import CrowdData, MeshData, Options, PlacementData, World, WorldSetting, bind

TEXT = """species hunter { size 4 mm }
species prey { size 2 mm }"""
PLAN = optimise_plan(plan_of(TEXT))
FLOOR = {"ground": MeshData(*meshes.grid(200.0, 8))}


def bind_crowds(
    hunters: PlacementData, prey: PlacementData, counts: tuple[int, int] = (10, 200), **setting_arguments: object
) -> World:
    crowds = (CrowdData("hunter", counts[0], hunters, 0), CrowdData("prey", counts[1], prey, 1))
    return bind(PLAN, WorldSetting(**{**dict(crowds=crowds, surfaces=FLOOR, seed=5), **setting_arguments}), Options())  # type: ignore[arg-type]


def positions_by_id(world: World, species: str) -> np.ndarray:
    population = world.populations[species]
    return population.position[population.get_rows_by_id()]


def nearest(points: np.ndarray) -> np.ndarray:
    return cKDTree(points).query(points, 2)[0][:, 1]


def test_even_is_as_far_apart_as_all_have_room_for_across_species() -> None:
    even = PlacementData(surfaces=("ground",), spacing=np.inf)
    world = bind_crowds(even, even)
    drawn = bind_crowds(replace(even, spacing=0.0), replace(even, spacing=0.0))
    both, by_chance = (np.concatenate([positions_by_id(w, "hunter"), positions_by_id(w, "prey")]) for w in (world, drawn))
    least_distance = 2 * np.sqrt(0.42 * 200.0**2 / (np.pi * 210))
    assert not world.overcrowded_lines and nearest(both).min() >= least_distance
    assert nearest(by_chance).min() < least_distance / 2  # by chance alone they stand in heaps and gaps
    assert nearest(both).std() / nearest(both).mean() < 0.5 * nearest(by_chance).std() / nearest(by_chance).mean()


def test_a_length_holds_between_lines_too_and_agents_without_room_are_reported() -> None:
    wide, near = PlacementData(surfaces=("ground",), spacing=30.0), PlacementData(surfaces=("ground",), spacing=6.0)
    world = bind_crowds(wide, near)
    hunters, prey = positions_by_id(world, "hunter"), positions_by_id(world, "prey")
    assert nearest(hunters).min() >= 30 and nearest(prey).min() >= 6
    assert cKDTree(hunters).query(prey)[0].min() >= 18  # half of each
    assert not world.overcrowded_lines
    assert [line.species for line in bind_crowds(wide, near, (200, 10)).overcrowded_lines] == ["hunter"]


def test_a_seed_of_its_own_moves_that_line_alone() -> None:
    free, own = PlacementData(surfaces=("ground",)), PlacementData(surfaces=("ground",), seed=3)
    one, other, again = bind_crowds(free, free), bind_crowds(free, own), bind_crowds(free, own, seed=6)
    assert (positions_by_id(one, "hunter") == positions_by_id(other, "hunter")).all()
    assert not (positions_by_id(one, "prey") == positions_by_id(other, "prey")).all(axis=1).any()
    assert not (positions_by_id(one, "hunter") == positions_by_id(again, "hunter")).all(axis=1).any()
    same = (positions_by_id(other, "prey") == positions_by_id(again, "prey")).all(axis=1)
    assert same.mean() > 0.9  # but for who would stand in a hunter now
    assert crowd().place.seed is None


@pytest.mark.parametrize("added", [0, 50])
def test_more_agents_move_no_others_where_a_length_is_given(added: int) -> None:
    place = PlacementData(surfaces=("ground",), spacing=8.0)
    assert (
        positions_by_id(bind_crowds(place, place, (10, 100 + added)), "prey")[:100]
        == positions_by_id(bind_crowds(place, place, (10, 100)), "prey")
    ).all()
