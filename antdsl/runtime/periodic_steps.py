"""Checks the length of steps in a periodic world. For a step of half a width or more, the nearest image is ambiguous."""

from __future__ import annotations

import numpy as np

from antdsl.runtime.faults import Fault, LimitStop
from antdsl.runtime.periodic_world import MARGIN_SHARE
from antdsl.runtime.world import AXES, World

_STEP_SLACK = 0.999  # the ground ends at the margin, so velocities of longer steps are a little shorter than it


def check_periodic_steps(world: World) -> None:
    """Raise LimitStop if an agent of a periodic world has moved by half a width or more in this step."""
    if world.periodic is None:
        return
    box = world.periodic.box
    for population in world.populations.values():
        for k in box.axes:
            steps = np.abs(population.now[f"velocity.{AXES[k]}"].astype(np.float64)) * float(world.dt)
            rows = np.flatnonzero(steps >= MARGIN_SHARE * box.widths[k] * _STEP_SLACK)
            if len(rows):
                row = rows[np.argmin(population.ids[rows])]
                advice = "write a wider range below `wrap`, more `fps`, or a lower `max_speed`"
                why = f"is so high that the agent crosses half of the world or more in one step: {advice}"
                values = (("step", f"{steps[row]:.4g} mm"), ("width", f"{box.widths[k]:.4g} mm"))
                raise LimitStop(Fault(world.frame, population.name, int(population.ids[row]), "velocity", None, values, why))
