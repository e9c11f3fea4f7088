"""Flows as arrows on the ground, stored in a cache for pictures. The number of arrows is limited so that single arrows stay
visible.

static.npz  flow.NAME.P f4 (n, 3): start points of the arrows
            flow.NAME.V f4 (n, 3): vectors of the arrows, as at the first frame"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.outputs.cache.scene_positions import to_scene_positions
from antdsl.runtime.world import World

_ARROWS_PER_EXTENT = 44  # number of arrows along the longest side of the ground
_ARROW_LENGTH_SHARE = 0.85  # length of an arrow of strength 1, as a share of the arrows' distance
_MIN_ARROW_STRENGTH = 0.02  # weaker flows are not drawn
_ARROW_LIFT = 0.06


def make_flow_arrows(world: World, scale: float) -> dict[str, NDArray[Any]]:
    """Return arrows for all flows on meshes, in scene units relative to the world's origin. `scale`: scene units per mm."""
    meshes = world.ground.meshes
    if meshes is None:
        return {}
    table = meshes.triangles[3]
    step = max(float(meshes.extent) / _ARROWS_PER_EXTENT, 1e-9)
    output: dict[str, NDArray[Any]] = {}
    for name, flow in world.flows.items():
        face, (b1, b2) = flow.lattice.get_face_by_slot(), flow.lattice.compute_slot_weights()
        strong = np.flatnonzero(
            flow.axis1_components * flow.axis1_components + flow.axis2_components * flow.axis2_components
            > _MIN_ARROW_STRENGTH * _MIN_ARROW_STRENGTH
        )
        face, b1, b2 = face[strong], b1[strong], b2[strong]
        place = table.corner.take(face, axis=1) + b1 * table.edge1.take(face, axis=1) + b2 * table.edge2.take(face, axis=1)
        direction = meshes.to_world_vectors(face, flow.axis1_components[strong], flow.axis2_components[strong])
        cells = np.floor((place.T - meshes.low) / step).astype(np.int64)
        middle = (np.abs(place.T - meshes.low - (cells + 0.5) * step)).sum(axis=1)
        order = np.lexsort((middle, *cells.T))
        first = np.ones(len(order), bool)
        first[1:] = (cells[order][1:] != cells[order][:-1]).any(axis=1)
        chosen = order[first]
        lifted = place[:, chosen] + _ARROW_LIFT * step * table.normal.take(face[chosen], axis=1)
        output[f"flow.{name}.P"] = to_scene_positions(lifted.T, scale)
        output[f"flow.{name}.V"] = (direction[:, chosen].T * (_ARROW_LENGTH_SHARE * step * scale)).astype(np.float32)
    return output


def read_flow_arrows(static: Mapping[str, NDArray[Any]]) -> dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Return the start points (n, 3) and the vectors (n, 3) of the arrows, by flow name."""
    names = [key.removeprefix("flow.").removesuffix(".P") for key in static if key.startswith("flow.") and key.endswith(".P")]
    return {n: (np.asarray(static[f"flow.{n}.P"], np.float64), np.asarray(static[f"flow.{n}.V"], np.float64)) for n in names}
