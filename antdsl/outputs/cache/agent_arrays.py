"""What agents are in a frame: arrays with one row an agent, species after species by name, by id within each; scene units.

Each species writes its own rows of an array. With kernels a register is read as rows lie, and each value goes to the place of the
agent's rank by id."""

from __future__ import annotations

from collections.abc import Container, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import compiled
from antdsl.outputs.cache.places import scene_places
from antdsl.runtime.world import AXES, Population, World

Arrays = dict[str, NDArray[Any]]
_KINDS: Mapping[str, tuple[Any, tuple[int, ...]]] = {
    "P": (np.float32, (3,)), "v": (np.float32, (3,)), "orient": (np.float32, (4,)), "Cd": (np.float32, (3,)),
    "state": (np.int16, ()), "species": (np.int16, ()),
}  # fmt: skip


class AgentArrays:
    """Makes these arrays. `scale`: scene units in a millimetre; `factors`: what a number of a species is multiplied by, 1 where
    none is given; `pairs`: names that a species has a value per pair for."""

    def __init__(
        self,
        world: World,
        scale: float,
        factors: Mapping[tuple[str, str], float],
        pairs: Mapping[str, Container[str]],
    ) -> None:
        self.scale, self.factors, self.pairs = scale, factors, pairs
        self.colours = {name: _colours(p) for name, p in world.populations.items()}

    def arrays(self, world: World, attributes: tuple[str, ...]) -> Arrays:
        """The arrays of these names."""
        populations = [world.populations[name] for name in sorted(world.populations)]
        count, found = sum(map(len, populations)), Arrays()
        for attribute in attributes:
            if attribute == "id":
                ids = [population.sorted_ids()[0] for population in populations]
                found["id"] = ids[0] if len(ids) == 1 else np.concatenate(ids)
                continue
            kind, shape = _KINDS.get(attribute, (np.float32, ()))
            found[attribute] = np.empty((count, *shape), kind)
            begin = 0
            for number, population in enumerate(populations):
                end = begin + len(population)
                self._write(world, attribute, number, population, found[attribute][begin:end])
                begin = end
        return found

    def _write(self, world: World, attribute: str, number: int, population: Population, out: NDArray[Any]) -> None:
        """Write an attribute of a species, the one of a number, into its rows of an array."""
        if attribute in ("P", "v", "orient"):
            write_placed(population, attribute, self.scale, out)
        elif attribute == "Cd":
            write_colours(population, self.colours[population.name], out)
        elif attribute == "state":
            _write_states(population, out)
        elif attribute == "species":
            out[:] = number
        elif attribute == "age":
            out[:] = (world.frame - population.born[population.in_id_order()]) * world.dt
        elif attribute == "pscale":
            write_numbers(population, "size", self.scale, out)
        elif attribute not in population.plan.registers or attribute in self.pairs[population.name]:
            out[:] = np.nan
        else:
            write_numbers(population, attribute, self.factors.get((population.name, attribute), 1.0), out)


def write_placed(population: Population, attribute: str, scale: float, out: NDArray[np.float32]) -> None:
    """Write `P`, `v` or `orient` of agents by id, [n, 3 or 4]."""
    if compiled.wanted(len(out)):
        from antdsl.outputs.cache import frames_compiled as kernels

        ranks = population.ranks()
        if attribute == "P":
            kernels.places(population.position, ranks, scale, out)
        elif attribute == "v":
            kernels.vectors(_columns(population, "velocity"), ranks, scale, out)
        else:
            kernels.orientations(_columns(population, "heading"), _columns(population, "up"), ranks, out)
        return
    rows = population.in_id_order()
    if attribute == "P":
        out[:] = scene_places(population.position[rows], scale)
    elif attribute == "v":
        out[:] = _vector(population, "velocity", rows) * np.float32(scale)
    else:
        out[:] = orientation(_vector(population, "heading", rows), _vector(population, "up", rows))


