"""Finds the body of each agent, for species with several bodies."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.runtime.world import Population
from antdsl.scene.crowds.body_choice import choose_body_numbers
from antdsl.scene.setting import WorldSetting


def find_body_numbers(population: Population, setting: WorldSetting) -> NDArray[np.uint8]:
    """Return the number of each agent's body within the species' list of bodies, uint8[n]. Callers must not change the array."""
    if population.bodies is None or population.bodies[0] != population.version or len(population.bodies[1]) != len(population):
        weights = setting.body_weights.get(population.name, ())
        population.bodies = population.version, choose_body_numbers(weights, setting.seed, population.name, population.ids)
    return population.bodies[1]


def group_rows_by_body(population: Population, setting: WorldSetting) -> tuple[tuple[str, NDArray[np.intp] | None], ...]:
    """Return (body key, rows) for each body of a species: the ascending rows of the agents that have this body.

    If the species has a single body, its rows are None, which means all agents."""
    keys = setting.list_body_keys(population.name)
    if len(keys) < 2:
        return ((population.name, None),)
    numbers = find_body_numbers(population, setting)
    return tuple((key, np.flatnonzero(numbers == k)) for k, key in enumerate(keys))
