"""Neighbours of agents as columns: the results of a search, and velocities that avoid given neighbours."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from antdsl.machine_code.kernels import BOOL, F64, I64, Array1, Array2, allocate_scratch, kernel
from antdsl.runtime import World
from antdsl.runtime.sensing.neighbourhood import build_nearest_search
from antdsl.runtime.world import Population
from antdsl.senses import nearest_others as others
from antdsl.senses.clear_velocity import find_nearest_allowed_velocity, write_velocity_border
from antdsl.senses.nearest_others import MAX_SEARCH_CANDIDATES, CandidateMemory, CrowdTables, NeighbourRequests, RelativeAgent


class Moves(NamedTuple):
    """Velocities and the ones that agents wish for, ahead and to the left, speed limits and horizons."""

    velocity: tuple[Array1[F64], Array1[F64]]
    wish: tuple[Array1[F64], Array1[F64]]
    fastest: Array1[F64]
    horizon: Array1[F64]


class Neighbours(NamedTuple):
    """Fields of `RelativeAgent` for n agents, at most m each: float64[n,m]. `is_present`: which entries are valid."""

    x: Array2[F64]
    y: Array2[F64]
    vx: Array2[F64]
    vy: Array2[F64]
    radius_sum: Array2[F64]
    is_present: Array2[BOOL]
    first: Array2[BOOL]


def clear_velocities(neighbours: Neighbours, moves: Moves, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Velocities that avoid these neighbours."""
    x, y = np.empty((2, len(moves.fastest)))
    _fill_velocities(neighbours, moves, dt, x, y)
    return x, y


@kernel
def _fill_velocities(neighbours: Neighbours, moves: Moves, dt: F64, x: Array1[F64], y: Array1[F64]) -> None:
    borders = (
        allocate_scratch(MAX_SEARCH_CANDIDATES, F64),
        allocate_scratch(MAX_SEARCH_CANDIDATES, F64),
        allocate_scratch(MAX_SEARCH_CANDIDATES, F64),
        allocate_scratch(MAX_SEARCH_CANDIDATES, F64),
        allocate_scratch(MAX_SEARCH_CANDIDATES, I64),
    )
    between = (
        allocate_scratch(MAX_SEARCH_CANDIDATES, F64),
        allocate_scratch(MAX_SEARCH_CANDIDATES, F64),
        allocate_scratch(MAX_SEARCH_CANDIDATES, F64),
        allocate_scratch(MAX_SEARCH_CANDIDATES, F64),
        allocate_scratch(MAX_SEARCH_CANDIDATES, I64),
    )
    for k in range(x.size):
        count = 0
        for c in range(neighbours.x.shape[1]):
            if neighbours.is_present[k, c]:
                ahead, left, radius_sum = neighbours.x[k, c], neighbours.y[k, c], neighbours.radius_sum[k, c]
                other = RelativeAgent(ahead, left, neighbours.vx[k, c], neighbours.vy[k, c], radius_sum)
                side = -1.0 if neighbours.first[k, c] else 1.0
                write_velocity_border(
                    other, side, count, moves.velocity[0][k], moves.velocity[1][k], moves.horizon[k], dt, borders
                )
                count += 1
        x[k], y[k] = find_nearest_allowed_velocity(borders, between, count, moves.fastest[k], moves.wish[0][k], moves.wish[1][k])


def nearest_others(
    world: World, population: Population, rows: np.ndarray, within: np.ndarray, most: np.ndarray
) -> tuple[Neighbours, np.ndarray]:
    """The nearest others of rows of a population, and the axes up, ahead and left of these rows (9, n)."""
    shape = len(rows), 256
    columns, planes = Neighbours(*np.zeros((5, *shape)), *np.zeros((2, *shape), np.bool_)), np.empty((9, len(rows)))
    fill_neighbours(*build_nearest_search(world, population, rows, within, most), columns, planes)
    return columns, planes


@kernel
def fill_neighbours(crowd: CrowdTables, requesters: NeighbourRequests, columns: Neighbours, planes: Array2[F64]) -> None:
    memory = CandidateMemory(
        allocate_scratch(MAX_SEARCH_CANDIDATES, I64),
        allocate_scratch(MAX_SEARCH_CANDIDATES, I64),
        allocate_scratch(MAX_SEARCH_CANDIDATES, I64),
        allocate_scratch(MAX_SEARCH_CANDIDATES, I64),
        allocate_scratch(MAX_SEARCH_CANDIDATES, I64),
    )
    others.reset_candidates(memory)
    for k in range(requesters.max_others.size):
        at, plane = requesters.positions[k], others.compute_tangent_plane(crowd, requesters, k)
        for axis in range(3):
            planes[axis, k], planes[3 + axis, k], planes[6 + axis, k] = plane.up[axis], plane.ahead[axis], plane.left[axis]
        for c in range(others.find_nearest_others(crowd, requesters, k, plane.up, memory)):
            other = others.compute_relative_agent(crowd, plane, at, memory.nearest_rows[c])
            columns.x[k, c], columns.y[k, c], columns.vx[k, c], columns.vy[k, c] = other.x, other.y, other.vx, other.vy
            columns.radius_sum[k, c], columns.is_present[k, c] = other.radius_sum, True
            columns.first[k, c] = others.compare_agent_names(crowd, at, memory.nearest_keys[c]) < 0.0
