"""Cell grids for searches: crowds sorted by cell (`senses.cell_order`). Arrays and cells are used again in later steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from math import ceil, inf, log2
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.number_kinds import LANE_COUNT
from antdsl.numerics import parallel
from antdsl.runtime.world import AXES, Population, World
from antdsl.senses.cell_order import CellOrder, GridShape, Positions, find_bounding_box, pack_columns_by_position

_BOX_LIFETIME_STEPS = 64  # steps after which a crowd gets new cells and the sheet test is repeated
_BOX_MARGIN_SHARE = 1 / 32  # margin of a box around a crowd, as a share of the extent
_MIN_FILLED_SHARE = 0.8  # a crowd that fills less of its box gets new cells
_MAX_AGENTS_IN_ONE_CELL = 128  # for fewer agents, cells do not reduce the candidates
_UNUSED_STEPS_BEFORE_RELEASE = 16  # steps after which the arrays of an unused cell size are released
_MAX_COARSENING_STEPS = 2  # quarters of an octave: searching cells wider by this costs less than sorting again
_MAX_CELLS_PER_AGENT = 4  # with more cells per agent, wider cells cost less
_INFINITE_BOX_WIDTH = 1e300  # mm: width of a single cell for all positions

Arrays = Mapping[str, NDArray[Any] | None]
RegisterGroups = Sequence[tuple[str, list[NDArray[np.float32]]]]  # groups of up to four registers, with their names
BoxCorners = tuple[list[float], list[float]]


class _CrowdBoundingBox:
    """A box slightly larger than a crowd. The cells of several steps fill this box.

    The cells are used while the crowd stays inside the box and fills most of it. They are replaced after some steps in any case,
    because the crowd may have spread in height."""

    def __init__(self, corners: BoxCorners, expiry_step: int) -> None:
        extent = [high - low for low, high in zip(*corners, strict=True)]
        self.low = [low - _BOX_MARGIN_SHARE * each for low, each in zip(corners[0], extent, strict=True)]
        self.high = [high + _BOX_MARGIN_SHARE * each for high, each in zip(corners[1], extent, strict=True)]
        self._min_extent, self._expiry_step = [_MIN_FILLED_SHARE * each for each in extent], expiry_step

    def is_suitable(self, corners: BoxCorners, step: int) -> bool:
        """Return whether the cells of this box are suitable in a step. `corners`: the corners of the crowd's bounding box."""
        (ax, ay, az), (bx, by, bz) = corners
        (lx, ly, lz), (hx, hy, hz), (x, y, z) = self.low, self.high, self._min_extent
        inside = lx <= ax and ly <= ay and lz <= az and bx <= hx and by <= hy and bz <= hz
        return inside and bx - ax >= x and by - ay >= y and bz - az >= z and step < self._expiry_step


class _CrowdGrid(CellOrder):
    """A crowd sorted into cells of one size, together with registers in the order of the cells."""

    def __init__(self, count: int, threads: int) -> None:
        super().__init__(count, threads)
        self.last_used_step = 0  # the last step in which a search read it
        self.box: _CrowdBoundingBox | None = None  # the box of the cells
        self._sorted_in_step: dict[str, int] = {}  # by register names: the step in which they were sorted

    def sort_registers(self, registers: RegisterGroups, step: int) -> None:
        """Write registers in the order of the cells, unless this was already done in the current `step`."""
        for names, columns in registers:
            if self._sorted_in_step.get(names) == step:
                continue
            if names not in self._sorted_in_step:
                self.tables = {**self.tables, names: np.zeros((self.count + LANE_COUNT, 4), np.float32)}
            self._sorted_in_step[names], laid = step, self.tables[names]
            assert laid is not None
            four = parallel.make_contiguous(*columns, *(columns[:1] * (4 - len(columns))))
            work = partial(pack_columns_by_position, self.position_by_row, four, laid.reshape(-1))
            parallel.run_in_parts(work, self.count, self.threads, parallel.MIN_LIGHT_ITEMS_PER_THREAD)