def write_colours(population: Population, colours: NDArray[np.float32], out: NDArray[np.float32]) -> None:
    """Write the colours of agents' states, [n, 3]. IndexError for a state that is none."""
    machines = population.plan.machines
    if machines and compiled.wanted(len(out)):
        from antdsl.outputs.cache import frames_compiled as kernels

        if kernels.coloured(colours, population.now[f"{machines[0].name}.state"], population.ranks(), out):
            return
    out[:] = colours.take(_states(population), axis=0)


def _write_states(population: Population, out: NDArray[np.int16]) -> None:
    machines = population.plan.machines
    if machines and compiled.wanted(len(out)):
        from antdsl.outputs.cache import frames_compiled as kernels

        kernels.wholes(population.now[f"{machines[0].name}.state"], population.ranks(), out)
    else:
        out[:] = _states(population)


def write_numbers(population: Population, name: str, factor: float, out: NDArray[np.float32]) -> None:
    """Write a register of agents times a factor, [n]."""
    of = population.now[name]
    if of.dtype == np.float32 and compiled.wanted(len(out)):
        from antdsl.outputs.cache import frames_compiled as kernels

        kernels.numbers(of, population.ranks(), np.float32(factor), out)
    else:
        out[:] = of.take(population.in_id_order()).astype(np.float32, copy=False) * np.float32(factor)


def orientation(heading: NDArray[np.float32], up: NDArray[np.float32]) -> NDArray[np.float32]:
    """Quaternions (n, 4) x, y, z, w that turn +x to the heading and +y to the part of `up` across it. (n, 3) float32 each.

    A turn of +x to the heading by the shortest way, then one about the heading. A heading of nothing counts as +x, an `up` along
    the heading as some direction across it."""
    hx, hy, hz = heading.astype(np.float64).T
    length = np.sqrt(hx * hx + hy * hy + hz * hz)
    still = length < 1e-12
    inverse = 1 / np.where(still, 1.0, length)
    hx, hy, hz = np.where(still, 1.0, hx * inverse), hy * inverse, hz * inverse
    # the shortest way: half way between +x and the heading; straight back is half a turn about z
    back = hx < -1 + 1e-12
    half = 1 / np.sqrt(np.where(back, 1.0, 2 * (1 + hx)))
    aw, ay, az = np.where(back, 0.0, (1 + hx) * half), np.where(back, 0.0, -hz * half), np.where(back, 1.0, hy * half)
    # where that turn brings +y and +z, and how `up` lies between them
    ux, uy, uz = up.astype(np.float64).T
    above = 2 * -az * aw * ux + (1 - 2 * az * az) * uy + 2 * ay * az * uz
    beside = 2 * ay * aw * ux + 2 * ay * az * uy + (1 - 2 * ay * ay) * uz
    size = np.sqrt(above * above + beside * beside)
    cosine = np.where(size > 1e-12, above / np.maximum(size, 1e-30), 1.0)
    bw = np.sqrt(np.maximum(0.5 + 0.5 * cosine, 0.0))
    other = np.sqrt(np.maximum(0.5 - 0.5 * cosine, 0.0))
    bx = np.where(np.signbit(beside) & (beside == beside), -other, other)  # what is no number may have any sign
    return np.stack([aw * bx, ay * bw + az * bx, az * bw - ay * bx, aw * bw], axis=1).astype(np.float32)


def _colours(population: Population) -> NDArray[np.float32]:
    machines = population.plan.machines
    return np.array(machines[0].colours if machines else ((1.0, 1.0, 1.0),), np.float32)


def _states(population: Population) -> NDArray[np.int32]:
    rows, machines = population.in_id_order(), population.plan.machines
    return population.now[f"{machines[0].name}.state"].take(rows) if machines else np.zeros(len(rows), np.int32)


def _vector(population: Population, name: str, rows: NDArray[np.intp]) -> NDArray[np.float32]:
    return np.stack([column.take(rows) for column in _columns(population, name)], axis=1)


def _columns(population: Population, name: str) -> tuple[NDArray[np.float32], ...]:
    return tuple(population.now[f"{name}.{axis}"] for axis in AXES)
