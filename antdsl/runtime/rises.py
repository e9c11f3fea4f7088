"""What rises before agents: a wall of the ground that the next steps lead onto, and how far a body is to be tilted for it by then."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.runtime import kernels
from antdsl.runtime.world import Population, World

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]

_STEEP = 0.7071067811865476  # cosine of the least turn of the ground that is a wall; less is smooth, or a slope
_EYE = 0.03  # of a body: how high above the feet a ray looks for walls
_WIDEST = 4.0  # half bodies before a wall within which a body tilts, at most


@dataclass(frozen=True, slots=True, eq=False)
class Rises:
    """Walls before some agents (`rows`): normals `wall` (3, k) on their side, the `angle` (radians) by which the ground turns into
    it, how `far` along their heading (`ahead`) feet are from it, and the way `over` which the body tilts, mm."""

    rows: Rows
    wall: Floats
    ahead: Floats
    angle: Floats
    far: Floats
    over: Floats

    @staticmethod
    def none() -> Rises:
        return Rises(np.empty(0, np.intp), np.empty((3, 0)), np.empty((3, 0)), *np.empty((3, 0)))

    def tilted(self, rows: Rows, normal: Floats, gone: Floats) -> Floats:
        """How bodies of `rows` (ascending, all of the own among them) should stand on ground of a normal (3, m), `gone` mm on: as
        it does, or before a wall tilted towards that of the wall."""
        found = normal.copy()
        if not len(self.rows):
            return found
        at = np.searchsorted(rows, self.rows)
        n = normal[:, at]
        part = np.clip(1.0 - (self.far - gone[at]) / self.over, 0.0, 1.0) * self.angle
        axis, cosine = _cross(n, self.wall), _dot(n, self.wall)
        sine = np.sqrt(_dot(axis, axis))
        left = kernels.atan2(sine.astype(np.float32), cosine.astype(np.float32)).astype(np.float64)
        part = np.minimum(part, left).astype(np.float32)
        side = _cross(axis / np.maximum(sine, 1e-300), n)
        turned = n * kernels.cos(part) + side * kernels.sin(part)
        turned /= np.sqrt(_dot(turned, turned))
        tilts = (part > 0) & (sine > 1e-6)
        found[:, at] = np.where(tilts, turned, n)
        return found

    def room(self, rows: Rows, up: Floats, way: Floats, most: Floats) -> Floats:
        """How far (mm) feet of `rows` may go in directions (3, m) while the body, which stands as `up` (3, m), tilts by `most`."""
        found = np.full(len(rows), np.inf)
        if not len(self.rows):
            return found
        at = np.searchsorted(rows, self.rows)
        u, towards = up[:, at], _dot(way[:, at], self.ahead)
        across = _cross(u, self.wall)
        left = kernels.atan2(np.sqrt(_dot(across, across)).astype(np.float32), _dot(u, self.wall).astype(np.float32))
        tilt = self.angle - left.astype(np.float64) + most[at]
        free = np.maximum(self.over * (tilt / self.angle - 1.0) + self.far, 0.0)
        found[at] = np.where(towards > 0.05, free / np.maximum(towards, 0.05), np.inf)
        return found


def rises(world: World, population: Population, ahead: NDArray[np.float32]) -> Rises:
    """What rises before whom who looks along `ahead` (3, n) over its ground.

    The body of length L tilts over a way of L before a wall, linearly: so its head, L/2 before its feet, keeps out of a wall that
    rises by up to a right angle, and of one that hangs over if the way is longer by angle / sine."""
    meshes = world.ground.meshes
    if meshes is None:
        return Rises.none()
    size = np.maximum(population.now["size"], np.float32(0)).astype(np.float64)
    half = np.where(np.isfinite(size), size / 2, 0.0)
    on_mesh = (population.footing.mesh >= 0) & (population.footing.mesh < len(meshes.names))
    rows = np.flatnonzero(meshes.near_rises(population.position, _WIDEST * half) & on_mesh & (half > 0))
    if not len(rows):
        return Rises.none()
    half, normal, look = half[rows], population.normal[rows].T.astype(np.float64), ahead[:, rows].astype(np.float64)
    high = 2 * _EYE * half
    eye, way = population.position[rows].T + normal * high, look * (_WIDEST * half)
    met, part, footing = meshes.met(eye.T, way.T, world.options.threads)
    wall = meshes.normal(footing).T
    wall = np.where(_dot(wall, look) > 0, -wall, wall)
    cosine = _dot(normal, wall)
    across = _cross(normal, wall)
    sine = np.maximum(np.sqrt(_dot(across, across)), 1e-6)
    angle = kernels.atan2(sine.astype(np.float32), cosine.astype(np.float32)).astype(np.float64)
    over = half * np.clip(angle / sine, 2.0, _WIDEST)
    far = np.maximum(part * _WIDEST * half - high * cosine / sine, 0.0)
    chosen = np.flatnonzero(met & (cosine < _STEEP) & (far < over + _WIDEST * half))
    return Rises(rows[chosen], wall[:, chosen], look[:, chosen], angle[chosen], far[chosen], over[chosen])


def _dot(a: Floats, b: Floats) -> Floats:
    total: Floats = (a[0] * b[0] + a[1] * b[1]) + a[2] * b[2]
    return total


def _cross(a: Floats, b: Floats) -> Floats:
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
