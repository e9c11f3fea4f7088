"""Moves agents by the displacements that contacts request, over their ground and along obstacles.

No agent moves farther than it can walk in the step's duration."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.protocol import GroundMove
from antdsl.machine_code.kernels import BOOL, F32, F64, I64, Array1, Array2, Strided2, inlined, kernel, simd_range
from antdsl.numerics import vectors as vec
from antdsl.numerics.kernel_vectors import Vec3, Vec3F32, VectorColumns, dot, get_column, minus, plus, store_column, times
from antdsl.numerics.vectors import VectorArrays, VectorComponents
from antdsl.runtime.moving.contacts.capsules import CapsuleCrowd, NearbyCapsulePairs
from antdsl.runtime.moving.falling import find_airborne, move_airborne
from antdsl.runtime.moving.obstacles import slide_rows
from antdsl.runtime.world import Population

Flags = NDArray[np.bool_]

_VISIBLE_OVERLAP_SHARE = 0.05  # share of both collision radii; a larger overlap needs another pass
_MISSED_TARGET_RADIUS_SHARE = 0.05  # share of the radius; an agent that ends this far from its target is measured again
# Share of the requested displacement. An agent that advances less is held by an obstacle, a border or a fall; others then move.
_MIN_ADVANCED_SHARE = 0.5
Floats = NDArray[np.float64]
Rows = NDArray[np.intp]

_DISTANCE_SLACK_FACTOR = 1.005  # factor of the allowed distance; smaller excesses are rounding at seams
_MAX_BACKTRACKS = 3  # an agent that went too far is moved back at most this often
_FLOAT32_ZERO, _FLOAT32_ONE, _MIN_VECTOR_LENGTH, _MIN_MASS = np.float32(0), np.float32(1), np.float32(1e-12), 1e-30


class CorrectionWalker:
    """Moves agents by the displacements that contacts request, within one substep of `dt` s.

    `began`: the positions (n, 3) mm at the start of the substep, by species."""

    def __init__(self, crowd: CapsuleCrowd, start_positions: Mapping[str, Floats], dt: float) -> None:
        self._crowd, self._start_positions, self._dt = crowd, start_positions, dt

    def walk_corrections(self, rows: Rows, displacement: Floats) -> Floats:
        """Move agents by `displacement` (3, k) mm over their ground. Return their actual displacements (3, k) mm. `rows`:
        ascending rows of the crowd."""
        got: list[Floats] = []
        for population, own in self._crowd.split_rows(rows):
            first = sum(each.shape[1] for each in got)
            got.append(self._walk_species(population, own, displacement[:, first : first + len(own)]))
        return got[0] if len(got) == 1 else np.concatenate(got, axis=1)

    def _walk_species(self, population: Population, rows: Rows, displacement: Floats) -> Floats:
        """Move agents of one species by `displacement` (3, k) mm over their ground and along obstacles.

        Return their actual displacements. The velocities of the agents lose their component against the displacement."""
        if not len(rows):
            return np.empty_like(displacement)
        world, threads = self._crowd.world, self._crowd.world.options.threads
        step, normal, up, heading, size = self._prepare_walk(population, rows, displacement)
        step = slide_rows(world, population, rows, step, normal)
        moved = world.ground.move(population.footing.select_rows(rows), vec.stack_rows(step), heading, up, size, threads)
        if world.solids and len(airborne_rows := find_airborne(world, population, rows)):
            moved.write_rows(airborne_rows, move_airborne(world, population, rows[airborne_rows], displacement.T[airborne_rows]))
        fair = self._move_back_in_range(population, rows, moved, size)
        if fair is None:
            return self._apply_move(population, rows, moved)
        got = np.zeros_like(displacement)
        if len(fair):
            got[:, fair] = self._apply_move(population, rows.take(fair), moved.select_rows(fair))
        return got

    def _prepare_walk(
        self, population: Population, rows: Rows, displacement: Floats
    ) -> tuple[VectorArrays, VectorComponents, Floats, Floats, Floats]:
        """Return the inputs of a walk by `displacement` (3, k) mm.

        These are the steps and the ground normals (float32), the same normals and the headings (both float64 (k, 3)), and the
        sizes (mm)."""
        now = population.now
        step, feet = np.empty((2, 3, len(rows)), np.float32)
        up, heading, size = *np.empty((2, 3, len(rows))), np.empty(len(rows))
        _prepare_walk(
            rows,
            displacement,
            population.normal,
            vec.get_vector_registers(now, "heading"),
            now["size"],
            step,
            feet,
            up,
            heading,
            size,
        )
        return (step[0], step[1], step[2]), feet, up.T, heading.T, size

    def _move_back_in_range(self, population: Population, rows: Rows, move: GroundMove, size: Floats) -> Rows | None:
        """Move agents back towards their start positions if they went too far. This can happen on curved ground.

        Return the ascending indices of the rows that are within range afterwards. Return None if these are all rows."""
        for _ in range(_MAX_BACKTRACKS):
            far, most = self._measure_distance_limits(population, rows, move)
            if far is None:
                return None
            over = np.flatnonzero(far > most * _DISTANCE_SLACK_FACTOR)
            if not len(over):
                break
            start = self._start_positions[population.name][rows[over]]
            back = (move.position[over] - start) * (most[over] / far[over] - 1.0)[:, None]
            again, ground = move.select_rows(over), self._crowd.world.ground
            threads = self._crowd.world.options.threads
            move.write_rows(over, ground.move(again.footing, back, again.heading, again.up, size[over], threads))
        far, most = self._measure_distance_limits(population, rows, move)
        return None if far is None else np.flatnonzero(far <= most * _DISTANCE_SLACK_FACTOR)

    def _measure_distance_limits(self, population: Population, rows: Rows, move: GroundMove) -> tuple[Floats | None, Floats]:
        """Return the distances (mm) of agents from their start positions, and the greatest distances that are allowed.

        The first result is None if all agents are within the allowed distances."""
        began, max_speed = self._start_positions[population.name], population.now["max_speed"]
        far, most = np.empty((2, len(rows)))
        is_too_far = _has_row_out_of_range(rows, move.position, began, population.position, max_speed, self._dt, far, most)
        return (far if is_too_far else None), most

    def _apply_move(self, population: Population, rows: Rows, move: GroundMove) -> Floats:
        """Write the new positions and footings of agents. Return the displacements (3, k) mm of these agents.

        Bodies retain their up direction, because otherwise leaning bodies might overlap others again. The next step aligns them
        with their feet. The arrays are changed in place: the walk of this substep created them, so they are not shared."""
        at, velocity = (vec.get_vector_registers(population.now, name) for name in ("position", "velocity"))
        got = np.empty((3, len(rows)))
        _store_arrivals(rows, move.position, move.up, self._dt, at, velocity, population.position, population.normal, got)
        population.footing.write_rows(rows, move.footing)  # last, because the footings on a plane are the positions themselves
        return got


@inlined
def _read_column_vector(table: Strided2[F64], column: I64) -> Vec3:
    """Return row `column` of vectors (n, 3)."""
    return table[column, 0], table[column, 1], table[column, 2]


@inlined
def _to_float32(v: Vec3) -> Vec3F32:
    return np.float32(v[0]), np.float32(v[1]), np.float32(v[2])


class SpeciesStances(NamedTuple):
    """Positions and limits of the agents of a species.

    `start_position` (n, 3) mm: positions at the start of the substep. `current_position` (n, 3) mm: current positions.
    `normal` (n, 3): ground normals. `max_speed` (mm/s), `mass` (n): the speed limit and the mass of each agent."""

    start_position: Strided2[F64]
    current_position: Strided2[F64]
    normal: Strided2[F32]
    max_speed: Array1[F32]
    mass: Array1[F32]


@kernel
def write_stances(
    rows: Array1[I64],
    first_index: I64,
    species: SpeciesStances,
    dt: F64,
    start_position: Array2[F64],
    travel: Array2[F64],
    normal: Array2[F64],
    max_distance: Array1[F64],
    mass: Array1[F64],
) -> None:
    """Write the data of agents after a substep of `dt` s to the outputs, from index `first_index` on.

    The outputs are `travel` (3, k), the displacements (mm), and arrays for the fields of `contact_solver._ContactAgents`."""
    began, place, feet, max_speed, weight = species
    for n in simd_range(0, rows.size):
        row, k = rows[n], first_index + n
        start_point = _read_column_vector(began, row)
        store_column(start_position, k, start_point)
        store_column(travel, k, minus(_read_column_vector(place, row), start_point))
        normal[0, k], normal[1, k], normal[2, k] = feet[row, 0], feet[row, 1], feet[row, 2]
        max_distance[k] = np.float64(_FLOAT32_ZERO if max_speed[row] <= 0 else max_speed[row]) * dt
        mass[k] = max(np.float64(weight[row]), _MIN_MASS)


@kernel
def write_approach(rows: Array1[I64], first_index: I64, velocity: VectorColumns, dt: F32, approach: Array2[F64]) -> None:
    """Write the previous displacements (mm) of agents of a species, which are their velocities times `dt`, to `approach`. The
    first one is written at index `first_index`."""
    for n in simd_range(0, rows.size):
        for axis in range(3):
            approach[axis, first_index + n] = velocity[axis][rows[n]] * dt


@kernel
def _prepare_walk(
    rows: Array1[I64],
    displacement: Strided2[F64],
    feet: Strided2[F32],
    headings: VectorColumns,
    body_lengths: Array1[F32],
    step: Array2[F32],
    normal: Array2[F32],
    up: Array2[F64],
    heading: Array2[F64],
    size: Array1[F64],
) -> None:
    """Write the inputs of a walk by `displacement` (3, k) mm for agents of a species.

    These are the step and the ground normal as float32, and the same normal, the heading and the size (mm) as float64."""
    for k in simd_range(0, rows.size):
        row = rows[k]
        size[k] = body_lengths[row]
        for axis in range(3):
            step[axis, k], heading[axis, k] = displacement[axis, k], headings[axis][row]
            normal[axis, k] = feet[row, axis]
            up[axis, k] = feet[row, axis]


@kernel
def _has_row_out_of_range(
    rows: Array1[I64],
    end_positions: Strided2[F64],
    start_positions: Strided2[F64],
    position: Strided2[F64],
    max_speed: Array1[F32],
    dt: F64,
    distances: Array1[F64],
    max_distances: Array1[F64],
) -> BOOL:
    """Return whether any agent at `end_positions` (k, 3) would be farther from its start position than allowed, or at an
    unknown distance. `start_positions` (n, 3): positions at the start of the substep. Writes the distances (mm) to
    `distances`, and the allowed distances to `max_distances`."""
    is_too_far = False
    for k in range(rows.size):
        row = rows[k]
        start = _read_column_vector(start_positions, row)
        displacement, walked = (
            minus(_read_column_vector(end_positions, k), start),
            minus(_read_column_vector(position, row), start),
        )
        distances[k] = np.sqrt(dot(displacement, displacement))
        max_distances[k] = max(np.float64(max_speed[row]) * dt, np.sqrt(dot(walked, walked)))
        is_too_far |= not distances[k] <= max_distances[k] * _DISTANCE_SLACK_FACTOR
    return is_too_far


@kernel
def _store_arrivals(
    rows: Array1[I64],
    end_positions: Strided2[F64],
    arrival_ups: Strided2[F64],
    dt: F32,
    positions: VectorColumns,
    velocity: VectorColumns,
    position: Strided2[F64],
    ground_normal: Strided2[F32],
    reached_moves: Array2[F64],
) -> None:
    """Write positions, normals and velocities of agents after corrections, and the displacements of the agents. `end_positions`,
    `arrival_ups` (k, 3): new positions and up directions. `reached_moves` (3, k) mm: receives the displacements."""
    for k in simd_range(0, rows.size):
        row = rows[k]
        end, up = _read_column_vector(end_positions, k), _to_float32(_read_column_vector(arrival_ups, k))
        displacement = minus(end, _read_column_vector(position, row))
        store_column(reached_moves, k, displacement)
        pushed = _to_float32(displacement)
        size = np.sqrt(dot(pushed, pushed))
        good = size > _MIN_VECTOR_LENGTH and np.isfinite(size)
        factor = _FLOAT32_ONE / (size if good else _FLOAT32_ONE)
        against = times(pushed, factor)
        if not good:
            against = (size * _FLOAT32_ZERO, size * _FLOAT32_ZERO, size * _FLOAT32_ZERO)
        v = (velocity[0][row], velocity[1][row], velocity[2][row])
        back, most = -dot(v, against), size / dt
        back = _FLOAT32_ZERO if back <= 0 else back  # avoid -0
        v = plus(v, times(against, most if most < back else back))
        v = minus(v, times(up, dot(v, up)))
        for axis in range(3):
            positions[axis][row], velocity[axis][row] = end[axis], v[axis]
            position[row, axis], ground_normal[row, axis] = end[axis], up[axis]


def select_corrected_rows(corrections: Floats) -> tuple[Rows, Floats]:
    """Return the rows with a nonzero displacement in `corrections` (3, k) mm, and these displacements."""
    moved_rows, requested_moves = np.empty(corrections.shape[1], np.intp), np.empty_like(corrections)
    count = _select_moves(corrections, moved_rows, requested_moves)
    return moved_rows[:count], requested_moves[:, :count]


def find_unresolved_rows(
    nearby_pairs: NearbyCapsulePairs, moved_rows: Rows, requested_moves: Floats, reached_moves: Floats, is_held: Flags
) -> Flags:
    """Return which rows (k) must be measured again because they have moved, or because they could not move as requested.

    Also update their capsules. `moved_rows`: the rows that had to move. `requested_moves`, `reached_moves` (3, ..) mm: their
    requested and actual displacements. `is_held` (k): set for rows that moved too little; flags that are set already stay set."""
    touched = np.zeros(len(is_held), np.bool_)
    _mark_unresolved_rows(moved_rows, requested_moves, reached_moves, nearby_pairs.radius, nearby_pairs.middle, is_held, touched)
    return touched


def find_overlapping_pairs(nearby_pairs: NearbyCapsulePairs, is_touched: Flags) -> Flags | None:
    """Return which pairs (m) have a row that is flagged in `is_touched` (k). Return None if none of these pairs overlaps enough
    for another pass."""
    which = np.empty(len(nearby_pairs.first_indices), np.bool_)
    return (
        which
        if _mark_overlapping_pairs(
            nearby_pairs.first_indices, nearby_pairs.second_indices, nearby_pairs.gap, nearby_pairs.radius, is_touched, which
        )
        else None
    )


@kernel
def _select_moves(corrections: Array2[F64], moved_rows: Array1[I64], requested_moves: Array2[F64]) -> I64:
    """Write the rows with a nonzero displacement to the start of `moved_rows` and `requested_moves` (3, k); return their
    number."""
    count = 0
    for k in range(moved_rows.size):
        correction = get_column(corrections, k)
        moved_rows[count] = k  # stored unconditionally: the branch would be hard to predict
        store_column(requested_moves, count, correction)
        count += (correction[0] != 0) | (correction[1] != 0) | (correction[2] != 0)
    return count


@kernel
def _mark_unresolved_rows(
    moved_rows: Array1[I64],
    requested_moves: Strided2[F64],
    reached_moves: Strided2[F64],
    radius: Array1[F64],
    middle: Strided2[F64],
    is_held: Array1[BOOL],
    is_touched: Array1[BOOL],
) -> None:
    for n in simd_range(0, moved_rows.size):
        row, to, on = moved_rows[n], get_column(requested_moves, n), get_column(reached_moves, n)
        short, far = minus(to, on), _MISSED_TARGET_RADIUS_SHARE * radius[row]
        store_column(middle, row, plus(get_column(middle, row), on))
        if dot(short, short) > far * far:
            is_touched[row] = True
            if dot(on, to) < _MIN_ADVANCED_SHARE * dot(to, to):
                is_held[row] = True


@kernel
def _mark_overlapping_pairs(
    i: Array1[I64], j: Array1[I64], gap: Array1[F64], radius: Array1[F64], is_touched: Array1[BOOL], is_overlapping: Array1[BOOL]
) -> BOOL:
    """Set `is_overlapping` for the pairs that have a row in `is_touched`.

    Return whether any of these pairs overlaps visibly, so that another pass is needed."""
    for pair in simd_range(0, i.size):
        is_overlapping[pair] = is_touched[i[pair]] | is_touched[j[pair]]
    has_overlap = False
    for pair in range(i.size):
        if is_overlapping[pair]:
            has_overlap |= gap[pair] < -((radius[i[pair]] + radius[j[pair]]) * _VISIBLE_OVERLAP_SHARE)
    return has_overlap
