"""A frame of foraging ants as one would write it by hand for this scene alone: the bound that `page.py` compares with.

Everything is done for every ant in every frame: three feelers and two surface rays by Embree through Open3D, feelers limited to
their reach; a cell grid and separation from about eight neighbours; nine cells of a pheromone grid of 1024 by 1024, which spreads
and fades whole; a machine of five states; a budget of force; a sample of a distance field of 128³, into which 500 ants dig. One
thread, float32, all but the rays in kernels compiled by numba, each ant in one go. There is no language, no order of rows to
keep, no exact sum, and nothing is skipped because it cannot matter.

`python tests/benchmarks/bound.py [AGENTS…]` prints milliseconds of CPU time a frame."""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence

import numpy as np
import open3d as o3d
from numba import njit
from numpy.typing import NDArray

F = np.float32
Floats = NDArray[np.float32]
SIDE = 100.0  # of the ground
LINES = 159  # vertices along a side: 49,928 triangles
NEIGHBOURS = 8
CELLS = 1024  # of the pheromone, along a side
VOXELS = 128  # of the distance field, along a side
DIGGERS = 500
SEARCH, HOME, APPROACH, CARRY, TRAIL = range(5)
FRAMES, WARM = 20, 3
SINE, COSINE = F(np.sin(np.radians(35.0))), F(np.cos(np.radians(35.0)))


@njit(cache=True, fastmath=True)
def fill_cells(x: Floats, z: Floats, size: F, across: int, start: NDArray, order: NDArray, cell: NDArray) -> None:
    """Numbers of ants cell by cell, by counting."""
    start[:] = 0
    for i in range(len(x)):
        c = min(max(int(z[i] / size), 0), across - 1) * across + min(max(int(x[i] / size), 0), across - 1)
        cell[i] = c
        start[c + 1] += 1
    for c in range(across * across):
        start[c + 1] += start[c]
    for i in range(len(x) - 1, -1, -1):
        c = cell[i]
        start[c + 1] -= 1
        order[start[c + 1]] = i
    for c in range(across * across):
        start[c] = start[c + 1]
    start[across * across] = len(x)


@njit(cache=True, fastmath=True)
def separate(
    x: Floats, z: Floats, r: F, across: int, start: NDArray, order: NDArray, cell: NDArray, px: Floats, pz: Floats
) -> None:
    """The push away from those within `r`, over nine cells."""
    for i in range(len(x)):
        ax, az, row, column = F(0), F(0), cell[i] // across, cell[i] % across
        for a in range(max(row - 1, 0), min(row + 2, across)):
            for k in range(start[a * across + max(column - 1, 0)], start[a * across + min(column + 1, across - 1) + 1]):
                j = order[k]
                dx, dz = x[i] - x[j], z[i] - z[j]
                d2 = dx * dx + dz * dz
                if F(1e-12) < d2 < r * r:
                    by = F(1) / np.sqrt(d2) - F(1) / r
                    ax += dx * by
                    az += dz * by
        px[i], pz[i] = ax, az


@njit(cache=True, fastmath=True)
def rays_of(x: Floats, y: Floats, z: Floats, hx: Floats, hz: Floats, feelers: Floats, feet: Floats) -> None:
    """Three feelers and two rays to the ground for each ant: (3 n, 6) and (2 n, 6)."""
    for i in range(len(x)):
        for k in range(3):
            turn = F(k - 1) * SINE
            c = COSINE if k != 1 else F(1)
            ray = feelers[3 * i + k]
            ray[0], ray[1], ray[2] = x[i], y[i] + F(0.2), z[i]
            ray[3], ray[4], ray[5] = c * hx[i] - turn * hz[i], F(0), turn * hx[i] + c * hz[i]
        for k in range(2):
            ahead = F(0.2) * F(k)
            ray = feet[2 * i + k]
            ray[0], ray[1], ray[2] = x[i] + ahead * hx[i], y[i] + F(1), z[i] + ahead * hz[i]
            ray[3], ray[4], ray[5] = F(0), F(-1), F(0)


