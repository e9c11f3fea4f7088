"""A camera's rays and its projection, and two ways to put one: over a whole scene, or at an ant's eye level."""

from dataclasses import dataclass, replace
from math import radians, tan

import numpy as np
from numpy.typing import NDArray

from antdsl.outputs.pictures.model import Camera, Solid

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

    def rays(self, first: int, last: int, samples: int) -> NDArray[np.float32]:
        """Unit directions (rows · samples · width · samples, 3) of the pixel rows `first` to `last`, samples on a regular grid."""
        rows = np.arange(first * samples, last * samples)
        columns = np.arange(self.width * samples)
        x = ((columns + 0.5) / (self.width * samples) * 2 - 1) * self.half[0]
        y = (1 - (rows + 0.5) / (self.height * samples) * 2) * self.half[1]
        towards = self.ahead + x[None, :, None] * self.right + y[:, None, None] * self.above
        towards = towards / np.sqrt((towards * towards).sum(axis=2, keepdims=True))
        return towards.reshape(-1, 3).astype(np.float32)

    def project(self, points: Array) -> tuple[Array, Array]:
        """Pixel places (n, 2) and distances ahead (n,) of world points; not ahead of the camera where the distance is ≤ 0."""
        seen = np.asarray(points, np.float64) - self.eye
        depth = seen @ self.ahead
        safe = np.where(depth > 1e-9, depth, 1.0)
        x = (seen @ self.right) / safe / self.half[0]
        y = (seen @ self.above) / safe / self.half[1]
        return np.stack([(x + 1) * 0.5 * self.width, (1 - y) * 0.5 * self.height], axis=1), depth

    def pixel_at(self, depth: Array) -> Array:
        """How long a pixel's edge is in world units at these distances ahead."""
        return depth * (2 * self.half[0] / self.width)


def view(camera: Camera, width: int, height: int, up: tuple[float, float, float]) -> View:
    """`camera` for a picture of `width` × `height` pixels. A camera that looks at its own place looks along the first level axis."""
    eye = np.asarray(camera.at, np.float64)
    ahead = _unit(np.asarray(camera.look_at, np.float64) - eye, np.array([1.0, 0.0, 0.0]))
    upward = _unit(np.asarray(camera.up or up, np.float64), np.array([0.0, 1.0, 0.0]))
    right = np.cross(ahead, upward)
    if np.linalg.norm(right) < 1e-6:  # straight down: the picture's top is where the next axis points
        right = np.cross(ahead, np.roll(upward, 1))
    right = _unit(right, np.array([1.0, 0.0, 0.0]))
    across = tan(radians(min(max(camera.fov, 1.0), 170.0)) / 2) if camera.fov is not None else 18.0 / max(camera.focal, 1.0)
    return View(eye, right, np.cross(right, ahead), ahead, (across, across * height / width), width, height)


def camera_over(solids: tuple[Solid, ...], up: tuple[float, float, float], *, focal: float = 35.0, aspect: float = 16 / 9) -> Camera:
    """A camera that sees all solids from above at a slant."""
    points = np.concatenate([solid.vertices for solid in solids]) if solids else np.array([[-1.0, -1, -1], [1.0, 1, 1]])
    low, high = points.min(axis=0), points.max(axis=0)
    middle, reach = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    upward = np.asarray(up, np.float64)
    level = _unit(np.cross(upward, np.array([1.0, 0.0, 0.0])), np.array([0.0, 0.0, 1.0]))  # towards −z with y up, so +z faces the camera
    direction = _unit(0.9 * upward - 0.95 * level + 0.28 * np.cross(level, upward), upward)
    distance = 0.98 * reach * focal / 18.0 / max(1.0, 1.15 * 16 / 9 / aspect)
    at = middle + direction * max(distance, 1e-6)
    return Camera(_three(at), _three(middle - 0.06 * reach * upward), focal=focal, up=up)


def camera_at_eye_level(
    position: Array, heading: Array, up: Array, length: float, *, behind: float = 4.5, aside: float = 1.6, high: float = 1.15, focal: float = 28.0
) -> Camera:
    """A camera some body lengths behind an agent, at the height of its back, looking where it heads."""
    upward = _unit(np.asarray(up, np.float64), np.array([0.0, 1.0, 0.0]))
    ahead = np.asarray(heading, np.float64) - upward * float(np.dot(heading, upward))
    ahead = _unit(ahead, np.roll(upward, 1))
    side = np.cross(ahead, upward)
    at = np.asarray(position, np.float64) + length * (-behind * ahead + aside * side + high * upward)
    look = np.asarray(position, np.float64) + length * (2.5 * ahead + 0.35 * upward)
    return Camera(_three(at), _three(look), focal=focal, up=_three(upward))


def moved(camera: Camera, by: Array) -> Camera:
    """The same camera elsewhere, looking the same way."""
    return replace(camera, at=_three(np.asarray(camera.at) + by), look_at=_three(np.asarray(camera.look_at) + by))


def _three(values: Array) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in values)
    return x, y, z


def _unit(vector: Array, otherwise: Array) -> Array:
    length = float(np.linalg.norm(vector))
    return vector / length if length > 1e-9 else otherwise
