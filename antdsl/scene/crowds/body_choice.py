"""The choice of a body for each agent, for species with several bodies.

Each agent gets one body for its lifetime, drawn in proportion to the weights of the bodies. The draw depends only on the agent's
id and the scene's seed, not on rows or on births and deaths of other agents. A species with one body has the body key `SPECIES`.
A species with several bodies has the keys `SPECIES#0`, `SPECIES#1` and so on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.randomness import draw_uniform

_BODY_KEY_SEPARATOR = "#"


def make_body_key(species: str, number: int, count: int) -> str:
    """Return the key of a species' body. `number`: the index of the body. `count`: how many bodies the species has."""
    return f"{species}{_BODY_KEY_SEPARATOR}{number}" if count > 1 else species


def list_body_keys(species: str, count: int) -> tuple[str, ...]:
    """Return the keys of all bodies of a species. `count`: how many bodies it has; 0 also gives one key."""
    return tuple(make_body_key(species, number, count) for number in range(max(1, count)))


def find_species_of_key(key: str) -> str:
    """Return the species to which a body key belongs."""
    return key.partition(_BODY_KEY_SEPARATOR)[0]


def find_number_of_key(key: str) -> int:
    """Return the number at the end of a body key: the index of the body among the bodies of its species."""
    return int(key.partition(_BODY_KEY_SEPARATOR)[2] or 0)


def choose_body_numbers(weights: Sequence[float], seed: int, species: str, ids: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Return the index of each agent's body, uint8[n], drawn at random.

    `weights`: the weight of each body, above 0; empty for a single body. `ids`: the ids of the agents."""
    if len(weights) < 2:
        return np.zeros(len(ids), np.uint8)
    drawn = draw_uniform(seed, 0, species, "body", 0, np.asarray(ids, np.int64)).astype(np.float64)
    limits = np.cumsum(np.asarray(weights, np.float64))
    numbers = np.searchsorted(limits[:-1] / limits[-1], drawn, side="right")
    return numbers.astype(np.uint8)
