"""Numbers along the curve of G. Morton as a loop: the same as `sorting.interleaved`."""

import numpy as np

from antdsl.machine_code.kernels import I64, U64, Array1, Array2, independent, inlined, kernel


@inlined
def _spread(bits):  # type: ignore[no-untyped-def]
    bits = (bits | (bits << np.uint64(32))) & np.uint64(0x1F00000000FFFF)
    bits = (bits | (bits << np.uint64(16))) & np.uint64(0x1F0000FF0000FF)
    bits = (bits | (bits << np.uint64(8))) & np.uint64(0x100F00F00F00F00F)
    bits = (bits | (bits << np.uint64(4))) & np.uint64(0x10C30C30C30C30C3)
    return (bits | (bits << np.uint64(2))) & np.uint64(0x1249249249249249)


@kernel
def interleaved(cells: Array2[U64], code: Array1[U64], begin: I64, end: I64) -> None:
    """The number `code` [n] of each of the cells [n,3] from `begin` to before `end`."""
    for n in independent(begin, end):
        x, y, z = _spread(cells[n, 0]), _spread(cells[n, 1]), _spread(cells[n, 2])
        code[n] = x | (y << np.uint64(1)) | (z << np.uint64(2))
