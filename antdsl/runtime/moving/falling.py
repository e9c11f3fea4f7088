"""Limits the speed of falls: no agent moves farther in a step than `max_speed` allows.

An agent that loses its ground because of digging is in the air while it falls."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.protocol import Floats, Footing, GroundMove
from antdsl.numerics.vector_rows import length
from antdsl.runtime.world import Population, World

Rows = NDArray[np.intp]

_DISTANCE_SLACK_FACTOR = 1.005  # factor of the allowed distance; smaller excesses are rounding at seams
_SOLID_CONTACT_BODY_LENGTHS = 0.02  # body lengths; the largest distance of an agent from the solid that it stands on
_FALL_BODY_LENGTHS_PER_SECOND = 7.5  # falling speed of agents with a max_speed of 0


def limit_fall_speed(world: World, population: Population, move: GroundMove, dt: np.float32) -> GroundMove:
    """Return the result of a walk, limited to `max_speed`. An agent that would move faster moves only as far as allowed, on
    the straight line to its target. It is then in the air of the solid that it falls from or falls to. Its next step continues
    from this position."""
    now, first = population.now, len(world.ground.names) - len(world.solids)
    speed = np.where(now["max_speed"] > 0, now["max_speed"], now["size"] * np.float32(_FALL_BODY_LENGTHS_PER_SECOND)).astype(
        np.float64
    )
    displacement = move.position - population.position
    far, most = length(displacement), speed * float(dt)
    from_solid, to_solid = population.footing.mesh >= first, move.footing.mesh >= first
    rows = np.flatnonzero((from_solid | to_solid) & (far > most * _DISTANCE_SLACK_FACTOR))
    if not len(rows):
        return move
    place = population.position[rows] + displacement[rows] * (most[rows] / far[rows])[:, None]
    solid = np.where(from_solid[rows], population.footing.mesh[rows], move.footing.mesh[rows])
    footing, position = move.footing.copy(), move.position.copy()
    footing.write_rows(rows, Footing.from_solids(solid, place))
    position[rows] = place
    return dataclasses.replace(move, footing=footing, position=position)


def find_airborne(world: World, population: Population, rows: Rows) -> Rows:
    """Return which of the agents at `rows` are falling through the air of a solid, as ascending indices into `rows`."""
    first = len(world.ground.names) - len(world.solids)
    mesh = population.footing.mesh[rows]
    is_airborne = np.zeros(len(rows), np.bool_)
    for number, volume in enumerate(world.solids.values(), first):
        subset = np.flatnonzero(mesh == number)
        is_airborne[subset] = (
            volume.sample_distances(population.position[rows[subset]])
            > population.now["size"][rows[subset]] * _SOLID_CONTACT_BODY_LENGTHS
        )
    return np.flatnonzero(is_airborne)


def move_airborne(world: World, population: Population, rows: Rows, displacement: Floats) -> GroundMove:
    """Move agents in the air of a solid by `displacement` (k, 3) mm, and return the result. An agent that would enter a solid
    stays where it is."""
    place = population.position[rows] + displacement
    for volume in world.solids.values():
        inside = volume.sample_distances(place) < 0
        place[inside] = population.position[rows[inside]]
    mesh, up, heading = (
        population.footing.mesh[rows],
        population.normal[rows].astype(np.float64),
        population.read_vector("heading")[rows],
    )
    no = np.zeros(len(rows), np.bool_)
    return GroundMove(Footing.from_solids(mesh, place), place, up, heading, heading, length(displacement), no, no)
