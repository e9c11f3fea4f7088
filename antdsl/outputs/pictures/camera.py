"""A camera with its rays and its projection."""

from dataclasses import dataclass
from math import radians, tan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.vector_rows import unit_or
from antdsl.outputs.pictures.model import Camera
from antdsl.outputs.pictures.shading_rows import Floats

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class CameraView:
    """A camera, prepared for a picture of one size.

    `eye` (3,): its position.
    `right`, `above`, `ahead`: unit axes.
    `half`: the tangents of half the angle of view across width and height. With `parallel` rays: half the width and height in
    world units."""

    eye: Array
    right: Array
    above: Array
    ahead: Array
    half: tuple[float, float]
    width: int
    height: int
    parallel: bool = False

    def rays(self, pixels: NDArray[np.int64], across: float = 0.5, down: float = 0.5) -> tuple[Array, Floats]:
        """Return ray origins, (n, 3) or (3,), and unit directions float32 (n, 3), for pixels (n,) counted row by row.

        `across`, `down`: the position in a pixel, as shares from its upper left corner."""
        row, column = np.divmod(pixels, self.width)
        x = ((column + across) / self.width * 2 - 1) * self.half[0]
        y = (1 - (row + down) / self.height * 2) * self.half[1]
        if self.parallel:
            start = self.eye + x[:, None] * self.right + y[:, None] * self.above
            return start, np.broadcast_to(self.ahead.astype(np.float32), (len(pixels), 3))
        towards = np.empty((len(pixels), 3), np.float32)
        length = 1 / np.sqrt(1 + x * x + y * y)
        for axis in range(3):
            towards[:, axis] = (self.ahead[axis] + x * self.right[axis] + y * self.above[axis]) * length
        return self.eye, towards

    def project(self, points: Array) -> tuple[Array, Array]:
        """Return pixel positions (n, 2) and distances ahead (n,) of world points. Points with a distance ≤ 0 are not in front of
        the camera."""
        offset = np.asarray(points, np.float64) - self.eye
        depth = offset @ self.ahead
        safe = 1.0 if self.parallel else np.where(depth > 1e-9, depth, 1.0)
        x = (offset @ self.right) / safe / self.half[0]
        y = (offset @ self.above) / safe / self.half[1]
        return np.stack([(x + 1) * 0.5 * self.width, (1 - y) * 0.5 * self.height], axis=1), depth

    def distance(self, points: Array) -> Array:
        """Return the distance of each point (n, 3) along its ray."""
        offset = np.asarray(points, np.float64) - self.eye
        return np.asarray(offset @ self.ahead if self.parallel else np.linalg.norm(offset, axis=1))

    def pixel_size(self, depth: Any) -> Any:
        """Return the edge length of a pixel, in world units, at a distance ahead or an array of distances."""
        return (0.0 * depth + 1.0 if self.parallel else depth) * (2 * self.half[0] / self.width)


def make_view(camera: Camera, width: int, height: int, up: tuple[float, float, float]) -> CameraView:
    """Return `camera` prepared for a picture of `width` × `height` pixels. If it is aimed at its own position, it looks along
    x."""
    eye = np.asarray(camera.at, np.float64)
    ahead = unit_or(np.asarray(camera.look_at, np.float64) - eye, np.array([1.0, 0.0, 0.0]))
    upward = unit_or(np.asarray(camera.up or up, np.float64), np.array([0.0, 1.0, 0.0]))
    right = np.cross(ahead, upward)
    if np.linalg.norm(right) < 1e-6:  # straight down: the picture's top is where the next axis points
        right = np.cross(ahead, np.roll(upward, 1))
    right = unit_or(right, np.array([1.0, 0.0, 0.0]))
    if camera.wide is not None:
        across = camera.wide / 2
    else:
        across = tan(radians(min(max(camera.fov, 1.0), 170.0)) / 2) if camera.fov is not None else 18.0 / max(camera.focal, 1.0)
    half = (across, across * height / width)
    return CameraView(eye, right, np.cross(right, ahead), ahead, half, width, height, camera.wide is not None)


def three(values: Array) -> tuple[float, float, float]:
    """Return a point as three Python floats, for a `Camera`."""
    x, y, z = (float(v) for v in values)
    return x, y, z
