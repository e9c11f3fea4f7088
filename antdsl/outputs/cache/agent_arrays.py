"""Arrays of the agents in a frame, in scene units, with one row per agent. Rows are sorted by species name, then by id.

The rows of a species are written together. Registers are read in row order, and each value is written at the rank of the agent's
id."""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import parallel
from antdsl.outputs.cache import frame_loops
from antdsl.program.tables.columns import COLUMN_BY_ATTRIBUTE, Column
from antdsl.runtime.body_positions import compute_body_positions
from antdsl.runtime.world import AXES, Population, World

Arrays = dict[str, NDArray[Any]]


class AgentArrayBuilder:
    """Builder of the agents' arrays.

    `scale`: scene units per millimetre. `factors`: by (species, name of a number), the factor from the program's unit to the unit
    in frames; 1 where absent. `pair_names`: for each species, the names of values that belong to pairs of agents instead of
    single agents."""

    def __init__(self, scale: float, factors: Mapping[tuple[str, str], float], pairs: Mapping[str, Container[str]]) -> None:
        self.scale, self.factors, self.pair_names = scale, factors, pairs

    def build_arrays(self, world: World, attributes: tuple[str, ...]) -> Arrays:
        """Return the arrays called `attributes`, with one row per agent of the world."""
        populations = [world.populations[name] for name in sorted(world.populations)]
        output = Arrays()
        for attribute in attributes:
            column, end = COLUMN_BY_ATTRIBUTE.get(attribute), 0
            kind, shape = ("f4", ()) if column is None else (column.frame_type, column.compute_dimensions())
            output[attribute] = np.empty((len(world), *shape), kind)
            for population in populations:
                begin, end = end, end + len(population)
                self._write_attribute(world, attribute, population, output[attribute][begin:end])
        return output

    def _write_attribute(self, world: World, attribute: str, population: Population, out: NDArray[Any]) -> None:
        """Write an attribute of a species to `out`, which has only the rows of this species. NaN for agents without the
        attribute."""
        threads = world.options.threads
        column = COLUMN_BY_ATTRIBUTE.get(attribute)
        if column is not None and column.kind == "derived":
            VALUE_WRITERS[column.name](world, population, out)
        elif column is not None:
            write_column(population, column, self.scale, out, threads)
        elif attribute not in population.plan.registers or attribute in self.pair_names[population.name]:
            out[:] = np.nan
        else:
            write_numbers(population, attribute, self.factors.get((population.name, attribute), 1.0), out, threads)


def write_column(population: Population, column: Column, scale: float, out: NDArray[Any], threads: int = 1) -> None:
    """Write one column of a population to `out`, sorted by id, in the units of the cache. The column is a fixed array or
    registers."""
    ranks, factor = population.compute_id_ranks(), column.compute_unit_factor(scale)
    if column.kind == "register" and not column.shape:
        write_numbers(population, column.name, factor, out, threads)
    elif column.kind == "register":
        work = partial(frame_loops.write_vectors, _find_vector_columns(population, column.name), ranks, factor, out)
        parallel.run_in_parts(work, len(ranks), threads)
    elif column.shape:
        work = partial(frame_loops.write_positions, compute_body_positions(population), ranks, factor, out)
        parallel.run_in_parts(work, len(ranks), threads)
    else:
        out[:] = population.columns[column.name].take(population.get_rows_by_id())


def write_numbers(population: Population, name: str, factor: float, out: NDArray[np.float32], threads: int = 1) -> None:
    """Write a register times `factor` to `out` float32[n], sorted by id."""
    of = population.now[name]
    if of.dtype == np.float32:
        work = partial(frame_loops.write_numbers, of, population.compute_id_ranks(), np.float32(factor), out)
        parallel.run_in_parts(work, len(of), threads, parallel.MIN_LIGHT_ITEMS_PER_THREAD)
    else:
        out[:] = of.take(population.get_rows_by_id()).astype(np.float32, copy=False) * np.float32(factor)


def write_colours(world: World, population: Population, out: NDArray[np.float32]) -> None:
    """Write the colours of the agents' states to `out` float32[n, 3], sorted by id. Raises IndexError for an invalid state."""
    machines = population.plan.machines
    if not machines:
        out[:] = 1.0
        return
    colours, ranks = np.array(machines[0].colours, np.float32), population.compute_id_ranks()
    work = partial(frame_loops.write_colours, colours, population.now[f"{machines[0].name}.state"], ranks, out)
    if not all(parallel.run_in_parts(work, len(ranks), world.options.threads, parallel.MIN_LIGHT_ITEMS_PER_THREAD)):
        raise IndexError("a state that does not belong to the species has no colour")


def _write_states(world: World, population: Population, out: NDArray[np.int16]) -> None:
    """Write the state numbers of the agents to `out` int16[n], sorted by id."""
    machines = population.plan.machines
    if machines:
        work = partial(
            frame_loops.write_integers, population.now[f"{machines[0].name}.state"], population.compute_id_ranks(), out
        )
        parallel.run_in_parts(work, len(population), world.options.threads, parallel.MIN_LIGHT_ITEMS_PER_THREAD)
    else:
        out[:] = 0


def write_orientations(world: World, population: Population, out: NDArray[np.float32]) -> None:
    """Write the orientations of the agents to `out` float32[n, 4] as quaternions x, y, z, w, sorted by id."""
    heading, up, ranks = (
        _find_vector_columns(population, "heading"),
        _find_vector_columns(population, "up"),
        population.compute_id_ranks(),
    )
    parallel.run_in_parts(partial(frame_loops.write_orientations, heading, up, ranks, out), len(ranks), world.options.threads)


def _write_species(world: World, population: Population, out: NDArray[np.int16]) -> None:
    """Write the number of the species into all rows of `out` int16[n]."""
    out[:] = sorted(world.populations).index(population.name)


def _write_ages(world: World, population: Population, out: NDArray[np.float32]) -> None:
    """Write the ages of agents into `out` float32[n], in order of id."""
    out[:] = (world.frame - population.born[population.get_rows_by_id()]) * world.dt


def _find_vector_columns(population: Population, name: str) -> tuple[NDArray[np.float32], ...]:
    """Return the registers of the x, y and z components of the vector `name`."""
    return tuple(population.now[f"{name}.{axis}"] for axis in AXES)


VALUE_WRITERS: Mapping[str, Callable[[World, Population, NDArray[Any]], None]] = {
    "orient": write_orientations,
    "Cd": write_colours,
    "state": _write_states,
    "species": _write_species,
    "age": _write_ages,
}
