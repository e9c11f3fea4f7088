"""The compiled half of `frames`, `shown_arrays` and `surface_error`: one pass over the agents for each array, the same bits.

What takes several numbers of an agent goes by rows, as they lie in memory, and writes to the place of the agent's rank by id: one
such write costs less than several reads here and there.

Imported only where `compiled.wanted` says so."""

from __future__ import annotations

import numpy as np

from antdsl.machine_code.kernels import BOOL, F32, F64, I32, I64, Array1, Array2, Strided2, as_bits, independent, inlined, kernel

Three = tuple[Array1[F32], Array1[F32], Array1[F32]]


@kernel
def places(position: Strided2[F64], ranks: Array1[I32], x: F64, y: F64, z: F64, scale: F64, out: Array2[F32]) -> None:
    """Positions of agents in scene units, each to the place of its rank."""
    for i in range(ranks.size):
        k = ranks[i]
        out[k, 0] = np.float32((position[i, 0] + x) * scale)
        out[k, 1] = np.float32((position[i, 1] + y) * scale)
        out[k, 2] = np.float32((position[i, 2] + z) * scale)


@kernel
def vectors(of: Three, ranks: Array1[I32], scale: F32, out: Array2[F32]) -> None:
    """Vectors of agents times a factor, each to the place of its rank."""
    x, y, z = of
    for i in range(ranks.size):
        k = ranks[i]
        out[k, 0] = x[i] * scale
        out[k, 1] = y[i] * scale
        out[k, 2] = z[i] * scale


@kernel
def coloured(colours: Array2[F32], state: Array1[I32], rows: Array1[I64], out: Array2[F32]) -> BOOL:
    """Colours of the states of the agents at some rows; whether all states have one."""
    for k in range(rows.size):
        number = state[rows[k]]
        if number < 0 or number >= colours.shape[0]:
            return False
        out[k, 0], out[k, 1], out[k, 2] = colours[number, 0], colours[number, 1], colours[number, 2]
    return True


@kernel
def worn(on: Array1[BOOL], rows: Array1[I64], bit: I64, mask: Array1[I64]) -> None:
    """Put a bit into the masks of those at some rows who have it on."""
    for k in range(rows.size):
        mask[k] |= bit if on[rows[k]] else 0


@kernel
def not_zero(values: Array1[F64], cells: Array1[I32], out: Array1[F32]) -> I64:
    """Write the numbers of the values that are not 0, and these values; how many. Both have room for one more than all."""
    count = 0
    for i in range(values.size):
        value = values[i]
        cells[count] = i
        out[count] = np.float32(value)
        count += 1 if value != 0.0 else 0
    return count


@inlined
def _signed(size, sign):  # type: ignore[no-untyped-def]
    """As np.copysign, of a size that has no sign; the sign of what is no number does not count."""
    return -size if as_bits(sign) < 0 and sign == sign else size


@kernel
def orientations(heading: Three, up: Three, ranks: Array1[I32], out: Array2[F32]) -> None:
    """As `frames.orientation`, each to the place of its rank."""
    px, py, pz = heading
    qx, qy, qz = up
    for i in independent(0, ranks.size):
        k = ranks[i]
        hx, hy, hz = np.float64(px[i]), np.float64(py[i]), np.float64(pz[i])
        ux, uy, uz = np.float64(qx[i]), np.float64(qy[i]), np.float64(qz[i])
        length = np.sqrt(hx * hx + hy * hy + hz * hz)
        still = length < 1e-12
        inverse = 1.0 / (1.0 if still else length)
        hx, hy, hz = hx * inverse, hy * inverse, hz * inverse
        hx = np.float64(1.0) if still else hx
        back = hx < -1 + 1e-12
        half = 1.0 / np.sqrt(1.0 if back else 2 * (1 + hx))
        aw, ay, az = (1 + hx) * half, -hz * half, hy * half
        aw, ay, az = 0.0 if back else aw, 0.0 if back else ay, 1.0 if back else az
        above = 2 * -az * aw * ux + (1 - 2 * az * az) * uy + 2 * ay * az * uz
        beside = 2 * ay * aw * ux + 2 * ay * az * uy + (1 - 2 * ay * ay) * uz
        size = np.sqrt(above * above + beside * beside)
        cosine = above / max(size, 1e-30)
        cosine = cosine if size > 1e-12 else 1.0
        bw = np.sqrt(max(0.5 + 0.5 * cosine, 0.0))
        bx = _signed(np.sqrt(max(0.5 - 0.5 * cosine, 0.0)), beside)
        out[k, 0] = np.float32(aw * bx)
        out[k, 1] = np.float32(ay * bw + az * bx)
        out[k, 2] = np.float32(az * bw - ay * bx)
        out[k, 3] = np.float32(aw * bw)


@kernel
def farthest(position: Strided2[F64], ground: Strided2[F64], clearance: Array1[F32], size: Array1[F32]) -> F64:
    """The greatest distance of positions, as they are written, from their ground less the clearance, in sizes; NaN if one is."""
    worst, unknown = 0.0, False
    for i in range(size.size):
        x = np.float64(np.float32(position[i, 0])) - ground[i, 0]
        y = np.float64(np.float32(position[i, 1])) - ground[i, 1]
        z = np.float64(np.float32(position[i, 2])) - ground[i, 2]
        share = abs(np.sqrt((x * x + y * y) + z * z) - clearance[i]) / max(np.float64(size[i]), 1e-9)
        worst = share if share > worst else worst
        unknown = unknown or share != share
    return np.nan if unknown else worst
