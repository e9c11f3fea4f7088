"""Rotations, scales, shears and affine matrices of many joints of many agents, one array per component.

The component axes come first: a quaternion is [4, …], a matrix [3, 4, …]. The remaining axes are equal in all arguments. Every
number is computed from sums, products, quotients and roots in a fixed order. So results are bit-identical for any number of
agents and on any processor. BLAS and `einsum` are not used: they choose instructions and order at run time.

A local transform is the product translation · rotation · shear · scale, for column vectors. So a point is scaled first, then
sheared (`x += shear1 y + shear2 z`, `y += shear3 z`), rotated, and translated.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
NumberArray = NDArray[Any]  # float32 or float64, as the input

_POLAR_ITERATIONS = 8  # six suffice for a matrix with scales of 1 to 1e15


def normalise_quaternions(rotation: NumberArray) -> NumberArray:
    """Normalise quaternions [4, …] in place and return them. A quaternion of length 0 becomes the identity."""
    x, y, z, w = rotation
    square = x * x
    square += y * y
    square += z * z
    square += w * w
    nothing = square == 0
    w[nothing] = 1
    square[nothing] = 1
    np.sqrt(square, out=square)
    rotation /= square
    return rotation


def multiply_quaternions(a: NumberArray, b: NumberArray) -> NumberArray:
    """Return the products a · b of quaternions [4, …], which rotate by `b` first, then by `a`."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return np.stack([
        ((aw * bx + ax * bw) + ay * bz) - az * by,
        ((aw * by - ax * bz) + ay * bw) + az * bx,
        ((aw * bz + ax * by) - ay * bx) + az * bw,
        ((aw * bw - ax * bx) - ay * by) - az * bz,
    ])  # fmt: skip


def compose_matrices(
    translation: NumberArray, rotation: NumberArray, scale: NumberArray | None, shear: NumberArray | None, out: NumberArray
) -> NumberArray:
    """Write matrices [3, 4, …] into `out` and return it.

    `translation`: [3, …].
    `rotation`: unit quaternions [4, …].
    `scale`: [3, …]; None means 1.
    `shear`: [3, …]; None means 0.
    """
    x, y, z, w = rotation
    two = rotation.dtype.type(2)
    x2, y2, z2 = x * two, y * two, z * two
    xx, yy, zz = x * x2, y * y2, z * z2
    xy, xz, yz = x * y2, x * z2, y * z2
    wx, wy, wz = w * x2, w * y2, w * z2
    one = rotation.dtype.type(1)
    for a, b, sum_index, difference_index in ((xy, wz, (1, 0), (0, 1)), (xz, wy, (0, 2), (2, 0)), (yz, wx, (2, 1), (1, 2))):
        np.add(a, b, out=out[sum_index])
        np.subtract(a, b, out=out[difference_index])
    for k, a, b in ((0, yy, zz), (1, xx, zz), (2, xx, yy)):
        np.add(a, b, out=out[k, k])
        np.subtract(one, out[k, k], out=out[k, k])
    out[:, 3] = translation
    if shear is not None:
        first, second = out[:, 0], out[:, 1].copy()
        out[:, 1] += first * shear[0]
        out[:, 2] += first * shear[1]
        out[:, 2] += second * shear[2]
    if scale is not None:
        for k in range(3):
            out[:, k] *= scale[k]
    return out


def multiply_matrices(a: NumberArray, b: NumberArray, out: NumberArray) -> NumberArray:
    """Write the products a · b of matrices [3, 4, …] into `out` and return it. `out` must be neither `a` nor `b`."""
    part = np.empty(out.shape[2:], out.dtype)
    for r in range(3):
        for c in range(4):
            to = out[r, c]
            np.multiply(a[r, 0], b[0, c], out=to)
            for k in (1, 2):
                np.multiply(a[r, k], b[k, c], out=part)
                to += part
        out[r, 3] += a[r, 3]
    return out


def compute_cofactors(m: NumberArray) -> NumberArray:
    """Return the cofactors [3, 3, …] of matrices [3, 3 or 4, …]: the transposed inverse times the determinant."""
    turns = ((1, 2), (2, 0), (0, 1))
    return np.stack([
        np.stack([m[a, c] * m[b, d] - m[a, d] * m[b, c] for c, d in turns]) for a, b in turns
    ])  # fmt: skip


def compute_determinants(m: NumberArray, cofactor: NumberArray) -> NumberArray:
    """Return the determinants […] of matrices. `cofactor`: their cofactors."""
    determinant: NumberArray = (m[0, 0] * cofactor[0, 0] + m[0, 1] * cofactor[0, 1]) + m[0, 2] * cofactor[0, 2]
    return determinant


def invert_and_transpose(m: NumberArray) -> NumberArray:
    """Return the transposed inverse [3, 3, …], which transforms normals. A matrix without an inverse gives its cofactors
    instead."""
    inverse = compute_cofactors(m)
    determinant = compute_determinants(m, inverse)
    inverse /= np.where(determinant == 0, m.dtype.type(1), determinant)
    return inverse


