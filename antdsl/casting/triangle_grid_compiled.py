"""What `triangle_grid` does, for one ray or place at a time: the same float64 operations in the same order for each face."""

from __future__ import annotations

import numpy as np

from antdsl.casting.faces_compiled import along, nearest_on, square_of, towards
from antdsl.casting.tolerances import CLOSED
from antdsl.casting.triangle_grid import FURTHER, LONGEST, NOTHING, RINGS
from antdsl.numerics.kernel_cache import njit
from antdsl.numerics.vectors_compiled import minus

_STILL = 1e-12  # cubes: a ray that goes no farther along an axis stays in its layer
_TOUCHING = 1e-6  # mm: nearer than this the face itself says which way is out


@njit(cache=True, nogil=True, error_model="numpy")
def firsts(grid, hair, origin, way, t, face):  # type: ignore[no-untyped-def]
    """As `TriangleGrid.first`, into the last two arrays."""
    for i in range(face.size):
        t[i], face[i] = _first(grid, hair, (origin[i, 0], origin[i, 1], origin[i, 2]), (way[i, 0], way[i, 1], way[i, 2]))


@njit(cache=True, nogil=True, error_model="numpy")
def nearests(grid, points, place, square, face):  # type: ignore[no-untyped-def]
    """As `TriangleGrid.nearest`, into the last three arrays."""
    for i in range(face.size):
        p = (points[i, 0], points[i, 1], points[i, 2])
        square[i], face[i], q = _nearest(grid, p)
        place[i, 0], place[i, 1], place[i, 2] = q[0], q[1], q[2]


@njit(cache=True, nogil=True, error_model="numpy")
def _first(grid, hair, a, w):  # type: ignore[no-untyped-def]
    """After what part of its way a ray meets its first face, and which."""
    shape, size, first, listed, planes = grid[0], grid[1], grid[2], grid[3], grid[4]
    part = 1.0 / shape[3]
    px, py, pz = (a[0] - shape[0]) * part, (a[1] - shape[1]) * part, (a[2] - shape[2]) * part
    dx, dy, dz = w[0] * part, w[1] * part, w[2] * part
    long = (abs(dx) + abs(dy)) + abs(dz)
    if long > LONGEST:
        return np.inf, FURTHER
    if not (abs(px) + abs(py) + abs(pz) < np.inf and long <= LONGEST):
        return np.inf, NOTHING
    # A ray that stays in a layer has its borders infinitely far away, and none that is outside enters it.
    mx, my, mz = abs(dx) > _STILL, abs(dy) > _STILL, abs(dz) > _STILL
    ix, iy, iz = 1.0 / dx if mx else np.inf, 1.0 / dy if my else np.inf, 1.0 / dz if mz else np.inf
    bx, ex = _between(px, ix, mx, np.float64(size[0]))
    by, ey = _between(py, iy, my, np.float64(size[1]))
    bz, ez = _between(pz, iz, mz, np.float64(size[2]))
    begin, end = max(max(max(bx, by), bz), 0.0), min(min(min(ex, ey), ez), 1.0)
    if begin > end:
        return np.inf, NOTHING
    x = min(max(np.int64(np.floor(px + dx * begin)), 0), size[0] - 1)
    y = min(max(np.int64(np.floor(py + dy * begin)), 0), size[1] - 1)
    z = min(max(np.int64(np.floor(pz + dz * begin)), 0), size[2] - 1)
    ux, uy, uz = 1 if dx > 0 else 0, 1 if dy > 0 else 0, 1 if dz > 0 else 0
    h = hair / np.sqrt((w[0] * w[0] + w[1] * w[1]) + w[2] * w[2])
    best, face = np.inf, NOTHING
    most = 1.0
    while True:
        cell = (x * size[1] + y) * size[2] + z
        for k in range(first[cell], first[cell + 1]):
            f = np.int64(listed[k])
            t = -along(planes, f, 0, a) / towards(planes, f, 0, w)
            if t > h and t <= most:
                w1 = along(planes, f, 1, a) + t * towards(planes, f, 1, w)
                w2 = along(planes, f, 2, a) + t * towards(planes, f, 2, w)
                if (1.0 - w1) - w2 >= -CLOSED and w1 >= -CLOSED and w2 >= -CLOSED and (t < best or f < face):
                    best, face, most = t, f, t
        # Where the ray leaves the cube: what it meets before is listed in it.
        tx = (np.float64(x + ux) - px) * ix if mx else np.inf
        ty = (np.float64(y + uy) - py) * iy if my else np.inf
        tz = (np.float64(z + uz) - pz) * iz if mz else np.inf
        out = min(min(tx, ty), tz)
        if best <= out or out > end:
            return best, face
        if tx == out:
            x += 2 * ux - 1
            if x < 0 or x >= size[0]:
                return best, face
        elif ty == out:
            y += 2 * uy - 1
            if y < 0 or y >= size[1]:
                return best, face
        else:
            z += 2 * uz - 1
            if z < 0 or z >= size[2]:
                return best, face


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _between(p, inverse, moves, size):  # type: ignore[no-untyped-def]
    """After which parts of its way a ray enters and leaves the grid along one axis."""
    if not moves:
        return (0.0, 1.0) if p >= 0.0 and p < size else (np.inf, -np.inf)
    one, two = -p * inverse, (size - p) * inverse
    return (one, two) if one < two else (two, one)


