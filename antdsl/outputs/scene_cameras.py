"""The cameras of a cache: the cameras of its scene, by name, and cameras that follow an agent over a range of frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.vector_rows import normalise_or_fallback
from antdsl.outputs.cache.cache_reader import Cache
from antdsl.outputs.cache.frame_agents import get_agent_ids, get_species_numbers
from antdsl.outputs.cache.manifest import Manifest, make_camera_array_name
from antdsl.outputs.cache.manifest_parts import CameraEntry, FollowEntry, LensEntry
from antdsl.outputs.edits.verbs.terrain import Ground
from antdsl.outputs.gallery import Gallery, PictureUnavailable
from antdsl.outputs.pictures.camera import to_tuple
from antdsl.outputs.pictures.cameras import CAMERA_ANGLES, make_ray_scene, score_camera
from antdsl.outputs.pictures.following import (
    CLOSE_FOCAL_MM,
    SMOOTH_SECONDS,
    AgentTrack,
    FollowingCamera,
    StableTrack,
    measure_body,
)
from antdsl.outputs.pictures.model import Camera, Crowd, Picture
from antdsl.scene.camera_models import DEFAULT_CAMERA_NAME
from antdsl.scene.crowds.line_ids import CrowdLineIds
from antdsl.scene.notes.selectors import parse_agent_name
from antdsl.scene.setting import DEFAULT_FOCAL_MM
from antdsl.scene.thing_models import UNIT_MM, UP_VECTORS

Array = NDArray[np.float64]

_TRACK_ARRAYS = frozenset(("P", "orient", "id", "species"))
_HEIGHTS = np.array([0.0, 0.15, 0.3, 0.5, 0.8, 1.2, 2.0])  # in distances from its aim: how far a camera may rise above the ground
_SPARE_DISTANCE, _NEAREST_SHARE = 0.1, 0.1  # in distances from its aim: free space behind a camera, and how near it may come
_MAX_SCORED_FRAMES = 4  # frames for which a direction is examined


class SceneCameras:
    """The cameras of the scene from which a gallery's cache was made."""

    def __init__(self, gallery: Gallery) -> None:
        self._gallery, self._entries = gallery, gallery.manifest.named_cameras
        self._following: dict[str, FollowingCamera] = {}

    @property
    def names(self) -> list[str]:
        """Return the names of the cameras in the scene."""
        return list(self._entries)

    def is_fitted(self, name: str = DEFAULT_CAMERA_NAME) -> bool:
        """Return whether a camera is placed so that it shows the complete crowd in all drawn frames."""
        return self._entries.get(name) == "fit"

    def is_moving(self, name: str = DEFAULT_CAMERA_NAME) -> bool:
        """Return whether a camera changes from frame to frame."""
        entry = self._entries.get(name)
        has_moving_focus = isinstance(entry, LensEntry) and isinstance(entry.focus, str)
        return isinstance(entry, FollowEntry) or has_moving_focus or (isinstance(entry, CameraEntry) and entry.moves)

    def make_camera(self, frame: int, name: str = DEFAULT_CAMERA_NAME) -> Camera | None:
        """Return a camera at a frame. None if the scene has no such camera, or if the camera depends on the drawn frames."""
        entry = self._entries.get(name)
        if isinstance(entry, FollowEntry):
            if name not in self._following:
                self._following[name] = _make_following_camera(self._gallery, entry)
            return self._add_lens(self._following[name].make_camera(frame), entry, frame)
        if not isinstance(entry, CameraEntry):
            return None
        return self._add_lens(self._make_placed_camera(frame, name, entry), entry, frame)

    def _add_lens(self, camera: Camera, entry: LensEntry, frame: int) -> Camera:
        """Return the camera with the depth of field of an entry. If the frame lacks the agent in focus, `look_at` remains in
        focus."""
        manifest, focus = self._gallery.manifest, entry.focus
        if isinstance(focus, str):
            track = read_track(self._gallery.cache, *find_agent(manifest, focus), [frame] if self._has_frame(frame) else [])
            ahead = np.subtract(camera.look_at, camera.at)
            depths = (track.position - camera.at) @ ahead / max(float(np.linalg.norm(ahead)), 1e-12)
            focus = float(depths[0]) if len(depths) and depths[0] > 0 else None
        aperture = compute_aperture(camera.focal, entry.f_stop, manifest.units)
        return replace(camera, aperture=aperture, focus=camera.focus if focus is None else focus)

    def _has_frame(self, frame: int) -> bool:
        return frame in self._gallery.cache.frames()

    def _make_placed_camera(self, frame: int, name: str, entry: CameraEntry) -> Camera:
        """Return a camera that does not depend on agents, at a frame."""
        static = self._gallery.static
        if not entry.moves:
            return Camera(entry.at, entry.look_at, focal=entry.focal or DEFAULT_FOCAL_MM, up=entry.up)
        row = min(max(frame - self._gallery.manifest.first, 0), len(static[make_camera_array_name(name, "at")]) - 1)
        at, look_at, up = (to_tuple(static[make_camera_array_name(name, part)][row]) for part in ("at", "look_at", "up"))
        return Camera(at, look_at, focal=float(static[make_camera_array_name(name, "focal")][row]) or DEFAULT_FOCAL_MM, up=up)

    def list_exported(self, frame: int) -> dict[str, str]:
        """Return the cameras that exported files can contain: by name in the scene, the name in the file.

        The default camera is called `camera`. Cameras fitted to the drawn frames are omitted, and so are those that follow an
        agent that the cache lacks."""
        names = {}
        for name in self._entries:
            try:
                exists = self.make_camera(frame, name) is not None
            except PictureUnavailable:
                exists = False
            if exists:
                names[name] = "camera" if name == DEFAULT_CAMERA_NAME else name
        return names


