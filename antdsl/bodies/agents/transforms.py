"""Local transforms as translation, rotation, shear and scale, and as matrices for column vectors.

A point is scaled first, then sheared, then rotated, then translated: `T @ R @ H @ S`. The shear `H` adds `shear1` times y plus
`shear2` times z to x, and `shear3` times z to y. Every invertible matrix has exactly one such form (Thomas, Decomposing a Matrix
into Simple Transformations, in Graphics Gems II, 1991).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents import affine
from antdsl.numerics.elementary import atan2_float64, cos_float64, sin_float64

Floats = NDArray[np.float64]
ROTATION_ORDERS = ("xyz", "xzy", "yxz", "yzx", "zxy", "zyx")


def quaternion_to_matrix(quaternion: Floats) -> Floats:
    """Return matrices float64[..., 3, 3] of unit quaternions float64[..., 4] (x, y, z, w)."""
    nowhere, plain = np.zeros((*quaternion.shape[:-1], 3)), np.ones((*quaternion.shape[:-1], 3))
    return compose_matrix(nowhere, quaternion, plain)[..., :3, :3]


def matrix_to_quaternion(matrix: Floats) -> Floats:
    """Return unit quaternions float64[..., 4], with w not negative, of rotation matrices float64[..., 3, 3].

    The largest of the four components is computed first, so that no divisor is near 0 (Shepperd, Quaternion from Rotation Matrix,
    1978).
    """
    m = np.moveaxis(matrix.reshape(-1, 3, 3), 0, -1)
    four = np.array(
        [m[0, 0] - m[1, 1] - m[2, 2], m[1, 1] - m[0, 0] - m[2, 2], m[2, 2] - m[0, 0] - m[1, 1], m[0, 0] + m[1, 1] + m[2, 2]]
    )
    rows = np.array(
        [
            [1 + four[0], m[0, 1] + m[1, 0], m[2, 0] + m[0, 2], m[2, 1] - m[1, 2]],
            [m[0, 1] + m[1, 0], 1 + four[1], m[1, 2] + m[2, 1], m[0, 2] - m[2, 0]],
            [m[2, 0] + m[0, 2], m[1, 2] + m[2, 1], 1 + four[2], m[1, 0] - m[0, 1]],
            [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], 1 + four[3]],
        ]
    )
    best = np.argmax(four, axis=0)
    quaternions = np.take_along_axis(rows, best[None, None], axis=0)[0].T
    return normalise_quaternion(np.where(quaternions[:, 3:] < 0, -quaternions, quaternions)).reshape(*matrix.shape[:-2], 4)


def normalise_quaternion(quaternion: Floats) -> Floats:
    """Return quaternions float64[..., 4] normalised to length 1. A zero quaternion becomes the identity."""
    length = np.sqrt((quaternion * quaternion).sum(axis=-1, keepdims=True))
    known = np.isfinite(length) & (length > 1e-30)
    return np.where(known, quaternion / np.where(known, length, 1.0), np.array([0.0, 0.0, 0.0, 1.0]))


def multiply_quaternions(a: Floats, b: Floats) -> Floats:
    """Return the products a · b of quaternions float64[..., 4], which rotate by `b` first, then by `a`."""
    return np.moveaxis(affine.multiply_quaternions(np.moveaxis(a, -1, 0), np.moveaxis(b, -1, 0)), 0, -1)


def angles_to_quaternion(angles: Floats, order: str) -> Floats:
    """Convert Euler angles float64[..., 3] (rad, about x, y and z) to unit quaternions float64[..., 4].

    The rotations are applied in `order`: "xyz" rotates about x first. Signs are continuous along the first array axis."""
    rotation = np.broadcast_to(np.array([0.0, 0.0, 0.0, 1.0]), (*angles.shape[:-1], 4))
    for letter in order:
        axis = "xyz".index(letter)
        turn = np.zeros((*angles.shape[:-1], 4))
        half = np.ascontiguousarray(angles[..., axis] / 2)
        turn[..., axis], turn[..., 3] = sin_float64(half), cos_float64(half)
        rotation = multiply_quaternions(turn, rotation)
    return align_signs(normalise_quaternion(rotation))


def quaternion_to_angles(quaternion: Floats) -> Floats:
    """Convert unit quaternions to Euler angles float64[..., 3] (rad) about x, y and z, which are applied in this order.

    If the angle about y is 90 degrees, the angle about z is 0."""
    m = quaternion_to_matrix(quaternion)
    level = np.sqrt(m[..., 0, 0] ** 2 + m[..., 1, 0] ** 2)
    locked = level < 1e-7
    x = np.where(locked, atan2_float64(-m[..., 1, 2], m[..., 1, 1]), atan2_float64(m[..., 2, 1], m[..., 2, 2]))
    z = np.where(locked, 0.0, atan2_float64(m[..., 1, 0], m[..., 0, 0]))
    return np.stack([x, atan2_float64(-m[..., 2, 0], level), z], axis=-1)


def align_signs(quaternion: Floats) -> Floats:
    """Return quaternions float64[F, ..., 4] with continuous signs: each gets the sign that is closer to the previous one along
    the first axis."""
    if quaternion.ndim < 2 or len(quaternion) < 2:
        return quaternion
    turned = (quaternion[1:] * quaternion[:-1]).sum(axis=-1) < 0
    signs = np.where(np.cumsum(turned, axis=0) % 2 == 1, -1.0, 1.0)
    return np.concatenate([quaternion[:1], quaternion[1:] * signs[..., None]])


def slerp_quaternions(a: Floats, b: Floats, share: Floats) -> Floats:
    """Return the rotation at the fraction `share` float64[...] of the shortest path from `a` to `b`. Both are quaternions
    float64[..., 4].

    The angular speed along the path is constant (Shoemake, Animating Rotation with Quaternion Curves, 1985)."""
    b = np.where((a * b).sum(axis=-1, keepdims=True) < 0, -b, b)
    chord, along = np.sqrt(((a - b) ** 2).sum(axis=-1)), np.sqrt(((a + b) ** 2).sum(axis=-1))
    angle = 2 * atan2_float64(chord, along)
    sine = sin_float64(angle)
    wide = sine > 1e-9
    divisor = np.where(wide, sine, 1.0)
    first = np.where(wide, sin_float64((1 - share) * angle) / divisor, 1 - share)
    second = np.where(wide, sin_float64(share * angle) / divisor, share)
    return normalise_quaternion(first[..., None] * a + second[..., None] * b)


def compose_matrix(translation: Floats, rotation: Floats, scale: Floats, shear: Floats | None = None) -> Floats:
    """Return matrices float64[..., 4, 4], composed of translations [..., 3], unit quaternions [..., 4], scales [..., 3] and
    shears [..., 3]."""
    count = translation[..., 0].size
    matrices = np.zeros((count, 4, 4))
    matrices[:, 3, 3] = 1.0
    place, turn, size = (each.reshape(count, each.shape[-1]).T for each in (translation, rotation, scale))
    slant = None if shear is None else shear.reshape(count, 3).T
    affine.compose_matrices(place, turn, size, slant, matrices[:, :3].transpose(1, 2, 0))
    return matrices.reshape(*translation.shape[:-1], 4, 4)


def decompose_matrix(matrix: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Split matrices float64[..., 4, 4] into the arguments of `compose_matrix`: translations, unit quaternions, scales, shears.

    For mirroring matrices, the scale along z is negative. For singular matrices, the rotation is arbitrary."""
    x, y, z = (matrix[..., :3, column] for column in range(3))
    wide = _compute_lengths(x)
    first = _normalise_or_fallback(x, wide, (1.0, 0.0, 0.0))
    xy = (first * y).sum(axis=-1)
    y = y - first * xy[..., None]
    high = _compute_lengths(y)
    second = _normalise_or_fallback(y, high, (0.0, 1.0, 0.0))
    second = second - first * (first * second).sum(axis=-1)[..., None]
    lone = _compute_lengths(second) < 1e-6
    spare = np.cross(first, np.where(np.abs(first[..., :1]) < 0.7, np.array([1.0, 0, 0]), np.array([0, 0, 1.0])))
    second = np.where(lone[..., None], spare, second)
    second = second / _compute_lengths(second)[..., None]
    third = np.cross(first, second)
    depth = (third * z).sum(axis=-1)
    xz, yz = (first * z).sum(axis=-1), (second * z).sum(axis=-1)
    scale = np.stack([wide, high, depth], axis=-1)
    over = np.where(np.abs(scale) > 1e-30, scale, 1.0)
    shear = np.stack([xy / over[..., 1], xz / over[..., 2], yz / over[..., 2]], axis=-1)
    return matrix[..., :3, 3], matrix_to_quaternion(np.stack([first, second, third], axis=-1)), scale, shear


