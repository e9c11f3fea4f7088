"""Cameras that move with one agent. They depend on its positions in a range of frames, but not on which frames were drawn before.

The motion of the agent is averaged over some time before and after each frame, so that the camera does not shake. The camera does
not turn with the agent: its direction is transported along the agent's path over the ground."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.body import rotate_vectors
from antdsl.numerics.vector_rows import dot, normalise
from antdsl.outputs.pictures.camera import to_tuple
from antdsl.outputs.pictures.model import Camera, Crowd

Array = NDArray[np.float64]

SMOOTH_SECONDS = 0.5  # the motion of an agent is averaged over this time before and after a frame
CLOSE_FOCAL_MM, EYE_FOCAL_MM = 35.0, 26.0
_CLOSE_ELEVATION = np.radians(16.7)
_EYE_BACK, _EYE_UP, _EYE_AIM = 2.8, 0.85, 0.8  # in longest sides of a body: the camera behind and above it, its aim ahead of it
_FILLED_SHARES = 0.46, 0.225  # half of the picture's width and height that a close body fills, at the distance of its centre
_MAX_OFF_CENTRE = 0.1  # in distances from the camera: how far off the aim an agent may be
_LEVEL_COSINES = 0.2, 0.8  # of the agent's up: the horizon is level above the second, and the agent's own below the first


class AgentTrack(NamedTuple):
    """The track of one agent. `frames` int64[n]: ascending. `position` (n, 3), `orient` (n, 4): its pose in each of these
    frames."""

    frames: NDArray[np.int64]
    position: Array
    orient: Array


class BodySize(NamedTuple):
    """The size of a posed body in world units: its radius sideways, its height, and the longest side of its bounding box."""

    radius: float
    height: float
    longest: float


def measure_body(crowd: Crowd, row: int) -> BodySize:
    """Return the size of the bounding box of an agent's posed body."""
    points = np.asarray(crowd.pose_vertices(crowd.body, np.array([row]))[0][0], np.float64) * float(crowd.scale[row])
    low, high = (points.min(axis=0), points.max(axis=0)) if len(points) else (np.zeros(3), np.full(3, float(crowd.scale[row])))
    length, height, width = np.maximum(high - np.minimum(low, [np.inf, 0.0, np.inf]), 1e-9).tolist()
    return BodySize(max(length, width) / 2, height, max(length, height, width))


def take_track(crowd: Crowd, row: int, frame: int) -> AgentTrack:
    """Return a track of an agent that consists of one frame."""
    rows = slice(row, row + 1)
    return AgentTrack(np.array([frame]), np.asarray(crowd.position, np.float64)[rows], np.asarray(crowd.orient, np.float64)[rows])


@dataclass(frozen=True, slots=True, eq=False)
class StableTrack:
    """The smoothed motion of an agent in n frames.

    `reach`: the number of frames before and after each frame over which the motion is averaged. `position`, `place` (n, 3): the
    position before and after smoothing. `up` (n, 3): the smoothed up direction of the agent. `ahead` (n, 3): the agent's heading
    in the first frame, transported along the ground. `level` (n, 3): the unit vector that points to the top of the picture."""

    frames: NDArray[np.int64]
    reach: float
    position: Array
    place: Array
    up: Array
    ahead: Array
    level: Array

    @classmethod
    def of(cls, track: AgentTrack, reach: float, upright: Array) -> StableTrack:
        """Return the smoothed motion of a track. `upright`: the up direction of the world."""
        up = normalise(
            _smooth_values(rotate_vectors(track.orient, np.tile([0.0, 1.0, 0.0], (len(track.frames), 1))), track.frames, reach)
        )
        ahead = np.empty_like(up)
        ahead[0] = rotate_vectors(track.orient[:1], np.array([[1.0, 0.0, 0.0]]))[0]
        for row in range(len(up)):
            previous = ahead[max(row - 1, 0)]
            ahead[row] = normalise(previous - dot(previous, up[row]) * up[row])
        low, high = _LEVEL_COSINES
        share = np.clip((dot(up, upright) - low) / (high - low), 0.0, 1.0)
        share = (share * share * (3 - 2 * share))[:, None]
        level = normalise(_smooth_values(share * upright + (1 - share) * up, track.frames, reach))
        return cls(
            track.frames,
            reach,
            track.position,
            _smooth_values(track.position, track.frames, reach, has_trend=True),
            up,
            ahead,
            level,
        )


def _smooth_values(values: Array, frames: NDArray[np.int64], reach: float, has_trend: bool = False) -> Array:
    """Return values (n, 3) averaged over `reach` frames before and after each frame.

    `has_trend`: whether to correct the ends, so that they do not lag behind a steady motion."""
    smooth = np.empty_like(values)
    for row, frame in enumerate(frames.tolist()):
        near = slice(*np.searchsorted(frames, [frame - reach, frame + reach + 1]).tolist())
        away = (frames[near] - frame).astype(np.float64)
        weights = (1 - np.minimum(np.abs(away) / (reach + 1), 1.0) ** 2) ** 2
        first, second = weights @ away, weights @ (away * away)
        spread = weights.sum() * second - first * first
        if has_trend and spread > 1e-9:
            weights = weights * (second - first * away) / spread
        else:
            weights = weights / weights.sum()
        smooth[row] = weights @ values[near]
    return smooth