@njit(cache=True, fastmath=True)
def spread(old: Floats, new: Floats, keep: F, share: F) -> None:
    """What is in each cell of a grid, after it went on to its four neighbours and faded."""
    n = CELLS
    for a in range(n):
        up, down = max(a - 1, 0) * n, min(a + 1, n - 1) * n
        own = a * n
        for b in range(1, n - 1):
            at = own + b
            new[at] = keep * (old[at] + share * (old[up + b] + old[down + b] + old[at - 1] + old[at + 1] - F(4) * old[at]))
        new[own] = keep * old[own]
        new[own + n - 1] = keep * old[own + n - 1]


@njit(cache=True, fastmath=True)
def live(
    x: Floats,
    y: Floats,
    z: Floats,
    vx: Floats,
    vz: Floats,
    hx: Floats,
    hz: Floats,
    state: NDArray,
    since: Floats,
    swing: Floats,
    px: Floats,
    pz: Floats,
    hit: Floats,
    ground: Floats,
    items: Floats,
    scent: Floats,
    field: Floats,
    frame: int,
) -> None:
    """All else of a frame, ant by ant: what it smells, its state, its budget of force, its way, what it lays and digs."""
    dt, top, strong = F(1 / 24), F(1.5), F(8.0)
    to_cell, to_voxel = F(CELLS / SIDE), F((VOXELS - 2) / SIDE)
    for i in range(len(x)):
        ca = min(max(int(z[i] * to_cell), 1), CELLS - 2)
        cb = min(max(int(x[i] * to_cell), 1), CELLS - 2)
        best, gx, gz = F(0), F(0), F(0)
        for a in range(-1, 2):
            for b in range(-1, 2):
                value = scent[(ca + a) * CELLS + cb + b]
                best = max(best, value)
                gx += F(b) * value
                gz += F(a) * value
        meal, mx, mz, nest, nx, nz = F(1e9), F(0), F(0), F(1e9), F(0), F(0)
        for k in range(len(items)):
            dx, dz = items[k, 0] - x[i], items[k, 1] - z[i]
            d = np.sqrt(dx * dx + dz * dz)
            if items[k, 2] > 0 and d < meal:
                meal, mx, mz = d, dx / d, dz / d
            if items[k, 2] == 0 and d < nest:
                nest, nx, nz = d, dx / d, dz / d
        s, since[i] = state[i], since[i] + dt
        previous_state = s
        if s == SEARCH:
            s = APPROACH if meal < 3 else TRAIL if best > F(0.05) else HOME if since[i] > 30 else s
        elif s == HOME:
            s = APPROACH if meal < 3 else SEARCH if nest < 1 else s
        elif s == APPROACH:
            s = CARRY if meal < 1 else SEARCH if meal > 3 else s
        elif s == CARRY:
            s = TRAIL if nest < 1 else s
        else:
            s = APPROACH if meal < 3 else SEARCH if best < F(0.05) and since[i] > 1 else s
        if s != previous_state:
            state[i], since[i] = s, 0
        word = np.uint32(i) * np.uint32(0x9E3779B9) ^ np.uint32(frame) * np.uint32(0x85EBCA6B)
        word ^= word >> np.uint32(15)
        word *= np.uint32(0x2C1B3C6D)
        word ^= word >> np.uint32(12)
        swing[i] = F(0.9) * swing[i] + F(0.1) * (F(word) * F(2 / 2**32) - F(1))
        if s == SEARCH:
            wx, wz = hx[i] - swing[i] * hz[i], hz[i] + swing[i] * hx[i]
        elif s == APPROACH:
            wx, wz = mx, mz
        elif s == TRAIL:
            wx, wz = gx - F(0.3) * nx, gz - F(0.3) * nz
        else:
            wx, wz = nx, nz
        long = np.sqrt(wx * wx + wz * wz) + F(1e-9)
        left = strong
        fx, fz = F(0), F(0)
        for layer in range(3):
            if layer == 0:
                qx, qz = hit[i, 0] * strong, hit[i, 1] * strong
            elif layer == 1:
                qx, qz = F(4) * px[i], F(4) * pz[i]
            else:
                qx, qz = (wx / long * top - vx[i]) * F(6), (wz / long * top - vz[i]) * F(6)
            size = np.sqrt(qx * qx + qz * qz) + F(1e-9)
            by = min(size, left) / size
            fx += qx * by
            fz += qz * by
            left -= size * by
        # the distance field, with its slope
        fa = min(max(x[i] * to_voxel, F(0)), F(VOXELS - 2) - F(1e-3))
        fb = min(max((y[i] + F(50)) * to_voxel, F(0)), F(VOXELS - 2) - F(1e-3))
        fc = min(max(z[i] * to_voxel, F(0)), F(VOXELS - 2) - F(1e-3))
        a, b, c = int(fa), int(fb), int(fc)
        u, v, w = fa - F(a), fb - F(b), fc - F(c)
        at = (a * VOXELS + b) * VOXELS + c
        one, two = VOXELS, VOXELS * VOXELS
        low = (field[at] * (1 - w) + field[at + 1] * w) * (1 - v) + (field[at + one] * (1 - w) + field[at + one + 1] * w) * v
        at += two
        high = (field[at] * (1 - w) + field[at + 1] * w) * (1 - v) + (field[at + one] * (1 - w) + field[at + one + 1] * w) * v
        inside = low * (1 - u) + high * u
        if inside < 0:
            fx += (high - low) * strong
        vx[i] += fx * dt
        vz[i] += fz * dt
        speed = np.sqrt(vx[i] * vx[i] + vz[i] * vz[i]) + F(1e-9)
        by = min(speed, top) / speed
        vx[i] *= by
        vz[i] *= by
        speed *= by
        hx[i], hz[i] = vx[i] / speed, vz[i] / speed
        x[i] += vx[i] * dt
        z[i] += vz[i] * dt
        if not F(1) < x[i] < F(SIDE - 1):
            vx[i] = -vx[i]
            x[i] = min(max(x[i], F(1)), F(SIDE - 1))
        if not F(1) < z[i] < F(SIDE - 1):
            vz[i] = -vz[i]
            z[i] = min(max(z[i], F(1)), F(SIDE - 1))
        y[i] += F(1) - F(0.5) * (ground[2 * i] + ground[2 * i + 1])
        scent[ca * CELLS + cb] += F(0.2) if s == CARRY else F(0.001)
        if i < DIGGERS:
            for da in range(-2, 3):
                for db in range(-2, 3):
                    for dc in range(-2, 3):
                        ka = min(max(a + da, 0), VOXELS - 1)
                        kb = min(max(b + db, 0), VOXELS - 1)
                        kc = min(max(c + dc, 0), VOXELS - 1)
                        k = (ka * VOXELS + kb) * VOXELS + kc
                        field[k] = max(field[k], F(2) - np.sqrt(F(da * da + db * db + dc * dc)))


