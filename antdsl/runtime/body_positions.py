"""Positions at which bodies are drawn."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from antdsl.runtime.feet.wearers import BodyWearers

LIFT_REGISTERS = ("~lift.x", "~lift.y", "~lift.z")  # mm; for species with bodies that stay outside their ground


def compute_body_positions(population: BodyWearers) -> NDArray[np.float64]:
    """Return the positions (n, 3; mm) at which bodies are drawn. Each component is contiguous. These are the agents' positions
    on the ground. In species with `LIFT_REGISTERS`, they are shifted so that bodies stay outside the ground."""
    if LIFT_REGISTERS[0] not in population.now:
        return population.position
    shifted = np.empty((3, len(population)))
    for component, feet, name in zip(shifted, population.position.T, LIFT_REGISTERS, strict=True):
        np.add(feet, population.now[name], out=component)
    return shifted.T
