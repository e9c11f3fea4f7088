"""The choice of a body for each agent, for species that have several bodies.

A body is drawn for each agent by its id and the scene's seed, in proportion to weights, for the agent's lifetime. So the choice
does not depend on rows, or on births and deaths of other agents. A species with one body has the body key `SPECIES`. A species
with several bodies has a key for each: `SPECIES#0` and so on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.randomness import draw_uniform

_BODY_KEY_SEPARATOR = "#"


def make_body_key(species: str, number: int, count: int) -> str:
    """Return the key of the body with index `number` of a species that has `count` bodies."""
    return f"{species}{_BODY_KEY_SEPARATOR}{number}" if count > 1 else species


def list_body_keys(species: str, count: int) -> tuple[str, ...]:
    """Return the keys of all bodies of a species that has `count` bodies; at least one."""
    return tuple(make_body_key(species, number, count) for number in range(max(1, count)))


def find_species_of_key(key: str) -> str:
    """Return the species of a body key."""
    return key.partition(_BODY_KEY_SEPARATOR)[0]


def find_number_of_key(key: str) -> int:
    """Return the index of the body with this key among the bodies of its species."""
    return int(key.partition(_BODY_KEY_SEPARATOR)[2] or 0)


def choose_body_numbers(weights: Sequence[float], seed: int, species: str, ids: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Return the index of the body that is drawn for each agent, uint8[n].

    `weights`: the weight of each body, above 0; empty for a single body. `ids`: the ids of the agents."""
    if len(weights) < 2:
        return np.zeros(len(ids), np.uint8)
    drawn = draw_uniform(seed, 0, species, "body", 0, np.asarray(ids, np.int64)).astype(np.float64)
    limits = np.cumsum(np.asarray(weights, np.float64))
    numbers = np.searchsorted(limits[:-1] / limits[-1], drawn, side="right")
    return numbers.astype(np.uint8)
