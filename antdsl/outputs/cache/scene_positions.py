"""Positions in a cache. They are relative to the origin of the world, which the manifest has in double precision.

Without the origin, positions far from the zero point would lose precision as float32. A world near the zero point has the
origin 0."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.runtime.world import World


def find_scene_origin(world: World) -> tuple[float, float, float]:
    """Return the origin of a world in scene units."""
    x, y, z = (world.origin / world.setting.unit_mm).tolist()
    return x, y, z


def to_scene_positions(positions: NDArray[np.floating], scale: float) -> NDArray[np.float32]:
    """Convert positions in mm, relative to the world's origin, to scene units as float32. `scale`: scene units per millimetre."""
    unsigned = positions + 0.0  # a negative zero would change the bytes of a file
    scene_positions: NDArray[np.float32] = (unsigned * scale).astype(np.float32)
    return scene_positions