def _compute_lengths(vectors: Floats) -> Floats:
    """Return the lengths [...] of vectors [..., k]."""
    return np.asarray(np.sqrt((vectors * vectors).sum(axis=-1)))


def _normalise_or_fallback(vectors: Floats, lengths: Floats, fallback: tuple[float, float, float]) -> Floats:
    """Return vectors [..., k] divided by their `lengths`. A vector with a length of at most 1e-30 is replaced by `fallback`."""
    known = lengths > 1e-30
    return np.where(known[..., None], vectors / np.where(known, lengths, 1.0)[..., None], np.array(fallback))


def compose_transforms(outer: Floats, inner: Floats) -> Floats:
    """Return the products `outer` · `inner` of matrices float64[..., 4, 4]. Sums are in a fixed order, so that every processor
    gives the same bits."""
    a, b = outer[..., :, :, None], inner[..., None, :, :]
    matrix: Floats = ((a[..., 0, :] * b[..., 0, :] + a[..., 1, :] * b[..., 1, :]) + a[..., 2, :] * b[..., 2, :]) + a[
        ..., 3, :
    ] * b[..., 3, :]
    return matrix


def compute_world_matrices(parents: NDArray[np.int32], local_matrices: Floats) -> Floats:
    """Return the world matrices float64[J, 4, 4] of a rig, from its local matrices. Parents must come before children."""
    world = np.empty_like(local_matrices)
    for joint, parent in enumerate(parents):
        world[joint] = local_matrices[joint] if parent < 0 else compose_transforms(world[parent], local_matrices[joint])
    return world
