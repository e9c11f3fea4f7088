"""Joint rotations of many agents, and arithmetic with vectors [3, n], in which the component axis comes first.

Sums are in a fixed order, so results have the same bits for any number of agents."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.affine import Floats, NumberArray, compose_matrices, normalise_quaternions
from antdsl.bodies.agents.leg_chains import Joints


def build_rotation_matrices(quaternions: NDArray[np.floating]) -> NumberArray:
    """Return matrices float64[3, 3, n] of quaternions [n, 4]. A zero quaternion becomes the identity."""
    q = normalise_quaternions(np.array(np.asarray(quaternions, np.float64).T, order="C"))
    return compose_matrices(np.zeros((3, q.shape[1])), q, None, None, np.empty((3, 4, q.shape[1])))[:, :3]


def compute_heel_rotation(arch: Floats, to_hip: Floats, reach: Floats) -> Floats:
    """Return the vectors [3, n] from foot joints to ankles after raising the heels just enough for the bones to reach the
    ankles.

    `arch` [3, n]: these vectors with flat soles. `to_hip` [3, n]: from the foot joints to the hips. `reach` [n]: the greatest
    distance from hip to ankle."""
    size, far = measure_lengths(arch), measure_lengths(to_hip)
    towards = normalise(to_hip)
    along = dot(arch, towards)
    across = arch - towards * along
    tiny = np.float32(1e-6) * far
    needed = (size * size + far * far - reach * reach) / np.maximum(2 * size * far, np.float32(1e-20))
    is_short = (measure_lengths(to_hip - arch) > reach) & (measure_lengths(across) > tiny)
    cosine = np.clip(needed, -1, 1)
    raised = towards * (size * cosine) + normalise(across) * (size * np.sqrt(1 - cosine * cosine))
    return np.asarray(np.where(is_short, raised, arch))


def rotate_vectors(matrices: Floats, vectors: Floats) -> Floats:
    """Return vectors [3, n] rotated by matrices [3, 3, n]."""
    return np.stack([(m[0] * vectors[0] + m[1] * vectors[1]) + m[2] * vectors[2] for m in matrices])


def rotate_vectors_by_inverse(matrices: Floats, vectors: Floats) -> Floats:
    """Return vectors [3, n] rotated by the inverses (transposes) of rotation matrices [3, 3, n] or [3, 3]."""
    m, (x, y, z) = matrices, vectors
    return np.stack([(m[0, r] * x + m[1, r] * y) + m[2, r] * z for r in range(3)])


def rotate_joints(world: Floats, joints: Joints, turn: Floats, pivots: Floats) -> None:
    """Rotate `joints` in the world matrices `world` [3, 4, J, n] by `turn` [3, 3, n] about the points `pivots` [3, n], in
    place."""
    old = world[:, :, joints]
    old[:, 3] -= pivots[:, None]
    for r in range(3):
        new = (turn[r, 0] * old[0] + turn[r, 1] * old[1]) + turn[r, 2] * old[2]
        new[3] += pivots[r]
        world[r][:, joints] = new


def build_axis_rotation(axis: Floats, cosine: Floats, sine: Floats) -> Floats:
    """Return matrices [3, 3, n] of rotations about unit axes [3, n], from the cosine and sine of their angles (Rodrigues'
    formula)."""
    x, y, z = axis
    left = 1 - cosine
    return np.stack([
        np.stack([cosine + x * x * left, x * y * left - z * sine, x * z * left + y * sine]),
        np.stack([x * y * left + z * sine, cosine + y * y * left, y * z * left - x * sine]),
        np.stack([x * z * left - y * sine, y * z * left + x * sine, cosine + z * z * left]),
    ])  # fmt: skip


def build_rotation_between(a: Floats, b: Floats) -> Floats:
    """Return matrices [3, 3, n] of the shortest rotations from unit vectors `a` [3, n] to unit vectors `b` [3, n]."""
    axis, cosine = cross(a, b), dot(a, b)
    x, y, z = axis
    by = 1 / np.maximum(1 + cosine, np.float32(1e-6))
    return np.stack([
        np.stack([cosine + x * x * by, x * y * by - z, x * z * by + y]),
        np.stack([x * y * by + z, cosine + y * y * by, y * z * by - x]),
        np.stack([x * z * by - y, y * z * by + x, cosine + z * z * by]),
    ])  # fmt: skip


def dot(a: Floats, b: Floats) -> Floats:
    product: Floats = (a[0] * b[0] + a[1] * b[1]) + a[2] * b[2]
    return product


def cross(a: Floats, b: Floats) -> Floats:
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def measure_lengths(v: Floats) -> Floats:
    return np.asarray(np.sqrt(dot(v, v)))


def normalise(v: Floats) -> Floats:
    return np.asarray(v / np.maximum(measure_lengths(v), np.float32(1e-12)))
