"""Orientations as angles about x, y and z for animation curves, without jumps from frame to frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.body import build_rotation_matrices

Floats = NDArray[np.float64]
_GIMBAL_LOCK_COSINE = 1e-6  # cosine of the middle angle; below it, only the sum or difference of the other angles is defined


class EulerAngles:
    """The angles of agents about x, then y, then z, frame by frame.

    Of all equivalent angles, each agent gets those nearest to its previous angles (least sum of squares). New agents get those
    nearest to 0."""

    def __init__(self) -> None:
        self._ids: NDArray[np.int64] = np.empty(0, np.int64)
        self._last_angles: Floats = np.empty((0, 3))

    def compute_angles(self, ids: NDArray[np.int64], orient: NDArray[np.floating]) -> Floats:
        """Return the angles (n, 3) in degrees for orientations `orient` (n, 4), quaternions x, y, z, w. Zero length means no
        rotation.

        `ids` (n,): the agents, ascending."""
        previous = np.zeros((len(ids), 3))
        if len(self._ids):
            at = np.minimum(np.searchsorted(self._ids, ids), len(self._ids) - 1)
            previous = np.where((self._ids[at] == ids)[:, None], self._last_angles[at], previous)
        angles = find_nearest_angles(build_rotation_matrices(np.asarray(orient, np.float64)), previous)
        self._ids, self._last_angles = ids.copy(), angles
        return np.degrees(angles)


def find_nearest_angles(rotations: Floats, previous_angles: Floats) -> Floats:
    """Return angles (n, 3) about x, then y, then z, in radians, for rotation matrices (n, 3, 3) that act on column vectors.

    Of all equivalent angles, those nearest to `previous_angles` are returned. The outer angle is computed first, and the others
    from the rotation that remains. So the angles reproduce the matrix even if the middle angle is near 90 degrees (M. Day,
    Extracting Euler Angles from a Rotation Matrix, Insomniac Games, 2014)."""
    flat = np.hypot(rotations[:, 0, 0], rotations[:, 1, 0])
    outer = np.where(flat > _GIMBAL_LOCK_COSINE, np.arctan2(rotations[:, 1, 0], rotations[:, 0, 0]), previous_angles[:, 2])
    c, s = np.cos(outer), np.sin(outer)
    middle = np.arctan2(-rotations[:, 2, 0], c * rotations[:, 0, 0] + s * rotations[:, 1, 0])
    inner = np.arctan2(s * rotations[:, 0, 2] - c * rotations[:, 1, 2], c * rotations[:, 1, 1] - s * rotations[:, 0, 1])
    one = _unwrap_angles(np.stack([inner, middle, outer], axis=1), previous_angles)
    other = _unwrap_angles(np.stack([inner + np.pi, np.pi - middle, outer + np.pi], axis=1), previous_angles)
    nearer = ((other - previous_angles) ** 2).sum(axis=1) < ((one - previous_angles) ** 2).sum(axis=1)
    return np.where(nearer[:, None], other, one)


def _unwrap_angles(angles: Floats, previous_angles: Floats) -> Floats:
    """Return each angle shifted by full turns, so that it is nearest to the previous angle."""
    return angles - 2 * np.pi * np.round((angles - previous_angles) / (2 * np.pi))
