"""Agents in a frame, as arrays in scene units. Rows are agents: species in order of their names, agents by id within each.

Each species writes its own rows of an array. A register is read in row order, and each value is written to the agent's rank by
id."""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import parallel
from antdsl.outputs.cache import frame_loops
from antdsl.runtime.world import AXES, Population, World

Arrays = dict[str, NDArray[Any]]
_KINDS: Mapping[str, tuple[Any, tuple[int, ...]]] = {
    "P": (np.float32, (3,)), "v": (np.float32, (3,)), "orient": (np.float32, (4,)), "Cd": (np.float32, (3,)),
    "state": (np.int16, ()), "species": (np.int16, ()),
}  # fmt: skip


class AgentArrays:
    """Builder of the agents' arrays. `scale`: scene units per millimetre. `factors`: multipliers of a species' numbers, 1 by
    default. `pairs`: names for which a species has one value per pair."""

    def __init__(
        self, world: World, scale: float, factors: Mapping[tuple[str, str], float], pairs: Mapping[str, Container[str]]
    ) -> None:
        self.scale, self.factors, self.pairs = scale, factors, pairs
        self.colours = {name: _colours(p) for name, p in world.populations.items()}

    def arrays(self, world: World, attributes: tuple[str, ...]) -> Arrays:
        """The arrays of these names."""
        populations = [world.populations[name] for name in sorted(world.populations)]
        count, output = sum(map(len, populations)), Arrays()
        for attribute in attributes:
            if attribute == "id":
                ids = [population.sorted_ids()[0] for population in populations]
                output["id"] = ids[0] if len(ids) == 1 else np.concatenate(ids)
                continue
            kind, shape = _KINDS.get(attribute, (np.float32, ()))
            output[attribute] = np.empty((count, *shape), kind)
            begin = 0
            for number, population in enumerate(populations):
                end = begin + len(population)
                self._write(world, attribute, number, population, output[attribute][begin:end])
                begin = end
        return output

    def _write(self, world: World, attribute: str, number: int, population: Population, out: NDArray[Any]) -> None:
        """Write an attribute of the species with this number into its rows of an array."""
        threads = world.options.threads
        if attribute in ("P", "v", "orient"):
            write_placed(population, attribute, self.scale, out, threads)
        elif attribute == "Cd":
            write_colours(population, self.colours[population.name], out, threads)
        elif attribute == "state":
            _write_states(population, out, threads)
        elif attribute == "species":
            out[:] = number
        elif attribute == "age":
            out[:] = (world.frame - population.born[population.in_id_order()]) * world.dt
        elif attribute == "pscale":
            write_numbers(population, "size", self.scale, out, threads)
        elif attribute not in population.plan.registers or attribute in self.pairs[population.name]:
            out[:] = np.nan
        else:
            write_numbers(population, attribute, self.factors.get((population.name, attribute), 1.0), out, threads)


def write_placed(population: Population, attribute: str, scale: float, out: NDArray[np.float32], threads: int = 1) -> None:
    """Write `P`, `v` or `orient` of agents by id, [n, 3 or 4]."""
    ranks = population.id_ranks()
    if attribute == "P":
        work: Callable[[int, int], Any] = partial(frame_loops.agent_positions, population.position, ranks, scale, out)
    elif attribute == "v":
        work = partial(frame_loops.agent_vectors, _columns(population, "velocity"), ranks, scale, out)
    else:
        work = partial(frame_loops.agent_orientations, _columns(population, "heading"), _columns(population, "up"), ranks, out)
    parallel.in_parts(work, len(ranks), threads)


def write_colours(population: Population, colours: NDArray[np.float32], out: NDArray[np.float32], threads: int = 1) -> None:
    """Write the state colours of agents, [n, 3]. Raises IndexError for an invalid state."""
    machines = population.plan.machines
    if not machines:
        out[:] = colours[0]
        return
    ranks = population.id_ranks()
    work = partial(frame_loops.agent_colours, colours, population.now[f"{machines[0].name}.state"], ranks, out)
    if not all(parallel.in_parts(work, len(ranks), threads, parallel.LIGHT)):
        raise IndexError("a state that does not belong to the species has no colour")


def _write_states(population: Population, out: NDArray[np.int16], threads: int) -> None:
    machines = population.plan.machines
    if machines:
        work = partial(frame_loops.agent_integers, population.now[f"{machines[0].name}.state"], population.id_ranks(), out)
        parallel.in_parts(work, len(population), threads, parallel.LIGHT)
    else:
        out[:] = 0


def write_numbers(population: Population, name: str, factor: float, out: NDArray[np.float32], threads: int = 1) -> None:
    """Write a register of agents times a factor, [n]."""
    of = population.now[name]
    if of.dtype == np.float32:
        work = partial(frame_loops.agent_numbers, of, population.id_ranks(), np.float32(factor), out)
        parallel.in_parts(work, len(of), threads, parallel.LIGHT)
    else:
        out[:] = of.take(population.in_id_order()).astype(np.float32, copy=False) * np.float32(factor)


def _colours(population: Population) -> NDArray[np.float32]:
    machines = population.plan.machines
    return np.array(machines[0].colours if machines else ((1.0, 1.0, 1.0),), np.float32)


def _columns(population: Population, name: str) -> tuple[NDArray[np.float32], ...]:
    return tuple(population.now[f"{name}.{axis}"] for axis in AXES)
