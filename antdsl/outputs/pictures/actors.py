"""All that moves, as one ray scene: every agent's posed body and every item at its size, in this frame."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.body import Body, orientation, rotation, vertex_normals
from antdsl.bodies.catalogue import body
from antdsl.bodies.placed import placed
from antdsl.bodies.posed_body import PosedBody
from antdsl.casting.rays import RayScene
from antdsl.outputs.pictures.camera import View
from antdsl.outputs.pictures.light import decoded
from antdsl.outputs.pictures.model import Crowd, Item, Picture
from antdsl.outputs.pictures.shading_rows import Floats

Array = NDArray[np.float64]

CLOSE = 28.0  # pixels of body length from which the close-up body is worth its triangles
MOST_CLOSE = 1200  # bodies at most that are drawn so, the largest first
MOST_ENLARGED = 3.0
MOST_TRIANGLES = 2_000_000  # of close-up bodies of a species' own
_DARK = decoded((0.16, 0.11, 0.09))  # legs, feelers, eyes


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """One kind of thing many times: vertices and normals (n, 3), faces, linear colour (n, 3), gloss (n,)."""

    vertices: Array
    faces: NDArray[np.int32]
    normal: Floats
    colour: Floats
    gloss: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Actors:
    """`rays` over one mesh of everything that moves; `tall`: the longest way its shadow needs to be looked
    for; `size`: how far around a body the ground lies in its shade."""

    rays: RayScene
    mesh: Mesh
    tall: float
    size: float


def actors(picture: Picture, view: View, least: float = 0.0, ground: RayScene | None = None) -> Actors:
    """The moving part of `picture`, agents that are large in `view` with their close-up bodies, those out of sight left out;
    what is of loose soil follows `ground`.

    Bodies shorter than `least` pixels are drawn that long, though never more than MOST_ENLARGED times their size."""
    parts: list[Mesh] = []
    longest = 0.0
    for crowd in picture.crowds:
        if len(crowd.position):
            parts += _crowd(crowd, view, least)
            longest = max(longest, float(np.max(crowd.scale)))
    parts += [
        item_mesh(item, picture.up, ground)
        for item in picture.items
        if item.shape != "none" and item.left > 0 and item.radius > 0
    ]
    widest = max((item.radius for item in picture.items), default=0.0)
    if not parts:
        none = np.zeros((0, 3), np.float32)
        nothing = Mesh(none.astype(np.float64), np.zeros((0, 3), np.int32), none, none, none[:, 0])
        return Actors(RayScene(nothing.vertices, nothing.faces), nothing, 0.0, 0.0)
    starts = np.cumsum([0] + [len(part.vertices) for part in parts])
    mesh = Mesh(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + np.int32(start) for part, start in zip(parts, starts[:-1], strict=True)]),
        np.concatenate([part.normal for part in parts]),
        np.concatenate([part.colour for part in parts]),
        np.concatenate([part.gloss for part in parts]),
    )
    return Actors(RayScene(mesh.vertices, mesh.faces), mesh, max(20 * longest, 8 * widest), max(longest, 0.3 * widest))


def _crowd(crowd: Crowd, view: View, least: float) -> list[Mesh]:
    scale = np.asarray(crowd.scale, np.float64)
    finite = np.isfinite(crowd.position).all(axis=1) & np.isfinite(crowd.orient).all(axis=1) & np.isfinite(scale) & (scale > 0)
    position = np.where(finite[:, None], crowd.position, 0.0)
    scale = np.where(finite, scale, 1.0)
    depth = view.project(position)[1]
    # What is a little outside still throws its shadow into the picture.
    seen = finite & (depth > -20 * scale) & _in_sight(position, depth, 20 * scale, view)
    near = np.maximum(np.linalg.norm(position - view.eye, axis=1), 1e-9)
    pixels = scale / view.pixel_at(near)
    large = np.flatnonzero(seen & (pixels >= CLOSE))
    most = MOST_CLOSE if crowd.worn is None else min(MOST_CLOSE, MOST_TRIANGLES // max(1, len(crowd.worn.fine.faces)))
    close = np.sort(large[np.argsort(-pixels[large], kind="stable")[:most]])
    far = np.setdiff1d(np.flatnonzero(seen), close)
    sizes = np.minimum(np.maximum(scale, least * view.pixel_at(near)), MOST_ENLARGED * scale)
    if crowd.worn is not None:
        parts = ((crowd.worn.fine, close), (crowd.worn.coarse, far))
        return [_worn(crowd, own, rows, sizes) for own, rows in parts if len(rows) and len(own.faces)]
    made = [_posed(crowd, body(crowd.body, True), close, scale[close], np.zeros(len(close)))]
    # Of a body a few pixels long the dark legs would hide the state's colour.
    made.append(_posed(crowd, body(crowd.body, False), far, sizes[far], np.clip(1 - pixels[far] / CLOSE, 0.0, 1.0) ** 2))
    return [mesh for mesh in made if len(mesh.vertices)]


def _worn(crowd: Crowd, body: PosedBody, rows: NDArray[np.int64], size: Array) -> Mesh:
    """The bodies of some agents, each posed by what it plays, `size` (n,) long for all agents of the crowd."""
    plays = [each.rows(rows) for each in crowd.plays]
    local, normal = body.posed(plays, len(rows), crowd.feet_beside(rows), driven=crowd.driven.rows(rows))
    across = np.swapaxes(rotation(np.asarray(crowd.orient, np.float64)[rows]).astype(np.float32), 1, 2)
    local = np.matmul(local * size[rows].astype(np.float32)[:, None, None], across)
    vertices = local.astype(np.float64) + np.asarray(crowd.position, np.float64)[rows, None, :]
    bright = decoded(np.nan_to_num(np.asarray(crowd.colour, np.float32)[rows]))[:, None, :]
    tint = body.tint[None, :, None]
    colour = bright * tint + body.own[None] * (1 - tint)
    count = len(body.tint)
    faces = (body.faces[None] + (np.arange(len(rows), dtype=np.int32) * count)[:, None, None]).reshape(-1, 3)
    gloss = np.full(len(rows) * count, 0.35, np.float32)
    normal = np.matmul(normal, across)
    return Mesh(vertices.reshape(-1, 3), faces, normal.reshape(-1, 3), colour.reshape(-1, 3), gloss)


def _in_sight(points: Array, depth: Array, margin: Array, view: View) -> NDArray[np.bool_]:
    """Whether a ball of `margin` around each point reaches into the picture's pyramid."""
    seen = points - view.eye
    inside = np.ones(len(points), np.bool_)
    for axis, half in ((view.right, view.half[0]), (view.above, view.half[1])):
        inside &= np.abs(seen @ axis) - depth * half <= margin * float(np.hypot(1.0, half))
    return inside


