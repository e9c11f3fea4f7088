"""Digging. In each step, all balls that agents dig are removed from the solids together, before any agent moves.

Fields on a solid get new cells at the walls that digging creates."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

import numpy as np
from numpy.typing import NDArray

from antdsl.fields.growing import GrowingCells
from antdsl.fields.pheromone import PheromoneField
from antdsl.ground.solid import Volume
from antdsl.runtime.requests import RequestEntry
from antdsl.runtime.world import Population, World

Floats = NDArray[np.float64]

_SURFACE_DISTANCE_VOXELS = 0.5  # ball points within this distance of the surface are on a new wall
_MAX_POINTS_PER_EDGE = 16  # points along an edge of the cube that is projected onto a ball


def apply_dig_requests(world: World) -> None:
    """Remove the balls that agents dig from the solids, and add the dug volume to each agent's register.

    Agents that lose the ground below them fall in the phase `move`."""
    requests: dict[str, list[tuple[Population, RequestEntry]]] = {}
    for population in world.populations.values():
        for entry in population.effects.pop_requests("carve"):
            if len(entry.rows):
                requests.setdefault(entry.request.target, []).append((population, entry))
    for name, entries in sorted(requests.items()):
        _carve_solid(world, name, entries)


def _carve_solid(world: World, solid: str, entries: list[tuple[Population, RequestEntry]]) -> None:
    """Remove balls from one solid in the order of (species, id, position in the source), whatever the order of rows."""
    names = list(world.populations)
    species = np.concatenate([np.full(len(e.rows), names.index(p.name)) for p, e in entries])
    ids = np.concatenate([p.ids[e.rows] for p, e in entries])
    place = np.concatenate([np.full(len(e.rows), e.order) for _, e in entries])
    middle = np.concatenate([np.column_stack([e.get_required_operand(1 + k) for k in range(3)]) for _, e in entries]).astype(
        np.float64
    )
    radius = np.concatenate([e.get_required_operand(0) for _, e in entries]).astype(np.float64)
    order = np.lexsort((place, ids, species))
    owner = np.empty(len(order), np.int64)
    owner[order] = np.arange(len(order))
    removed = world.solids[solid].carve_balls(middle, radius, owner)
    dug = order[removed[order] > 0]
    fields = [field for name, field in world.fields.items() if solid in world.plan.fields[name].surfaces]
    if fields:
        add_cells_on_dug_walls(fields, world.solids[solid], middle[dug], radius[dug])
    if world.dug_balls is not None:
        world.dug_balls.setdefault(solid, []).append(np.column_stack([middle, radius]))
    first = 0
    for population, entry in entries:
        _add_dug_amount(population, entry, removed[first : first + len(entry.rows)])
        first += len(entry.rows)


def _add_dug_amount(population: Population, entry: RequestEntry, removed: NDArray[np.float64]) -> None:
    """Add the dug volume to the register that the request names, if any. `removed`: the volume for each row of `entry`."""
    if entry.request.register is not None:
        register = population.now[entry.request.register]
        register[entry.rows] = (register[entry.rows].astype(np.float64) + removed).astype(np.float32)


def take_dug_balls(world: World) -> dict[str, NDArray[np.float64]]:
    """Return the balls that were dug since the last call, by solid: float64[k, 4], centre and radius (mm).

    A solid without new balls has no entry."""
    balls_by_solid, world.dug_balls = world.dug_balls or {}, None if world.dug_balls is None else {}
    return {name: np.concatenate(balls) for name, balls in balls_by_solid.items() if sum(map(len, balls))}


def add_cells_on_dug_walls(fields: Iterable[PheromoneField], volume: Volume, centres: Floats, radius: Floats) -> None:
    """Add cells to the fields on a solid, at the walls of dug balls with centres [k,3] and radii [k] in mm.

    The result depends on the order of the balls."""
    by_cells: dict[int, list[PheromoneField]] = {}
    for field in fields:
        if isinstance(field.cells, GrowingCells):
            by_cells.setdefault(id(field.cells), []).append(field)
    for sharing in by_cells.values():
        cells = sharing[0].cells
        assert isinstance(cells, GrowingCells)
        points, normals = sample_wall_points(volume, centres, radius, cells.cell)
        new = cells.add_cells_at_points(points, normals)
        if len(new):
            for field in sharing:
                field.extend_arrays(new)


def sample_wall_points(volume: Volume, centres: Floats, radius: Floats, spacing: float) -> tuple[Floats, Floats]:
    """Return points [n,3] on the walls that dug balls left, and unit normals towards the air. The points are about half of
    `spacing` (mm) apart."""
    found = [(np.empty((0, 3)), np.empty((0, 3)))]
    lines = np.minimum(np.ceil(4 * radius / spacing).astype(np.int64), _MAX_POINTS_PER_EDGE)
    for number in np.unique(lines):
        rows, directions = np.flatnonzero(lines == number), _make_sphere_directions(max(int(number), 1))
        points = (centres[rows, None, :] + radius[rows, None, None] * directions).reshape(-1, 3)
        near = np.flatnonzero(np.abs(volume.sample_distances(points)) < _SURFACE_DISTANCE_VOXELS * volume.voxel)
        found.append((points[near], -np.broadcast_to(directions, (len(rows), *directions.shape)).reshape(-1, 3)[near]))
    points, normals = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return points, normals


@cache
def _make_sphere_directions(lines: int) -> Floats:
    """Return 6 · lines² unit vectors spread over a sphere, through the cells of a square grid on each side of a cube."""
    at = (np.arange(lines) + 0.5) / lines * 2 - 1
    u, v = (w.ravel() for w in np.meshgrid(at, at, indexing="ij"))
    sides = [np.roll(np.stack([np.full(u.size, s), u, v], axis=1), axis, axis=1) for axis in range(3) for s in (-1.0, 1.0)]
    ways = np.concatenate(sides)
    unit: Floats = ways / np.sqrt((ways * ways).sum(axis=1))[:, None]
    return unit
