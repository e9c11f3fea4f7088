"""The wearers of a body: all agents that have this body. They are presented in the form that the code of feet needs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.protocol import Footing
from antdsl.runtime.body_positions import LIFT_REGISTERS
from antdsl.runtime.body_rows import find_body_numbers, group_rows_by_body
from antdsl.runtime.moving.crouching import compute_lowering, has_crouch
from antdsl.runtime.world import AXES, Population, World
from antdsl.scene.crowds.body_choice import find_number_of_key, find_species_of_key

_REGISTERS = (*(f"{name}.{axis}" for name in ("heading", "up") for axis in AXES), "size")


class BodyWearers(Protocol):
    """The agents that have a certain body: a complete population, or some of its rows."""

    @property
    def ids(self) -> NDArray[np.int64]:
        """Return the ids of the agents, one per row."""

    @property
    def position(self) -> NDArray[np.float64]:
        """Return positions in mm, [n, 3]."""

    @property
    def now(self) -> Mapping[str, NDArray[Any]]:
        """Return the current values of registers by name. These include heading, up and size, and the shift of the body if the
        species has one."""

    def __len__(self) -> int: ...

    def get_buffers(self, name: str, count: int, shape: tuple[int, ...], dtype: type[np.generic]) -> tuple[NDArray[Any], ...]:
        """Return arrays to which a step can write results. Same as `Population.get_buffers`."""

    @property
    def footing(self) -> Footing:
        """Return the footings of the agents."""


@dataclass(frozen=True, slots=True, eq=False)
class BodyWearersInRows:
    """The agents of a population at the given `rows`, which all have the body `key`. Implements `BodyWearers`."""

    population: Population
    key: str
    rows: NDArray[np.intp]
    ids: NDArray[np.int64]
    position: NDArray[np.float64]
    now: Mapping[str, NDArray[Any]]

    def __len__(self) -> int:
        return len(self.rows)

    def get_buffers(self, name: str, count: int, shape: tuple[int, ...], dtype: type[np.generic]) -> tuple[NDArray[Any], ...]:
        return self.population.get_buffers(f"{name} of {self.key}", count, shape, dtype)

    @property
    def footing(self) -> Footing:
        return self.population.footing.select_rows(self.rows)


def get_body_wearers(world: World, key: str) -> BodyWearers:
    """Return the agents that have the body `key`."""
    population = world.populations[find_species_of_key(key)]
    parts = group_rows_by_body(population, world.setting)
    rows = dict(parts)[key]
    if rows is None:
        return population
    names = (*_REGISTERS, *(name for name in LIFT_REGISTERS if name in population.now))
    registers = {name: population.now[name].take(rows) for name in names}
    return BodyWearersInRows(population, key, rows, population.ids.take(rows), population.position.take(rows, axis=0), registers)


def compute_crouch_lowering(world: World, key: str) -> NDArray[np.float32] | None:
    """Return by how much (mm) crouching lowers each agent with the body `key`, in the order of ids. Return None if the species
    does not crouch."""
    population = world.populations.get(find_species_of_key(key))
    if population is None or not has_crouch(population):
        return None
    rows = population.get_rows_by_id()
    own_rows = dict(group_rows_by_body(population, world.setting))[key]
    rows = rows if own_rows is None else rows[np.isin(rows, own_rows)]
    return compute_lowering(population, rows)


def find_sorted_ids(world: World, key: str) -> NDArray[np.int64]:
    """Return the ids of the agents that have the body `key`, ascending."""
    population = world.populations[find_species_of_key(key)]
    if len(world.setting.list_body_keys(population.name)) < 2:
        return population.get_sorted_ids()[0]
    numbers = find_body_numbers(population, world.setting)[population.get_rows_by_id()]
    own: NDArray[np.int64] = population.get_sorted_ids()[0][numbers == find_number_of_key(key)]
    return own
