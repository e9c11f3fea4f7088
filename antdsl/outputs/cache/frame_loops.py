"""Kernels of `frame_maker`, `agent_arrays`, `pose_arrays` and `surface_error`.

Each kernel passes over the agents once, and writes one array, or the arrays for all clips of a machine. Kernels with the last
arguments `begin` and `end` run in parallel chunks.

A kernel that reads several numbers of an agent processes rows in memory order, and writes each result at the rank of the agent's
id. One scattered write is cheaper than several scattered reads."""

from __future__ import annotations

import numpy as np

from antdsl.machine_code.kernels import (
    BOOL,
    F32,
    F64,
    I16,
    I32,
    I64,
    U8,
    Array1,
    Array2,
    Array3,
    Strided2,
    float_to_bits,
    inlined,
    kernel,
    simd_range,
)  # fmt: skip

FloatColumns3 = tuple[Array1[F32], Array1[F32], Array1[F32]]
Clips = tuple[Array1[I32], Array1[I32]]
ClipsOut = tuple[Array1[I16], Array1[I16]]
Shares = tuple[Array1[F32], Array1[F32], Array1[F32], Array1[F32], Array1[F32]]


@kernel
def write_positions(position: Strided2[F64], ranks: Array1[I32], scale: F64, out: Array2[F32], begin: I64, end: I64) -> None:
    """Write the agents' positions times `scale` (scene units per mm), each at the agent's rank. Minus zero becomes zero."""
    for i in range(begin, end):
        k = ranks[i]
        out[k, 0] = np.float32((position[i, 0] + 0.0) * scale)
        out[k, 1] = np.float32((position[i, 1] + 0.0) * scale)
        out[k, 2] = np.float32((position[i, 2] + 0.0) * scale)


@kernel
def write_vectors(vectors: FloatColumns3, ranks: Array1[I32], scale: F32, out: Array2[F32], begin: I64, end: I64) -> None:
    """Write the vectors of agents times `scale`, each at the agent's rank."""
    x, y, z = vectors
    for i in range(begin, end):
        k = ranks[i]
        out[k, 0] = x[i] * scale
        out[k, 1] = y[i] * scale
        out[k, 2] = z[i] * scale


@kernel
def write_numbers(numbers: Array1[F32], ranks: Array1[I32], scale: F32, out: Array1[F32], begin: I64, end: I64) -> None:
    """Write the numbers of agents times `scale`, each at the agent's rank."""
    for i in range(begin, end):
        out[ranks[i]] = numbers[i] * scale


@kernel
def write_integers(integers: Array1[I32], ranks: Array1[I32], out: Array1[I16], begin: I64, end: I64) -> None:
    """Write integers of agents, each at the agent's rank."""
    for i in range(begin, end):
        out[ranks[i]] = integers[i]


@kernel
def write_colours(colours: Array2[F32], state: Array1[I32], ranks: Array1[I32], out: Array2[F32], begin: I64, end: I64) -> BOOL:
    """Write the colours of the agents' states, each at the agent's rank. Return whether every state has a colour."""
    for i in range(begin, end):
        number, k = state[i], ranks[i]
        if number < 0 or number >= colours.shape[0]:
            return False
        out[k, 0], out[k, 1], out[k, 2] = colours[number, 0], colours[number, 1], colours[number, 2]
    return True


@kernel
def write_playing_clips(
    clips: Clips, shares: Shares, ranks: Array1[I32], clips_out: ClipsOut, shares_out: Shares, begin: I64, end: I64
) -> None:
    """Write the clips that one machine of each agent plays, each at the agent's rank.

    `clips`, `clips_out`: the current and the previous clip. `shares`, `shares_out`: played cycles and weight of the current clip,
    then of the previous clip, and the fade."""
    clip, previous = clips
    clip_out, before_out = clips_out
    turns, weight, before_turns, before_weight, fade = shares
    turns_out, weight_out, before_turns_out, before_weight_out, fade_out = shares_out
    for i in range(begin, end):
        k = ranks[i]
        clip_out[k], before_out[k] = clip[i], previous[i]
        turns_out[k], weight_out[k], fade_out[k] = turns[i], weight[i], fade[i]
        before_turns_out[k], before_weight_out[k] = before_turns[i], before_weight[i]


@kernel
def mark_worn_layer(is_worn: Array1[BOOL], ranks: Array1[I32], bit: I64, mask: Array1[I64]) -> None:
    """Set `bit` in the masks of the agents for which `is_worn` holds. `mask`: the masks in the order of ranks."""
    for i in range(ranks.size):
        mask[ranks[i]] |= bit if is_worn[i] else 0


@kernel
def compress_nonzero_cells(values: Array1[F64], cells: Array1[I32], out: Array1[F32]) -> I64:
    """Write the indices of the nonzero values to `cells`, and these values to `out`. Return their number.

    Both outputs need one element more than `values`."""
    count = 0
    for i in range(values.size):
        value = values[i]
        cells[count] = i
        out[count] = np.float32(value)
        count += 1 if value != 0.0 else 0
    return count


@inlined
def _copy_sign(size: F64, sign: F64) -> F64:
    """Return `size` (not negative) with the sign of `sign`, as np.copysign does. NaN counts as positive."""
    return -size if float_to_bits(sign) < 0 and sign == sign else size


