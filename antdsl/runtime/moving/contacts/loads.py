"""Extends the capsules of bodies that carry a load."""

from __future__ import annotations

import numpy as np

from antdsl.machine_code.kernels import kernel, simd_range
from antdsl.machine_code.kernels.types import BOOL, F32, F64, I64, Array1
from antdsl.numerics.kernel_vectors import VectorColumns
from antdsl.runtime.moving.contacts.capsule_distances import TrunkCapsules

LOAD_REGISTER = "wear#load"  # whether the body of an agent shows its load


@kernel
def extend_trunks_over_loads(
    is_carrying: Array1[BOOL], heading: VectorColumns, size: Array1[F32], load_front: F64, first_index: I64, trunks: TrunkCapsules
) -> BOOL:
    """Extend the capsules of agents that carry a load to `load_front` body lengths ahead of the feet. Return whether any agent
    carries a load. `first_index`: the first capsule of the species in `trunks`, as `place_trunks` stored it."""
    half, radius, shift, reach, middle = trunks
    has_loads = False
    for i in simd_range(0, size.size):
        row = first_index + i
        wide = np.float64(np.float32(0) if size[i] <= np.float32(0) else size[i])
        longer = max(wide * load_front - (shift[row] + half[row] + radius[row]), 0.0) * (0.5 if is_carrying[i] else 0.0)
        half[row] += longer
        shift[row] += longer
        reach[row] += longer
        for axis in range(3):
            middle[axis, row] += np.float64(heading[axis][i]) * longer
    for i in range(size.size):
        has_loads |= is_carrying[i]
    return has_loads
