"""`creases.RiseMap.rising` as loops: who stands on a face near a rise, and of these who is near one there."""

from __future__ import annotations

import numpy as np

from antdsl.machine_code.kernels import BOOL, F64, I32, I64, Array1, Array3, Strided2, as_bits, inlined, kernel

_EXPONENT = 1022  # more than the power of two below which a number of these bits is


@inlined
def _rung(reach, width, whole):  # type: ignore[no-untyped-def]
    """As the exponent of np.frexp."""
    return ((as_bits(min(max(reach, width), whole)) >> 52) & 0x7FF) - _EXPONENT


@kernel
def candidates(
    mesh: Array1[I32],
    face: Array1[I32],
    first: Array1[I64],
    clear: Array1[F64],
    wide: Array1[F64],
    reach: Array1[F64],
    width: F64,
    whole: F64,
    rows: Array1[I64],
    rungs: Array1[I64],
    begin: I64,
    end: I64,
) -> tuple[I64, I64, I64]:
    """Gives `begin`, how many from there to before `end` stand on a face that is no further than `reach` from a rise, and which
    rungs of `Creases` are asked, by bits from that of `width` on; from `begin` on their rows, and the rung of those whose face is
    larger than their reach (-1 for others)."""
    count, asked = begin, 0
    lowest = _rung(width, width, whole)
    for i in range(begin, end):
        if mesh[i] < 0 or mesh[i] >= first.size - 1 or face[i] < 0 or not reach[i] > 0:
            continue
        f = first[mesh[i]] + face[i]
        if not clear[f] <= reach[i]:
            continue
        rung = -1
        if wide[f] > reach[i]:
            rung = _rung(reach[i], width, whole) - lowest
            asked = asked | (1 << rung)
        rows[count], rungs[count] = i, rung
        count += 1
    return begin, count - begin, asked


@kernel
def close(
    rows: Array1[I64],
    rungs: Array1[I64],
    rung: I64,
    place: Strided2[F64],
    low: Array1[F64],
    width: F64,
    near: Array3[BOOL],
    begin: I64,
    end: I64,
) -> None:
    """Those of a rung, from `begin` to before `end`, who are in a cell that is `near` something become of rung -1, others of
    -2."""
    for k in range(begin, end):
        if rungs[k] != rung:
            continue
        i = rows[k]
        x = int(min(max(np.floor((place[i, 0] - low[0]) / width), 0.0), float(near.shape[0] - 1)))
        y = int(min(max(np.floor((place[i, 1] - low[1]) / width), 0.0), float(near.shape[1] - 1)))
        z = int(min(max(np.floor((place[i, 2] - low[2]) / width), 0.0), float(near.shape[2] - 1)))
        rungs[k] = -1 if near[x, y, z] else -2
