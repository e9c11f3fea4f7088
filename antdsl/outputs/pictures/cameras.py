"""Default cameras: one that shows the complete scene, and one at eye level beside an agent that has others nearby."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.rays import RayScene
from antdsl.outputs.pictures.camera import make_view, to_tuple
from antdsl.outputs.pictures.following import EYE_FOCAL_MM, FollowingCamera, StableTrack, measure_body, take_track
from antdsl.outputs.pictures.light import make_sun
from antdsl.outputs.pictures.model import Camera, Crowd, Picture
from antdsl.outputs.pictures.moving_bodies import make_item_mesh
from antdsl.outputs.pictures.static_setting import TABLE_DEPTH_SHARE

Array = NDArray[np.float64]

_MAX_TRIED_AGENTS = 24  # agents tried for an eye-level camera
# Directions from an agent, to the right of its heading. Those behind its shoulder and in front of it come first.
CAMERA_ANGLES = tuple(np.radians((150.0, -150.0, 35.0, -35.0, 115.0, -115.0, 75.0, -75.0)).tolist())


def make_overview_camera(picture: Picture, *, aspect: float = 16 / 9, focal: float = 35.0, slant: float = 38.0) -> Camera:
    """Return a camera that looks down by `slant` degrees, and shows every solid, agent and item of the picture."""
    up = np.asarray(picture.up, np.float64) / np.linalg.norm(picture.up)
    return make_fitted_camera(_collect_points(picture, up), up, aspect=aspect, focal=focal, slant=slant)


def make_top_camera(picture: Picture, *, aspect: float = 16 / 9) -> Camera:
    """Return a camera with parallel rays that looks straight down and shows everything. +x is to the right in the picture."""
    up = np.asarray(picture.up, np.float64) / np.linalg.norm(picture.up)
    points = _collect_points(picture, up)
    north = np.array([0.0, 0.0, -1.0]) if abs(up[2]) < 0.5 else np.array([0.0, 1.0, 0.0])
    right = np.cross(north, up)
    across, along, high = points @ right, points @ north, points @ up
    wide = 1.04 * max(float(np.ptp(across)), aspect * float(np.ptp(along)), 1e-6)
    middle = right * (across.min() + across.max()) / 2 + north * (along.min() + along.max()) / 2
    at = middle + up * (high.max() + 0.5 * wide)
    return Camera(to_tuple(at), to_tuple(at - up), up=to_tuple(north), parallel_width=wide)


def make_fitted_camera(points: Array, up: Array, *, aspect: float = 16 / 9, focal: float = 35.0, slant: float = 38.0) -> Camera:
    """Return a camera that looks down by `slant` degrees, and shows all points (n, 3) as large as possible. `up`: a unit
    vector."""
    if not len(points):
        points = np.array([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]])
    first = np.roll(up, 1) - up * float(np.roll(up, 1) @ up)
    first /= np.linalg.norm(first)
    # With y up, the picture's right is slightly off +x. With z up, the same applies.
    second = np.cross(up, first)
    sideways, towards = (second, first) if abs(second[0]) > abs(first[0]) else (first, second)
    sideways = sideways * (1.0 if sideways[0] >= 0 else -1.0)
    towards = np.cross(sideways, up)
    turn, high = np.radians(14.0), np.radians(slant)
    direction = np.cos(high) * (np.cos(turn) * towards + np.sin(turn) * sideways) + np.sin(high) * up
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    reach = max(float(np.linalg.norm(points - middle, axis=1).max()), 1e-6)
    near, far = 0.5 * reach, 12.0 * reach
    for _ in range(40):
        distance = (near + far) / 2
        fits = _fits_picture(middle + direction * distance, middle, points, up, focal, aspect)
        near, far = (near, distance) if fits else (distance, far)
    at, aim = _centre_camera(middle + direction * far, middle, points, up, focal, aspect)
    return Camera(to_tuple(at), to_tuple(aim), focal=focal, up=to_tuple(up))


def _collect_points(picture: Picture, up: Array) -> Array:
    """Return points (n, 3) of all solids, agents and items of a picture."""
    parts = [np.asarray(solid.vertices, np.float64) for solid in picture.solids]
    parts += [np.asarray(crowd.position, np.float64) for crowd in picture.crowds]
    parts += [np.asarray(item.position, np.float64)[None] for item in picture.items]
    points = np.concatenate(parts) if parts else np.zeros((0, 3))
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) and picture.solids:
        low = (points @ up).min() - TABLE_DEPTH_SHARE * float(np.linalg.norm(points.max(axis=0) - points.min(axis=0)))
        points = np.concatenate([points, points - up * (points @ up - low)[:, None]])
    return points if len(points) else np.array([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]])


def _project_points(position: Array, aim: Array, points: Array, up: Array, focal: float, aspect: float) -> tuple[Array, Array]:
    """Return where points are in the picture: horizontal and vertical positions (n, 2), and distances ahead of the camera (n,).

    Positions are from 0 to 1 for visible points."""
    camera_view = make_view(
        Camera(to_tuple(position), to_tuple(aim), focal=focal, up=to_tuple(up)), round(1000 * aspect), 1000, to_tuple(up)
    )
    pixels, ahead = camera_view.project(points)
    return pixels / np.array([camera_view.width, camera_view.height]), ahead


def _fits_picture(position: Array, aim: Array, points: Array, up: Array, focal: float, aspect: float) -> bool:
    """Return whether the points fit into the picture if the picture is centred on them."""
    shares, ahead = _project_points(position, aim, points, up, focal, aspect)
    wide = shares.max(axis=0) - shares.min(axis=0)
    return bool((ahead > 0).all() and (wide <= 0.93).all())


def _centre_camera(position: Array, aim: Array, points: Array, up: Array, focal: float, aspect: float) -> tuple[Array, Array]:
    """Return the camera's position and aim, moved sideways so that the points are centred in the picture."""
    for _ in range(4):
        shares, _ = _project_points(position, aim, points, up, focal, aspect)
        off = (shares.max(axis=0) + shares.min(axis=0)) / 2 - 0.5
        ready = make_view(Camera(to_tuple(position), to_tuple(aim), focal=focal, up=to_tuple(up)), 100, 100, to_tuple(up))
        distance = float(np.linalg.norm(aim - position)) * 2 * 18.0 / focal
        step = ready.right_axis * off[0] * distance - ready.up_axis * off[1] * distance / aspect
        position, aim = position + step, aim + step
    return position, aim


