"""Which way faces point, of many footings in one pass: as `surface.MeshGround.sides`."""

from __future__ import annotations

from antdsl.numerics.kernel_cache import njit


@njit(cache=True, nogil=True, error_model="numpy")
def faced(mesh, face, first, side, found):  # type: ignore[no-untyped-def]
    """Write the side (int8) of each face, of those of its mesh (int32[n] both), which begin at `first` int64; 0 for nowhere."""
    for n in range(found.size):
        found[n] = 0
        if mesh[n] >= 0 and face[n] >= 0:
            found[n] = side[first[mesh[n]] + face[n]]
