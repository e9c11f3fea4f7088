"""An agent definition: all that agents of one kind share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.clip import Clip
from antdsl.bodies.agents.layer import Layer, TransformGroup
from antdsl.bodies.agents.legs import Gait, Leg
from antdsl.bodies.agents.rig import Rig
from antdsl.bodies.agents.shape import Shape
from antdsl.bodies.agents.variation import NONE, Variation

FRONT = (1.0, 0.0, 0.0)
UP = (0.0, 1.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Definition:
    """`front` and `up`: the axes of its space that it looks along and stands along; `length`: how long it is along `front` in
    its own units, which is what an agent's `size` scales it to; `unit`: millimetres in one of its units. `materials`: base
    colours (linear, 0 to 1) by name. `gaits` go from slow to fast. `idle`: the clip of agents that play none ("": rest).
    `variation`: by what bodies differ."""

    name: str
    rig: Rig
    shapes: Mapping[str, Shape] = field(default_factory=dict)
    layers: Mapping[str, Layer] = field(default_factory=dict)
    clips: Mapping[str, Clip] = field(default_factory=dict)
    groups: Mapping[str, TransformGroup] = field(default_factory=dict)
    metadata: Mapping[str, Any] = field(default_factory=dict)
    materials: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    front: tuple[float, float, float] = FRONT
    up: tuple[float, float, float] = UP
    length: float = 1.0
    unit: float = 1.0
    legs: tuple[Leg, ...] = ()
    gaits: tuple[Gait, ...] = ()
    idle: str = ""
    variation: Variation = NONE

    def base(self) -> NDArray[np.float64]:
        """The matrix float64[4, 4] from its own space to that of agents: length 1, front +x, up +y."""
        ahead, up = np.array(self.front, np.float64), np.array(self.up, np.float64)
        found = np.eye(4)
        found[0, :3], found[1, :3], found[2, :3] = ahead, up, np.cross(ahead, up)
        found[:3] /= self.length
        return found
