"""A camera's rays and its projection."""

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
class View:
    """A camera made ready: `eye` (3,), `right`, `above`, `ahead` unit axes, `half` the tangents of half the width and height."""

    eye: Array
    right: Array
    above: Array
    ahead: Array
    half: tuple[float, float]
    width: int
    height: int

    def rays(self, first: int, last: int, samples: int) -> Floats:
        """Unit directions (rows · samples · width · samples, 3) of the pixel rows `first` to `last`, on a regular grid."""
        rows = np.arange(first * samples, last * samples)
        columns = np.arange(self.width * samples)
        x = ((columns + 0.5) / (self.width * samples) * 2 - 1) * self.half[0]
        y = (1 - (rows + 0.5) / (self.height * samples) * 2) * self.half[1]
        towards = self.ahead + x[None, :, None] * self.right + y[:, None, None] * self.above
        length = np.sqrt(1 + x[None, :] ** 2 + y[:, None] ** 2)
        return (towards / length[:, :, None]).reshape(-1, 3).astype(np.float32)

    def project(self, points: Array) -> tuple[Array, Array]:
        """Pixel places (n, 2) and distances ahead (n,) of world points; not ahead of the camera where the distance is ≤ 0."""
        seen = np.asarray(points, np.float64) - self.eye
        depth = seen @ self.ahead
        safe = np.where(depth > 1e-9, depth, 1.0)
        x = (seen @ self.right) / safe / self.half[0]
        y = (seen @ self.above) / safe / self.half[1]
        return np.stack([(x + 1) * 0.5 * self.width, (1 - y) * 0.5 * self.height], axis=1), depth

    def pixel_at(self, depth: Any) -> Any:
        """How long a pixel's edge is in world units at distances ahead, one or an array."""
        return depth * (2 * self.half[0] / self.width)


def view(camera: Camera, width: int, height: int, up: tuple[float, float, float]) -> View:
    """`camera` for a picture of `width` × `height` pixels. One that looks at its own place looks along x."""
    eye = np.asarray(camera.at, np.float64)
    ahead = unit_or(np.asarray(camera.look_at, np.float64) - eye, np.array([1.0, 0.0, 0.0]))
    upward = unit_or(np.asarray(camera.up or up, np.float64), np.array([0.0, 1.0, 0.0]))
    right = np.cross(ahead, upward)
    if np.linalg.norm(right) < 1e-6:  # straight down: the picture's top is where the next axis points
        right = np.cross(ahead, np.roll(upward, 1))
    right = unit_or(right, np.array([1.0, 0.0, 0.0]))
    across = tan(radians(min(max(camera.fov, 1.0), 170.0)) / 2) if camera.fov is not None else 18.0 / max(camera.focal, 1.0)
    return View(eye, right, np.cross(right, ahead), ahead, (across, across * height / width), width, height)


def three(values: Array) -> tuple[float, float, float]:
    """A point as the plain numbers that a `Camera` holds."""
    x, y, z = (float(v) for v in values)
    return x, y, z