def compute_aperture(focal: float, f_stop: float | None, units: str) -> float:
    """Return the diameter of a lens in scene units (`units`). 0 if `f_stop` is None. `focal`: the focal length in mm."""
    return focal / f_stop / UNIT_MM[units] if f_stop else 0.0


def find_camera_axes(camera: Camera, up: str) -> tuple[Array, Array]:
    """Return the position of a camera, and its axes to the right, upwards and backwards as rows. `up`: the up axis of the
    scene."""
    eye, aim = np.asarray(camera.at, np.float64), np.asarray(camera.look_at, np.float64)
    back = normalise_or_fallback(eye - aim, np.array([0.0, 0.0, 1.0]))
    top = np.asarray(camera.up or UP_VECTORS[up], np.float64)
    if np.linalg.norm(np.cross(top, back)) < 1e-6:
        top = np.roll(top, 1)
    side = normalise_or_fallback(np.cross(top, back), np.array([1.0, 0.0, 0.0]))
    return eye, np.stack([side, np.cross(back, side), back])


def find_agent(manifest: Manifest, text: str) -> tuple[int, int]:
    """Return the species index and the id of an agent that is named as in a scene, such as `guards.17`.

    Raises PictureUnavailable if the cache has no such crowd line or species, or if the line has no agent with this number."""
    name, lines = parse_agent_name(text), {line.name: line for line in manifest.lines}
    species, ids = name.name, np.array([] if name.first is None else [name.first], np.int64)
    if name.name in lines and name.first is not None:
        line = lines[name.name]
        species, ids = line.species, CrowdLineIds(line.species, line.ranges).list_ids_between(name.first, name.first)
    numbers = [number for number, each in enumerate(manifest.species) if each.name == species]
    if not numbers or not len(ids):
        raise PictureUnavailable(f"the cache has no agent `{text}`")
    return numbers[0], int(ids[0])


def read_track(cache: Cache, species: int, agent: int, frames: Sequence[int]) -> AgentTrack:
    """Return the track of an agent in those of `frames` that contain the agent. Raises CacheError for damaged frames."""
    rows = []
    for frame in frames:
        arrays = cache.frame(frame, _TRACK_ARRAYS)
        at = np.flatnonzero((get_agent_ids(arrays) == agent) & (get_species_numbers(arrays) == species))
        if len(at):
            rows.append((frame, arrays["P"][at[0]], arrays["orient"][at[0]]))
    numbers = np.array([row[0] for row in rows], np.int64)
    return AgentTrack(numbers, *(np.array([row[k] for row in rows], np.float64).reshape(len(rows), -1) for k in (1, 2)))


