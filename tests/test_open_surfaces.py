"""Open and non-manifold surfaces: nobody comes to the other side of what is walked on unless edges lead there, goes through a wall,
is lost, stuck for good, or steps farther than asked."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from meshes import Mesh
from numpy.typing import NDArray
from open_shapes import Led, led
from torture_walks import BODY, STEP, crowd

from antdsl.runtime.senses.ground import Ground, MoveResult

Floats = NDArray[np.float64]
HAIR = 1e-6  # mm off the surface
SMALL = 0.2  # mm: a step in which one walker steps over once at most, but for crumbs
BENDS = (1e-5, 0.02, 0.1, 0.2, 0.4)  # mm: how far outside a corner the way round it may lead
WINDOW = 100


@dataclass
class Watch:
    """What is told of a crowd: of those who stepped over, whose feet cannot have gone that way."""

    mesh: Mesh
    led: Led
    changed: list[tuple[int, int, int]] = field(default_factory=list)
    through: list[tuple[int, int, int]] = field(default_factory=list)
    farthest: float = 0.0
    lost: int = 0
    over: int = 0
    wish: Floats = field(default_factory=lambda: np.empty((0, 3)))

    def look(self, ground: Ground, before: MoveResult, at: MoveResult, step: float, closely: bool) -> None:
        gone = np.linalg.norm(at.position - before.position, axis=1)
        self.farthest = max(self.farthest, float(gone.max()) / step, float(at.travelled.max()) / step)
        self.lost += int((at.lost | ~np.isfinite(at.position).all(axis=1)).sum())
        (f, here), (g, there) = standing(ground, before), standing(ground, at)
        way, part = self.led.way, self.led.part
        other = np.flatnonzero(way[here, f] != way[there, g])
        own = other[(part[f] == part[g])[other]]
        own = own[self.led.open[f[own]]]
        self.changed += [(int(k), int(f[k]), int(g[k])) for k in own if not self.crossed_over(ground, before, at, k)]
        over = other[part[f[other]] != part[g[other]]]
        self.over += over.size
        if closely:
            bad = over[~self.free(before.take(over), at.take(over), f[over], g[over], ground)]
            self.through += [(int(k), int(f[k]), int(g[k])) for k in bad]

    def crossed_over(self, ground: Ground, before: MoveResult, at: MoveResult, who: int) -> bool:
        """Whether another part was stood on within the step: shorter steps end earlier on the same way."""
        f = standing(ground, before)[0][who]
        one = before.take(np.array([who]))
        for share in np.arange(1, 64) / 64:
            heading = self.wish[who : who + 1] * share
            part = ground.move(one.footing, heading, heading, one.up, BODY)
            if self.led.part[standing(ground, part)[0][0]] != self.led.part[f]:
                return True
        return False

    def free(self, before: MoveResult, at: MoveResult, f: Floats, g: Floats, ground: Ground) -> NDArray[np.bool_]:
        """Whether a way is free from a hair above where feet were to a hair above where they are, round a corner at most."""
        up0, up1 = facing(ground, before), facing(ground, at)
        start, end = before.position + up0 * HAIR, at.position + up1 * HAIR
        found = ~self.crosses(start, end)
        way = end - start
        flat = [way - (way * up).sum(axis=1)[:, None] * up for up in (up0, up1)]
        for bend in BENDS:
            for corner in ((start + end) / 2, start, end, start + flat[0], end - flat[1], start + flat[0] / 2, end - flat[1] / 2):
                corner = corner + (up0 + up1) * bend
                found |= ~self.crosses(start, corner) & ~self.crosses(corner, end)
        return found

    def crosses(self, start: Floats, end: Floats) -> NDArray[np.bool_]:
        """Whether any face lies between places (Möller, Trumbore, as in `boxes`, but for all faces)."""
        a, b, c = (self.mesh[0][self.mesh[1][:, k]] for k in range(3))
        e1, e2 = b - a, c - a
        found = np.zeros(len(start), bool)
        for k, (o, d) in enumerate(zip(start, end - start, strict=True)):
            p = np.cross(d, e2)
            det = (e1 * p).sum(axis=1)
            safe = np.where(det == 0, 1.0, det)
            s = o - a
            q = np.cross(s, e1)
            u, v, t = (s * p).sum(axis=1) / safe, (q @ d) / safe, (e2 * q).sum(axis=1) / safe
            found[k] = ((det != 0) & (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & (t < 1)).any()
        return found


def standing(ground: Ground, at: MoveResult) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    return ground.on_faces(at.footing)[0], ((ground.normal(at.footing) * at.up).sum(axis=1) < 0).astype(np.int64)


def facing(ground: Ground, at: MoveResult) -> Floats:
    normal = ground.normal(at.footing)
    return normal * np.where((normal * at.up).sum(axis=1) < 0, -1.0, 1.0)[:, None]


def watched(mesh: Mesh, n: int, steps: int, step: float = STEP, closely: bool = False) -> tuple[Watch, NDArray[np.bool_]]:
    """A crowd's walk, and who has hardly moved in its last `WINDOW` steps."""
    ground, rng = Ground({"mesh": mesh}), np.random.default_rng(4)
    watch, at = Watch(mesh, led(mesh)), crowd(ground, [mesh], n, rng)
    places = []
    for _ in range(steps):
        heading = at.heading + np.cross(at.up, at.heading) * rng.normal(0, 0.3, (n, 1))
        heading *= np.where(at.blocked, -step, step)[:, None] / np.linalg.norm(heading, axis=1, keepdims=True)
        before, at = at, ground.move(at.footing, heading, heading, at.up, BODY)
        watch.wish = heading
        watch.look(ground, before, at, step, closely)
        places.append(at.position)
    last = np.array(places[-WINDOW:])
    return watch, np.linalg.norm(last.max(axis=0) - last.min(axis=0), axis=1) < 0.02 * step * min(steps, WINDOW)


def held(mesh: Mesh, n: int, steps: int) -> Watch:
    watch, still = watched(mesh, n, steps)
    assert not watch.changed and watch.lost == 0 and watch.farthest <= 1.01, watch
    assert still.mean() < 0.02, still.mean()
    return watch
