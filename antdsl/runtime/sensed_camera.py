"""Cameras as agents sense them: a position and a field of view at each frame. They depend on the scene and the frame alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import vectors as vec
from antdsl.numerics.vector_rows import compute_view_axes
from antdsl.scene.setting import DEFAULT_FOCAL_MM, SENSOR_WIDTH_MM, CameraData

VIEW_ASPECT = 16 / 9  # width over height of the picture that `in_view` is about
Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class SensedCamera:
    """A camera of a world. `origin` (3,): the point in mm that the world's positions are relative to."""

    data: CameraData
    origin: Floats

    def find_position(self, frame: int) -> Floats:
        """Return the position (3,) in mm at a frame."""
        place: Floats = self.data.at[self.data.find_row(frame)] - self.origin
        return place

    def find_in_view(self, frame: int, place: Floats, margin: Floats) -> NDArray[np.bool_]:
        """Return which positions (n, 3) the picture at a frame shows, or would show with `margin` (mm) more room on each side.

        A margin below 0 leaves out what is near the edge."""
        row = self.data.find_row(frame)
        eye, aim = self.data.at[row] - self.origin, self.data.look_at[row] - self.origin
        right, up, ahead = compute_view_axes(eye, aim, self.data.up[row])
        offset = vec.subtract(place.T, eye)
        depth = vec.dot(offset, ahead)
        across = SENSOR_WIDTH_MM / 2 / (float(self.data.focal[row]) or DEFAULT_FOCAL_MM)
        is_in_view: NDArray[np.bool_] = depth > -margin
        for axis, tangent in ((right, across), (up, across / VIEW_ASPECT)):
            is_in_view &= np.abs(vec.dot(offset, axis)) - depth * tangent <= margin * np.sqrt(1 + tangent * tangent)
        return is_in_view
