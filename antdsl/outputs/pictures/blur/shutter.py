"""The shutter of a picture: the camera's views while it is open, and the times at which bodies are sampled."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from antdsl.outputs.pictures.camera import CameraView, make_view
from antdsl.outputs.pictures.model import Camera, Picture

Array = NDArray[np.float64]

MAX_SHUTTER_TIMES = 6
_PIXELS_PER_TIME = 16.0  # of the longest motion; between two times, samples are spread along their motion


class MovingBodies(Protocol):
    """Bodies that move in straight lines from this frame to the next."""

    @property
    def is_moving(self) -> bool: ...

    def compute_vertices(self, time_offset: float) -> Array:
        """Return the vertices (b, v, 3) at `time_offset` frames after the picture's frame."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Shutter:
    """The views of a camera from the picture's frame until the shutter closes, `open_frames` frames later.

    `first`, `middle`, `last`: the views at the beginning, in the middle, and at the end of this time."""

    first: CameraView
    middle: CameraView
    last: CameraView
    open_frames: float = 0.0

    @property
    def has_camera_motion(self) -> bool:
        """Return whether the camera moves while the shutter is open."""
        return self.first is not self.last

    def find_view(self, time_offset: float) -> CameraView:
        """Return the view at `time_offset` frames after the picture's frame."""
        if not self.has_camera_motion:
            return self.middle
        return self.first.interpolate(self.last, time_offset / self.open_frames)

    def choose_times(self, bodies: list[MovingBodies]) -> list[float]:
        """Return the times at which the open shutter is sampled, in frames after the picture's frame.

        Their number depends on the longest motion in pixels."""
        if self.open_frames <= 0:
            return [0.0]
        longest = 0.0
        for part in bodies:
            if part.is_moving or self.has_camera_motion:
                ends = [part.compute_vertices(time)[:, ::7].reshape(-1, 3) for time in (0.0, self.open_frames)]
                (a, first), (b, last) = (view.project(end) for view, end in zip((self.first, self.last), ends, strict=True))
                size = np.array([self.middle.width, self.middle.height])
                seen = (first > 0) & (last > 0) & ((a > -size) & (a < 2 * size)).all(axis=1)
                displacement = np.linalg.norm(b - a, axis=1)[seen]
                longest = max(longest, float(np.quantile(displacement, 0.99)) if len(displacement) else 0.0)
        count = int(np.clip(np.ceil(longest / _PIXELS_PER_TIME), 1, MAX_SHUTTER_TIMES))
        return [self.open_frames * (k + 0.5) / count for k in range(count)]


def make_shutter(
    picture: Picture, camera: Camera, next_camera: Camera | None, size: tuple[int, int], open_frames: float
) -> Shutter:
    """Return the views of a camera while the shutter is open.

    `next_camera`: the camera in the next frame; None if it does not move. `size`: width and height of the picture in pixels."""
    first = make_view(camera, *size, picture.up)
    if next_camera is None or next_camera == camera or open_frames <= 0:
        return Shutter(first, first, first, open_frames)
    last = first.interpolate(make_view(next_camera, *size, picture.up), open_frames)
    return Shutter(first, first.interpolate(last, 0.5), last, open_frames)
