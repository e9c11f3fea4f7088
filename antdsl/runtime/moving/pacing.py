"""Agents that move at a share of their own speed, as if their time passed more slowly.

Between steps, velocities are those of the motion in the scene. While agents decide and while their push acts, velocities are
divided by the share. So a program sees the speed that its agents would have, and they reach it again afterwards."""

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
class Paces:
    """The agents of a species that move at a share of their speed in this step.

    `rows`: their rows. `shares` float32: from 0, standing still, to 1. `previous_shares`: those of the step before."""

    rows: NDArray[np.intp]
    shares: NDArray[np.float32]
    previous_shares: NDArray[np.float32]
    _velocities: VectorArrays | None = None  # in the scene, at the start of the step
    _limits: dict[str, NDArray[np.float32]] = field(default_factory=dict)

    def restore_velocities(self, population: Population) -> None:
        """Give agents the velocities that they would have at their full speed."""
        self._velocities = vec.take_rows(vec.get_vector_registers(population.start, "velocity"), self.rows)
        for registers in (population.start, population.now):
            _divide_velocities(vec.get_vector_registers(registers, "velocity"), self.rows, self.previous_shares)

    def begin_move(self, population: Population) -> None:
        """Set velocities at the start of the step to those of the visible motion, and record the limits of speed and turn."""
        assert self._velocities is not None
        for register, values in zip(vec.get_vector_registers(population.start, "velocity"), self._velocities, strict=True):
            register[self.rows] = values
        self._limits = {name: population.now[name][self.rows] for name in _LIMIT_NAMES if name in population.now}

    def prepare_substep(self, population: Population, substep: int, dt: np.float32) -> None:
        """Set velocities and limits for the push of a substep of `dt` s: turns are slower, speeds are not."""
        now = population.now
        if substep:
            _divide_velocities(vec.get_vector_registers(now, "velocity"), self.rows, self.shares)
        for name, values in self._limits.items():
            now[name][self.rows] = values
        turn = self._limits["max_turn"]
        fastest = np.where(np.isfinite(turn), turn, np.where(self.shares < 1, np.float32(np.pi) / dt, np.float32(np.inf)))
        now["max_turn"][self.rows] = np.where(self.shares > 0, fastest * self.shares, 0)

    def slow_steps(self, population: Population, *motions: VectorArrays | NDArray[np.float32]) -> None:
        """Scale velocities, steps and step lengths, and the limits of speed for contacts."""
        for motion in motions:
            for component in motion if isinstance(motion, tuple) else (motion,):
                component[self.rows] *= self.shares
        for name in self._limits.keys() - {"max_turn"}:
            population.now[name][self.rows] = self._limits[name] * self.shares

    def end_move(self, population: Population) -> None:
        """Restore the limits of speed and turn."""
        for name, values in self._limits.items():
            population.now[name][self.rows] = values


def find_paces(world: World, population: Population) -> Paces | None:
    """Return the agents of a species that move at a share of their speed in this step; None without any."""
    return None if world.notes is None else world.notes.paces.get(population.name)


def _divide_velocities(velocity: VectorArrays, rows: NDArray[np.intp], shares: NDArray[np.float32]) -> None:
    divisor = np.where(shares >= _MIN_RESTORED_SHARE, shares, np.float32(1))
    for component in velocity:
        component[rows] /= divisor