def make_eye_level_camera(
    picture: Picture, agent: int | None = None, *, species: str | None = None, focal: float = EYE_FOCAL_MM, close: bool = False
) -> Camera | None:
    """Return a camera beside an agent, at the height of its back. None if there is no such agent.

    The view of the agent is not blocked, and many agents are behind it. With `close`, the agent fills the picture. `agent`: its
    id; None chooses an agent that has others nearby. `species`: the species of the agent; by default, the first one that has this
    id."""
    best = find_agent_view(picture, agent, species=species, focal=focal, close=close)
    return best.camera if best else None


class AgentView(NamedTuple):
    """A camera beside an agent. `crowd`, `row`: the crowd of the agent, and its row in the crowd."""

    crowd: Crowd
    row: int
    camera: Camera


def find_agent_view(
    picture: Picture, agent: int | None = None, *, species: str | None = None, focal: float = EYE_FOCAL_MM, close: bool = False
) -> AgentView | None:
    """Return the camera of `make_eye_level_camera`, together with the agent that it shows."""
    crowds = [crowd for crowd in picture.crowds if len(crowd.position) and species in (None, crowd.species)]
    if not crowds:
        return None
    if agent is not None:  # agents of a species may be in several crowds, by their worn layers
        has = (each for each in crowds if each.ids is not None and (np.asarray(each.ids) == agent).any())
        crowd = next(has, None)
        if crowd is None:
            return None
        rows = np.flatnonzero(np.asarray(crowd.ids) == agent)
    else:
        crowd = max((each for each in crowds if each.species == crowds[0].species), key=lambda crowd: len(crowd.position))
        rows = _find_crowded_rows(crowd)
    rays, upright = make_ray_scene(picture), np.asarray(picture.up, np.float64)
    best: tuple[float, AgentView] | None = None
    for row in rows.tolist():
        track, body = StableTrack.of(take_track(crowd, row, 0), 0.0, upright), measure_body(crowd, row)
        for angle in CAMERA_ANGLES:
            camera = FollowingCamera.of(track, body, focal, angle, close).make_camera(0)
            score = score_camera(crowd, row, body.longest, camera, rays)
            if best is None or score > best[0]:
                best = (score, AgentView(crowd, row, camera))
    return best[1] if best else None