def _posed(crowd: Crowd, shape: Body, rows: NDArray[np.int64], size: Array, plain: Array) -> Mesh:
    """The bodies of some agents, `size` (a,) long; `plain` (a,): how much their dark parts take the agent's colour too."""
    scale = np.asarray(crowd.scale, np.float64)[rows]
    walked = np.zeros(len(rows)) if crowd.walked is None else np.asarray(crowd.walked, np.float64)[rows] / scale
    across = np.swapaxes(rotation(np.asarray(crowd.orient, np.float64)[rows]).astype(np.float32), 1, 2)
    local = shape.posed(np.nan_to_num(walked)) * size.astype(np.float32)[:, None, None]
    vertices = np.matmul(local, across).astype(np.float64) + np.asarray(crowd.position, np.float64)[rows, None, :]
    normal = np.matmul(np.broadcast_to(shape.normals, (len(rows), *shape.normals.shape)), across)
    bright = decoded(np.nan_to_num(np.asarray(crowd.colour, np.float32)[rows]))[:, None, :]
    tint = shape.tint[None, :, None]
    tint = tint + (1 - tint) * (0.8 * plain.astype(np.float32))[:, None, None]
    colour = bright * tint + (_DARK + bright * 0.07) * (1 - tint)
    count = len(shape.normals)
    faces = (shape.faces[None] + (np.arange(len(rows), dtype=np.int32) * count)[:, None, None]).reshape(-1, 3)
    gloss = np.full(len(rows) * count, 0.55, np.float32)
    return Mesh(vertices.reshape(-1, 3), faces, normal.reshape(-1, 3), colour.reshape(-1, 3), gloss)


def item_mesh(item: Item, up: tuple[float, float, float], ground: RayScene | None = None) -> Mesh:
    vertices, faces, colour = placed(item.shape)
    size = item.radius * min(max(item.left, 0.0), 1.0) ** (1 / 3)
    upward = np.array([up]) / np.linalg.norm(up)
    turn = rotation(orientation(np.array([[0.83, 0.31, 0.46]]), upward))[0]
    points = (vertices * size) @ turn.T + np.asarray(item.position, np.float64)
    if item.shape == "mound" and ground is not None:
        points += _slump(points, np.asarray(item.position, np.float64), upward[0], size, ground)[:, None] * upward
    gloss = np.full(len(points), 0.0 if item.shape == "mound" else 0.5, np.float32)
    return Mesh(points, faces, vertex_normals(points, faces), decoded(colour), gloss)


def _slump(points: Array, foot: Array, up: Array, size: float, ground: RayScene) -> Array:
    """How much higher than at `foot` the ground is below each point (n,); 0 where it is not within `size` of it."""
    level = points - ((points - foot) @ up)[:, None] * up
    start = level + size * up
    down = ground.cast(start, np.broadcast_to(-up, start.shape)).t.astype(np.float64)
    return np.where(down <= 2 * size, size - down, 0.0)
