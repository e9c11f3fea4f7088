"""The light of one frame's samples: what stands still with the shadows of what moves, what moves itself, sky and haze."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.rays import Hits, RayScene
from antdsl.outputs.pictures import looks
from antdsl.outputs.pictures.actors import Actors
from antdsl.outputs.pictures.light import SUN, Sun, ambient, displayed, hazed, sky
from antdsl.outputs.pictures.looks import Scales
from antdsl.outputs.pictures.samples import Stage, screen_places
from antdsl.outputs.pictures.shading_rows import Floats, blended, dots, units
from antdsl.outputs.pictures.texture_noise import dither

Rows = NDArray[np.int64]

_AIR = 2.2  # extents of the set after which haze hides most
_FLOOR = 3.2  # extents after which the table is one with the sky


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One frame to be lit: `albedo` (n, 3) of the stage's samples with trails on, `shade` (h, w) with what moves in it;
    `ground`: the rays of what stands still."""

    stage: Stage
    albedo: Floats
    shade: Floats
    cast: Actors
    ground: RayScene
    sun: Sun
    scales: Scales
    threads: int


def lit_strip(frame: Frame, rows: tuple[int, int]) -> Floats:
    """Display-linear light (n, 3) of the samples of pixel rows `rows[0]` to `rows[1]`."""
    still, sun = frame.stage, frame.sun
    wide = still.view.width * still.samples**2
    own = slice(rows[0] * wide, rows[1] * wide)
    direction = still.view.rays(*rows, still.samples)
    far = still.far[own]
    hits = frame.cast.rays.cast(np.broadcast_to(still.view.eye, direction.shape), direction, frame.threads)
    front = np.flatnonzero(hits.t < far)
    solid = np.isfinite(far)
    solid[front] = False
    back = np.flatnonzero(solid)
    light = np.empty_like(direction)
    empty = np.flatnonzero(~np.isfinite(far) & ~np.isfinite(hits.t))
    light[empty] = sky(direction[empty], sun)
    row, column = (place[back] for place in screen_places(still.view, still.samples, rows))
    direct = _shadowed(frame, still.sun[own][back], far[back], direction[back], row, column)
    opened = frame.shade[row // still.samples, column // still.samples]
    around = ambient(still.upness[own][back]) * opened[:, None]
    colour = frame.albedo[own][back] * (direct[:, None] * SUN + around)
    light[back] = _airy(frame, colour, still.kind[own][back], far[back], direction[back])
    if len(front):
        colour = _moving(frame, hits, direction, front)
        light[front] = hazed(colour, hits.t[front], direction[front], sun, _AIR * frame.scales.extent)
    return displayed(light)


def _airy(frame: Frame, colour: Floats, kind: NDArray[np.uint8], far: Floats, direction: Floats) -> Floats:
    """Haze; the table is lost in it sooner, so that its end is never seen."""
    extent = frame.scales.extent
    colour = hazed(colour, far, direction, frame.sun, _AIR * extent)
    table = np.flatnonzero(kind == looks.TABLE)
    if len(table):
        fade = 1 - np.exp(-np.square(far[table] / np.float32(_FLOOR * extent)))
        level = direction[table] - (direction[table] @ frame.sun.up)[:, None] * frame.sun.up
        colour[table] += (sky(level, frame.sun) - colour[table]) * fade[:, None]
    return colour


def _shadowed(frame: Frame, direct: Floats, far: Floats, direction: Floats, row: Rows, column: Rows) -> Floats:
    """Sunlight (n,) less what the moving things keep from it."""
    if frame.cast.size <= 0:
        return direct
    lit = np.flatnonzero(direct > 0)
    start: Floats = frame.stage.view.eye.astype(np.float32) + far[lit, None] * direction[lit]
    rays = frame.sun.directions(dither(row[lit], column[lit]), dither(row[lit], column[lit], 1))
    start += rays * np.float32(1e-5 * frame.scales.extent)
    met = frame.cast.rays.occluded(start, rays, far=frame.cast.tall, threads=frame.threads)
    direct = direct.copy()
    direct[lit[met]] = 0
    return direct


def _moving(frame: Frame, hits: Hits, direction: Floats, front: Rows) -> Floats:
    """Light (n, 3) from the samples that meet something that moves: a dull body with a glint of sun and a bright rim."""
    mesh, sun = frame.cast.mesh, frame.sun
    corners = mesh.faces[hits.face[front]]
    u, v, flat, towards = hits.u[front], hits.v[front], hits.normal[front], direction[front]
    normal = units(blended(mesh.normal, corners, u, v))
    normal *= np.where(dots(normal, flat) < 0, np.float32(-1), np.float32(1))[:, None]
    colour = blended(mesh.colour, corners, u, v)
    gloss = mesh.gloss[corners[:, 0]]
    where: Floats = frame.stage.view.eye.astype(np.float32) + hits.t[front, None] * towards
    where += flat * np.float32(2e-5 * frame.scales.extent)
    facing = np.clip(normal @ sun.towards, 0, 1)
    lit = np.flatnonzero(facing > 0)
    aim = np.broadcast_to(sun.towards, (len(lit), 3))
    hidden = frame.cast.rays.occluded(where[lit], aim, far=frame.cast.tall, threads=frame.threads)
    open_to = np.flatnonzero(~hidden)
    hidden[open_to] = frame.ground.occluded(where[lit[open_to]], aim[open_to], threads=frame.threads)
    facing[lit[hidden]] = 0
    upness = normal @ sun.up
    half = units(sun.towards - towards)
    shine = gloss * np.clip(dots(normal, half), 0, 1) ** 42 * (facing > 0)
    rim = gloss * (1 - np.clip(-dots(normal, towards), 0, 1)) ** 4
    # Undersides see mostly the near ground, which the body keeps dark.
    near = (0.45 + 0.55 * np.clip(0.6 + 0.8 * upness, 0, 1)) * 1.15
    around = ambient(upness)
    light: Floats = colour * (facing[:, None] * SUN + around * near[:, None])
    light += (shine * 0.7)[:, None] * SUN
    light += (rim * 0.25)[:, None] * around
    return light
