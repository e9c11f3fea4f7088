"""Cameras as agents sense them: a position and a field of view in each frame. They depend only on the scene and the frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import vectors as vec
from antdsl.numerics.vector_rows import compute_view_axes
from antdsl.scene.setting import DEFAULT_FOCAL_MM, SENSOR_WIDTH_MM, CameraData

if TYPE_CHECKING:
    from antdsl.scene.notes.selectors import View

SENSED_VIEW_ASPECT_RATIO = 16 / 9  # width over height of the picture that `in_view` is about
Floats = NDArray[np.float64]


class ViewPyramid(NamedTuple):
    """The space that a camera sees: everything between four planes through the `eye_position` (3,).

    `view_direction` (3,): the unit vector of the viewing direction. `side_planes`: for the right and for the top of the picture,
    a unit vector (3,) and the tangent of half the angle of view along it."""

    eye_position: Floats
    view_direction: Floats
    side_planes: tuple[tuple[Floats, float], tuple[Floats, float]]


@dataclass(frozen=True, slots=True, eq=False)
class SensedCamera:
    """A camera of a world. `origin` (3,) mm: the point to which the world's positions are relative."""

    data: CameraData
    origin: Floats

    def find_position(self, frame: int) -> Floats:
        """Return the camera's position (3,) in mm at a frame."""
        place: Floats = self.data.at[self.data.find_row(frame)] - self.origin
        return place

    def find_view_pyramid(self, frame: int) -> ViewPyramid:
        """Return the space that the camera sees at a frame."""
        row = self.data.find_row(frame)
        eye, aim = self.data.at[row] - self.origin, self.data.look_at[row] - self.origin
        right, up, ahead = compute_view_axes(eye, aim, self.data.up[row])
        across = SENSOR_WIDTH_MM / 2 / (float(self.data.focal[row]) or DEFAULT_FOCAL_MM)
        return ViewPyramid(eye, ahead, ((right, across), (up, across / SENSED_VIEW_ASPECT_RATIO)))

    def find_positions_in_view(self, frame: int, place: Floats, margin: Floats | float = 0.0) -> NDArray[np.bool_]:
        """Return a mask of the positions (n, 3) that are in the picture at a frame, enlarged by `margin` (mm) on each side.

        A negative margin excludes positions near the edge."""
        eye, ahead, sides = self.find_view_pyramid(frame)
        offset = vec.subtract(place.T, eye)
        depth = vec.dot(offset, ahead)
        is_in_view: NDArray[np.bool_] = depth > -margin
        for axis, tangent in sides:
            is_in_view &= np.abs(vec.dot(offset, axis)) - depth * tangent <= margin * np.sqrt(1 + tangent * tangent)
        return is_in_view


@dataclass(frozen=True, slots=True, eq=False)
class CameraInFrame:
    """A camera in one frame, for selectors. Positions are in mm, relative to the scene's origin."""

    data: CameraData
    frame: int

    def find_position(self) -> Floats:
        return SensedCamera(self.data, np.zeros(3)).find_position(self.frame)

    def find_visible(self, position: Floats, view: View) -> NDArray[np.bool_]:
        """Return a mask of the positions (n, 3) that are in the given part of the picture."""
        camera = SensedCamera(self.data, np.zeros(3))
        is_visible = camera.find_positions_in_view(self.frame, position)
        eye, ahead, sides = camera.find_view_pyramid(self.frame)
        offset = vec.subtract(position.T, eye)
        depth = vec.dot(offset, ahead)
        for (axis, tangent), (low, high) in zip(sides, (view.across, view.up), strict=True):
            along, half = vec.dot(offset, axis), depth * tangent
            is_visible &= ((low <= 0) | (along >= (2 * low - 1) * half)) & ((high >= 1) | (along <= (2 * high - 1) * half))
        return is_visible
