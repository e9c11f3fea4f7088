"""A ray scene of everything that moves in a frame: the posed body of each agent, and each item at its current size."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.body import build_orientations, build_rotation_matrices, compute_vertex_normals
from antdsl.bodies.posed_body import PosedBody
from antdsl.bodies.shapes import build_item_mesh
from antdsl.casting.picture_rays import PictureRays
from antdsl.numerics.records import select_record_rows
from antdsl.outputs.pictures import surface_materials
from antdsl.outputs.pictures.blur.shutter import Shutter
from antdsl.outputs.pictures.camera import CameraView
from antdsl.outputs.pictures.light import SunLight, decode_srgb
from antdsl.outputs.pictures.model import Crowd, Item, Picture
from antdsl.outputs.pictures.shading_rows import Floats
from antdsl.outputs.pictures.static_setting import StaticSetting
from antdsl.scene.looks import KIND_BY_LOOK, SURFACE_KINDS, is_lamp_look

Array = NDArray[np.float64]

CLOSE_BODY_PIXELS = 60.0  # pixels of body length; from this length on, the close-up body is drawn
DISTANT_BODY_PIXELS = 18.0  # pixels of body length; shorter bodies are drawn with few triangles
MAX_CLOSE_BODIES = 1200  # maximum number of close-up bodies; the largest come first
METAL_GLOSS, LIGHT_GLOSS = 1.5, -1.0  # special values of gloss
MAX_CLOSE_TRIANGLES = 1_000_000  # maximum number of triangles in close-up bodies of one definition
_SHADOW_MAP_CELLS = 2048  # cells along each side of the shadow map
_TINY_BODY_PIXELS = 4.0  # pixels; rays through pixel centres may miss a smaller body
_STEEP_SLOPE_SHARE = 0.8  # share of a pile's slope; steeper neighbouring ground is a stone or a wall


@dataclass(frozen=True, slots=True, eq=False)
class ActorMesh:
    """One or more bodies at one time, as a single mesh.

    `vertices` (n, 3), `faces` (m, 3). `normal` (n, 3): unit normals. `colour` (n, 3): linear colours. `gloss` (n,): from 0 (dull)
    to 1; METAL_GLOSS (above 1) for metal, LIGHT_GLOSS (below 0) for a light source. `motion` (n, 3): the displacement of the
    vertices until the next frame."""

    vertices: Array
    faces: NDArray[np.int32]
    normal: Floats
    colour: Floats
    gloss: Floats
    motion: Floats


@dataclass(frozen=True, slots=True, eq=False)
class BodyMesh:
    """The b bodies of one shape with v vertices each.

    `local_vertices` float32 (b, v, 3): rotated vertices relative to the body's position, at the picture's frame. `positions` (b,
    3): the positions of the bodies. `next_frame`: both for the next frame; None for static bodies. `faces`: the faces of all
    bodies. `normal`, `colour`, `gloss`: values for all vertices."""

    local_vertices: Floats
    positions: Array
    next_frame: tuple[Floats, Array] | None
    faces: NDArray[np.int32]
    normal: Floats
    colour: Floats
    gloss: Floats

    @property
    def is_moving(self) -> bool:
        """Return whether the bodies move until the next frame."""
        return self.next_frame is not None and self.local_vertices.size > 0

    def compute_vertices(self, time_offset: float) -> Array:
        """Return the vertices (b, v, 3) at `time_offset` frames after the picture's frame. Vertices move in straight lines."""
        if self.next_frame is None or time_offset == 0:
            return self.local_vertices + self.positions[:, None]
        local = self.local_vertices + (self.next_frame[0] - self.local_vertices) * np.float32(time_offset)
        return np.asarray(local + (self.positions + (self.next_frame[1] - self.positions) * time_offset)[:, None])

    def compute_motion(self) -> Floats:
        """Return the displacement (b · v, 3) of each vertex until the next frame."""
        if self.next_frame is None:
            return np.zeros((self.local_vertices.shape[0] * self.local_vertices.shape[1], 3), np.float32)
        shift = (self.next_frame[1] - self.positions).astype(np.float32)
        return np.asarray(self.next_frame[0] - self.local_vertices + shift[:, None]).reshape(-1, 3)


