"""Wishes of notes: velocities that replace what the states of agents steer, or the result of all layers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import vectors as vec
from antdsl.numerics.vector_rows import dot, length
from antdsl.runtime.notes.active_notes import Rows
from antdsl.runtime.world import AXES, Population, World

STATE_WISH_REGISTER, FINAL_WISH_REGISTER = (
    "~steer",
    "push",
)  # registers: the sum of what states steer, and the result of the layers
_STATE_LAYER_NAME = "state"  # the line of `layers` that stands for what states steer
Floats = NDArray[np.float64]


def has_state_wish(population: Population) -> bool:
    """Return whether the steering of states affects the push of a species. If so, a wish mixed into it does not change other
    layers."""
    layers = population.plan.layers
    return f"{STATE_WISH_REGISTER}.x" in population.now and (
        not layers or any(layer.text.split("(")[0].split()[:1] == [_STATE_LAYER_NAME] for layer in layers)
    )


def add_velocity_wishes(
    world: World, population: Population, rows: Rows, velocity: Floats, share: NDArray[np.floating] | float, register: str
) -> None:
    """Mix a push into the wishes of agents that would give them `velocity` (k, 3) mm/s within this step. `share`: the weight of
    the push for each agent, 0 to 1. `register`: the register of the wishes."""
    now, f = population.now, np.float32
    own = vec.take_rows(vec.get_vector_registers(now, "velocity"), rows)
    gain = now["mass"][rows] / (now["max_force"][rows] * f(world.dt))
    up = vec.split_columns(population.normal[rows], f)
    change = vec.subtract(vec.project_to_plane(vec.split_columns(velocity, f), up), vec.project_to_plane(own, up))
    push = vec.scale(change, np.where(np.isfinite(gain), gain, f(0)))
    size = vec.length(push)
    push = vec.scale(push, f(1) / np.maximum(size, f(1)))
    part = np.asarray(share, f)
    for axis, component in zip(AXES, push, strict=True):
        wish = now[f"{register}.{axis}"]
        wish[rows] += (component - wish[rows]) * part


def project_directions_to_ground(population: Population, rows: Rows, direction: Floats) -> Floats:
    """Return unit vectors along the ground below agents, for directions (k, 3). 0 where a direction has no component along it."""
    normal = population.normal[rows].astype(np.float64)
    flat = direction - dot(direction, normal)[:, None] * normal
    size = length(flat)
    unit: Floats = flat / np.where(size > 1e-9, size, np.inf)[:, None]
    return unit


def read_max_speeds(population: Population, rows: Rows) -> Floats:
    """Return the top speeds (mm/s) of agents, at least 0."""
    return np.maximum(population.now["max_speed"][rows].astype(np.float64), 0.0)
