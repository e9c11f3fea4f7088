"""Feet in the frames of a cache: `feet.SPECIES.FIELD`, one row an agent of the species, by id.

`P` float32[n, L, 3], scene units: where each foot stands or swings, in the order of the body's legs; `down` uint8[n, L]: which
stand; `phase` float32[n]: of the gait; `rise` float32[n] (scene units) and `tilt` float32[n, 4] (x y z w): how much higher than
it rests and turned from `orient` the trunk is."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.leg_ik import PlacedFeet
from antdsl.numerics import parallel
from antdsl.outputs.cache import frame_loops
from antdsl.runtime.world import World

Arrays = Mapping[str, NDArray[Any]]


def placed_feet(world: World, species: str, scale: float) -> dict[str, NDArray[Any]]:
    """The arrays of a species whose feet are worked out; none for others. `scale`: scene units in a millimetre."""
    feet = world.feet.get(species)
    if feet is None:
        return {}
    n, legs = len(feet), feet.legs
    place, down = np.empty((n, legs, 3), np.float32), np.empty((n, legs), np.uint8)
    rise, tilt = np.empty(n, np.float32), np.empty((n, 4), np.float32)
    of = parallel.plain(feet.shown.swapaxes(1, 2), feet.swing.T, feet.rise, feet.slope)  # leg by leg, as they mostly lie
    work = partial(frame_loops.feet, *of, scale, place.reshape(n, 3 * legs), down, rise, tilt)
    parallel.in_parts(work, n, world.options.threads)
    values: dict[str, NDArray[Any]] = {"P": place, "down": down, "phase": feet.phase.copy(), "rise": rise, "tilt": tilt}
    return {f"feet.{species}.{name}": array for name, array in values.items()}


def feet_of(species: str, arrays: Arrays, count: int, legs: int) -> PlacedFeet | None:
    """The feet of a species in a frame with `count` agents of it that have so many legs; None where the frame does not say."""
    shapes = {"P": (count, legs, 3), "down": (count, legs), "phase": (count,), "rise": (count,), "tilt": (count, 4)}
    found = {name: arrays.get(f"feet.{species}.{name}") for name in shapes}
    if not legs or any(array is None or array.shape != shapes[name] for name, array in found.items()):
        return None
    place, phase, rise, tilt = (np.asarray(found[name], np.float32) for name in ("P", "phase", "rise", "tilt"))
    return PlacedFeet(place, np.asarray(found["down"], np.uint8), phase, rise, tilt)
