"""The values that crowd lines give to attributes and states at birth. The block `born` reads them from temporary registers.

A value depends only on (seed, species, attribute, id), and a painted value also on the position."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import elementary, randomness
from antdsl.plan import ir
from antdsl.runtime.world import Population, World
from antdsl.scene.crowds.crowd_data import MAX_STANDARD_DEVIATIONS, CrowdData, ValueDraw

Rows = NDArray[np.intp]
_F = np.float32
_FULL_TURN = _F(2 * np.pi)


def write_initial_values(world: World, population: Population, rows: Rows, crowd: CrowdData) -> None:
    """Write the attribute values of a crowd line into the registers of `rows`. Values given for a point override others."""
    for name, draw in crowd.initial_values.items():
        if (register := ir.format_birth_register_name(name)) in population.now:
            population.now[register][rows] = _draw_values(world, population, rows, name, draw)
    for name, column in crowd.place.values.items():
        if (register := ir.format_birth_register_name(name)) in population.now:
            point_values = column[population.ids[rows] % len(column)]
            others = population.now[register][rows] if name in crowd.initial_values else np.inf
            population.now[register][rows] = np.where(np.isfinite(point_values), point_values, others)


def _draw_values(world: World, population: Population, rows: Rows, name: str, draw: ValueDraw) -> NDArray[np.float32]:
    """Return a random value of the attribute `name` for each row. `draw`: how to draw it."""
    low, high = _F(draw.low), _F(draw.high)
    if draw.kind == "number":
        return np.full(len(rows), low)
    if draw.kind == "painted":
        meshes = world.ground.meshes
        if meshes is None:
            return np.full(len(rows), low)
        return low + (high - low) * world.maps[draw.map_name].sample(meshes, population.footing.select_rows(rows))
    u, v = (
        randomness.draw_uniform(world.setting.seed, 0, population.name, f"each {name}", k, population.ids[rows]) for k in range(2)
    )
    if draw.kind == "uniform":
        return low + (high - low) * u
    if draw.kind == "choice":
        limits = np.cumsum(np.asarray(draw.weights, np.float64))
        picked = np.searchsorted(limits[:-1] / limits[-1], u.astype(np.float64), side="right")
        return np.asarray(draw.values, _F)[picked]
    # G. E. P. Box, M. E. Muller, A note on the generation of random normal deviates, 1958
    deviations = np.sqrt(_F(-2) * elementary.log(_F(1) - u)) * elementary.cos(v * _FULL_TURN)
    values: NDArray[np.float32] = low + high * np.clip(deviations, _F(-MAX_STANDARD_DEVIATIONS), _F(MAX_STANDARD_DEVIATIONS))
    return values