@njit(cache=True, fastmath=True)
def push_away(number: NDArray, normals: Floats, hit: Floats) -> None:
    """Push away from what feelers met: `number` of each feeler that did."""
    hit[:] = 0
    for k in range(len(number)):
        hit[number[k] // 3, 0] += normals[k, 0]
        hit[number[k] // 3, 1] += normals[k, 2]


def terrain() -> tuple[Floats, NDArray[np.uint32]]:
    """Hills of 49,928 triangles."""
    line = np.linspace(0.0, SIDE, LINES)
    x, z = np.meshgrid(line, line)
    y = 1.5 * np.sin(x / 7.0) + 1.2 * np.sin(z / 5.0 + x / 19.0)
    a = (np.arange(LINES - 1)[:, None] * LINES + np.arange(LINES - 1)).ravel()
    faces = np.concatenate([np.stack([a, a + LINES, a + 1], 1), np.stack([a + 1, a + LINES, a + LINES + 1], 1)])
    return np.stack([x.ravel(), y.ravel(), z.ravel()], 1).astype(F), faces.astype(np.uint32)


class Bound:
    """So many ants on a ground of one size, `frame()` by `frame()`: they see eight others each, however many there are."""

    def __init__(self, agents: int, seed: int = 1) -> None:
        draw = np.random.default_rng(seed)
        n = self.agents = agents
        self.x, self.z = (draw.uniform(1.0, SIDE - 1.0, n).astype(F) for _ in range(2))
        self.y = np.zeros(n, F)
        turn = draw.uniform(0.0, 2 * np.pi, n)
        self.hx, self.hz = np.cos(turn).astype(F), np.sin(turn).astype(F)
        self.vx, self.vz = self.hx.copy(), self.hz.copy()
        self.state, self.since, self.swing = np.zeros(n, np.int32), np.zeros(n, F), np.zeros(n, F)
        self.px, self.pz, self.hit = np.zeros(n, F), np.zeros(n, F), np.zeros((n, 2), F)
        self.feelers, self.feet = np.empty((3 * n, 6), F), np.empty((2 * n, 6), F)
        self.radius = F(SIDE * np.sqrt(NEIGHBOURS / (np.pi * n)))
        self.reach = float(self.radius)
        self.across = max(1, int(SIDE / self.radius))
        self.start = np.zeros(self.across**2 + 1, np.int64)
        self.order, self.cell = np.empty(n, np.int64), np.empty(n, np.int64)
        positions = draw.uniform(10.0, SIDE - 10.0, (9, 2))
        self.items = np.concatenate([positions, (np.arange(9) < 6).astype(float)[:, None]], 1).astype(F)
        self.scent, self.spread = np.zeros(CELLS**2, F), np.zeros(CELLS**2, F)
        self.field = np.full(VOXELS**3, F(1))
        self.number = 0
        vertices, faces = terrain()
        self.scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        self.scene.add_triangles(o3d.core.Tensor(vertices), o3d.core.Tensor(faces))
        self._step_down()

    def _step_down(self) -> None:
        rays_of(self.x, self.y + F(20), self.z, self.hx, self.hz, self.feelers, self.feet)
        distances = self.scene.cast_rays(o3d.core.Tensor(self.feet), nthreads=1)["t_hit"].numpy()
        self.y = (F(21) - distances[::2]).astype(F)

    def frame(self) -> None:
        """One frame."""
        fill_cells(self.x, self.z, F(SIDE / self.across), self.across, self.start, self.order, self.cell)
        separate(self.x, self.z, self.radius, self.across, self.start, self.order, self.cell, self.px, self.pz)
        rays_of(self.x, self.y, self.z, self.hx, self.hz, self.feelers, self.feet)
        occluded = self.scene.test_occlusions(o3d.core.Tensor(self.feelers), tnear=0.0, tfar=self.reach, nthreads=1).numpy()
        number = np.flatnonzero(occluded)
        hits = self.scene.cast_rays(o3d.core.Tensor(self.feelers[number]), nthreads=1)
        push_away(number, hits["primitive_normals"].numpy(), self.hit)
        ground = self.scene.cast_rays(o3d.core.Tensor(self.feet), nthreads=1)["t_hit"].numpy()
        spread(self.scent, self.spread, F(0.995), F(0.05))
        self.scent, self.spread = self.spread, self.scent
        live(
            self.x, self.y, self.z, self.vx, self.vz, self.hx, self.hz, self.state, self.since, self.swing,
            self.px, self.pz, self.hit, ground, self.items, self.scent, self.field, self.number,
        )  # fmt: skip
        self.number += 1


def milliseconds(agents: int, frames: int) -> float:
    """CPU time of a frame: the median."""
    bound, spent = Bound(agents), []
    for number in range(WARM + frames):
        began = time.process_time()
        bound.frame()
        if number >= WARM:
            spent.append(1000 * (time.process_time() - began))
    return float(np.median(spent))


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a line for each number of ants."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("agents", type=int, nargs="*", default=[15_000, 100_000, 1_000_000])
    parser.add_argument("--frames", type=int, default=FRAMES)
    options = parser.parse_args(arguments)
    for agents in options.agents:
        print(f"{agents:>9,} ants: {milliseconds(agents, options.frames):8.1f} ms a frame", flush=True)


if __name__ == "__main__":
    from bound import main as named  # compiled kernels are stored under the name of the module that they are of

    named()
