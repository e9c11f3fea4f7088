"""Pheromone on surfaces. Agents deposit it in cells and smell it; it evaporates and diffuses. Deposits are added exactly, so
their order does not matter."""

from __future__ import annotations

from functools import cached_property, partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from antdsl.fields.cells import NEAREST_CELL_COUNT, CellLinks, Cells, SurfaceCells
from antdsl.fields.growing import GrowingCells
from antdsl.machine_code.kernels import F64, I32, I64, Array1, Array2, kernel, simd_range
from antdsl.numerics import parallel
from antdsl.numerics.row_hash import RowHasher
from antdsl.numerics.sorting import sort_stably
from antdsl.scene.field_settings import compute_max_diffusion

Floats = NDArray[np.float32]

DEPOSIT_QUANTUM = 2.0**-24  # deposits are integer multiples of this
MAX_DEPOSIT = 2.0**16  # five million such deposits in a cell fit into 63 bits
ZERO_FLUSH_THRESHOLD = 1e-12
_NO_REMAINING_SHARES = np.empty(0)
_SYMMETRIC_ENTRIES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


class PheromoneField:
    """The amounts of one pheromone in the cells of surfaces.

    `combine`: `add` sums the deposits of a step in a cell; `max` takes the greatest. `limit`: the largest amount of a cell.
    `amounts` float64[cells]: the amounts at the start of a step. `stencil`: 4 if cells that share a face exchange pheromone; 8
    if cells that share an edge do so, too. `deposits_first`: whether deposits are added before diffusion and evaporation;
    otherwise they are added at the end of the step. `has_signed_amounts`: whether amounts may be negative, like components of
    vectors; otherwise negative amounts become 0."""

    def __init__(
        self,
        cells: SurfaceCells,
        combine: Literal["add", "max"] = "add",
        limit: float = np.inf,
        stencil: int = 4,
        deposits_first: bool = False,
        has_signed_amounts: bool = False,
    ) -> None:
        self.cells, self.combine, self.limit = cells, combine, float(limit)
        self.stencil, self.deposits_first = stencil, deposits_first
        self._flush_floor = -ZERO_FLUSH_THRESHOLD if has_signed_amounts else -np.inf
        self._padded = np.zeros(len(cells) + 1)  # the extra entry is the amount of "no cell"
        self._pending = np.zeros(len(cells), np.int64)
        self.version = 0  # increases whenever an array of the field or of its cells is replaced
        self.row_hasher = RowHasher()  # of `values`
        self._has_pending = False
        self._remaining_amounts: list[
            tuple[NDArray[np.integer[Any]], NDArray[np.float64]]
        ] = []  # cells, and their amounts after claims
        self._dependents_by_size: dict[int, tuple[NDArray[np.int64], Cells]] = {}

    @property
    def amounts(self) -> NDArray[np.float64]:
        """Return the amount in each cell. To restore a state, write into this array."""
        return self._padded[:-1]

    @property
    def padded_values(self) -> NDArray[np.float64]:
        """Return the amount in each cell, followed by a 0 that stands for "no cell"."""
        return self._padded

    @property
    def sensed_positions(self) -> NDArray[np.float32]:
        """Return the cell positions that agents sense, float32[cells + 1, 4]. Each row is (x, y, z, 0); the last row stands
        for "no cell"."""
        return self._sensed_positions

    @property
    def pending_deposits(self) -> NDArray[np.int64]:
        """Return the deposits in each cell that are not yet in `amounts`, in units of `DEPOSIT_QUANTUM`.

        A caller that writes into the array must call `mark_deposits_pending`."""
        return self._pending

    def mark_deposits_pending(self) -> None:
        """Record that `pending_deposits` contains deposits, which the next step must add."""
        self._has_pending = True

    def extend_arrays(self, new: NDArray[np.int64]) -> None:
        """Extend the arrays for cells that were added to `cells`. `new`: the numbers of these cells."""
        self.version += 1
        added_count = len(self.cells) - len(self.amounts)
        if added_count:
            self._padded = np.concatenate([self.amounts, np.zeros(added_count + 1)])
            self._pending = np.concatenate([self._pending, np.zeros(added_count, np.int64)])
            for name in ("_cell_positions", "_sensed_positions"):
                self.__dict__.pop(name, None)
        elif "_cell_positions" in self.__dict__:
            self._cell_positions[:, new] = self.cells.position[new].T
            self._sensed_positions[new, :3] = self._cell_positions[:, new].T
        self.__dict__.pop("_laplacian", None)

    @property
    def added_cells(self) -> dict[str, NDArray[Any]]:
        """Return the cells that were added after the start, in the form that `restore_added_cells` takes.

        The result is empty if no cells can be added."""
        return self.cells.added_cells if isinstance(self.cells, GrowingCells) else {}

    def restore_added_cells(self, keys: NDArray[np.int64], positions: NDArray[np.float64]) -> None:
        """Add the cells that `added_cells` returned. Cells that another field on the same cells has already added are skipped."""
        assert isinstance(self.cells, GrowingCells)
        added_count = self.cells.used_count - self.cells.initial_count
        self.cells.add_cells(keys[added_count:], positions[added_count:])
        self.extend_arrays(np.arange(self.cells.initial_count, self.cells.used_count))

    def deposit(self, cells: Cells, amounts: Floats) -> int:
        """Deposit amounts in cells; `advance` will add them to the field. Return how many amounts were rejected or reduced.

        `cells`: the cell of each amount, -1 for none. NaN is rejected, and amounts above `MAX_DEPOSIT` are reduced to
        `MAX_DEPOSIT`. If `combine` is `max`, amounts of 0 or less are ignored."""
        cells, amounts = np.asarray(cells), np.asarray(amounts, np.float64)
        is_finite = np.isfinite(amounts)
        wrong = int(np.count_nonzero(~is_finite | (np.abs(amounts) > MAX_DEPOSIT)))
        rows = np.flatnonzero(is_finite & (cells >= 0) & (amounts != 0))
        if rows.size:
            unit_counts = np.rint(np.clip(amounts[rows], -MAX_DEPOSIT, MAX_DEPOSIT) / DEPOSIT_QUANTUM).astype(np.int64)
            (np.add if self.combine == "add" else np.maximum).at(self._pending, cells[rows], unit_counts)
            self._has_pending = True
        return wrong

    def set_remaining_amounts(self, cells: NDArray[np.integer[Any]], amounts: NDArray[np.float64]) -> None:
        """Set the amounts that remain in distinct cells after agents took pheromone from them. The next call of `advance` stores
        them."""
        self._remaining_amounts.append((cells, amounts))

    def advance(self, remaining_share: float, diffusion: float, dt: float, threads: int = 1) -> None:
        """Advance the field by `dt` (s). First stores the amounts from `set_remaining_amounts`, then diffuses, multiplies by
        `remaining_share`, and adds deposits. With `deposits_first`, deposits are added before diffusion. `diffusion` is in mm²/s.
        Raises ValueError with the largest stable value if `diffusion` is unstable for the cell size."""
        values = self.amounts
        for cells, amounts in self._remaining_amounts:
            values[cells] = amounts
        self._remaining_amounts.clear()
        max_diffusion = compute_max_diffusion(self.cells.cell, dt)
        if diffusion > max_diffusion * (1 + 1e-9):
            raise ValueError(
                f"a diffusion of {diffusion:g} mm²/s is unstable for this cell size and frame rate; write at most "
                f"{max_diffusion:g} mm²/s"
            )
        self._run_step_kernels(float(np.float32(remaining_share)), diffusion * dt / self.cells.cell**2, threads)

    def _run_step_kernels(self, remaining_share: float, spread: float, threads: int) -> None:
        """Diffuse, evaporate and add deposits with kernels."""

        def run_kernel(*arguments: Any) -> None:
            parallel.run_in_parts(
                partial(advance_cells, self._padded, *arguments), len(self._pending), threads, parallel.MIN_LIGHT_ITEMS_PER_THREAD
            )

        lands = 0 if not self._has_pending else 1 if self.combine == "add" else 2
        self._has_pending = False
        if self.deposits_first:
            run_kernel(_NO_REMAINING_SHARES, self._pending, 0.0, 1.0, DEPOSIT_QUANTUM, self.limit, 0.0, 0.0, lands)
        change = self._laplacian.compute_flow(self._padded, threads) if spread > 0 else _NO_REMAINING_SHARES
        last = (0.0, np.inf, 0) if self.deposits_first else (DEPOSIT_QUANTUM, self.limit, lands)
        flushed = (self._flush_floor, ZERO_FLUSH_THRESHOLD)
        run_kernel(change, self._pending, spread, remaining_share, *last[:2], *flushed, last[2])

    @cached_property
    def _laplacian(self) -> _DiffusionOperator:
        """Return the operator that computes the flow between cells for one unit of diffusion.

        The flow between two linked cells is their difference times 4 / max(4, links of either cell). On a plane, this is the
        five-point stencil. The total exchange of a cell is at most that over four links, so stability depends only on the cell
        size. With a stencil of 8, these flows are multiplied by 2/3, and the flows between cells that share an edge by 1/6. On
        a plane, this is the nine-point Laplacian (4, 1) / 6, which has the same error in all directions (Patra and Karttunen,
        Stencils with isotropic discretization error for differential operators, Numerical Methods for Partial Differential
        Equations 22, 2006)."""
        if self.stencil == 4:
            return _DiffusionOperator(self._build_flow_matrix(self.cells.links, 1.0))
        return _DiffusionOperator(
            self._build_flow_matrix(self.cells.links, 2 / 3) + self._build_flow_matrix(self.cells.diagonal_links, 1 / 6)
        )

    def _build_flow_matrix(self, links: CellLinks, share: float) -> Any:
        """Return a sparse matrix [cells, cells] with the fractions of the amounts that flow between linked cells.

        Each entry is `share` times 4 / max(4, links of either cell)."""
        from scipy.sparse import csr_array

        count = np.diff(links.link_starts)
        rows = np.repeat(np.arange(len(self.cells)), count)
        weight = share * 4.0 / np.maximum(np.maximum(count[rows], count[links.linked_cells]), 4)
        return csr_array((weight, links.linked_cells, links.link_starts), shape=(len(self.cells), len(self.cells)))

    def sample(self, cells: Cells) -> Floats:
        """Return the amount in each of the given cells, float32[n]; 0 for cell -1."""
        return self._padded.take(np.where(np.asarray(cells) < 0, len(self.cells), cells)).astype(np.float32)

    def sample_strongest(self, cells: Cells, k: int = NEAREST_CELL_COUNT) -> tuple[Floats, Floats, Floats, Floats]:
        """Return the largest amount among the `k` nearest cells of each of `cells`, and x, y and z (mm) of the cell that has
        it. All four results are float32[n]. Of cells with equal amounts, the first is used. If all amounts are 0, the position
        is that of the given cell. For cell -1, it is (0, 0, 0)."""
        agent_cells = np.asarray(cells).astype(np.int32, copy=False)
        best, value = np.empty(agent_cells.size, np.int64), np.empty(agent_cells.size)
        find_strongest_nearby_cells(agent_cells, self._get_nearest_cells(k), self._padded, best, value)
        x, y, z = (self._sensed_positions[:, k].take(best) for k in range(3))
        return value.astype(np.float32), x, y, z

    def get_dependent_cells(self, k: int) -> tuple[NDArray[np.int64], Cells]:
        """Return, for each cell, the cells that have it among their `k` nearest cells.

        The result is two arrays, `start` and `cell`. For cell a, these are `cell[start[a]:start[a+1]]`, ascending. This is only
        valid for fields that cannot get new cells."""
        if k not in self._dependents_by_size:
            self._dependents_by_size[k] = _find_dependent_cells(self._get_nearest_cells(k), len(self.cells))
        return self._dependents_by_size[k]

    def sample_gradient(self, cells: Cells, k: int = NEAREST_CELL_COUNT) -> tuple[Floats, Floats, Floats]:
        """Return the gradient (per mm) along the surface at each of `cells`, as x, y and z, each float32[n].

        It is a least-squares fit over the `k` nearest cells. It is 0 for cell -1."""
        agent_cells = np.asarray(cells, np.int64)
        has_cell = (agent_cells >= 0) & (len(self.cells) > 0)
        agent_cells = np.where(has_cell, agent_cells, 0)
        if not len(self.cells):
            zeros = np.zeros(agent_cells.size, np.float32)
            return zeros, zeros.copy(), zeros.copy()
        positions = self._cell_positions
        own_positions, normal = (
            positions.take(agent_cells, axis=1),
            np.ascontiguousarray(self.cells.normal.take(agent_cells, axis=0).T),
        )
        amounts = self._padded.take(agent_cells)
        moments = np.zeros((6, agent_cells.size))
        slope = np.zeros((3, agent_cells.size))
        for column in np.ascontiguousarray(self._get_nearest_cells(k).take(agent_cells, axis=0).T).astype(np.int64):
            real = column < len(self.cells)
            # A missing cell is replaced by the agent's own cell, which adds nothing.
            column = np.where(real, column, agent_cells)
            d = self.cells.compute_offsets(positions.take(column, axis=1).T, own_positions.T).T
            rise = self._padded.take(column) - amounts
            for m, (a, b) in enumerate(_SYMMETRIC_ENTRIES):
                moments[m] += d[a] * d[b]
            slope += d * rise
        # Cells give no information along the normal: a large weight there keeps the result in the surface.
        stiff = moments[0] + moments[1] + moments[2] + 1e-30
        for m, (a, b) in enumerate(_SYMMETRIC_ENTRIES):
            moments[m] += stiff * normal[a] * normal[b] * 1e3 + (1e-9 * stiff if m < 3 else 0.0)
        return tuple(np.where(has_cell, g, 0.0).astype(np.float32) for g in _solve_symmetric_system(moments, slope))  # type: ignore[return-value]

    def _get_nearest_cells(self, k: int) -> Cells:
        return self.cells.get_nearest_cells(k)

    @cached_property
    def _sensed_positions(self) -> NDArray[np.float32]:
        """Return the cell positions as float32, one contiguous row per cell, for `sensed_positions`."""
        single_positions = np.zeros((len(self.cells) + 1, 4), np.float32)
        single_positions[:, :3] = self._cell_positions.T
        return single_positions

    @cached_property
    def _cell_positions(self) -> NDArray[np.float64]:
        """Return the cell positions, float64[3, cells + 1]. The last column stands for "no cell"."""
        return np.ascontiguousarray(np.concatenate([self.cells.position.T, np.zeros((3, 1))], axis=1))


