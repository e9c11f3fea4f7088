"""Grains and pebbles on the ground near a close camera: a sense of scale. They are in pictures only; nothing walks round them."""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.shapes import joined, stone
from antdsl.outputs.pictures.camera import View
from antdsl.outputs.pictures.looks import Scales

Array = NDArray[np.float64]

_SHAPES = 8
_MOST = 12_000
_A_FACE = 48  # pebbles on one triangle at most
_REACH = 36  # body lengths round the camera
_SMALLEST, _LARGEST = 0.022, 0.24  # radius in body lengths
_FINE = 0.06  # from this radius on a pebble is worth a round shape


@cache
def _shapes(detail: int) -> tuple[Array, NDArray[np.int32]]:
    """Unit pebbles (k, n, 3) that share their faces."""
    made = [stone(70 + k, (1.0, 0.62, 0.8), detail=detail, roughness=0.2) for k in range(_SHAPES)]
    return np.stack([vertices for vertices, _ in made]), made[0][1]


def litter(
    vertices: Array, faces: NDArray[np.int32], up: Array, view: View, scales: Scales
) -> tuple[Array, NDArray[np.int32]] | None:
    """Pebbles lying on a ground near the camera, as one mesh; None where none would be seen as more than a speck.

    Each triangle has its own pebbles, wherever the camera is."""
    corners = vertices[faces]
    middle = corners.mean(axis=1)
    away = np.linalg.norm(middle - view.eye, axis=1)
    if not len(faces) or view.pixel_at(np.maximum(away.min(), 1e-9)) * 4 > _LARGEST * scales.grain:
        return None
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(across, axis=1) / 2
    level = (across @ up) / np.maximum(2 * area, 1e-30)
    draw = np.random.Generator(np.random.Philox(77)).random((len(faces), 2))
    patch = 0.35 + 1.3 * draw[:, 0] ** 2
    many = np.where(level > 0.55, area / scales.grain**2 * 11.0 * patch, 0.0)
    count = np.minimum((many + draw[:, 1]).astype(np.int64), _A_FACE)
    near = np.flatnonzero((away < _REACH * scales.grain) & (count > 0))
    near = near[np.argsort(away[near], kind="stable")]
    near = near[: int(np.searchsorted(np.cumsum(count[near]), _MOST))]
    face = np.repeat(near, count[near])
    if not len(face):
        return None
    rank = np.arange(len(face)) - np.repeat(np.cumsum(count[near]) - count[near], count[near])
    chance = _chances(face, rank)
    u, v = chance[:, 0], chance[:, 1]
    over = u + v > 1
    u, v = np.where(over, 1 - u, u), np.where(over, 1 - v, v)
    place = corners[face, 0] * (1 - u - v)[:, None] + corners[face, 1] * u[:, None] + corners[face, 2] * v[:, None]
    size = scales.grain * _SMALLEST * (_LARGEST / _SMALLEST) ** (chance[:, 2] ** 5)
    normal = across[face] / (2 * area[face])[:, None]
    small = size < _FINE * scales.grain
    return joined(
        [_laid(place[rows], normal[rows], size[rows], chance[rows], detail) for rows, detail in ((small, 0), (~small, 1))]
    )


def _chances(face: NDArray[np.int64], rank: NDArray[np.int64]) -> Array:
    """Five numbers within 0..1 for each pebble, from its triangle and its rank there alone."""
    own = (face * _A_FACE + rank).astype(np.uint64)[:, None]
    key: NDArray[np.uint64] = np.add(own * np.uint64(5), np.arange(5, dtype=np.uint64), dtype=np.uint64)
    # The finaliser of SplitMix64 (Steele et al., Fast Splittable Pseudorandom Number Generators, OOPSLA 2014).
    key = (key ^ np.right_shift(key, np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    key = (key ^ np.right_shift(key, np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    key = np.right_shift(key ^ np.right_shift(key, np.uint64(31)), np.uint64(11))
    return np.asarray(key.astype(np.float64) * 2.0**-53)


def _laid(place: Array, normal: Array, size: Array, chance: Array, detail: int) -> tuple[Array, NDArray[np.int32]]:
    shapes, faces = _shapes(detail)
    side = np.cross(normal, np.array([0.31, 0.72, 0.62]))
    side /= np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-12)
    other = np.cross(side, normal)
    turn = chance[:, 3:4] * 2 * np.pi
    first, second = np.cos(turn) * side + np.sin(turn) * other, np.cos(turn) * other - np.sin(turn) * side
    local = shapes[(chance[:, 4] * _SHAPES).astype(np.int64)] * size[:, None, None]
    points = (
        local[:, :, :1] * first[:, None]
        + (local[:, :, 1:2] + 0.22 * size[:, None, None]) * normal[:, None]
        + local[:, :, 2:] * second[:, None]
    )
    points += place[:, None]
    triangles = faces[None] + (np.arange(len(place), dtype=np.int32) * shapes.shape[1])[:, None, None]
    return points.reshape(-1, 3), triangles.reshape(-1, 3).astype(np.int32)