def make_stable_track(gallery: Gallery, track: AgentTrack, seconds: float = SMOOTH_SECONDS) -> StableTrack:
    """Return a track smoothed over `seconds` before and after each frame."""
    return StableTrack.of(track, seconds / gallery.dt, np.array(UP_VECTORS[gallery.manifest.up]))


def find_crowd_row(picture: Picture, species: str, agent: int) -> tuple[Crowd, int] | None:
    """Return the crowd of an agent in a picture, and its row in the crowd. None if the picture does not contain the agent."""
    for crowd in picture.crowds:
        if crowd.species == species and crowd.ids is not None and len(rows := np.flatnonzero(np.asarray(crowd.ids) == agent)):
            return crowd, int(rows[0])
    return None


def _make_following_camera(gallery: Gallery, entry: FollowEntry) -> FollowingCamera:
    """Return the camera that an entry describes. Raises PictureUnavailable if no frame contains the agent."""
    number, agent = find_agent(gallery.manifest, entry.follow)
    track = read_track(gallery.cache, number, agent, gallery.cache.frames())
    if not len(track.frames):
        raise PictureUnavailable(f"no frame of the cache has the agent `{entry.follow}`, which a camera follows")
    stable = make_stable_track(gallery, track, SMOOTH_SECONDS if entry.smooth is None else entry.smooth)
    offset = None if entry.by is None else np.array(entry.by)
    return choose_direction(gallery, number, agent, stable, entry.focal or CLOSE_FOCAL_MM, is_close=True, offset=offset)


def choose_direction(
    gallery: Gallery, number: int, agent: int, track: StableTrack, focal: float, *, is_close: bool, offset: Array | None = None
) -> FollowingCamera:
    """Return a camera beside an agent, in the direction from which the agent is best visible in a few frames of its track.

    `number`: the index of its species. `offset`: the vector from the agent to the camera, if it is given; then no direction is
    chosen."""
    count = 1 if offset is not None else _MAX_SCORED_FRAMES
    frames = track.frames[np.unique(np.linspace(0, len(track.frames) - 1, count).astype(np.int64))].tolist()
    species = gallery.manifest.species[number].name
    samples = [(picture, find_crowd_row(picture, species, agent)) for picture in map(gallery.make_picture, frames)]
    views = [(picture, *place) for picture, place in samples if place is not None]
    body = measure_body(*views[0][1:])
    if offset is not None:
        return _keep_above_ground(gallery, FollowingCamera.of(track, body, focal, offset=offset))
    cameras = [FollowingCamera.of(track, body, focal, angle, is_close) for angle in CAMERA_ANGLES]
    scores = np.zeros(len(cameras))
    for frame, (picture, crowd, row) in zip(frames, views, strict=True):
        rays = make_ray_scene(picture)
        scores += [score_camera(crowd, row, body.longest, each.make_camera(frame), rays) for each in cameras]
    return _keep_above_ground(gallery, cameras[int(scores.argmax())])


def _keep_above_ground(gallery: Gallery, camera: FollowingCamera) -> FollowingCamera:
    """Return the camera raised, or else moved nearer, in frames with ground between it and its agent, and in frames around these.

    So it is never below the ground on which its agent stands."""
    ground, frames = Ground(gallery.cache), camera.track.frames.tolist()
    heights, shares = np.zeros((len(frames), 1)), np.ones((len(frames), 1))
    for row, frame in enumerate(frames):
        terrain, plain = ground.at(frame), camera.make_camera(frame)
        if terrain is None:
            return camera
        eye, aim = np.asarray(plain.at), np.asarray(plain.look_at)
        distance = float(np.linalg.norm(eye - aim))
        eyes = eye + np.outer(_HEIGHTS, np.asarray(plain.up)) * distance
        free = terrain.measure_free_shares(np.tile(aim, (len(eyes), 1)), aim + (eyes - aim) * (1 + _SPARE_DISTANCE))
        is_free = free >= 1
        heights[row] = distance * _HEIGHTS[int(is_free.argmax())] if is_free.any() else 0.0
        shares[row] = 1.0 if is_free.any() else max(float(free[0]), _NEAREST_SHARE)
    return camera.raise_eye(heights, shares)
