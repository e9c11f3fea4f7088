"""The origin of a world: what agents count their positions from, so that float32 is fine enough far from the zero point."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.scene.setting import Setting

_NEAR = 1e5  # mm: a world whose middle is no farther out keeps the zero point


def world_origin(setting: Setting) -> NDArray[np.float64]:
    """The point (3), in mm, that positions are relative to: the middle of the world in whole metres, or 0 near the zero point."""
    meshes = setting.surfaces or {name: solid.mesh for name, solid in setting.solids.items()}
    meshes = meshes or setting.obstacles  # one more stone moves nothing
    places = [m.vertices for m in meshes.values() if len(m.vertices)]
    places = places or [np.array([i.position for items in setting.items.values() for i in items], np.float64).reshape(-1, 3)]
    if not len(places[0]):
        return np.zeros(3)
    low, high = (np.min([p.min(axis=0) for p in places], axis=0), np.max([p.max(axis=0) for p in places], axis=0))
    middle = (low + high) / 2
    return np.round(middle / 1000.0) * 1000.0 if np.abs(middle).max() > _NEAR else np.zeros(3)
