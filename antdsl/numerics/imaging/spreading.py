"""Kernels that spread light over pixels along lines (motion blur) and discs (depth of field), and composite the results."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from antdsl.machine_code.kernels import F32, I64, Array1, Array2, Array3, kernel

RADIUS_STEPS_PER_PIXEL = 4  # radii of discs are rounded to this fraction of a pixel
CHANNEL_COUNT = 4  # of sums of discs: red, green, blue, and the weight


class DiscTable(NamedTuple):
    """A table of discs with radii in steps of a fraction of a pixel; r is the number of the radius.

    `half_widths` (r, k): half of the disc's width in the pixel row k rows above or below the centre; 0 outside. `share` (r,):
    the weight of each pixel of the disc."""

    half_widths: Array2[F32]
    share: Array1[F32]


@kernel
def add_line_averages(lines: Array2[F32], values: Array2[F32], max_steps: I64, sums: Array3[F32], begin: I64, end: I64) -> None:
    """Distribute the values of each sample equally over the pixels of its line. `lines` (n, 4): the column and row of one end,
    then of the other, in pixels. `values` (n, c): c values per sample. `sums` (h, w, c): the image to which values are added."""
    high, wide, channels = sums.shape[0], sums.shape[1], sums.shape[2]
    for i in range(begin, end):
        x, y = lines[i, 0], lines[i, 1]
        dx, dy = lines[i, 2] - x, lines[i, 3] - y
        steps = min(max(int(np.ceil(max(abs(dx), abs(dy)))), 1), max_steps)
        part = 1 / np.float32(steps)
        for k in range(steps):
            along = (np.float32(k) + np.float32(0.5)) * part
            column, row = int(np.floor(x + dx * along)), int(np.floor(y + dy * along))
            if column >= 0 and column < wide and row >= 0 and row < high:
                for c in range(channels):
                    sums[row, column, c] = sums[row, column, c] + values[i, c] * part


@kernel
def add_disc_averages(
    pixels: Array1[I64],
    values: Array2[F32],
    radius_steps: Array1[I64],
    table: DiscTable,
    width: I64,
    sums: Array3[F32],
    begin: I64,
    end: I64,
) -> None:
    """Distribute the light of each pixel evenly over a disc around it. Only rows `begin` to before `end` of `sums` (h, w + 2,
    4) are written. `pixels` (n,): pixel numbers in ascending order. `values` (n, 4): red, green, blue and weight.
    `radius_steps` (n,): the row of `table` for each disc. `sums` stores differences from the pixel to the left. So only the
    two ends of each disc row are written (Kosloff et al., Graphics Interface 2009)."""
    reach, edge = table.half_widths.shape[1] - 1, np.float32(width)
    for i in range(0, pixels.size):
        row = pixels[i] // width
        if row + reach < begin or row - reach >= end:
            continue
        centre, step = np.float32(pixels[i] - row * width) + np.float32(0.5), radius_steps[i]
        share = table.share[step]
        red, green, blue, weight = values[i, 0] * share, values[i, 1] * share, values[i, 2] * share, values[i, 3] * share
        for k in range(-reach, reach + 1):
            half, target = table.half_widths[step, abs(k)], row + k
            if half > 0 and target >= begin and target < end:
                for side in range(2):
                    sign = np.float32(1 - 2 * side)
                    at = min(max(centre - half * sign, np.float32(0)), edge)
                    cell = int(np.floor(at))
                    second = (at - np.float32(cell)) * sign
                    first = sign - second
                    sums[target, cell, 0] = sums[target, cell, 0] + red * first
                    sums[target, cell, 1] = sums[target, cell, 1] + green * first
                    sums[target, cell, 2] = sums[target, cell, 2] + blue * first
                    sums[target, cell, 3] = sums[target, cell, 3] + weight * first
                    sums[target, cell + 1, 0] = sums[target, cell + 1, 0] + red * second
                    sums[target, cell + 1, 1] = sums[target, cell + 1, 1] + green * second
                    sums[target, cell + 1, 2] = sums[target, cell + 1, 2] + blue * second
                    sums[target, cell + 1, 3] = sums[target, cell + 1, 3] + weight * second


@kernel
def add_layer_behind(sums: Array3[F32], total: Array3[F32], begin: I64, end: I64) -> None:
    """Composite a layer behind the layers in `total` (h, w, 4), where these do not cover a pixel completely.

    Then set the layer's `sums` to 0. Coverage of layers is added, because most layers are parts of one surface."""
    for row in range(begin, end):
        red, green, blue, weight = np.float32(0), np.float32(0), np.float32(0), np.float32(0)
        for column in range(0, total.shape[1]):
            red, green = red + sums[row, column, 0], green + sums[row, column, 1]
            blue, weight = blue + sums[row, column, 2], weight + sums[row, column, 3]
            cover = min(weight, 1 - total[row, column, 3])
            if cover > np.float32(1e-4):
                part = cover / weight
                total[row, column, 0] = total[row, column, 0] + red * part
                total[row, column, 1] = total[row, column, 1] + green * part
                total[row, column, 2] = total[row, column, 2] + blue * part
                total[row, column, 3] = total[row, column, 3] + cover
        for column in range(0, sums.shape[1]):
            for channel in range(4):
                sums[row, column, channel] = np.float32(0)