def _find_dependent_cells(nearest_cells: Cells, cells: int) -> tuple[NDArray[np.int64], Cells]:
    """Compute the result of `PheromoneField.get_dependent_cells`. `nearest_cells` [cells, k]: the nearest cells of each cell."""
    flat = nearest_cells.ravel()
    start = np.zeros(cells + 2, np.int64)
    np.cumsum(np.bincount(flat, minlength=cells + 1), out=start[1:])
    return start, (sort_stably(flat) // nearest_cells.shape[1]).astype(np.int32)


class _DiffusionOperator:
    """An operator that computes a symmetric flow between cells. `inflow_matrix`: a sparse matrix [cells, cells] with the
    fraction of each linked cell's amount that flows into a cell."""

    def __init__(self, inflow_matrix: Any) -> None:
        rows = np.repeat(np.arange(inflow_matrix.shape[0]), np.diff(inflow_matrix.indptr))
        self._outflow_shares = np.bincount(rows, inflow_matrix.data, inflow_matrix.shape[0]).astype(np.float64)
        self._inflow_matrix = (
            inflow_matrix.data,
            inflow_matrix.indices.astype(np.int32, copy=False),
            inflow_matrix.indptr.astype(np.int64, copy=False),
        )
        self._inflow = np.empty(0)

    def compute_flow(self, amounts: NDArray[np.float64], threads: int) -> NDArray[np.float64]:
        """Return the inflow minus the outflow of each cell. The next call overwrites the array.

        `amounts`: the amount in each cell; further entries are ignored."""
        if not len(self._inflow):
            self._inflow = np.empty(len(self._outflow_shares))
        work = partial(compute_cell_inflow, amounts, *self._inflow_matrix, self._outflow_shares, self._inflow)
        parallel.run_in_parts(work, len(self._outflow_shares), threads)
        return self._inflow


def _solve_symmetric_system(matrix: NDArray[np.float64], vector: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    """Solve M x = v for symmetric 3×3 matrices M by cofactors.

    Return the three components of x. `matrix`: the entries xx, yy, zz, xy, xz, yz of M. `vector`: the components of v."""
    xx, yy, zz, xy, xz, yz = matrix
    c00, c01, c02 = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    c11, c12, c22 = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    size = xx * c00 + xy * c01 + xz * c02
    size = np.where(size > 0, size, 1.0)
    return (
        (c00 * vector[0] + c01 * vector[1] + c02 * vector[2]) / size,
        (c01 * vector[0] + c11 * vector[1] + c12 * vector[2]) / size,
        (c02 * vector[0] + c12 * vector[1] + c22 * vector[2]) / size,
    )


@kernel
def compute_cell_inflow(
    values: Array1[F64],
    inflow_shares: Array1[F64],
    cell: Array1[I32],
    start: Array1[I64],
    outflow_shares: Array1[F64],
    change: Array1[F64],
    begin: I64,
    end: I64,
) -> None:
    """Write to `change` the inflow minus the outflow of each cell from `begin` to before `end`.

    `cell[start[n]:start[n+1]]`: the cells linked to cell n. `inflow_shares`: for each entry of `cell`, the fraction of that
    cell's amount that flows into cell n. `outflow_shares`: the fraction of each cell's amount that flows out."""
    for n in range(begin, end):
        total = 0.0
        for k in range(start[n], start[n + 1]):
            total += inflow_shares[k] * values[cell[k]]
        change[n] = total - outflow_shares[n] * values[n]


@kernel
def advance_cells(
    values: Array1[F64],
    change: Array1[F64],
    pending_deposits: Array1[I64],
    spread: F64,
    remaining_share: F64,
    deposit_quantum: F64,
    max_amount: F64,
    flush_floor: F64,
    flush_threshold: F64,
    deposit_mode: I64,
    begin: I64,
    end: I64,
) -> None:
    """Advance the cells from `begin` to before `end` by one step.

    Adds `spread` times `change` (nothing if `change` is empty), multiplies by `remaining_share`, then applies deposits.
    `pending_deposits`: the deposits in multiples of `deposit_quantum`; they are set to 0 once applied. `deposit_mode`: 1 adds
    deposits; 2 raises a cell's amount to its deposit if that is larger. `max_amount`: the largest allowed amount. Amounts
    between `flush_floor` and `flush_threshold` become 0."""
    spreads = change.size > 0
    for n in simd_range(begin, end):
        value = values[n]
        if spreads:
            value += spread * change[n]
        value *= remaining_share
        if deposit_mode > 0:
            landed = np.float64(pending_deposits[n]) * deposit_quantum
            if deposit_mode == 1:
                value += landed
            elif landed > value:
                value = landed
            pending_deposits[n] = 0
        value = min(value, max_amount)
        if value < flush_threshold and value > flush_floor:
            value = 0.0
        values[n] = value


@kernel
def find_strongest_nearby_cells(
    agent_cells: Array1[I32], nearest_cells: Array2[I32], values: Array1[F64], best_cells: Array1[I64], value: Array1[F64]
) -> None:
    """For each agent, write the largest amount near its cell to `value`, and the first cell with this amount to `best_cells`.

    If all amounts are 0, `best_cells` is the agent's own cell and `value` is 0. `agent_cells` [n]: the agents' cells, -1 for
    none. `nearest_cells` [cells, k]: the nearest cells of each cell. `values` [cells + 1]: the amounts, with a final 0 for "no
    cell"."""
    none = values.size - 1
    for n in range(agent_cells.size):
        cell = agent_cells[n]
        strongest_cell, strongest = cell, 0.0
        if cell < 0:
            strongest_cell = none
        else:
            for k in range(nearest_cells.shape[1]):
                candidate = nearest_cells[cell, k]
                if values[candidate] > strongest:
                    strongest_cell, strongest = candidate, values[candidate]
        best_cells[n], value[n] = strongest_cell, strongest