@dataclass(frozen=True, slots=True, eq=False)
class SceneActors:
    """Everything that moves in a frame.

    `times`: the shutter times, in frames after the picture's frame. `rays`: one ray scene for each of these times.
    `lamp_occluders`: the same without items that emit light, because a lamp's post does not hide its light. `mesh`: the bodies at
    the middle of the shutter times. `near_pixels` bool (h · w,): pixels in which a body may be visible. `tiny_body_pixels` bool
    (h · w,): pixels with a body so small that rays through pixel centres may miss it. `shadow_reach`: the greatest distance in
    world units at which shadows are searched. `contact_reach`: the distance in world units within which a body darkens the
    ground. `soft_edge_reach`: the greatest distance in world units for which the softness of shadow edges is computed. `boxes`:
    the lowest and highest corners (b, 3) of boxes around the bodies while the shutter is open."""

    rays: tuple[PictureRays, ...]
    lamp_occluders: tuple[PictureRays, ...]
    mesh: ActorMesh
    near_pixels: NDArray[np.bool_]
    tiny_body_pixels: NDArray[np.bool_]
    shadow_reach: float
    contact_reach: float
    soft_edge_reach: float
    boxes: tuple[Array, Array]
    times: tuple[float, ...]

    def find_shadable_points(self, points: Floats, sun: SunLight, reaches: Sequence[float]) -> list[NDArray[np.bool_]]:
        """Return, for each of `reaches`, a mask of the points (n, 3) that may be in the shadow of a box.

        Boxes are enlarged by the reach on all sides. Points and boxes are projected onto a map along the direction of the sun."""
        low, high = self.boxes
        if not len(low):
            return [np.zeros(len(points), np.bool_) for _ in reaches]
        across = np.stack([sun.first_axis, sun.second_axis], axis=1).astype(np.float64)
        middle, half = (low + high) / 2 @ across, (high - low) / 2 @ np.abs(across)
        widest = half + max(reaches)
        least, most = (middle - widest).min(axis=0), (middle + widest).max(axis=0)
        # One more column at each end, to allow for float32 rounding.
        cell = np.maximum((most - least) / (_SHADOW_MAP_CELLS - 4), 1e-12)
        coordinates = []
        for axis in range(2):
            turn = (across[:, axis] / cell[axis]).astype(np.float32)
            at = points @ turn
            at -= np.float32(least[axis] / cell[axis] - 2)
            coordinates.append(np.clip(at, 0, _SHADOW_MAP_CELLS - 1).astype(np.int32))
        cells = coordinates[1] * _SHADOW_MAP_CELLS + coordinates[0]
        masks = []
        for reach in reaches:
            first = np.floor((middle - half - reach - least) / cell).astype(np.int64) + 1
            last = np.floor((middle + half + reach - least) / cell).astype(np.int64) + 4
            covered = _fill_rectangles(first, np.minimum(last, _SHADOW_MAP_CELLS), _SHADOW_MAP_CELLS, _SHADOW_MAP_CELLS)
            covered[:, [0, -1]] = covered[[0, -1]] = False  # cells outside of the map
            masks.append(covered.reshape(-1)[cells])
        return masks