@kernel
def write_orientations(
    heading: FloatColumns3, up: FloatColumns3, ranks: Array1[I32], out: Array2[F32], begin: I64, end: I64
) -> None:
    """Write the orientations of agents as quaternions x, y, z, w, each at the agent's rank.

    Each quaternion rotates +x to the heading, and +y to the part of `up` that is perpendicular to the heading.

    It consists of the shortest rotation from +x to the heading, and a rotation about the heading. A zero heading counts as +x. If
    `up` is parallel to the heading, an arbitrary perpendicular direction is used."""
    px, py, pz = heading
    qx, qy, qz = up
    for i in simd_range(begin, end):
        hx, hy, hz = np.float64(px[i]), np.float64(py[i]), np.float64(pz[i])
        ux, uy, uz = np.float64(qx[i]), np.float64(qy[i]), np.float64(qz[i])
        length = np.sqrt(hx * hx + hy * hy + hz * hz)
        still = length < 1e-12
        inverse = 1.0 / (1.0 if still else length)
        hx, hy, hz = hx * inverse, hy * inverse, hz * inverse
        hx = np.float64(1.0) if still else hx
        # The shortest rotation of +x to the heading. For the opposite direction: half a turn about z.
        back = hx < -1 + 1e-12
        half = 1.0 / np.sqrt(1.0 if back else 2 * (1 + hx))
        aw, ay, az = (1 + hx) * half, -hz * half, hy * half
        aw, ay, az = 0.0 if back else aw, 0.0 if back else ay, 1.0 if back else az
        # The images of +y and +z under this rotation, and the components of `up` along them.
        above = 2 * -az * aw * ux + (1 - 2 * az * az) * uy + 2 * ay * az * uz
        beside = 2 * ay * aw * ux + 2 * ay * az * uy + (1 - 2 * ay * ay) * uz
        size = np.sqrt(above * above + beside * beside)
        cosine = above / max(size, 1e-30)
        cosine = cosine if size > 1e-12 else 1.0
        bw = np.sqrt(max(0.5 + 0.5 * cosine, 0.0))
        bx = _copy_sign(np.sqrt(max(0.5 - 0.5 * cosine, 0.0)), beside)
        k = ranks[i]
        out[k, 0], out[k, 1] = np.float32(aw * bx), np.float32(ay * bw + az * bx)
        out[k, 2], out[k, 3] = np.float32(az * bw - ay * bx), np.float32(aw * bw)


_BLOCK = 256  # agents per block; their rows stay in a core's cache from leg to leg


@kernel
def write_feet(
    foot_positions: Array3[F64],
    swing: Array2[F32],
    rise: Array1[F32],
    slope: Array2[F32],
    ranks: Array1[I32],
    scale: F64,
    positions_out: Array2[F32],
    is_on_ground: Array2[U8],
    rise_out: Array1[F32],
    tilt: Array2[F32],
    begin: I64,
    end: I64,
) -> None:
    """Write the feet of agents `begin` to `end` - 1, each at the agent's rank. Inputs have the shape (.., legs, n) or (.., n).

    `positions_out`: x, y, z of each leg's foot, in scene units. `is_on_ground`: 1 for feet on the ground (`swing` is -1), else 0.
    `rise_out`: the height of the trunk above its rest height, in scene units. `tilt`: the rotation of the trunk as unit
    quaternions x, y, z, w."""
    for low in range(begin, end, _BLOCK):
        high = min(low + _BLOCK, end)
        for leg in range(swing.shape[0]):
            for i in range(low, high):
                k = ranks[i]
                positions_out[k, 3 * leg] = np.float32((foot_positions[0, leg, i] + 0.0) * scale)
                positions_out[k, 3 * leg + 1] = np.float32((foot_positions[1, leg, i] + 0.0) * scale)
                positions_out[k, 3 * leg + 2] = np.float32((foot_positions[2, leg, i] + 0.0) * scale)
                is_on_ground[k, leg] = 1 if swing[leg, i] == np.float32(-1.0) else 0
        for i in simd_range(low, high):
            rank = ranks[i]
            rise_out[rank] = rise[i] * np.float32(scale)
            a, b = -np.float64(slope[0, i]), -np.float64(slope[1, i])
            size = 1.0 / np.sqrt((a * a + 1.0) + b * b)
            x, z, w = b * size, -a * size, 1.0 + size
            length = np.sqrt((x * x + z * z) + w * w)
            tilt[rank, 0], tilt[rank, 1] = np.float32(x / length), np.float32(0.0 / length)
            tilt[rank, 2], tilt[rank, 3] = np.float32(z / length), np.float32(w / length)


@kernel
def find_greatest_error(
    position: Strided2[F64], ground: Strided2[F64], clearance: Array1[F32], size: Array1[F32], begin: I64, end: I64
) -> F64:
    """Return the greatest error of an agent's distance from its ground, compared with its clearance, in body lengths.

    Positions are rounded to float32 first, as in the cache. The result is NaN if any value is NaN."""
    worst, unknown = 0.0, False
    for i in range(begin, end):
        x = np.float64(np.float32(position[i, 0])) - ground[i, 0]
        y = np.float64(np.float32(position[i, 1])) - ground[i, 1]
        z = np.float64(np.float32(position[i, 2])) - ground[i, 2]
        share = abs(np.sqrt((x * x + y * y) + z * z) - np.float64(clearance[i])) / max(np.float64(size[i]), 1e-9)
        worst = share if share > worst else worst
        unknown = unknown or share != share
    return np.nan if unknown else worst
