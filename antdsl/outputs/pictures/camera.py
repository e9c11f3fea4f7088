"""A camera prepared for a picture: its rays and its projection."""

from dataclasses import dataclass, replace
from math import radians, tan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.vector_rows import compute_view_axes
from antdsl.outputs.pictures.model import Camera
from antdsl.outputs.pictures.shading_rows import Floats

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class CameraView:
    """A camera, prepared for a picture of one size.

    `eye` (3,): its position. `right_axis`, `up_axis`, `forward_axis`: unit axes. `half_extent`: the tangents of half the
    angles of view in width and height; if `is_parallel`, half the width and height in world units. `is_parallel`: whether rays
    are parallel. `aperture`: the diameter of the lens in world units, 0 for a pinhole. `focus`: the distance ahead that is in
    focus."""

    eye: Array
    right_axis: Array
    up_axis: Array
    forward_axis: Array
    half_extent: tuple[float, float]
    width: int
    height: int
    is_parallel: bool = False
    aperture: float = 0.0
    focus: float = 1.0

    def interpolate(self, other: "CameraView", share: float) -> "CameraView":
        """Return the view at the fraction `share` between this view and `other`. Both have the same size."""

        def mix(first: Any, second: Any) -> Any:
            return first * (1 - share) + second * share

        forward = mix(self.forward_axis, other.forward_axis)
        forward /= np.linalg.norm(forward)
        right = mix(self.right_axis, other.right_axis)
        right -= forward * float(right @ forward)
        right /= np.linalg.norm(right)
        wide, high = (mix(a, b) for a, b in zip(self.half_extent, other.half_extent, strict=True))
        return replace(
            self,
            eye=mix(self.eye, other.eye),
            right_axis=right,
            up_axis=np.cross(right, forward),
            forward_axis=forward,
            half_extent=(wide, high),
            aperture=mix(self.aperture, other.aperture),
            focus=mix(self.focus, other.focus),
        )

    def make_rays(self, pixels: NDArray[np.int64], pixel_x: float = 0.5, pixel_y: float = 0.5) -> tuple[Array, Floats]:
        """Return the origins, (n, 3) or (3,), and the unit directions float32 (n, 3) of rays for `pixels` (n,), which are
        numbered row by row.

        `pixel_x`, `pixel_y`: the position of the rays in their pixels, as fractions from the upper left corner."""
        row, column = np.divmod(pixels, self.width)
        x = ((column + pixel_x) / self.width * 2 - 1) * self.half_extent[0]
        y = (1 - (row + pixel_y) / self.height * 2) * self.half_extent[1]
        if self.is_parallel:
            start = self.eye + x[:, None] * self.right_axis + y[:, None] * self.up_axis
            return start, np.broadcast_to(self.forward_axis.astype(np.float32), (len(pixels), 3))
        towards = np.empty((len(pixels), 3), np.float32)
        length = 1 / np.sqrt(1 + x * x + y * y)
        for axis in range(3):
            towards[:, axis] = (self.forward_axis[axis] + x * self.right_axis[axis] + y * self.up_axis[axis]) * length
        return self.eye, towards

    def project(self, points: Array) -> tuple[Array, Array]:
        """Return the pixel position (n, 2) and the distance ahead (n,) of each point. Points with a distance ≤ 0 are not in front
        of the camera."""
        offset = np.asarray(points, np.float64) - self.eye
        depth = offset @ self.forward_axis
        safe = 1.0 if self.is_parallel else np.where(depth > 1e-9, depth, 1.0)
        x = (offset @ self.right_axis) / safe / self.half_extent[0]
        y = (offset @ self.up_axis) / safe / self.half_extent[1]
        return np.stack([(x + 1) * 0.5 * self.width, (1 - y) * 0.5 * self.height], axis=1), depth

    def compute_distances(self, points: Array) -> Array:
        """Return the distance of each point (n, 3) from the camera along its ray."""
        offset = np.asarray(points, np.float64) - self.eye
        return np.asarray(offset @ self.forward_axis if self.is_parallel else np.linalg.norm(offset, axis=1))

    def compute_depths(self, distances: Floats) -> Floats:
        """Return the distances ahead of the camera for points on the rays of all pixels. `distances` (h · w,): their distances
        along the rays."""
        if self.is_parallel:
            return distances
        x = ((np.arange(self.width) + 0.5) / self.width * 2 - 1) * self.half_extent[0]
        y = (1 - (np.arange(self.height) + 0.5) / self.height * 2) * self.half_extent[1]
        return np.asarray(distances / np.sqrt(1 + x * x + (y * y)[:, None]).reshape(-1))

    def compute_pixel_size(self, depth: Any) -> Any:
        """Return the edge length of a pixel, in world units, at the distance `depth` ahead of the camera. `depth`: a number or an
        array."""
        return (0.0 * depth + 1.0 if self.is_parallel else depth) * (2 * self.half_extent[0] / self.width)


def make_view(camera: Camera, width: int, height: int, up: tuple[float, float, float]) -> CameraView:
    """Return a camera prepared for a picture of `width` × `height` pixels. If it looks at its own position, it looks along +x."""
    eye = np.asarray(camera.at, np.float64)
    right, top, ahead = compute_view_axes(eye, np.asarray(camera.look_at, np.float64), np.asarray(camera.up or up, np.float64))
    if camera.parallel_width is not None:
        across = camera.parallel_width / 2
    else:
        across = tan(radians(min(max(camera.fov, 1.0), 170.0)) / 2) if camera.fov is not None else 18.0 / max(camera.focal, 1.0)
    half = (across, across * height / width)
    is_parallel = camera.parallel_width is not None
    focus = float(np.linalg.norm(np.subtract(camera.look_at, camera.at))) if camera.focus is None else camera.focus
    aperture = 0.0 if is_parallel else camera.aperture
    return CameraView(eye, right, top, ahead, half, width, height, is_parallel, aperture, max(focus, 1e-9))


def to_tuple(values: Array) -> tuple[float, float, float]:
    """Return a point as three Python floats, as `Camera` expects them."""
    x, y, z = (float(v) for v in values)
    return x, y, z