def make_actors(
    picture: Picture,
    shutter: Shutter,
    min_body_pixels: float = 0.0,
    ground: StaticSetting | None = None,
    max_enlargement: float = 3.0,
) -> SceneActors:
    """Return everything that moves in a picture, without invisible agents.

    Agents that are large in the picture use close-up bodies. Agents of a few pixels use few triangles. `min_body_pixels`: shorter
    bodies are enlarged to this length in pixels, by a factor of at most `max_enlargement`. `ground`: the static surfaces to which
    loose soil is fitted."""
    parts: list[BodyMesh] = []
    lamps: list[BodyMesh] = []
    longest = 0.0
    for crowd in picture.crowds:
        if len(crowd.position):
            parts += _pose_crowd(crowd, shutter.middle, min_body_pixels, max_enlargement)
            longest = max(longest, float(np.max(crowd.scale)))
    for item in picture.items:
        if item.shape != "none" and item.remaining_share > 0 and item.radius > 0:
            solid = make_item_mesh(item, picture.up, ground)
            place = np.asarray([item.position], np.float64)
            local = (solid.vertices - place).astype(np.float32)[None]
            part = BodyMesh(local, place, None, solid.faces, solid.normal, solid.colour, solid.gloss)
            (lamps if is_lamp_look(item.look) else parts).append(part)
    without_lamps, parts = parts, parts + lamps
    widest = max((item.radius for item in picture.items), default=0.0)
    moments = shutter.choose_times(list(parts))
    meshes = [_join_parts(parts, time_offset, number == len(moments) // 2) for number, time_offset in enumerate(moments)]
    boxes = _compute_boxes(parts, shutter.open_frames)
    rays = occluders = tuple(PictureRays(mesh.vertices, mesh.faces) for mesh in meshes)
    if lamps:
        dark = (_join_parts(without_lamps, time_offset) for time_offset in moments)
        occluders = tuple(PictureRays(mesh.vertices, mesh.faces) for mesh in dark)
    mesh = meshes[len(meshes) // 2]
    tall, size = max(20 * longest, 8 * widest), max(longest, 0.3 * widest) if parts else 0.0
    throw = 20 * longest if longest > 0 else tall
    return SceneActors(rays, occluders, mesh, *_find_covered_pixels(boxes, shutter), tall, size, throw, boxes, tuple(moments))


def _join_parts(parts: list[BodyMesh], time_offset: float, has_motion: bool = False) -> ActorMesh:
    """Return all bodies as one mesh, at `time_offset` frames after the picture's frame. Without `has_motion`, its motion is
    empty."""
    if not parts:
        none = np.zeros((0, 3), np.float32)
        return ActorMesh(none.astype(np.float64), np.zeros((0, 3), np.int32), none, none, none[:, 0], none)
    points = [part.compute_vertices(time_offset).reshape(-1, 3) for part in parts]
    starts = np.cumsum([0] + [len(each) for each in points])
    return ActorMesh(
        np.concatenate(points),
        np.concatenate([part.faces + np.int32(start) for part, start in zip(parts, starts[:-1], strict=True)]),
        np.concatenate([part.normal for part in parts]),
        np.concatenate([part.colour for part in parts]),
        np.concatenate([part.gloss for part in parts]),
        np.concatenate([part.compute_motion() for part in parts]) if has_motion else np.zeros((0, 3), np.float32),
    )


def _compute_boxes(parts: list[BodyMesh], blur: float) -> tuple[Array, Array]:
    """Return axis-aligned boxes around all bodies while the shutter is open, as lowest and highest corners (b, 3)."""
    corners: list[tuple[Array, Array]] = [(np.zeros((0, 3)), np.zeros((0, 3)))]
    for part in parts:
        low, high = part.local_vertices.min(axis=1) + part.positions, part.local_vertices.max(axis=1) + part.positions
        if part.next_frame is not None and blur > 0:
            end = part.compute_vertices(blur)
            low, high = np.minimum(low, end.min(axis=1)), np.maximum(high, end.max(axis=1))
        corners.append((low, high))
    lows, highs = zip(*corners, strict=True)
    return np.concatenate(lows), np.concatenate(highs)


def _find_covered_pixels(boxes: tuple[Array, Array], shutter: Shutter) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return masks of the pixels (h · w,) that any box may cover, and of those that a very small box may cover.

    Rays through the centres of pixels may miss very small boxes."""
    high, wide = shutter.middle.height, shutter.middle.width
    corners = np.stack([[boxes[bit >> axis & 1][:, axis] for axis in range(3)] for bit in range(8)])  # shape (8, 3, b)
    points = np.moveaxis(corners, 2, 0).reshape(-1, 3)
    views = (shutter.first, shutter.last) if shutter.has_camera_motion else (shutter.middle,)
    shown = [view.project(points) for view in views]
    pixels = np.concatenate([each.reshape(-1, 8, 2) for each, _ in shown], axis=1)
    ahead = np.concatenate([each.reshape(-1, 8) for _, each in shown], axis=1)
    low, high_ = pixels.min(axis=1), pixels.max(axis=1)
    # A box that reaches behind the camera may cover any pixel.
    around = (ahead <= 0).any(axis=1) & (ahead > 0).any(axis=1)
    low[around], high_[around] = -1, max(high, wide) + 1
    is_ahead = (ahead > 0).any(axis=1)
    few = is_ahead & ((high_ - low).max(axis=1) < _TINY_BODY_PIXELS)

    def mark_covered(rows: NDArray[np.bool_], margin: float) -> NDArray[np.bool_]:
        first = np.clip(np.floor(low[rows] - margin), 0, (wide, high)).astype(np.int64)
        last = np.clip(np.ceil(high_[rows] + margin) + (margin > 0), 0, (wide, high)).astype(np.int64)
        return _fill_rectangles(first, last, wide, high).reshape(-1)

    return mark_covered(np.asarray(is_ahead), 2.0), mark_covered(np.asarray(few), 0.0)


def _fill_rectangles(first: NDArray[np.int64], last: NDArray[np.int64], column_count: int, row_count: int) -> NDArray[np.bool_]:
    """Return a mask of the cells (high, wide) of a grid that are in at least one of n rectangles.

    `first`, `last` (n, 2): column and row of the first cell, and of the cell after the last one."""
    count = np.zeros((row_count + 1, column_count + 1), np.int32)
    for x, y, sign in ((first, first, 1), (last, last, 1), (first, last, -1), (last, first, -1)):
        np.add.at(count, (y[:, 1], x[:, 0]), sign)
    return np.asarray(count.cumsum(axis=0).cumsum(axis=1)[:-1, :-1] > 0)


def _pose_crowd(crowd: Crowd, view: CameraView, min_body_pixels: float, max_enlargement: float) -> list[BodyMesh]:
    """Return the posed bodies of a crowd. Bodies that are larger in the picture have more triangles."""
    scale = np.asarray(crowd.scale, np.float64)
    finite = np.isfinite(crowd.position).all(axis=1) & np.isfinite(crowd.orient).all(axis=1) & np.isfinite(scale) & (scale > 0)
    position = np.where(finite[:, None], crowd.position, 0.0)
    scale = np.where(finite, scale, 1.0)
    depth = view.project(position)[1]
    # A body slightly outside still casts its shadow into the picture.
    is_visible = finite & (depth > -20 * scale) & _is_in_sight(position, depth, 20 * scale, view)
    near = np.maximum(view.compute_distances(position), 1e-9)
    pixels = scale / view.compute_pixel_size(near)
    large = np.flatnonzero(is_visible & (pixels >= CLOSE_BODY_PIXELS))
    most = min(MAX_CLOSE_BODIES, MAX_CLOSE_TRIANGLES // max(1, len(crowd.body.fine_body.faces))) if len(large) else 0
    close = np.sort(large[np.argsort(-pixels[large], kind="stable")[:most]])
    sizes = np.minimum(np.maximum(scale, min_body_pixels * view.compute_pixel_size(near)), max_enlargement * scale)
    tiny = is_visible & (sizes < DISTANT_BODY_PIXELS * view.compute_pixel_size(near))
    far = np.setdiff1d(np.flatnonzero(is_visible & ~tiny), close)
    # On a body a few pixels long, parts with their own colours would hide the agent's colour.
    is_plain = (pixels < CLOSE_BODY_PIXELS) & (crowd.is_marked if crowd.is_marked is not None else True)
    plain = np.where(is_plain, np.clip(1 - pixels / CLOSE_BODY_PIXELS, 0.0, 1.0) ** 2, 0.0)
    levels = (("fine_body", close), ("coarse_body", far), ("distant_body", np.setdiff1d(np.flatnonzero(tiny), close)))
    bodies = [(getattr(crowd.body, level), rows) for level, rows in levels if len(rows)]
    return [_pose_bodies(crowd, body, rows, sizes, plain) for body, rows in bodies if len(body.faces)]


def _pose_bodies(crowd: Crowd, body: PosedBody, rows: NDArray[np.int64], size: Array, plain: Array) -> BodyMesh:
    """Return the bodies of the agents in `rows`, posed by the clips that they play.

    `size` (n,): the drawn length of each agent of the crowd. `plain` (n,): how strongly parts with a separate colour take the
    agent's colour, 0 to 1."""
    turn, long = _make_rotations(crowd, rows), size[rows].astype(np.float32)[:, None, None]
    local, normal = crowd.pose_vertices(body, rows)
    then = None
    if crowd.next_crowd is not None:
        later, _ = crowd.next_crowd.pose_vertices(body, rows)
        then = (
            np.matmul(later * long, _make_rotations(crowd.next_crowd, rows)),
            np.asarray(crowd.next_crowd.position, np.float64)[rows],
        )
    bright = decode_srgb(np.nan_to_num(np.asarray(crowd.colour, np.float32)[rows]))[:, None, :]
    tint = body.tint_weights[None, :, None]
    tint = tint + (1 - tint) * (0.6 * plain[rows].astype(np.float32))[:, None, None]
    colour = bright * tint + body.compute_colours(select_record_rows(crowd.driven_pose, rows)) * (1 - tint)
    place = np.asarray(crowd.position, np.float64)[rows]
    return _make_part(np.matmul(local * long, turn), place, then, body.faces, np.matmul(normal, turn), colour, 0.5)


def _make_rotations(crowd: Crowd, rows: NDArray[np.int64]) -> Floats:
    """Return matrices (n, 3, 3) that rotate vertices, given as row vectors, to the orientations of the agents."""
    return np.swapaxes(build_rotation_matrices(np.asarray(crowd.orient, np.float64)[rows]).astype(np.float32), 1, 2)


def _make_part(
    local_vertices: Floats,
    positions: Array,
    next_frame: tuple[Floats, Array] | None,
    faces: NDArray[np.int32],
    normal: Floats,
    colour: Floats,
    gloss: float,
) -> BodyMesh:
    """Return a `BodyMesh` of bodies that share `faces`. All vertices have the same gloss."""
    bodies, own = local_vertices.shape[:2]
    every = (faces[None] + (np.arange(bodies, dtype=np.int32) * own)[:, None, None]).reshape(-1, 3)
    shine = np.full(bodies * own, gloss, np.float32)
    return BodyMesh(
        local_vertices, positions, next_frame, every, normal.reshape(-1, 3), np.ascontiguousarray(colour).reshape(-1, 3), shine
    )


def _is_in_sight(points: Array, depth: Array, margin: Array, view: CameraView) -> NDArray[np.bool_]:
    """Return a mask of the points with a ball of radius `margin` that intersects the view pyramid."""
    offset = points - view.eye
    inside = np.ones(len(points), np.bool_)
    if view.is_parallel:
        depth = np.ones(len(points))
    for axis, half in ((view.right_axis, view.half_extent[0]), (view.up_axis, view.half_extent[1])):
        inside &= np.abs(offset @ axis) - depth * half <= margin * float(np.hypot(1.0, half))
    return inside


def make_item_mesh(item: Item, up: tuple[float, float, float], ground: StaticSetting | None = None) -> ActorMesh:
    """Return the body of an item at its position and remaining size. `ground`: the static surfaces on which loose soil rests."""
    vertices, faces, colour = build_item_mesh(item.shape)
    size = item.drawn_radius
    upward = np.array([up]) / np.linalg.norm(up)
    turn = build_rotation_matrices(build_orientations(np.array([[0.83, 0.31, 0.46]]), upward))[0]
    points = (vertices * size) @ turn.T + np.asarray(item.position, np.float64)
    if item.shape == "mound" and ground is not None:
        points += _find_ground_heights(points, np.asarray(item.position, np.float64), upward[0], size, ground)[:, None] * upward
    shade, gloss = _find_item_material(item, decode_srgb(colour))
    normal, still = compute_vertex_normals(points, faces), np.zeros(points.shape, np.float32)
    return ActorMesh(points, faces, normal, shade, np.full(len(points), gloss, np.float32), still)


def _find_item_material(item: Item, colour: Floats) -> tuple[Floats, float]:
    """Return the linear colours (n, 3) and the gloss that an item has because of its look."""
    if item.look is None:
        return colour, 0.0 if item.shape == "mound" else 0.5
    kind = KIND_BY_LOOK[item.look]
    row = SURFACE_KINDS[kind]
    gloss = LIGHT_GLOSS if kind == "light" else METAL_GLOSS if row.metalness else max(0.0, 1.0 - row.roughness - 0.1)
    return np.broadcast_to(decode_srgb(row.colour), colour.shape), gloss


def _find_ground_heights(points: Array, base_point: Array, up: Array, size: float, ground: StaticSetting) -> Array:
    """Return the height (n,) of the ground below each point relative to `base_point`, limited in slope.

    So a mound follows uneven ground. Ground that cannot hold soil counts as height 0, as does ground that is lower than `size`
    below the point."""
    away = points - base_point
    level = points - (away @ up)[:, None] * up
    start = level + size * up
    hits = ground.rays.find_first_hits(start, np.broadcast_to((-up).astype(np.float32), start.shape))
    down = np.where(np.isin(ground.kind[hits.face], surface_materials.TRAIL_KINDS), hits.t, np.inf)  # no soil is piled on stone
    flat = np.linalg.norm(level - base_point, axis=1)
    return np.clip(
        np.where(down <= 2 * size, size - np.minimum(down, 2 * size), 0.0), -_STEEP_SLOPE_SHARE * flat, _STEEP_SLOPE_SHARE * flat
    )
