"""The Python interface: open a scene, step it, read and set its agents, and run sweeps.

The package `antdsl` exports the names in `__all__`. Arrays are copies, sorted by id, in base units: mm, s, mm/s, radians,
grams."""

from antdsl.api.errors import AntdslError
from antdsl.api.simulation import Simulation, open_scene
from antdsl.api.sweeps import SweepResult, sweep

__all__ = ["AntdslError", "Simulation", "SweepResult", "open_scene", "sweep"]
