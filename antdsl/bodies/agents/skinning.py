"""Skinning: points and normals of n agents that follow several joints each, by matrices or by dual quaternions.

One matrix per joint moves points from the capture pose to the current pose: world transform times inverse bind matrix.

Linear skinning transforms a point by the weighted mean of these matrices, and a normal by the weighted mean of their transposed
inverses.

Dual quaternion skinning (L. Kavan, S. Collins, J. Zara and C. O'Sullivan, Skinning with Dual Quaternions, I3D 2007) uses the
weighted mean of rigid transforms, so a twisted joint does not lose volume. The sign of each dual quaternion is aligned with that
of the point's strongest joint. A dual quaternion represents only a rotation and a translation. Therefore each matrix is
decomposed into M = R S: R is the nearest rotation (polar decomposition), and S is the remaining scale, shear and mirroring. The
point is first transformed by the linear mean of the S, in capture space, and then by the blended R with the translations. These
two phases are as in L. Kavan et al., Geometric Skinning with Approximate Dual Quaternion Blending, ACM TOG 27, 2008, and in USD.
For a point that follows one joint, the result equals linear skinning. Because S is a linear mean, only rotations blend without
loss of volume.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.affine import (
    Floats,
    NumberArray,
    extract_rotation_matrices,
    invert_and_transpose,
    matrices_to_quaternions,
    multiply_matrices,
    multiply_quaternions,
)
from antdsl.bodies.agents.definition import Definition, SkinShape
from antdsl.bodies.agents.poses import WorldPoses


@dataclass(frozen=True, slots=True, eq=False)
class DeformedShape:
    """A shape for n agents; n is 1 if all agents share it.

    `points`: float32[n, P, 3].
    `normals`: unit vectors float32[n, P, 3], or None.
    `attributes`: float32[n, P, …], other point attributes that a blend shape names.
    """

    points: Floats
    normals: Floats | None
    attributes: dict[str, Floats]


def apply_linear_skinning(
    deformed_shape: DeformedShape, shape: SkinShape, definition: Definition, poses: WorldPoses
) -> DeformedShape:
    """Return a shape after linear blend skinning. Raises ValueError for a shape without a capture, and KeyError for joints that
    the rig does not have."""
    joints, weights, matrices = _compute_joint_transforms(shape, definition, poses)
    x, y, z = _split_components(deformed_shape.points)
    points = np.empty((3, len(joints), matrices.shape[-1]), np.float32)
    for r in range(3):
        a, b, c, d = (_compute_weighted_mean(matrices[r, k], joints, weights) for k in range(4))
        points[r] = ((a * x + b * y) + c * z) + d
    normals = None
    if deformed_shape.normals is not None:
        normals = transform_normals(
            deformed_shape.normals, _compute_matrix_means(invert_and_transpose(matrices), joints, weights)
        )
    return DeformedShape(points.transpose(2, 1, 0), normals, deformed_shape.attributes)


def apply_dual_quaternion_skinning(
    deformed_shape: DeformedShape, shape: SkinShape, definition: Definition, poses: WorldPoses
) -> DeformedShape:
    """Return a shape after dual quaternion skinning in two phases. Raises the errors of `apply_linear_skinning`."""
    joints, weights, matrices = _compute_joint_transforms(shape, definition, poses)
    rotation = extract_rotation_matrices(matrices)
    rest = _remove_rotation(rotation, matrices)
    real = matrices_to_quaternions(rotation)
    moved = np.concatenate([matrices[:, 3], np.zeros_like(matrices[:1, 3])])
    dual = (0.5 * multiply_quaternions(moved.astype(np.float64), real)).astype(np.float32)
    turn, shift = _blend_dual_quaternions(real.astype(np.float32), dual, joints, weights)
    points = transform_points(_compute_matrix_means(rest, joints, weights), deformed_shape.points)
    rotate_points(points, turn)
    points += shift
    normals = None
    if deformed_shape.normals is not None:
        across = transform_points(_compute_matrix_means(invert_and_transpose(rest), joints, weights), deformed_shape.normals)
        rotate_points(across, turn)
        normals = normalise_in_place(across).transpose(2, 1, 0)
    return DeformedShape(points.transpose(2, 1, 0), normals, deformed_shape.attributes)


def blend_skinning_methods(
    deformed_shape: DeformedShape, shape: SkinShape, definition: Definition, poses: WorldPoses
) -> DeformedShape:
    """Return a blend of linear and dual quaternion skinning. The point attribute named by `dual_quaternion_blend` is the weight,
    from 0 (linear) to 1.

    Raises the errors of `apply_linear_skinning`, and ValueError if the shape lacks the attribute."""
    name = shape.dual_quaternion_blend
    if name not in shape.attributes:
        raise ValueError(
            f"shape `{shape.name}` needs the point attribute `{name}`, which its `deformDualQuaternionBlendAttrib` names"
        )
    share = shape.attributes[name].astype(np.float32).reshape(-1)[None, :, None]
    straight, turned_ = (
        apply_linear_skinning(deformed_shape, shape, definition, poses),
        apply_dual_quaternion_skinning(deformed_shape, shape, definition, poses),
    )
    points = straight.points + (turned_.points - straight.points) * share
    normals = None
    if straight.normals is not None and turned_.normals is not None:
        mixed = straight.normals + (turned_.normals - straight.normals) * share
        normals = normalise_in_place(mixed.transpose(2, 1, 0)).transpose(2, 1, 0)
    return DeformedShape(points, normals, deformed_shape.attributes)


def transform_points(matrices: NumberArray, points: Floats) -> Floats:
    """Transform points [n, P, 3] by matrices [3, 4, P, n], or directions by matrices [3, 3, P, n]. Return them as [3, P, n]."""
    x, y, z = _split_components(points)
    products = np.stack([(m[0] * x + m[1] * y) + m[2] * z for m in matrices])
    if matrices.shape[1] == 4:
        products += matrices[:, 3]
    return products


def transform_normals(normals: Floats, matrices: NumberArray) -> Floats:
    """Transform normals [n, P, 3] by matrices [3, 3, P, n] and normalise them. Return them with the same shape."""
    return normalise_in_place(transform_points(matrices, normals)).transpose(2, 1, 0)


def normalise_in_place(vectors: Floats) -> Floats:
    """Normalise vectors [3, …] in place and return them. Vectors of length 0 do not change."""
    x, y, z = vectors
    length = np.sqrt((x * x + y * y) + z * z)
    length[length == 0] = 1
    vectors /= length
    return vectors


def rotate_points(points: Floats, rotation: Floats) -> None:
    """Rotate points [3, P, n] by unit quaternions [4, P, n], in place."""
    qx, qy, qz, qw = rotation
    x, y, z = points
    ux = (qy * z - qz * y) + qw * x
    uy = (qz * x - qx * z) + qw * y
    uz = (qx * y - qy * x) + qw * z
    two = np.float32(2)
    points[0] = x + two * (qy * uz - qz * uy)
    points[1] = y + two * (qz * ux - qx * uz)
    points[2] = z + two * (qx * uy - qy * ux)


def _compute_joint_transforms(
    shape: SkinShape, definition: Definition, poses: WorldPoses
) -> tuple[NDArray[np.intp], Floats, Floats]:
    """Return the joints that each point follows [P, K], their weights [P, K], and a matrix for each joint, float32[3, 4, joints,
    n].

    The matrix of a joint transforms from the capture pose to the current pose."""
    capture = shape.capture
    if capture is None:
        raise ValueError(f"shape `{shape.name}` has no capture weights, so its points cannot follow joints")
    numbers = {name: number for number, name in enumerate(definition.rig.names)}
    missing = [name for name in capture.names if name not in numbers]
    if missing:
        raise KeyError(f"shape `{shape.name}` follows joint `{missing[0]}`, which the rig does not have")
    world = poses.world_transforms.transpose(2, 3, 1, 0)[:, :, [numbers[name] for name in capture.names]]
    inverse = np.ascontiguousarray(np.moveaxis(capture.inverse_matrices[:, :3], 0, -1), np.float32)[..., None]
    used = int(np.flatnonzero((capture.weights != 0).any(axis=0)).max(initial=0)) + 1
    matrices = multiply_matrices(world, inverse, np.empty(world.shape, np.float32))
    return capture.joints[:, :used].astype(np.intp), capture.weights[:, :used].astype(np.float32), matrices


def _split_components(points: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the x, y and z of points [n, P, 3] as three arrays [P, n]."""
    x, y, z = points.transpose(2, 1, 0)
    return x, y, z