def make_ray_scene(picture: Picture) -> RayScene:
    """Return a ray scene of the solids and items of a picture."""
    placed = [
        make_item_mesh(item, picture.up)
        for item in picture.items
        if item.shape != "none" and item.remaining_share > 0 and item.radius > 0
    ]
    around = [(solid.vertices, solid.faces) for solid in picture.solids if len(solid.faces)]
    return RayScene.from_meshes(around + [(mesh.vertices, mesh.faces) for mesh in placed])


def _find_crowded_rows(crowd: Crowd) -> NDArray[np.int64]:
    """Return the rows of agents that have many others within twelve body lengths, chosen at several separate positions."""
    from scipy.spatial import cKDTree

    points = np.where(np.isfinite(crowd.position), crowd.position, 1e12)
    reach = 12 * float(np.median(crowd.scale))
    sample_rows = np.unique(np.linspace(0, len(points) - 1, min(len(points), 600)).astype(np.int64))
    company = cKDTree(points).query_ball_point(points[sample_rows], reach, return_length=True)
    order = sample_rows[np.argsort(-np.minimum(company, 60), kind="stable")]
    return order[: _MAX_TRIED_AGENTS * 4 : 4] if len(order) >= _MAX_TRIED_AGENTS * 4 else order[:_MAX_TRIED_AGENTS]


def score_camera(crowd: Crowd, row: int, scale: float, camera: Camera, rays: RayScene) -> float:
    """Return a score for how much of the crowd a camera shows. It is far below zero if ground or rock blocks the view.

    `scale`: the longest side of the agent's body."""
    camera_view = make_view(camera, 160, 90, camera.up or (0.0, 1.0, 0.0))
    target = np.asarray(crowd.position, np.float64)[row] + scale * 0.2 * np.asarray(camera.up)
    directions = np.stack(
        [
            camera_view.eye - target,
            -0.45 * scale * camera_view.up_axis,
            *(
                scale * axis
                for axis in (camera_view.forward_axis, camera_view.right_axis, -camera_view.right_axis, camera_view.up_axis)
            ),
        ]
    )
    if rays.find_occluded_rays(np.stack([target, *[camera_view.eye] * 5]), directions, max_parameter=1.0).any():
        return -1e6
    pixels, ahead = camera_view.project(np.where(np.isfinite(crowd.position), crowd.position, 0.0))
    inside = (ahead < 60 * scale) & (pixels > 0).all(axis=1) & (pixels < [160, 90]).all(axis=1)
    is_obstructing, away = inside & (ahead > 0) & (ahead < 1.7 * scale), inside & (ahead >= 1.7 * scale)
    clear = rays.find_first_hits(camera_view.eye[None], camera_view.forward_axis[None]).t[0] > 14 * scale
    up = np.asarray(camera.up or (0.0, 1.0, 0.0), np.float64)
    sun = make_sun(up).direction.astype(np.float64)
    lit = not rays.find_occluded_rays(target[None] + 0.3 * scale * up, sun[None]).any()
    company = float(np.minimum(1.0, 10 * scale / ahead[away]).sum()) * (1.0 if clear else 0.3) * (1.0 if lit else 0.2)
    # Light from the side of the camera shows the shape of lit things.
    return company + 3.0 * lit * float(-camera_view.forward_axis @ sun) - 4.0 * float(is_obstructing.sum())
