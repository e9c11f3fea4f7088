"""The neighbours of an agent in the tangent plane of its ground, and the cell grids that find neighbours.

From the neighbours, it computes a velocity that avoids all of them, and the widest gap between them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import accumulate
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.limits import MAX_QUERY_NEIGHBOURS
from antdsl.machine_code.number_kinds import LANE_COUNT
from antdsl.numerics import parallel
from antdsl.numerics import vectors as vec
from antdsl.numerics.vectors import VectorArrays
from antdsl.runtime.sensing.image_pairs import ImageGrid, get_image_reach_by_axis
from antdsl.runtime.world import AXES, Population, World
from antdsl.senses.clear_velocity import WishedVelocities, fill_clear_velocities, find_widest_gaps
from antdsl.senses.nearest_others import CrowdTables, NeighbourRequests, fill_nearest_offsets, pack_up_and_motion
from antdsl.senses.neighbours import CellGrid

_MAX_COARSER_QUARTERS = 4  # cells may be wider than requested by this many quarters of an octave
_CELL_RATIO = 1.2  # more than the ratio of radii that one grid serves, a quarter of an octave
_ALL_SPECIES_GRID_NAME = ""  # the name of the grid of all agents
Floats = NDArray[np.float64]
Rows = NDArray[np.intp]


def compute_clear_velocity(
    world: World, population: Population, rows: Rows, wish: VectorArrays, radius: Floats, horizon: Floats, max_count: Floats
) -> tuple[NDArray[np.float32], ...]:
    """Return a velocity along the ground for each agent, as near as possible to `wish`: x, y and z arrays (mm/s).

    It avoids collisions with the `max_count` nearest agents of any species for `horizon` s. Only agents within `radius` mm on the
    same side of the ground count. All positions and velocities are those at the start of the step."""
    crowd, requesters = build_nearest_search(world, population, rows, radius, max_count)
    a, b, c = wish
    wished = np.ascontiguousarray(a, np.float64), np.ascontiguousarray(b, np.float64), np.ascontiguousarray(c, np.float64)
    wishes, velocities = WishedVelocities(wished, horizon, population.start["max_speed"]), np.empty((3, len(rows)), np.float32)
    work = partial(fill_clear_velocities, crowd, requesters, wishes, world.dt, velocities)
    parallel.run_in_parts(work, len(rows), world.options.threads)
    return tuple(velocities)


def find_widest_gap(
    world: World, population: Population, rows: Rows, radius: Floats, max_count: Floats
) -> tuple[NDArray[np.float32], ...]:
    """Return the direction of the widest gap between an agent's neighbours, from the agent to the middle of the gap. Directions
    are unit vectors along the ground: x, y and z arrays. Neighbours are the `max_count` nearest agents of any species, within
    `radius` mm on the same side of the ground. Without neighbours the result is 0."""
    crowd, requesters = build_nearest_search(world, population, rows, radius, max_count)
    shape = len(rows), int(min(np.max(max_count, initial=0.0, where=max_count > 0), MAX_QUERY_NEIGHBOURS))
    x, y, is_present, axes = np.zeros(shape), np.zeros(shape), np.zeros(shape, np.bool_), np.empty((6, len(rows)))
    parallel.run_in_parts(
        partial(fill_nearest_offsets, crowd, requesters, x, y, is_present, axes), len(rows), world.options.threads
    )
    ahead, left = find_widest_gaps(x, y, is_present)
    return tuple((axes[k] * ahead + axes[k + 3] * left).astype(np.float32) for k in range(3))


def build_nearest_search(
    world: World, population: Population, rows: Rows, radius: Floats, max_count: Floats
) -> tuple[CrowdTables, NeighbourRequests]:
    """Return the inputs of a search for the nearest neighbours: all agents as a crowd, and the given agents as requesters."""
    widest = float(np.max(radius, initial=0.0, where=np.isfinite(radius)))
    grid = _find_grid(world, _ALL_SPECIES_GRID_NAME, widest if widest > 0 else 1.0, partial(_CrowdGrid, world))
    assert isinstance(grid, _CrowdGrid)
    positions = grid.order.position_by_row.take(grid.first_rows[population.name] + rows)
    return grid.crowd, NeighbourRequests(
        positions, rows, radius, max_count, vec.get_vector_registers(population.start, "heading")
    )


class _CrowdGrid(CellGrid):
    """All agents of a world, sorted into cells. `first_rows`: the first row of each species. `crowd`: the tables that kernels
    read."""

    def __init__(self, world: World, cell: float) -> None:
        populations, threads = world.populations, world.options.threads
        self.first_rows = _find_first_rows(populations, list(populations))
        named = _find_first_rows(populations, sorted(populations))

        def join_arrays(arrays: Sequence[NDArray[Any]]) -> NDArray[Any]:
            return np.concatenate(arrays) if len(arrays) > 1 else np.ascontiguousarray(arrays[0])

        def join_vectors(name: str) -> VectorArrays:
            x, y, z = zip(*[vec.get_vector_registers(each.start, name) for each in populations.values()], strict=True)
            return join_arrays(x), join_arrays(y), join_arrays(z)

        x, y, z = join_vectors("position")
        sources: Rows | None = None
        if world.periodic is not None:
            reach = min(_CELL_RATIO * cell, max(world.periodic.box.widths) / 2)  # the grid serves all radii of its size class
            sources, (x, y, z) = world.periodic.box.find_image_rows((x, y, z), reach)

        def add_images(array: NDArray[Any]) -> NDArray[Any]:
            return array if sources is None else array.take(sources)

        super().__init__(x, y, z, np.arange(x.size), cell, threads)
        numbers = add_images(join_arrays([each.compute_id_ranks() + self.first_rows[name] for name, each in populations.items()]))
        radius = add_images(join_arrays([each.start["radius"] for each in populations.values()]))
        up, motion = np.empty((2, 4 * (x.size + LANE_COUNT)), np.float32)
        ups, velocities = (tuple(map(add_images, join_vectors(name))) for name in ("up", "velocity"))
        sensed = ups, velocities, radius, numbers
        parallel.run_in_parts(
            partial(pack_up_and_motion, self.order.position_by_row, *sensed, up, motion),
            x.size,
            threads,
            parallel.MIN_LIGHT_ITEMS_PER_THREAD,
        )
        by_name = np.empty(0, np.int32)
        if len(populations) > 1:
            by_name = add_images(
                join_arrays([np.arange(len(each), dtype=np.int32) + named[name] for name, each in populations.items()])
            )
        self.crowd = CrowdTables(self.make_tables(), up, motion, by_name, get_image_reach_by_axis(world))


def _find_first_rows(populations: Mapping[str, Population], names: Sequence[str]) -> dict[str, int]:
    """Return the first row of each species if all species are concatenated in the order of `names`."""
    ends = accumulate(len(populations[name]) for name in names)
    return {name: end - len(populations[name]) for name, end in zip(names, ends, strict=True)}


def find_species_grid(world: World, other: Population, max_radius: float) -> CellGrid:
    """Return the agents of a species, sorted into cells that suit searches up to `max_radius` (mm)."""

    def sort_agents(cell: float) -> CellGrid:
        if world.periodic is not None:
            reach = _CELL_RATIO * cell  # the grid serves all radii of its size class
            return ImageGrid(world.periodic.box, other, cell, reach, world.options.threads)
        x, y, z = (other.start[f"position.{axis}"] for axis in AXES)
        return CellGrid(x, y, z, other.ids, cell, world.options.threads)

    return _find_grid(world, other.name, max_radius, sort_agents)


def _find_grid(world: World, name: str, max_radius: float, sort: Callable[[float], CellGrid]) -> CellGrid:
    """Return a grid of this step that suits searches up to `max_radius` (mm). Sort the agents only if there is no such grid.

    A search in a grid with larger cells costs less than sorting again."""
    size = float(np.ceil(4 * np.log2(max_radius)))
    known = [(k, grid) for (of, k), grid in list(world.grids.items()) if of == name and size <= k <= size + _MAX_COARSER_QUARTERS]
    if known:
        return min(known, key=lambda entry: entry[0])[1]
    grid = world.grids[name, size] = sort(max_radius)
    return grid
