"""Positions in a cache, relative to the origin of the world. The manifest contains the origin in double precision.

Without an origin, float32 positions far from the scene's zero would lose precision. A world near the scene's zero has the origin
0."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.runtime.world import World


def find_scene_origin(world: World) -> tuple[float, float, float]:
    """Return the origin of a world in scene units."""
    x, y, z = (world.origin / world.setting.unit_mm).tolist()
    return x, y, z


def to_scene_positions(positions: NDArray[np.floating], scale: float) -> NDArray[np.float32]:
    """Return positions in scene units as float32. `positions`: in mm, relative to the world's origin. `scale`: scene units per
    millimetre."""
    unsigned = positions + 0.0  # a negative zero would change the bytes of a file
    scene_positions: NDArray[np.float32] = (unsigned * scale).astype(np.float32)
    return scene_positions
