"""Solid noise for the appearance of surfaces, computed from small tables: smooth noise with its gradient, and densely packed
grains."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.kernels import F32, I64, Array1, Array2, inlined, kernel, load3, simd_range, store3
from antdsl.numerics.kernel_vectors import Vec3F32, minus, plus, project_to_plane, times

Floats = NDArray[Any]

# Rotated, so that no plane across an axis of the world follows the lattice.
PATTERN_ROTATION = np.array([[0.36, 0.48, -0.80], [-0.80, 0.60, 0.0], [0.48, 0.64, 0.60]], np.float32)
_LATTICE_PERIOD = 32  # the pattern repeats after this many wavelengths


def compute_value_noise(points: Floats, wavelength: float, seed: int) -> tuple[Floats, Floats]:
    """Return smooth noise at `points` (n, 3): values (n,) from −1 to 1, and gradients (n, 3) per world unit.

    `wavelength`: the typical size of a bump, in world units."""
    count = len(points)
    value, gradient = np.empty(count, np.float32), np.empty((count, 3), np.float32)
    scale = np.float32(1.0 / wavelength)
    rows = np.ascontiguousarray(points, np.float32)
    fill_value_noise(rows, PATTERN_ROTATION, scale, make_noise_table(seed), value, gradient, 0, count)
    return value, gradient


@lru_cache(maxsize=32)
def make_noise_table(seed: int) -> Floats:
    """Return a table with a random value from −1 to 1 for each point of a periodic lattice."""
    values = np.random.Generator(np.random.Philox(seed)).uniform(-1.0, 1.0, _LATTICE_PERIOD**3).astype(np.float32)
    values.setflags(write=False)
    return values


@lru_cache(maxsize=8)
def make_grain_table(seed: int) -> Floats:
    """Return a table with one grain per lattice cell: three coordinates of its position, and its tone, from −1 to 1."""
    draw = np.random.Generator(np.random.Philox(seed)).uniform(-1.0, 1.0, (_LATTICE_PERIOD**3, 4)).astype(np.float32)
    draw.setflags(write=False)
    return draw.reshape(-1)


class GrainedSamples(NamedTuple):
    """Samples of surfaces with a grainy appearance. Points, normals and linear colours are (n, 3). The widths of their pixels
    (world units) and the strengths of the grain (0 to 1) are (n,)."""

    points: Array2[F32]
    normal: Array2[F32]
    albedo: Array2[F32]
    pixel: Array1[F32]
    share: Array1[F32]


@inlined
def rotate_to_lattice(rotation: Array2[F32], v: Vec3F32, scale: F32) -> Vec3F32:
    """Return a world vector rotated into the axes of the noise lattice and multiplied by `scale`."""
    x, y, z = v[0] * scale, v[1] * scale, v[2] * scale
    return (
        x * rotation[0, 0] + y * rotation[1, 0] + z * rotation[2, 0],
        x * rotation[0, 1] + y * rotation[1, 1] + z * rotation[2, 1],
        x * rotation[0, 2] + y * rotation[1, 2] + z * rotation[2, 2],
    )


@inlined
def rotate_from_lattice(rotation: Array2[F32], v: Vec3F32, scale: F32) -> Vec3F32:
    """Return a vector in the axes of the noise lattice rotated into the world and multiplied by `scale`."""
    x, y, z = v[0] * scale, v[1] * scale, v[2] * scale
    return (
        x * rotation[0, 0] + y * rotation[0, 1] + z * rotation[0, 2],
        x * rotation[1, 0] + y * rotation[1, 1] + z * rotation[1, 2],
        x * rotation[2, 0] + y * rotation[2, 1] + z * rotation[2, 2],
    )


@inlined
def sample_value_noise(rotation: Array2[F32], table: Array1[F32], point: Vec3F32, scale: F32) -> Any:
    """Return smooth noise at a point, and its gradient per world unit.

    `scale`: wavelengths per world unit. `table`: the values at the lattice points."""
    x, y, z = rotate_to_lattice(rotation, point, scale)
    a, b, c = np.floor(x), np.floor(y), np.floor(z)
    px, py, pz = x - a, y - b, z - c
    x0, y0, z0 = int(a) & 31, int(b) & 31, int(c) & 31
    x1, y1, z1 = ((x0 + 1) & 31) * 1024, ((y0 + 1) & 31) * 32, (z0 + 1) & 31
    x0, y0 = x0 * 1024, y0 * 32
    ex, ey, ez = px * px * (3 - 2 * px), py * py * (3 - 2 * py), pz * pz * (3 - 2 * pz)
    sx, sy, sz = 6 * px * (1 - px), 6 * py * (1 - py), 6 * pz * (1 - pz)
    n000, n010, n100, n110 = table[x0 + y0 + z0], table[x0 + y1 + z0], table[x1 + y0 + z0], table[x1 + y1 + z0]
    d00, d01 = table[x0 + y0 + z1] - n000, table[x0 + y1 + z1] - n010
    d10, d11 = table[x1 + y0 + z1] - n100, table[x1 + y1 + z1] - n110
    v00, v01, v10, v11 = n000 + d00 * ez, n010 + d01 * ez, n100 + d10 * ez, n110 + d11 * ez
    low, high = v00 + (v01 - v00) * ey, v10 + (v11 - v10) * ey
    by_y = (v01 - v00) + ((v11 - v10) - (v01 - v00)) * ex
    near, far = d00 + (d01 - d00) * ey, d10 + (d11 - d10) * ey
    slope = ((high - low) * sx, by_y * sy, (near + (far - near) * ex) * sz)
    return low + (high - low) * ex, rotate_from_lattice(rotation, slope, scale)


@inlined
def sample_grain_noise(rotation: Array2[F32], table: Array1[F32], point: Vec3F32, scale: F32) -> Any:
    """Find the grain that is nearest to a point, in a dense packing of grains (Worley, SIGGRAPH 1996).

    Return the point's distance from the grain's centre (0 to 1), the vector from there to the point, and the grain's tone (−1 to
    1). At the rim of the grain, the vector has a length of about 1. `scale`: grains per world unit. `table`: four numbers per
    lattice cell, from `make_grain_table`."""
    x, y, z = rotate_to_lattice(rotation, point, scale)
    half = np.float32(0.5)
    a, b, c = np.floor(x - half), np.floor(y - half), np.floor(z - half)
    px, py, pz = x - a, y - b, z - c
    x0, y0, z0 = int(a), int(b), int(c)
    nearest = np.float32(np.inf)
    nx, ny, nz, own = np.float32(0), np.float32(0), np.float32(0), np.float32(0)
    for dx in range(2):
        for dy in range(2):
            for dz in range(2):
                cell = ((((x0 + dx) & 31) * 32 + ((y0 + dy) & 31)) * 32 + ((z0 + dz) & 31)) * 4
                ox = px - half - np.float32(dx) - table[cell] * np.float32(0.42)
                oy = py - half - np.float32(dy) - table[cell + 1] * np.float32(0.42)
                oz = pz - half - np.float32(dz) - table[cell + 2] * np.float32(0.42)
                square = ox * ox + oy * oy + oz * oz
                if square < nearest:
                    nearest, nx, ny, nz, own = square, ox, oy, oz, table[cell + 3]
    rim = rotate_from_lattice(rotation, (nx, ny, nz), np.float32(1.5))
    return min(np.sqrt(nearest) * np.float32(1.5), np.float32(1)), rim, own


@kernel
def fill_value_noise(
    points: Array2[F32],
    rotation: Array2[F32],
    scale: F32,
    table: Array1[F32],
    value: Array1[F32],
    gradient: Array2[F32],
    begin: I64,
    end: I64,
) -> None:
    """Write smooth noise at `points` (n, 3) to `value`, and its gradient per world unit to `gradient`."""
    for i in simd_range(begin, end):
        value[i], slope = sample_value_noise(rotation, table, load3(points, i), scale)
        store3(gradient, i, slope)


@kernel
def add_bumps(
    samples: GrainedSamples, rotation: Array2[F32], table: Array1[F32], length: F32, height: F32, speck: F32, begin: I64, end: I64
) -> None:
    """Add bumps of one size to the normals of samples, and specks to their colours. `length`: the size of a bump in world
    units. `height`: its height as a fraction of its size. `speck`: the greatest relative change of a colour."""
    points, normal, albedo, pixel, rough = samples
    for i in simd_range(begin, end):
        visibility = min(max(length / pixel[i] * np.float32(0.4) - np.float32(0.5), np.float32(0)), np.float32(1)) * rough[i]
        if visibility > np.float32(0.01):
            value, slope = sample_value_noise(rotation, table, load3(points, i), 1 / length)
            own, share = load3(normal, i), visibility * height * length * np.float32(0.5)
            store3(normal, i, minus(own, times(project_to_plane(slope, own), share)))
            store3(albedo, i, times(load3(albedo, i), 1 + visibility * value * speck))


@kernel
def add_grains(
    samples: GrainedSamples,
    rotation: Array2[F32],
    grains: Array1[F32],
    patches: Array1[F32],
    length: F32,
    share: F32,
    quartz: Vec3F32,
    basalt: Vec3F32,
    begin: I64,
    end: I64,
) -> None:
    """Add grains of sand to the normals and colours of samples. `grains`: the table of grains. `patches`: a noise table that
    decides where grains lie. `length`: the size of a grain in world units. `share`: the fraction of the surface that grains
    cover. `quartz`, `basalt`: the colours of a few light and dark grains."""
    points, normal, albedo, pixel, loose = samples
    zero, one = np.float32(0), np.float32(1)
    for i in simd_range(begin, end):
        visibility = min(max(length / pixel[i] * np.float32(0.5) - np.float32(0.8), zero), one) * loose[i]
        if visibility > np.float32(0.01):
            point = load3(points, i)
            if share < one:
                patch, _ = sample_value_noise(rotation, patches, point, 1 / (9 * length))
                visibility = visibility * min(max((patch + 2 * share - 1) * 2 + np.float32(0.5), zero), one)
            out, offset, tone = sample_grain_noise(rotation, grains, point, 1 / length)
            own = load3(normal, i)
            store3(normal, i, plus(own, times(project_to_plane(offset, own), visibility * np.float32(0.42) * out)))
            light = np.float32(0.17) * tone - np.float32(0.30) * (out * out) * (out * out)
            colour = times(load3(albedo, i), 1 + visibility * light)
            # Some grains are quartz, some dark rock.
            pale = min(max((tone - np.float32(0.84)) * 7, zero), one) * visibility * np.float32(0.5)
            dark = min(max((-tone - np.float32(0.86)) * 7, zero), one) * visibility * np.float32(0.5)
            colour = plus(colour, times(minus(quartz, colour), pale))
            store3(albedo, i, plus(colour, times(minus(basalt, colour), dark)))
