"""Undoes steps after which bodies still overlap: agents of such a pair return to their stances at the start of the substep.
Contacts separate most bodies. Some cannot move far enough, for example in corners, on ground that was dug, or when clearance
shifts their bodies after contacts. If both agents of a pair overlapped no other at the start of the substep, one of them returns
to its stance at that time. If they still overlap, the other one returns too. Agents that return stand still for one substep, so
they neither jump nor turn. Other agents that have moved to where a returning agent must stand return too. The two agents of a
pair take turns from frame to frame, so that neither waits forever."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.kernels import F64, I64, Array1, kernel, simd_range
from antdsl.numerics import vectors as vec
from antdsl.numerics.kernel_vectors import dot, get_column, minus
from antdsl.runtime.body_positions import LIFT_REGISTERS
from antdsl.runtime.moving.contacts.capsule_distances import CapsuleArrays, find_separation_axis, gather_capsules, wrap_offset
from antdsl.runtime.moving.contacts.capsules import CapsuleCrowd, NearbyCapsulePairs, find_near_pairs
from antdsl.runtime.world import AXES, Population, World

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]
Flags = NDArray[np.bool_]

_MAX_DEPTH = 0.046  # widths of the narrower body; a deeper overlap would be visible
_LISTED_RADII = 0.6  # radii; bodies that moved less can only touch others in pairs with them
_MAX_ROUNDS = 32  # rounds in which agents return, because others have moved into their places
_POSE_REGISTERS = (*(f"{name}.{axis}" for name in ("heading", "up") for axis in AXES), *LIFT_REGISTERS, "~depth")


class Stances:
    """Copies of the stances of agents of one species: footings, positions, normals and poses."""

    def __init__(self, population: Population, rows: Rows | None = None) -> None:
        """Copy the stances of the given rows, or of all agents. For all agents, the arrays of footings, positions and normals
        are not copied, because walks replace them."""
        now = population.now
        names = [name for name in _POSE_REGISTERS if name in now]
        self.footing = population.footing if rows is None else population.footing.select_rows(rows)
        self.position = population.position if rows is None else population.position[rows]
        self.normal = population.normal if rows is None else population.normal[rows]
        self.poses = {name: now[name].copy() if rows is None else now[name].take(rows) for name in names}

    def restore(self, population: Population, rows: Rows, own: Rows) -> None:
        """Set the agents at `rows` of the species back to their copied stances. `own`: the indices of these stances among the
        copies."""
        position = self.position[own]
        for k, axis in enumerate(AXES):
            population.now[f"position.{axis}"][rows] = position[:, k]
        population.position[rows], population.normal[rows] = position, self.normal[own]
        for name, values in self.poses.items():
            population.now[name][rows] = values[own]
        # Last, because on a plane footings are the positions themselves.
        population.footing.write_rows(rows, self.footing.select_rows(own))


def take_back_overlapping_steps(world: World, start: Mapping[str, Stances], near: NearbyCapsulePairs) -> None:
    """Move pairs of agents that still overlap back to their stances at the start of a substep.

    Agents that overlapped others at the start do not return, because dense clusters must be able to separate. `near`: the pairs
    that were near enough to touch before contacts moved agents."""
    crowd = CapsuleCrowd(world)
    if not _has_moved_far(near.crowd, crowd) and not (_measure_depths(crowd, near) > _MAX_DEPTH).any():
        return
    can_return: Flags | None = None
    for _ in range(_MAX_ROUNDS):
        i, j = _find_deep_pairs(crowd)
        if can_return is None:
            can_return = _find_clear_agents(world, start) if len(i) else np.zeros(len(crowd), np.bool_)
            has_returned = np.zeros(len(crowd), np.bool_)
        is_selected = can_return[i] & can_return[j]
        is_new = np.zeros(len(crowd), np.bool_)
        first, second = i[is_selected], j[is_selected]
        # One of the two may go on if that is enough. They take turns, so neither waits for ever. `first` comes first by id.
        is_first_next = (crowd.agent_keys.take(first) + world.frame) % 2 == 0
        is_first_next = np.where(has_returned[first] | has_returned[second], has_returned[second], is_first_next)
        is_new[np.where(is_first_next, first, second)] = True
        is_new &= ~has_returned
        if not is_new.any():
            return
        has_returned |= is_new
        for population, own in crowd.split_rows(np.flatnonzero(is_new)):
            start[population.name].restore(population, own, own)
            for values in vec.get_vector_registers(population.now, "velocity"):
                values[own] = 0
        crowd = CapsuleCrowd(world)


def _has_moved_far(previous_crowd: CapsuleCrowd, crowd: CapsuleCrowd) -> bool:
    """Return whether any body has moved so far that it may touch a body with which it is not listed as a pair."""
    displacement = crowd.middle - previous_crowd.middle
    return bool((vec.dot(displacement, displacement) > (_LISTED_RADII * crowd.radius) ** 2).any())


def _find_clear_agents(world: World, start: Mapping[str, Stances]) -> Flags:
    """Return a mask (n) of agents that overlapped no other agent at the start of the substep."""
    rows = {name: np.arange(len(population)) for name, population in world.populations.items()}
    ends = {name: Stances(population, rows[name]) for name, population in world.populations.items()}
    for name, population in world.populations.items():
        start[name].restore(population, rows[name], rows[name])
    crowd = CapsuleCrowd(world)
    is_clear = np.ones(len(crowd), np.bool_)
    for own in _find_deep_pairs(crowd):
        is_clear[own] = False
    for name, population in world.populations.items():
        ends[name].restore(population, rows[name], rows[name])
    return is_clear


def _find_deep_pairs(crowd: CapsuleCrowd) -> tuple[Rows, Rows]:
    """Return the first and the second agent of each pair of bodies with a visible overlap, that is, one above `_MAX_DEPTH`."""
    near = find_near_pairs(crowd)
    overlapping_pairs = np.flatnonzero(_measure_depths(crowd, near) > _MAX_DEPTH)
    return near.rows.take(near.first_indices.take(overlapping_pairs)), near.rows.take(near.second_indices.take(overlapping_pairs))


def _measure_depths(crowd: CapsuleCrowd, near: NearbyCapsulePairs) -> Floats:
    """Return the overlap of each pair of bodies in space (m), in widths of the narrower body; negative without overlap."""
    rows, depth = near.rows, np.empty(len(near.first_indices))
    (middle, ahead, up), (half, radius) = np.empty((3, 3, len(rows))), np.empty((2, len(rows)))
    bodies = CapsuleArrays(middle, ahead, up, half, radius, crowd.period, crowd.tilted_cosine)
    gather_capsules(rows, crowd.capsules, bodies)
    _write_depths(bodies, near.first_indices, near.second_indices, depth)
    return depth


@kernel
def _write_depths(bodies: CapsuleArrays, i: Array1[I64], j: Array1[I64], depth: Array1[F64]) -> None:
    """Write the overlap of each pair (`i`, `j`) to `depth`, in the units of `_measure_depths`."""
    middle, ahead, _, half, radius, period, _ = bodies
    for pair in simd_range(0, i.size):
        p, q = i[pair], j[pair]
        away = wrap_offset(minus(get_column(middle, p), get_column(middle, q)), period)
        separation, _, _ = find_separation_axis(
            away, get_column(ahead, p), get_column(ahead, q), (0.0, 0.0, 0.0), half[p], half[q]
        )
        narrow = 2 * min(radius[p], radius[q])
        depth[pair] = (radius[p] + radius[q] - np.sqrt(dot(separation, separation))) / max(narrow, 1e-300)