@njit(cache=True, nogil=True, error_model="numpy")
def _nearest(grid, p):  # type: ignore[no-untyped-def]
    """The square distance of a place's nearest face, which one, and the place on it."""
    shape, size, first, listed, corners = grid[0], grid[1], grid[2], grid[3], grid[5]
    width = shape[3]
    part = 1.0 / width
    ax, ay, az = (p[0] - shape[0]) * part, (p[1] - shape[1]) * part, (p[2] - shape[2]) * part
    best, face, place = np.inf, FURTHER, p
    if not (abs(ax) + abs(ay) + abs(az) < np.inf):
        return best, face, place
    mx, my, mz = _middle(ax, size[0]), _middle(ay, size[1]), _middle(az, size[2])
    for ring in range(RINGS + 1):
        for x in range(max(mx - ring, 0), min(mx + ring, size[0] - 1) + 1):
            for y in range(max(my - ring, 0), min(my + ring, size[1] - 1) + 1):
                # On the sides of the ring all cubes of a row are new, elsewhere its two ends.
                side = abs(x - mx) == ring or abs(y - my) == ring
                z, step = max(mz - ring, 0) if side else mz - ring, 1 if side or ring == 0 else 2 * ring
                while z <= min(mz + ring, size[2] - 1):
                    if z >= 0:
                        cell = (x * size[1] + y) * size[2] + z
                        begin, end = first[cell], first[cell + 1]
                        if begin < end and _off(ax, ay, az, x, y, z) * width * width <= best * (1 + 1e-6):
                            for k in range(begin, end):
                                f = np.int64(listed[k])
                                q = nearest_on(corners, f, p)
                                d = square_of(minus(q, p))
                                if d < best or (d == best and f < face):
                                    best, face, place = d, f, q
                    z += step
        known = _known(ax, mx, ring, size[0])
        known = min(known, _known(ay, my, ring, size[1]))
        known = min(known, _known(az, mz, ring, size[2])) * width
        if best <= known * known:
            return best, face, place
    return np.inf, FURTHER, p


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _middle(at, size):  # type: ignore[no-untyped-def]
    return min(max(np.int64(np.floor(min(max(at, 0.0), 1e9))), 0), size - 1)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _known(at, middle, ring, size):  # type: ignore[no-untyped-def]
    below, above = middle - ring, middle + ring + 1
    low = np.inf if below <= 0 else at - np.float64(below)
    high = np.inf if above >= size else np.float64(above) - at
    return min(low, high)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _off(ax, ay, az, x, y, z):  # type: ignore[no-untyped-def]
    """The square distance (cubes) of a place from a cube, less what its faces may stand out."""
    ox = max(max(np.float64(x) - ax, ax - np.float64(x + 1)) - 1e-5, 0.0)
    oy = max(max(np.float64(y) - ay, ay - np.float64(y + 1)) - 1e-5, 0.0)
    oz = max(max(np.float64(z) - az, az - np.float64(z + 1)) - 1e-5, 0.0)
    return ox * ox + oy * oy + oz * oz
