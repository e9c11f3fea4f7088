"""The sense `light`: how much light the lamps with a given name cast on the ground below an agent. The same light is in pictures.

Lamps are items with `look: light`. Surfaces, obstacles and solids block their light; agents and items do not."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.lamps import LightSphere, place_bulb, select_brightest_lamps
from antdsl.casting.tolerances import MIN_VECTOR_LENGTH
from antdsl.numerics.vector_rows import dot
from antdsl.numerics.vectors import split_columns
from antdsl.plan import ir
from antdsl.runtime.sensing.thing_senses import Rows, read_exact_positions
from antdsl.runtime.world import Population, World
from antdsl.scene.looks import LAMP_SHAPE, choose_drawn_shape, compute_drawn_radius, compute_remaining_share, is_lamp_look

_RAYS_PER_LAMP = 16  # to evenly spread points of the side that faces the agent
_RAY_START_HEIGHT_PER_BODY = 0.02  # of the rays above the ground, in body lengths
_MIN_LIGHT = 1e-4  # lamps that give less are dark

Floats = NDArray[np.float64]


def sense_light(world: World, population: Population, node: ir.PlanNode, rows: Rows) -> NDArray[np.float32]:
    """Return the light of the lamps at the positions of `rows`, float32[n]. 1 is about the light of the sun in pictures."""
    place = read_exact_positions(world, population, rows)
    normal = population.normal[rows].astype(np.float64)
    start = place + normal * (population.start["size"][rows].astype(np.float64) * _RAY_START_HEIGHT_PER_BODY)[:, None]
    total = np.zeros(len(place))
    with np.errstate(all="ignore"):
        for lamp in select_brightest_lamps(_find_lamps_by_name(world, node.attrs[0])):
            light = lamp.compute_intensity(place, normal)
            lit = np.flatnonzero((light > _MIN_LIGHT) & (light < np.inf))
            total[lit] += light[lit] * (1 - _find_hidden_share(world, lamp, start[lit]))
        return total.astype(np.float32)


def _find_lamps_by_name(world: World, name: str) -> Iterator[LightSphere]:
    """Yield the items with this name that emit light, if their amount is above 0 at the start of the step."""
    items, strength = world.items[name], world.setting.lamp_strength
    for index, data in enumerate(world.setting.items.get(name, ())):
        amounts = (
            (data.attributes.get(attribute, default), float(items.visible_values[attribute][index]))
            for attribute, default in world.plan.items[name].attributes.items()
        )
        size = compute_drawn_radius(data.radius, compute_remaining_share(amounts))
        if is_lamp_look(data.look) and size > 0 and strength > 0:
            shape = choose_drawn_shape(name, data.name, data.look) if data.power is None else LAMP_SHAPE
            power = strength if data.power is None else strength * data.power
            yield LightSphere(*place_bulb(shape, items.position[index], size, world.up), power)


def _find_hidden_share(world: World, lamp: LightSphere, start: Floats) -> Floats:
    """Return the fraction (n,) of the lamp that is hidden when seen from each position (n, 3)."""
    count, hidden = _RAYS_PER_LAMP, np.zeros(len(start) * _RAYS_PER_LAMP, np.bool_)
    if not len(start) or not world.obstacles:
        return np.zeros(len(start))
    origin = np.repeat(start, count, axis=0)
    ray = lamp.aim_rays(origin, np.tile(np.arange(count), len(start)), count)
    reach = np.sqrt(dot(ray, ray))
    sound = np.flatnonzero(reach > MIN_VECTOR_LENGTH)
    for name in world.obstacles:
        left = sound[~hidden[sound]]
        positions, directions = (split_columns(each, np.float32) for each in (origin[left], ray[left] / reach[left, None]))
        hits = world.obstacles[name].cast_feelers(positions, directions, reach[left].astype(np.float32), world.options.threads)
        hidden[left] = hits.hit
    share: Floats = hidden.reshape(-1, count).sum(axis=1) / count
    return share