@dataclass(frozen=True, slots=True, eq=False)
class FollowingCamera:
    """A camera that moves with an agent.

    `centre` (n, 3): the points of the smoothed track that the camera follows, never far from the agent. `angle`: the direction
    from the agent to the camera, in radians to the right of its heading in the first frame. `is_close`: whether the body fills
    the picture; otherwise the camera is at eye level, with other agents in view. `offset` (3,): if set, the vector from the agent
    to the camera in the axes of the world, used instead of `angle`. `rise` (n, 1): how much the camera is raised, towards the top
    of the picture. `nearness` (n, 1): the factor by which its distance is multiplied."""

    track: StableTrack
    body: BodySize
    focal: float
    centre: Array
    angle: float = 0.0
    is_close: bool = True
    offset: Array | None = None
    rise: Array | None = None
    nearness: Array | None = None

    @classmethod
    def of(
        cls,
        track: StableTrack,
        body: BodySize,
        focal: float,
        angle: float = 0.0,
        is_close: bool = True,
        offset: Array | None = None,
    ) -> FollowingCamera:
        """Return a camera that follows a track. Where smoothing moves the track too far from the agent, the camera stays nearer
        to the agent."""
        camera = cls(track, body, focal, track.place, angle, is_close, offset)
        first = camera.make_camera(int(track.frames[0]))
        most = _MAX_OFF_CENTRE * float(np.linalg.norm(np.subtract(first.at, first.look_at)))
        away = track.position - track.place
        shift = away * np.maximum(0.0, 1 - most / np.maximum(np.linalg.norm(away, axis=1), 1e-12))[:, None]
        return replace(camera, centre=_smooth_values(track.place + shift, track.frames, track.reach / 2, has_trend=True))

    def make_camera(self, frame: int) -> Camera:
        """Return the camera at a frame. Frames before or after the track get the track's first or last camera."""
        track = self.track
        row = min(max(int(np.searchsorted(track.frames, frame, "right")) - 1, 0), len(track.frames) - 1)
        place, up, ahead = self.centre[row], track.up[row], track.ahead[row]
        level = np.cos(self.angle) * ahead + np.sin(self.angle) * np.cross(ahead, up)
        aim, top = place + self.body.height / 2 * up, track.level[row]
        if self.offset is not None:
            top = track.level[0]
            eye, aim = place + self.offset, place + self.body.height / 2 * top
        elif self.is_close:
            eye = aim + self._find_close_distance() * (np.cos(_CLOSE_ELEVATION) * level + np.sin(_CLOSE_ELEVATION) * up)
        else:
            eye = place + self.body.longest * (_EYE_BACK * level + _EYE_UP * up)
            aim = aim - _EYE_AIM * self.body.longest * level
        if self.rise is not None and self.nearness is not None:
            eye = aim + (eye + self.rise[row] * top - aim) * self.nearness[row]
        # The centre of the body is in focus; the aim of a camera at eye level is ahead of it.
        sharp = (place + self.body.height / 2 * up - eye) @ (aim - eye) / max(float(np.linalg.norm(aim - eye)), 1e-12)
        return Camera(to_tuple(eye), to_tuple(aim), focal=self.focal, up=to_tuple(top), focus=max(float(sharp), 1e-9))

    def raise_eye(self, heights: Array, shares: Array) -> FollowingCamera:
        """Return a camera that is raised by at least `heights` (n, 1), and that is nearer: at most at the fractions `shares` (n,
        1) of its distance.

        Both change smoothly from frame to frame."""
        frames, reach = self.track.frames, max(self.track.reach, 1.0)
        if not heights.any() and (shares == 1).all():
            return self
        spans = [slice(*np.searchsorted(frames, [frame - reach, frame + reach + 1]).tolist()) for frame in frames.tolist()]
        highest, nearest = (
            np.array([pick(values[span]) for span in spans])[:, None] for values, pick in ((heights, np.max), (shares, np.min))
        )
        return replace(self, rise=_smooth_values(highest, frames, reach), nearness=_smooth_values(nearest, frames, reach))

    def _find_close_distance(self) -> float:
        """Return the distance at which the body fills the picture, whatever its orientation."""
        wide, high = (share * 36.0 / self.focal for share in _FILLED_SHARES)
        rise = self.body.height / 2 * np.cos(_CLOSE_ELEVATION) + self.body.radius * np.sin(_CLOSE_ELEVATION)
        return float(max(self.body.radius / wide, rise / high))
