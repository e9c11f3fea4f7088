"""Crowds that begin evenly spaced: how far apart, who shares a spot with whom, and seeds of their own."""

from __future__ import annotations

from dataclasses import replace

import meshes
import numpy as np
import pytest
from meaning import crowd
from plan_text import plan_of
from scipy.spatial import cKDTree

from antdsl.passes import optimise
from antdsl.runtime import CrowdData, MeshData, Options, PlaceData, Setting, World, bind

TEXT = """species hunter { size 4 mm }
species prey { size 2 mm }"""
PLAN = optimise(plan_of(TEXT))
FLOOR = {"ground": MeshData(*meshes.grid(200.0, 8))}


def begun(hunters: PlaceData, prey: PlaceData, counts: tuple[int, int] = (10, 200), **more: object) -> World:
    crowds = (CrowdData("hunter", counts[0], hunters, 0), CrowdData("prey", counts[1], prey, 1))
    return bind(PLAN, Setting(**{**dict(crowds=crowds, surfaces=FLOOR, seed=5), **more}), Options())  # type: ignore[arg-type]


def places(world: World, species: str) -> np.ndarray:
    population = world.populations[species]
    return population.position[population.in_id_order()]


def nearest(points: np.ndarray) -> np.ndarray:
    return cKDTree(points).query(points, 2)[0][:, 1]


def test_even_is_as_far_apart_as_all_have_room_for_across_species() -> None:
    even = PlaceData(on=("ground",), apart=np.inf)
    world = begun(even, even)
    drawn = begun(replace(even, apart=0.0), replace(even, apart=0.0))
    both, by_chance = (np.concatenate([places(w, "hunter"), places(w, "prey")]) for w in (world, drawn))
    apart = 2 * np.sqrt(0.42 * 200.0**2 / (np.pi * 210))
    assert not world.crowded and nearest(both).min() >= apart
    assert nearest(by_chance).min() < apart / 2  # by chance alone they stand in heaps and gaps
    assert nearest(both).std() / nearest(both).mean() < 0.5 * nearest(by_chance).std() / nearest(by_chance).mean()


def test_a_length_holds_between_lines_too_and_who_finds_no_room_is_told() -> None:
    wide, near = PlaceData(on=("ground",), apart=30.0), PlaceData(on=("ground",), apart=6.0)
    world = begun(wide, near)
    hunters, prey = places(world, "hunter"), places(world, "prey")
    assert nearest(hunters).min() >= 30 and nearest(prey).min() >= 6
    assert cKDTree(hunters).query(prey)[0].min() >= 18  # half of each
    assert not world.crowded
    assert [line.species for line in begun(wide, near, (200, 10)).crowded] == ["hunter"]


def test_a_seed_of_its_own_moves_that_line_alone() -> None:
    free, own = PlaceData(on=("ground",)), PlaceData(on=("ground",), seed=3)
    one, other, again = begun(free, free), begun(free, own), begun(free, own, seed=6)
    assert (places(one, "hunter") == places(other, "hunter")).all()
    assert not (places(one, "prey") == places(other, "prey")).all(axis=1).any()
    assert not (places(one, "hunter") == places(again, "hunter")).all(axis=1).any()
    same = (places(other, "prey") == places(again, "prey")).all(axis=1)
    assert same.mean() > 0.9  # but for who would stand in a hunter now
    assert crowd().place.seed is None


@pytest.mark.parametrize("more", [0, 50])
def test_more_agents_move_nobody_where_a_length_is_given(more: int) -> None:
    place = PlaceData(on=("ground",), apart=8.0)
    assert (places(begun(place, place, (10, 100 + more)), "prey")[:100] == places(begun(place, place, (10, 100)), "prey")).all()
