"""Gradient noise over space and time. It is smooth, has values around 0, and depends only on point and seed, not on frame or
row. Gradients at lattice points are interpolated by a quintic function, which makes slope and curvature continuous (K. Perlin,
Improving noise, SIGGRAPH 2002). The 32 gradients in four dimensions (one is time) come from his reference code. The random
bits of a lattice point are from `hash_pcg4d` (M. Jarzynski and M. Olano, Hash functions for GPU rendering, JCGT 9(3), 2020)."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
UInt32Array = NDArray[np.uint32]

_LCG_MULTIPLIER, _LCG_INCREMENT, _SHIFT_16, _SHIFT_27 = np.uint32(1664525), np.uint32(1013904223), np.uint32(16), np.uint32(27)
_LATTICE_CORNERS = np.array(list(product((0, 1), repeat=4)), np.int64)[:, :, None]  # (16, 4, 1): the last dimension changes first
_SIGN_COMBINATIONS = np.array(list(product((-1.0, 1.0), repeat=3)))
# (32, 4): 0 along one dimension, 1 or -1 along the three others
_LATTICE_GRADIENTS = np.concatenate([np.insert(_SIGN_COMBINATIONS, still, 0.0, axis=1) for still in range(4)])
# The greatest sum is 1.53658: at each corner the three largest offsets, weighted by the fade.
_NOISE_SCALE = 0.65
MAX_LATTICE_COORDINATE = 2.0**51  # beyond this coordinate, float64 does not resolve positions within a cell


def compute_noise(points: Floats, seed: NDArray[np.int64]) -> Floats:
    """Return noise values from -1 to 1 at `points` (4, n). NaN where a point is not finite or too far away. Coordinates are x,
    y, z and time, in lattice cells."""
    is_valid = (np.abs(points) < MAX_LATTICE_COORDINATE).all(axis=0)
    points = np.where(is_valid, points, 0.0)
    cell = np.floor(points)
    inside = points - cell
    lattice = cell.astype(np.int64) + _compute_lattice_offset(seed)
    corner = (lattice + _LATTICE_CORNERS).astype(np.uint32)  # (16, 4, n)
    # the upper bits of the last word, which is mixed most; the lower bits of the first differ too little between cells
    gradient = _LATTICE_GRADIENTS[hash_pcg4d(corner.transpose(1, 0, 2))[3] >> _SHIFT_27]  # (16, n, 4)
    offset = inside - _LATTICE_CORNERS
    value: Floats = (gradient[..., 0] * offset[:, 0] + gradient[..., 1] * offset[:, 1]) + (
        gradient[..., 2] * offset[:, 2] + gradient[..., 3] * offset[:, 3]
    )
    for share in compute_fade(inside)[::-1]:  # time first, because it changes first among the corners
        value = value[0::2] + share * (value[1::2] - value[0::2])
    return np.where(is_valid, value[0] * _NOISE_SCALE, np.nan)


def compute_fade(t: Floats) -> Floats:
    """Return a smooth transition from 0 at `t` = 0 to 1 at `t` = 1. Slope and curvature are 0 at both ends (Perlin 2002)."""
    return (t * t * t) * (t * (t * 6.0 - 15.0) + 10.0)


def _compute_lattice_offset(seed: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the lattice offset by which each seed shifts the noise pattern, (4, n). The lattice has 2**32 points along each
    axis."""
    zero = np.zeros(seed.shape, np.uint32)
    words = np.stack((seed.astype(np.uint32), (seed >> 32).astype(np.uint32), zero, zero))
    return hash_pcg4d(hash_pcg4d(words)).astype(np.int64)


def hash_pcg4d(words: UInt32Array) -> UInt32Array:
    """Return a hash of four 32-bit words for each column of `words` (4, …)."""
    mixed_words = _mix_words(words * _LCG_MULTIPLIER + _LCG_INCREMENT)
    return _mix_words(mixed_words ^ (mixed_words >> _SHIFT_16))


def _mix_words(words: UInt32Array) -> UInt32Array:
    """Return the words after one round of multiplications and additions, which mix the four words of each column."""
    x, y, z, w = words
    x = x + y * w
    y = y + z * x
    z = z + x * y
    return np.stack((x, y, z, w + y * z))
