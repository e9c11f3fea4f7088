"""The passes of `reached` as loops, with the same results. Imported only where `compiled.wanted` says so."""

import numpy as np

from antdsl.machine_code.kernels import BOOL, F32, F64, I32, I64, U8, Array1, independent, kernel, scratch

_PART = 512  # cells that are compared before those that differ are written down


@kernel
def differing(held: Array1[F64], least: F32, holds: Array1[BOOL], changed: Array1[I64], begin: I64, end: I64) -> tuple[int, int]:
    """Write down the cells from `begin` to before `end` of which `holds` does not say whether what they hold, in float32, is as
    much as `least`, in `changed` from `begin` on; gives `begin`, and how many there are."""
    other, count = scratch(_PART, I32), 0
    for low in range(begin, end, 512):
        high = min(low + _PART, end)
        for n in independent(low, high):
            other[n - low] = 1 if (np.float32(held[n]) >= least) != holds[n] else 0
        for n in range(low, high):
            if other[n - low] != 0:
                changed[begin + count] = n
                count += 1
    return begin, count


@kernel
def renew(changed: Array1[I64], start: Array1[I64], cell: Array1[I32], holds: Array1[BOOL], count: Array1[U8]) -> None:
    """Turn round what `holds` says of the cells `changed`, and count each of them one more or less for those around which it is:
    from its `start` on in `cell`."""
    for n in range(changed.size):
        a = changed[n]
        more = -1 if holds[a] else 1
        holds[a] = not holds[a]
        for k in range(start[a], start[a + 1]):
            count[cell[k]] += more
