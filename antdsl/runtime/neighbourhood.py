"""The neighbourhood of an agent in the tangent plane of its ground: for the velocity that avoids all neighbours, and for the
widest gap; and the cell grids that find neighbours.

Vectors in the plane have two components: ahead and to the left."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.machine_code.kernels import BOOL, F32, F64, I64, Array1, Array2, independent, inlined, kernel
from antdsl.numerics import parallel
from antdsl.numerics import vectors as vec
from antdsl.numerics.kernel_vectors import Vec3, cross, dot, flat, put_vector, unit_or_perpendicular
from antdsl.numerics.vectors import Vector
from antdsl.runtime.world import AXES, Population, World
from antdsl.senses.clear_velocity import Neighbours, clear_velocities, widest_gaps
from antdsl.senses.neighbours import CellGrid, Pairs

Vectors32 = tuple[Array1[F32], Array1[F32], Array1[F32]]
Vectors64 = tuple[Array1[F64], Array1[F64], Array1[F64]]

_COARSER = 4  # quarters of an octave
_FASTEST = 1e9  # mm/s that count at most
Floats = NDArray[np.float64]
Rows = NDArray[np.intp]
# Of each place in the table: distance, species, id, and which pair of the species' it is; then how many places are taken
Nearest = tuple[Array2[F32], Array2[I64], Array2[I64], Array2[I64], Array1[I64]]


def clear_velocity(
    world: World, population: Population, rows: Rows, wish: Vector, within: Floats, horizon: Floats, most: Floats
) -> tuple[NDArray[np.float32], ...]:
    """Return velocities (mm/s, x y z) along the ground, for some agents, nearest to a requested velocity. They avoid, for
    `horizon` s, the `most` nearest others of any species within `within` mm on the same side of the ground. All agents are taken
    as at the start of the step."""
    threads = world.options.threads
    plane = Plane.of(population, rows, threads)
    moves = plane.measure_moves(population, rows, wish, threads)
    others = _nearest_others(world, population, rows, within, most, moves.own, plane)
    sound = np.where(horizon > 0, np.minimum(horizon, 1e6), 1e6)
    x, y = clear_velocities(others, moves.velocity, moves.wish, moves.fastest, sound, world.dt, threads)
    return plane.to_space(x, y, threads)


def widest_gap(world: World, population: Population, rows: Rows, within: Floats, most: Floats) -> tuple[NDArray[np.float32], ...]:
    """Return unit directions (x y z) along the ground, for some agents, into the widest gap between neighbours. These are the
    `most` nearest others of any species within `within` mm, on their side of the ground; 0 without any."""
    plane = Plane.of(population, rows, world.options.threads)
    others = _nearest_others(world, population, rows, within, most, None, plane)
    return plane.to_space(*widest_gaps(others.x, others.y, others.is_present), world.options.threads)


def _nearest_others(
    world: World, population: Population, rows: Rows, within: Floats, most: Floats, own: Vector | None, plane: Plane
) -> Neighbours:
    """Return the nearest others of all species, at most `most` for each agent; their velocities too if `own` is given."""
    count = np.minimum(np.where(most > 0, most, 0), limits.NEIGHBOURS).astype(np.intp)
    n, widest = len(rows), int(count.max(initial=0))
    place = tuple(np.ascontiguousarray(population.start[f"position.{axis}"][rows]) for axis in AXES)
    reach = np.where(within > 0, within, -1).astype(np.float32)
    ids, radius = population.ids[rows], _radii(population, rows)
    far = float(reach.max(initial=0.0, where=np.isfinite(reach)))
    shape = (n, widest)
    x, y, vx, vy, radius_sum = (np.zeros(shape) for _ in range(5))
    is_present, first = np.zeros(shape, np.bool_), np.zeros(shape, np.bool_)
    nearest = np.empty(shape, np.float32), *(np.empty(shape, np.int64) for _ in range(3)), np.zeros(n, np.int64)
    up, ahead, left = (_kernel_vector(each) for each in (plane.up, plane.ahead, plane.left))
    moving = ahead if own is None else _kernel_vector(own)
    asking = AskingAgents(ids, radius, ahead, left, own is not None, moving)
    columns = OtherColumns(x, y, vx, vy, radius_sum, is_present, first)
    candidates = []
    for number, (name, other) in enumerate(world.populations.items()):
        if not len(other) or not widest:
            continue
        p = _near(world, other, ids if other is population else None, place, reach, far)
        theirs = _kernel_vector(vec.vector_registers(other.start, "up"))
        _choose_nearest(p.i, p.j, p.distance, up, theirs, other.ids, number, count, nearest)
        candidates.append((number, name, other, p))
    for number, name, other, p in candidates:
        velocity = _kernel_vector(vec.vector_registers(other.start, "velocity"))
        other_species = Asked(number, other is population, population.name < name, velocity, _radii(other))
        _fill_columns(nearest, asking, other_species, p.j, (p.dx, p.dy, p.dz), columns)
    return Neighbours(*columns)


def _kernel_vector(vectors: vec.Columns) -> Vector:
    """The same, as kernels read them."""
    x, y, z = parallel.contiguous(*vectors)
    return x, y, z


def _near(
    world: World, other: Population, ids: NDArray[np.int64] | None, place: Any, reach: NDArray[np.float32], far: float
) -> Pairs:
    """Return pairs of places and agents of a species within their `reach`, at most `far` (mm). `ids`: those of the places, if
    they are agents of this species."""
    grid = grid_for(world, other, far if far > 0 else 1.0)
    return grid.find_pairs(None, reach, qx=place[0], qy=place[1], qz=place[2], qid=ids, threads=world.options.threads)


def _radii(population: Population, rows: Rows | slice = slice(None)) -> Floats:
    radius = population.start["radius"][rows].astype(np.float64)
    return np.where(np.isfinite(radius) & (radius > 0), radius, 0.0)


@inlined
def _dot(a: Vec3, b: Vec3) -> F64:
    return (a[0] * b[0] + a[1] * b[1]) + a[2] * b[2]


@kernel
def _choose_nearest(
    i: Array1[I64], j: Array1[I64], distance: Array1[F32], up: Vectors64, theirs: Vectors32, ids: Array1[I64], number: I64,
    most: Array1[I64], nearest: Nearest,
) -> None:  # fmt: skip
    """Add a species' pairs (agent i sees j) on i's side of the ground to the tables of the nearest. Each agent has at most `most`
    entries, ordered by distance, then species, then id."""
    far, species, names, pairs, taken = nearest
    for k in range(i.size):
        a, b = i[k], j[k]
        if not _dot((up[0][a], up[1][a], up[2][a]), finite_vector(theirs[0][b], theirs[1][b], theirs[2][b])) > 0.0:
            continue
        d, name, at = distance[k], ids[b], taken[a]
        while at > 0:
            previous = at - 1
            if far[a, previous] < d:
                break
            if far[a, previous] == d:
                if species[a, previous] < number:
                    break
                if species[a, previous] == number and names[a, previous] < name:
                    break
            at = previous
        if at >= most[a]:
            continue
        last = min(taken[a], most[a] - 1)
        taken[a] = last + 1
        while last > at:
            far[a, last], species[a, last] = far[a, last - 1], species[a, last - 1]
            names[a, last], pairs[a, last] = names[a, last - 1], pairs[a, last - 1]
            last -= 1
        far[a, at], species[a, at], names[a, at], pairs[a, at] = d, number, name, k


class AskingAgents(NamedTuple):
    """The requesting agents: their ids, radii, planes, and velocities if these count (`moves`)."""

    ids: Array1[I64]
    radius: Array1[F64]
    ahead: Vectors64
    left: Vectors64
    moves: BOOL
    velocity: Vectors64


class Asked(NamedTuple):
    """The agents of one species: its number; `same`: it is the species of the requesting agents; else `sooner`: whether its name
    comes first."""

    number: I64
    same: BOOL
    sooner: BOOL
    velocity: Vectors32
    radius: Array1[F64]


class OtherColumns(NamedTuple):
    """The columns of `Neighbours`."""

    x: Array2[F64]
    y: Array2[F64]
    vx: Array2[F64]
    vy: Array2[F64]
    radius_sum: Array2[F64]
    is_present: Array2[BOOL]
    first: Array2[BOOL]


@kernel
def _fill_columns(
    nearest: Nearest, asking: AskingAgents, other_species: Asked, j: Array1[I64], offset: Vectors32, columns: OtherColumns
) -> None:
    """Fill the columns for the neighbours of one species in the tables."""
    ids, radius, ahead, left, moves, own = asking
    number, same, sooner, theirs, other = other_species
    x, y, vx, vy, radius_sum, is_present, first = columns
    _, species, names, pairs, taken = nearest
    for a in range(taken.size):
        ax, ay, az = ahead[0][a], ahead[1][a], ahead[2][a]
        lx, ly, lz = left[0][a], left[1][a], left[2][a]
        for c in range(taken[a]):
            if species[a, c] != number:
                continue
            k = pairs[a, c]
            b = j[k]
            wx, wy, wz = np.float64(offset[0][k]), np.float64(offset[1][k]), np.float64(offset[2][k])
            x[a, c] = _dot((wx, wy, wz), (ax, ay, az))
            y[a, c] = _dot((wx, wy, wz), (lx, ly, lz))
            if moves:
                tx, ty, tz = finite_vector(theirs[0][b], theirs[1][b], theirs[2][b])
                mx, my, mz = own[0][a] - tx, own[1][a] - ty, own[2][a] - tz
                vx[a, c] = _dot((mx, my, mz), (ax, ay, az))
                vy[a, c] = _dot((mx, my, mz), (lx, ly, lz))
            radius_sum[a, c] = radius[a] + other[b]
            is_present[a, c] = True
            first[a, c] = ids[a] < names[a, c] if same else sooner


@dataclass(frozen=True, slots=True, eq=False)
class Moves:
    """The motion of some agents, float64: their velocities `own` in space, these and the wished ones by components ahead and to
    the left, and their speed limits (mm/s)."""

    own: Vector
    velocity: tuple[Floats, Floats]
    wish: tuple[Floats, Floats]
    fastest: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """The ground of some agents: unit `up`, `ahead` along their heading and `left`, float64."""

    up: Vector
    ahead: Vector
    left: Vector

    @classmethod
    def of(cls, population: Population, rows: Rows, threads: int) -> Plane:
        """Return the plane of the agents of some rows, as at the start of the step."""
        up, heading = (vec.vector_registers(population.start, name) for name in ("up", "heading"))
        axes = np.empty((3, 3, len(rows)))
        parallel.in_parts(partial(_fill_axes, rows, up, heading, *axes), len(rows), threads, parallel.LIGHT)
        return cls(*(tuple(each) for each in axes))

    def measure_moves(self, population: Population, rows: Rows, wish: Vector, threads: int) -> Moves:
        """Return the motion of these agents, with the velocities (mm/s) in space that they wish for. NaN becomes 0."""
        start = population.start
        velocity, speed = vec.vector_registers(start, "velocity"), start["max_speed"]
        wished, n = tuple(np.ascontiguousarray(component, np.float64) for component in wish), len(rows)
        own, laid, fastest = np.empty((3, n)), np.empty((4, n)), np.empty(n)
        work = partial(_fill_moves, rows, velocity, speed, wished, self.ahead, self.left, own, laid, fastest)
        parallel.in_parts(work, n, threads, parallel.LIGHT)
        return Moves((own[0], own[1], own[2]), (laid[0], laid[1]), (laid[2], laid[3]), fastest)

    def to_space(self, x: Floats, y: Floats, threads: int) -> tuple[NDArray[np.float32], ...]:
        """Vectors of such parts."""
        vectors = np.empty((3, len(x)), np.float32)
        parallel.in_parts(partial(_fill_vectors, self.ahead, self.left, x, y, vectors), len(x), threads, parallel.LIGHT)
        return tuple(vectors)


@inlined
def finite_vector(x: Any, y: Any, z: Any) -> Vec3:
    """A vector in float64, 0 where it is no number."""
    a, b, c = np.float64(x), np.float64(y), np.float64(z)
    good = np.isfinite(a) and np.isfinite(b) and np.isfinite(c)
    return (a if good else 0.0), (b if good else 0.0), (c if good else 0.0)


@inlined
def _of(vectors: Vectors64, k: I64) -> Vec3:
    return vectors[0][k], vectors[1][k], vectors[2][k]


@inlined
def _read_finite(vectors: tuple[Array1[Any], Array1[Any], Array1[Any]], k: I64) -> Vec3:
    return finite_vector(vectors[0][k], vectors[1][k], vectors[2][k])


@kernel
def _fill_axes(
    rows: Array1[I64],
    up: Vectors32,
    heading: Vectors32,
    above: Array2[F64],
    ahead: Array2[F64],
    left: Array2[F64],
    begin: I64,
    end: I64,
) -> None:
    """`Plane.of` for some rows, from the `begin`-th to before the `end`-th: their axes (3, n)."""
    for k in independent(begin, end):
        row = rows[k]
        u = _read_finite(up, row)
        forward = unit_or_perpendicular(flat(_read_finite(heading, row), u), u)
        put_vector(above, k, u)
        put_vector(ahead, k, forward)
        put_vector(left, k, cross(u, forward))


@kernel
def _fill_moves(
    rows: Array1[I64],
    velocity: Vectors32,
    max_speed: Array1[F32],
    wish: Vectors64,
    ahead: Vectors64,
    left: Vectors64,
    own: Array2[F64],
    laid: Array2[F64],
    fastest: Array1[F64],
    begin: I64,
    end: I64,
) -> None:
    """`Plane.moves` for some rows, from the `begin`-th to before the `end`-th: velocities (3, n), and the components of velocity
    and wish (4, n)."""
    for k in independent(begin, end):
        row = rows[k]
        v, w, x, y = _read_finite(velocity, row), _read_finite(wish, k), _of(ahead, k), _of(left, k)
        put_vector(own, k, v)
        laid[0, k], laid[1, k], laid[2, k], laid[3, k] = dot(v, x), dot(v, y), dot(w, x), dot(w, y)
        speed = np.float64(max_speed[row])
        fastest[k] = min(speed if speed > 0.0 else 0.0, _FASTEST)


@kernel
def _fill_vectors(
    ahead: Vectors64, left: Vectors64, x: Array1[F64], y: Array1[F64], vectors: Array2[F32], begin: I64, end: I64
) -> None:
    """`Plane.raised`, from the `begin`-th to before the `end`-th, into `vectors` (3, n)."""
    for k in independent(begin, end):
        for axis in range(3):
            vectors[axis, k] = np.float32(ahead[axis][k] * x[k] + left[axis][k] * y[k])


def grid_for(world: World, other: Population, widest: float) -> CellGrid:
    """Return the others in cells that suit a radius. Searching wider existing cells costs less than sorting again."""
    size = float(np.ceil(4 * np.log2(widest)))
    known = [(k, grid) for (name, k), grid in list(world.grids.items()) if name == other.name and size <= k <= size + _COARSER]
    if known:
        return min(known, key=lambda each: each[0])[1]
    x, y, z = (other.start[f"position.{axis}"] for axis in AXES)
    grid = world.grids[other.name, size] = CellGrid(x, y, z, other.ids, widest, world.options.threads)
    return grid
