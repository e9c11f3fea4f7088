"""A shape of a library: geometry in its rest pose, with what deformers need of it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
STATE = "state"  # the material that has the colour of the agent's state


@dataclass(frozen=True, slots=True, eq=False)
class Capture:
    """Which joints each of P points follows: `joints` int32[P, K] count `names`, `weights` float32[P, K] add up to 1 for each;
    `inverse` float64[J, 4, 4] takes a point of the rest pose into the space of each joint as it was captured."""

    names: tuple[str, ...]
    joints: NDArray[np.int32]
    weights: Floats
    inverse: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Blend:
    """Inputs of a blend shape: names of shapes of the library and of the channels that weigh them; which attributes are blended
    and by which point attribute the points of shapes are matched."""

    shapes: tuple[str, ...]
    channels: tuple[str, ...]
    attributes: tuple[str, ...] = ("P", "N")
    point_id: str = "id"
    primitive_id: str = "id"


@dataclass(frozen=True, slots=True)
class Between:
    """Corrective shapes of a blend shape's input, each applied at a weight that is neither 0 nor 1."""

    shapes: tuple[str, ...]
    weights: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """P points and M triangles. `normals` float32[P, 3], `uvs` float32[P, 2] or None; `materials` names, `material` int32[M] the
    number of each triangle's. `attributes`: further ones of points, by name, an `id` and a blend attribute among them."""

    name: str
    points: Floats
    faces: NDArray[np.int32]
    normals: Floats | None = None
    uvs: Floats | None = None
    materials: tuple[str, ...] = ()
    material: NDArray[np.int32] | None = None
    attributes: dict[str, NDArray[np.float32] | NDArray[np.int64]] = field(default_factory=dict)
    capture: Capture | None = None
    blend: Blend | None = None
    between: Between | None = None
    dual_quaternion_blend: str = ""
