"""Slows agents down to a fraction of their speed, as if their time passed more slowly. Between steps, velocities are those of the
slowed motion, as seen in the scene. While agents decide and while their push acts, velocities are divided by the fraction. So a
program sees its agents at full speed. Agents regain this speed when they are no longer slowed."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import vectors as vec
from antdsl.numerics.vectors import VectorArrays

if TYPE_CHECKING:
    from antdsl.runtime.world import Population, World

_MIN_RESTORED_SHARE = np.float32(0.02)  # agents that were slower start from their real velocity
_LIMIT_NAMES = ("max_speed", "max_turn", "min_speed")


@dataclass(slots=True, eq=False)
class SpeedShares:
    """The agents of a species that move at a fraction of their speed in this step.

    `slowed_rows`: their rows. `speed_shares` float32: the fractions, from 0 (standing still) to 1. `previous_speed_shares`:
    the fractions in the step before."""

    slowed_rows: NDArray[np.intp]
    speed_shares: NDArray[np.float32]
    previous_speed_shares: NDArray[np.float32]
    _full_velocities: VectorArrays | None = None  # in the scene, at the start of the step
    _full_limits: dict[str, NDArray[np.float32]] = field(default_factory=dict)

    def restore_full_velocities(self, population: Population) -> None:
        """Set the velocities of slowed agents to those that they would have at full speed."""
        self._full_velocities = vec.take_rows(vec.get_vector_registers(population.start, "velocity"), self.slowed_rows)
        for registers in (population.start, population.now):
            _undo_speed_shares(vec.get_vector_registers(registers, "velocity"), self.slowed_rows, self.previous_speed_shares)

    def scale_limits(self, population: Population) -> None:
        """Replace the velocities at the step's start by those of the slowed motion. Store the limits of speed and turn as they
        are before they are scaled."""
        assert self._full_velocities is not None
        for register, values in zip(vec.get_vector_registers(population.start, "velocity"), self._full_velocities, strict=True):
            register[self.slowed_rows] = values
        self._full_limits = {name: population.now[name][self.slowed_rows] for name in _LIMIT_NAMES if name in population.now}

    def prepare_substep(self, population: Population, substep: int, dt: np.float32) -> None:
        """Set velocities and limits for the push in a substep of `dt` s. Limits of turns are scaled; limits of speed are not."""
        now = population.now
        if substep:
            _undo_speed_shares(vec.get_vector_registers(now, "velocity"), self.slowed_rows, self.speed_shares)
        for name, values in self._full_limits.items():
            now[name][self.slowed_rows] = values
        turn = self._full_limits["max_turn"]
        fastest = np.where(np.isfinite(turn), turn, np.where(self.speed_shares < 1, np.float32(np.pi) / dt, np.float32(np.inf)))
        now["max_turn"][self.slowed_rows] = np.where(self.speed_shares > 0, fastest * self.speed_shares, 0)

    def scale_motions(self, population: Population, *motions: VectorArrays | NDArray[np.float32]) -> None:
        """Multiply the given velocities, steps or step lengths by the fractions. Also scale the speed limits, because contacts
        read them."""
        for motion in motions:
            for component in motion if isinstance(motion, tuple) else (motion,):
                component[self.slowed_rows] *= self.speed_shares
        for name in self._full_limits.keys() - {"max_turn"}:
            population.now[name][self.slowed_rows] = self._full_limits[name] * self.speed_shares

    def restore_limits(self, population: Population) -> None:
        """Restore the limits of speed and turn."""
        for name, values in self._full_limits.items():
            population.now[name][self.slowed_rows] = values


def find_speed_shares(world: World, population: Population) -> SpeedShares | None:
    """Return the agents of a species that move at a fraction of their speed in this step; None if there are none."""
    return None if world.notes is None else world.notes.speed_shares.get(population.name)


def _undo_speed_shares(velocity: VectorArrays, rows: NDArray[np.intp], shares: NDArray[np.float32]) -> None:
    divisor = np.where(shares >= _MIN_RESTORED_SHARE, shares, np.float32(1))
    for component in velocity:
        component[rows] /= divisor