def extract_rotation_matrices(m: NumberArray) -> NumberArray:
    """Return the rotation [3, 3, …] nearest to each matrix, from its polar decomposition M = R S.

    If M mirrors, the mirroring is in S, so R is always a rotation. For a matrix without an inverse, R is the identity. Uses
    Newton's iteration, scaled by Frobenius norms, in float64, with the same number of steps for every matrix (N. J. Higham,
    Computing the Polar Decomposition, SIAM J. Sci. Stat. Comput. 7, 1986).
    """
    rotation = m[:, :3].astype(np.float64)
    determinant = compute_determinants(rotation, compute_cofactors(rotation))
    rotation *= np.where(determinant < 0, -1.0, 1.0)
    flat = determinant == 0
    for r in range(3):
        for c in range(3):
            rotation[r, c][flat] = float(r == c)
    for _ in range(_POLAR_ITERATIONS):
        back = invert_and_transpose(rotation)
        by = np.sqrt(np.sqrt(_sum_squares(back) / _sum_squares(rotation)))
        rotation = 0.5 * (by * rotation + back / by)
    return rotation


def _sum_squares(m: NumberArray) -> NumberArray:
    """Return the sums of the squared elements of matrices [3, 3, …]."""
    total: NumberArray = m[0, 0] * m[0, 0]
    for k in range(1, 9):
        each = m[divmod(k, 3)]
        total += each * each
    return total


def matrices_to_quaternions(m: NumberArray) -> NumberArray:
    """Return unit quaternions [4, …] of rotation matrices [3, 3 or 4, …], with w not negative.

    Of the four possible formulas, the one with the largest divisor is used for each matrix (S. W. Shepperd, Quaternion from
    Rotation Matrix, J. Guidance and Control 1, 1978)."""
    trace = (m[0, 0] + m[1, 1]) + m[2, 2]
    sizes = np.stack([m[0, 0], m[1, 1], m[2, 2], trace])
    best = sizes.argmax(axis=0)
    xy, xz, yz = m[0, 1] + m[1, 0], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1]
    wx, wy, wz = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    own = [1 + 2 * m[k, k] - trace for k in range(3)]
    candidates = (
        np.stack([own[0], xy, xz, wx]), np.stack([xy, own[1], yz, wy]), np.stack([xz, yz, own[2], wz]),
        np.stack([wx, wy, wz, 1 + trace]),
    )  # fmt: skip
    quaternion = np.choose(best, candidates)
    quaternion *= np.where(quaternion[3] < 0, -1, 1)
    return normalise_quaternions(quaternion)


def decompose_matrices(matrices: NDArray[np.float64]) -> tuple[NumberArray, NumberArray, NumberArray, NumberArray]:
    """Split matrices [J, 4, 4] into translation [3, J], rotation [4, J], scale [3, J] and shear [3, J], float64.

    `compose_matrices` is the inverse. Uses Gram-Schmidt orthogonalisation, column by column. A mirroring matrix has a negative
    scale along x. A column of length 0 gives the scale 0. Shear cannot express a column that depends linearly on the previous
    columns. Such a column is therefore moved away from them by a millionth of its length.
    """
    m = np.moveaxis(np.asarray(matrices, np.float64)[:, :3], 0, -1)
    columns = [m[:, c].copy() for c in range(3)]
    axes: list[NumberArray] = []
    upper = np.zeros((3, 3, m.shape[-1]))
    for c, column in enumerate(columns):
        for k, axis in enumerate(axes):
            upper[k, c] = (axis[0] * column[0] + axis[1] * column[1]) + axis[2] * column[2]
            column -= upper[k, c] * axis
        size = np.sqrt((column[0] * column[0] + column[1] * column[1]) + column[2] * column[2])
        full_size = np.sqrt((m[0, c] * m[0, c] + m[1, c] * m[1, c]) + m[2, c] * m[2, c])
        flat = size <= 1e-12 * full_size
        upper[c, c] = np.where(flat, 1e-6 * full_size, size)
        axes.append(np.where(flat, _find_perpendicular(axes, m.shape[-1]), column / np.where(flat, 1.0, size)))
    mirror = compute_determinants(np.stack(axes, 1), compute_cofactors(np.stack(axes, 1))) < 0
    axes[0] = np.where(mirror, -axes[0], axes[0])
    upper[0] = np.where(mirror, -upper[0], upper[0])
    scale = np.stack([upper[k, k] for k in range(3)])
    by = np.where(scale == 0, 1.0, scale)
    shear = np.stack([upper[0, 1] / by[1], upper[0, 2] / by[2], upper[1, 2] / by[2]])
    return m[:, 3].copy(), matrices_to_quaternions(np.stack(axes, 1)), scale, shear


def _find_perpendicular(axes: list[NumberArray], count: int) -> NumberArray:
    """Return unit vectors [3, count] that are perpendicular to each array of `axes` [3, count]; there are at most two."""
    if len(axes) == 2:
        a, b = axes
        return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
    if not axes:
        return np.repeat([[1.0], [0.0], [0.0]], count, 1)
    a = axes[0]
    steep = np.abs(a[0]) > 0.6
    other = np.where(steep, [[0.0], [1.0], [0.0]], [[1.0], [0.0], [0.0]])
    perpendicular = other - ((a[0] * other[0] + a[1] * other[1]) + a[2] * other[2]) * a
    size = np.sqrt(
        (perpendicular[0] * perpendicular[0] + perpendicular[1] * perpendicular[1]) + perpendicular[2] * perpendicular[2]
    )
    unit: NumberArray = perpendicular / size
    return unit
