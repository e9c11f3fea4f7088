"""The motion of the world's things: the vertices of a mesh, the positions of items, or the points of a curve at each frame.

The complete motion is in memory from the start, so a position depends only on the frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from antdsl.scene.geometry.matrices import (
    apply_transforms,
    compose_transforms,
    invert_transforms,
    make_identity_transforms,
    multiply_matrices,
)

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class MeshMotion:
    """The motion of a mesh's vertices over frames.

    `tracks` float64 (tracks, frames, 3, 4): `tracks[track_indices[v], k]` is the transform of vertex v from frame 0 to frame k.
    `track_indices`: the track of each vertex.
    `deformed_vertices`: the indices of m vertices that are also shifted after the transform.
    `offsets` float64 (frames, m, 3): the shifts of these vertices in mm."""

    track_indices: NDArray[np.int32]
    tracks: Floats
    deformed_vertices: NDArray[np.int64]
    offsets: NDArray[np.float64]

    @property
    def frame_count(self) -> int:
        """Return the number of frames."""
        return int(self.tracks.shape[1])

    @staticmethod
    def from_transforms(transforms: Floats, count: int) -> MeshMotion:
        """Return the motion of `count` vertices that all follow the same transforms. `transforms` (frames, 3, 4): from one
        common space to each frame.

        The first transform must have an inverse."""
        track = compose_transforms(transforms, invert_transforms(transforms[0]))
        track[(transforms == transforms[0]).all(axis=(1, 2))] = make_identity_transforms()
        return MeshMotion(np.zeros(count, np.int32), track[None], np.empty(0, np.int64), np.empty((0, 0, 3), np.float64))

    @staticmethod
    def from_positions(positions: Floats) -> MeshMotion:
        """Return the motion of vertices that move independently of each other. `positions` (frames, n, 3)."""
        frames, count = positions.shape[:2]
        offsets = (positions - positions[0]).astype(np.float64)
        return MeshMotion(np.zeros(count, np.int32), make_identity_transforms(1, frames), np.arange(count), offsets)

    def compute_vertices(self, rest_positions: Floats, frame: int) -> Floats:
        """Return the vertices (n, 3) at a frame, counted from 0. `rest_positions`: their positions at frame 0.

        Before the first frame and after the last frame, the vertices do not move."""
        k = min(max(frame, 0), self.frame_count - 1)
        place = apply_transforms(self.tracks[:, k].take(self.track_indices, axis=0), rest_positions)
        if len(self.deformed_vertices):
            place[self.deformed_vertices] += self.offsets[k]
        return np.ascontiguousarray(place)

    def transform_motion(self, transforms: Floats) -> MeshMotion:
        """Return the same motion in another space. `transforms` (frames, 3, 4): from the current space to the other space."""
        back = invert_transforms(transforms[0])
        tracks = compose_transforms(compose_transforms(transforms[None], self.tracks), back)
        tracks[
            :, (transforms == transforms[0]).all(axis=(1, 2)) & (self.tracks == make_identity_transforms()).all(axis=(0, 2, 3))
        ] = make_identity_transforms()
        turn = transforms[: len(self.offsets), :, :3]
        offsets = multiply_matrices(self.offsets, np.swapaxes(turn, 1, 2))
        return MeshMotion(self.track_indices, tracks, self.deformed_vertices, offsets)

    def select_vertices(self, vertex_numbers: NDArray[np.int64]) -> MeshMotion:
        """Return the motion of only some vertices. `vertex_numbers`: the indices of these vertices, ascending."""
        place = np.full(len(self.track_indices), -1)
        place[vertex_numbers] = np.arange(len(vertex_numbers))
        left = np.flatnonzero(place[self.deformed_vertices] >= 0)
        return MeshMotion(
            self.track_indices[vertex_numbers], self.tracks, place[self.deformed_vertices[left]], self.offsets[:, left]
        )


@dataclass(frozen=True, slots=True, eq=False)
class GeometryMotion:
    """The motion of all moving things, by name.

    `first`: the frame of the scene at which the tracks begin (index 0).
    `items`, `curves`: positions (frames, n, 3) in mm."""

    first: int = 0
    meshes: Mapping[str, MeshMotion] = field(default_factory=dict)
    items: Mapping[str, Floats] = field(default_factory=dict)
    curves: Mapping[str, Floats] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return bool(self.meshes or self.items or self.curves)

    def find_positions(self, tracks: Floats, frame: int) -> Floats:
        """Return the positions (n, 3) of items or of a curve at a frame of the scene.

        `tracks` (frames, n, 3): the positions at all frames. Before the first and after the last of them, the nearest frame is
        used."""
        frame_positions: Floats = tracks[min(max(frame - self.first, 0), len(tracks) - 1)]
        return frame_positions