def _compute_weighted_mean(values: Floats, joints: NDArray[np.intp], weights: Floats) -> Floats:
    """Return, for each point, the weighted mean of the values [joints, n] of its joints, as [P, n]."""
    mean = values.take(joints[:, 0], axis=0)
    mean *= weights[:, 0, None]
    for k in range(1, joints.shape[1]):
        part = values.take(joints[:, k], axis=0)
        part *= weights[:, k, None]
        mean += part
    return mean


def _compute_matrix_means(matrices: Floats, joints: NDArray[np.intp], weights: Floats) -> Floats:
    """Return, for each point, the weighted mean of its joints' matrices [3, 3 or 4, joints, n], as [3, 3 or 4, P, n]."""
    return np.stack([np.stack([_compute_weighted_mean(each, joints, weights) for each in row]) for row in matrices])


def _remove_rotation(rotation: NDArray[np.float64], matrices: Floats) -> Floats:
    """Return the matrices S = R⁻¹ M, float32[3, 3, joints, n], which are `matrices` M without their rotation R. `rotation`:
    quaternions [4, joints, n]."""
    m = matrices[:, :3].astype(np.float64)
    rest = np.empty(m.shape, np.float32)
    for r in range(3):
        for c in range(3):
            rest[r, c] = (rotation[0, r] * m[0, c] + rotation[1, r] * m[1, c]) + rotation[2, r] * m[2, c]
    return rest


def _blend_dual_quaternions(real: Floats, dual: Floats, joints: NDArray[np.intp], weights: Floats) -> tuple[Floats, Floats]:
    """Return the weighted mean of the joints' dual quaternions for each point, as a rotation [4, P, n] and a translation [3, P,
    n].

    `real`, `dual`: the real and the dual part of the joints' dual quaternions, both [4, joints, n]."""
    most = joints[np.arange(len(joints)), weights.argmax(axis=1)]
    pivot = real.take(most, axis=1)
    turn = np.zeros_like(pivot)
    shift = np.zeros_like(pivot)
    for k in range(joints.shape[1]):
        each = real.take(joints[:, k], axis=1)
        near = each * pivot
        dots = ((near[0] + near[1]) + near[2]) + near[3]
        share = np.where(dots < 0, -weights[:, k, None], weights[:, k, None])
        turn += each * share
        shift += dual.take(joints[:, k], axis=1) * share
    square = turn * turn
    size = np.sqrt(((square[0] + square[1]) + square[2]) + square[3])
    size[size == 0] = 1
    turn /= size
    shift /= size
    (x, y, z, w), (ex, ey, ez, ew) = turn, shift
    two = np.float32(2)
    return turn, np.stack([
        two * (((w * ex - ew * x) + y * ez) - z * ey),
        two * (((w * ey - ew * y) + z * ex) - x * ez),
        two * (((w * ez - ew * z) + x * ey) - y * ex),
    ])  # fmt: skip