class SearchGrids:
    """The cell grids of all crowds. In each step, a crowd is sorted at most once for each cell size."""

    def __init__(self) -> None:
        self._grids_of_step: dict[tuple[str, float], _CrowdGrid] = {}  # of this step
        self._corners: dict[str, BoxCorners] = {}  # of this step
        self._stored_grids: dict[tuple[str, float], _CrowdGrid] = {}
        self._step = 0
        self._layer_tests: dict[str, tuple[int, int, bool]] = {}  # by species: number of agents, last step of validity, result

    def begin_step(self) -> None:
        """Invalidate the sorted crowds, because the agents have moved."""
        self._grids_of_step.clear()
        self._corners.clear()
        self._step += 1
        for key in [
            key for key, each in self._stored_grids.items() if self._step - each.last_used_step > _UNUSED_STEPS_BEFORE_RELEASE
        ]:
            del self._stored_grids[key]

    def build_tables(self, world: World, other: Population, radius: float, extra_registers: RegisterGroups = ()) -> Arrays:
        """Return the arrays of a cell grid, by name. The size of its cells suits searches with `radius` (mm).

        `extra_registers`: registers that the search needs in the order of the cells."""
        size = float(ceil(4 * log2(radius))) if len(other) > _MAX_AGENTS_IN_ONE_CELL and radius < inf else inf
        for wider in range(_MAX_COARSENING_STEPS + 1):
            grid = self._grids_of_step.get((other.name, size + wider))
            if grid is not None:
                break
        if grid is None:
            grid = self._grids_of_step[other.name, size] = self._sort_crowd(world, other, size)
        grid.sort_registers(extra_registers, self._step)
        return grid.tables

    def _sort_crowd(self, world: World, other: Population, size: float) -> _CrowdGrid:
        """Return a crowd sorted into cells that suit radii of 2**(size / 4) mm."""
        count, threads = len(other), world.options.threads
        crowd = self._stored_grids.get((other.name, size))
        if crowd is None or crowd.count != count or crowd.threads != threads:
            crowd = self._stored_grids[other.name, size] = _CrowdGrid(count, threads)
        crowd.last_used_step = self._step
        x, y, z = parallel.make_contiguous(*(other.start[f"position.{axis}"] for axis in AXES))
        corners = self._corners.get(other.name)
        if corners is None:
            corners = self._corners[other.name] = find_bounding_box((x, y, z))
        shape = crowd.shape
        if shape is None or crowd.box is None or not crowd.box.is_suitable(corners, self._step):
            crowd.box = _CrowdBoundingBox(corners, self._step + _BOX_LIFETIME_STEPS)
            shape = self._choose_shape(other, (x, y, z), crowd.box, size)
        crowd.sort(shape, (x, y, z))
        return crowd

    def _choose_shape(self, other: Population, positions: Positions, box: _CrowdBoundingBox, size: float) -> GridShape:
        """Return the shape of the cells for a crowd in a box. A crowd of very few agents gets a single cell."""
        if size == inf:
            return GridShape((0, 1, 2), box.low, [0.0] * 3, [_INFINITE_BOX_WIDTH] * 3, [1] * 3)
        shape = GridShape.from_bounds(box.low, box.high, 2.0 ** (size / 4))
        if self._needs_one_layer(other, positions, shape):
            shape = shape.flatten_to_one_layer()
        return _coarsen_shape(shape, _MAX_CELLS_PER_AGENT * len(other))

    def _needs_one_layer(self, other: Population, positions: Positions, shape: GridShape) -> bool:
        """Return whether a single layer of cells suffices for a crowd. This affects only speed, so it is not computed in each
        step."""
        count, until, known = self._layer_tests.get(other.name, (-1, 0, False))
        if count != len(other) or self._step >= until:
            known, until = shape.is_one_layer_enough(positions), self._step + _BOX_LIFETIME_STEPS
        self._layer_tests[other.name] = (len(other), until, known)
        return known and shape.extent[2] > 0


def _coarsen_shape(shape: GridShape, max_cells: int) -> GridShape:
    """Return a shape with larger cells, if a sparse crowd would need more than `max_cells` cells, most of them empty.

    Cells become up to four times longer along the fast axis. If this is not enough, they become up to twice as long along each
    axis."""
    if shape.cell_count <= max_cells:
        return shape
    width, size = list(shape.cell_widths), list(shape.cells_per_axis)
    for axis in (0, 0, 1, 2, 0):
        if size[0] * size[1] * size[2] <= max_cells:
            break
        if size[axis] > 1:
            width[axis] *= 2
            size[axis] = int(shape.extent[axis] / width[axis]) + 1
    return GridShape(shape.axes, shape.low_corner, shape.extent, width, size)
