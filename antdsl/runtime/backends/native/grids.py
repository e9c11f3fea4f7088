"""The cell grid of a search, sorted by machine code: the same cells as `senses.neighbours.CellGrid`, agents of a cell in any
order. Each thread sorts a part of the agents (`cell_sort`)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import ceil, inf, log2
from struct import Struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.kinds import WIDTH
from antdsl.machine_code.memory import address
from antdsl.numerics import parallel
from antdsl.numerics.cores import cores
from antdsl.runtime.backends.native.cell_sort import COLUMNS, KEYS, NAMES
from antdsl.runtime.backends.native.rooms import Rooms
from antdsl.runtime.cell_grids import grid_for
from antdsl.runtime.world import AXES, Population, World
from antdsl.senses.cell_order import Shape

_AGAIN = 64  # steps after which a crowd has cells anew, and is asked whether it lies in one sheet
_SPARE = 1 / 32  # of its extent, that a box goes on for beyond a crowd
_FILLED = 0.8  # of its extent: a crowd that is less wide gets other cells
_FEW = 128  # agents; among fewer the cells of an agent are no fewer to go through than all others
_UNUSED = 16  # steps after which arrays of a size of cells that nobody asks for are let go
_COARSER = 2  # quarters of an octave: finding others in cells that much wider costs less than sorting them again
_CELLS = 4  # for each agent, above which wider ones cost less
_PARTED = 8_192  # agents for whom several threads pay
_NO_KEYS = np.zeros(1, np.int64)  # cells are listed
_WHOLE = 1e300  # mm: the width of a cell that has all places in it

_REALS, _WHOLE_NUMBERS = Struct("=9d"), Struct("=10q")

Arrays = Mapping[str, NDArray[Any] | None]
Function = Callable[[int, int, int], Any]  # of a table, the first row and the one after the last


class _Places:
    """Where the agents of a species are, and the corners of the box around them, which are looked for once a step."""

    def __init__(self) -> None:
        self.arrays: list[NDArray[np.float32]] = []  # x, y, z
        self.lie: list[int] = []
        self.corners: list[float] = []  # least and greatest of each
        self.step = -1  # of the corners
        self._bounds, self._table = np.zeros(7), np.zeros(len(KEYS), np.int64)
        self._table[KEYS.index("bounds")] = address(self._bounds)
        self._address = address(self._table)

    def look(self, other: Population, step: int, bounds: Function, rooms: Rooms) -> None:
        """Where they are in a step; without corners if some are nowhere."""
        if step == self.step:
            return
        start, known = other.start, self.arrays
        x, y, z = start["position.x"], start["position.y"], start["position.z"]
        if not known or known[0] is not x or known[1] is not y or known[2] is not z:
            placed = [rooms.moved(other, f"position.{axis}", start=True) for axis in AXES]
            self.arrays, self.lie = [array for array, _ in placed], [place for _, place in placed]
            self._table[1:4] = self.lie
        bounds(self._address, 0, len(other))
        *corners, good = self._bounds.tolist()
        self.corners, self.step = corners if good else [], step


class _Box:
    """A box somewhat larger than one around a crowd: its cells serve as long as the crowd stays in it and fills it, and not for
    ever, since the crowd may spread in height."""

    def __init__(self, corners: list[float], until: int) -> None:
        extent = [high - low for low, high in zip(corners[:3], corners[3:], strict=True)]
        self.low = [low - _SPARE * each for low, each in zip(corners[:3], extent, strict=True)]
        self.high = [high + _SPARE * each for high, each in zip(corners[3:], extent, strict=True)]
        self._least, self._until = [_FILLED * each for each in extent], until

    def suits(self, corners: list[float], step: int) -> bool:
        """Whether its cells serve in a step in which these are the corners around the crowd."""
        ax, ay, az, bx, by, bz = corners
        (lx, ly, lz), (hx, hy, hz), (x, y, z) = self.low, self.high, self._least
        inside = lx <= ax and ly <= ay and lz <= az and bx <= hx and by <= hy and bz <= hz
        return inside and bx - ax >= x and by - ay >= y and bz - az >= z and step < self._until


class _Sorted:
    """A crowd in the order of cells: `tables` are those of `CellGrid.tables` and registers in that order, [n + 8, 4] by up to
    four names; another mapping whenever one of them is another array."""

    def __init__(self, count: int, tables: Arrays) -> None:
        self.count, self.tables = count, tables
        self._laid: dict[str, tuple[int, NDArray[np.int64]]] = {}  # the step that registers are of, addresses

    def lay(self, names: str, columns: list[int], step: int) -> int:
        """The address of the table that registers are put in order with, given theirs; 0 where that was done in this step."""
        known, table = self._laid.get(names, (-1, _NO_KEYS))
        if known == step:
            return 0
        if known < 0:
            table, laid = np.zeros(len(COLUMNS), np.int64), np.zeros((self.count + WIDTH, 4), np.float32)
            self.tables = {**self.tables, names: laid}
            arrays = (self.tables["at"], self.tables["whole"], laid)
            table[[0, 1, -1]] = [address(each) for each in arrays if each is not None]
        self._laid[names] = step, table
        table[2:-1] = columns + columns[:1] * (4 - len(columns))
        return address(table)


class _Crowd(_Sorted):
    """Arrays that a crowd is sorted with into cells of one size by so many threads, kept from step to step. What functions are
    called with for each part: `listed` with places as they lie, `turned` in the order of the cells' axes."""

    def __init__(self, count: int, threads: int) -> None:
        bounds = _shared(count, threads)
        self.threads, self._parts = threads, len(bounds)
        self._numbers, self._tables = np.zeros(9), np.zeros((2, len(bounds), len(KEYS)), np.int64)
        self._keys, self._before = np.zeros(count + WIDTH, np.int32), np.zeros((0, 0), np.int32)
        self.floats, self.whole = np.zeros(9), np.zeros(10, np.int64)
        own: dict[str, NDArray[Any]] = {axis: np.zeros(count + WIDTH, np.float32) for axis in AXES}
        own |= {"places": np.zeros((count + WIDTH, 4), np.float32), "floats": self.floats, "whole": self.whole, "keys": _NO_KEYS}
        own["at"] = np.zeros(count + WIDTH, np.int32)
        super().__init__(count, own | {"starts": np.zeros(0, np.int32)})
        self.asked = 0  # the last step in which somebody did
        lasting: dict[str, NDArray[Any]] = {"numbers": self._numbers, "keys": self._keys}
        lasting.update({name: own[name] for name in ("places", "whole", "at")}, **{f"sorted {axis}": own[axis] for axis in AXES})
        for name, array in lasting.items():
            self._tables[..., KEYS.index(name)] = address(array)
        self._axes: tuple[int, ...] = ()
        self._lie: list[int] = []
        self.box: _Box | None = None  # that the cells are of
        self.address = address(self._tables)
        self.listed, self.turned = (
            np.array([(address(table), *part) for table, part in zip(tables, bounds, strict=True)], np.int64)
            for tables in self._tables
        )

    def lies(self, lie: list[int]) -> None:
        """Where places lie in memory."""
        if lie is not self._lie:
            self._lie = lie
            self._tables[..., 1:4] = [[lie], [[lie[axis] for axis in self._axes]]]

    def shaped(self, shape: Shape) -> None:
        """Cells for it."""
        many = shape.cells + 2
        starts = self.tables["starts"]
        if starts is None or len(starts) < many + 2 * WIDTH:
            starts = np.zeros(many + (many >> 3) + 2 * WIDTH, np.int32)
            self._before = np.zeros((self._parts - 1, len(starts)), np.int32)
            self.tables = {**self.tables, "starts": starts}
            owned = [*map(address, self._before), address(starts)]
            self._tables[..., -3:] = [(address(starts), each, address(self._before)) for each in owned]
        self._axes, self._lie = shape.axes, []
        (a, b, c), low, size = shape.width, shape.low, shape.size
        inverse = (1 / a, 1 / b, 1 / c)
        _REALS.pack_into(self.floats.data, 0, *low, a, b, c, *inverse)
        _REALS.pack_into(self._numbers.data, 0, *low, *inverse, *size)
        _WHOLE_NUMBERS.pack_into(self.whole.data, 0, *shape.axes, *size, self.count, many, self._parts - 1, len(starts))


class Grids:
    """Sorts crowds into cells by machine code, whose functions are had by their names; arrays are kept from step to step."""

    def __init__(self, functions: Callable[[str], Function], rooms: Rooms) -> None:
        self._bounds, self._number, self._starts, self._sort, self._columns, self._beside = map(functions, NAMES)
        self._rooms = rooms
        self._found: dict[tuple[str, float], _Sorted] = {}  # of this step
        self._places: dict[str, _Places] = {}
        self._kept: dict[tuple[str, float], _Crowd] = {}
        self._step = 0
        self._sheets: dict[str, tuple[int, int, bool]] = {}  # agents, until which step it is known, whether

    def forget(self) -> None:
        """Agents have moved: another step begins."""
        self._found.clear()
        self._step += 1
        for key in [key for key, each in self._kept.items() if self._step - each.asked > _UNUSED]:
            del self._kept[key]

    def of(self, world: World, other: Population, cell: float, beside: Sequence[tuple[str, list[int]]] = ()) -> Arrays:
        """What a search is run with, of cells that suit a radius; `beside`: up to four registers each that are wanted in the
        order of the cells, by their names, and where they lie, with room."""
        size = float(ceil(4 * log2(cell))) if len(other) > _FEW and cell < inf else inf
        for wider in range(_COARSER + 1):
            found = self._found.get((other.name, size + wider))
            if found is not None:
                break
        if found is None:
            found = self._sorted(world, other, size) or _Sorted(len(other), grid_for(world, other, cell).tables)
            self._found[other.name, size] = found
        for names, columns in beside:
            if table := found.lay(names, columns, self._step):
                parts = np.array([(table, *part) for part in _shared(len(other), world.options.threads)], np.int64)
                parallel.listed(self._beside, parts, world.options.threads)
        return found.tables

    def _sorted(self, world: World, other: Population, size: float) -> _Crowd | None:
        """None where NumPy has to sort: where some are without a place, of a crowd so far apart that its cells are not listed,
        and of no agents at all."""
        count = len(other)
        if not count:
            return None
        crowd, threads = self._kept.get((other.name, size)), world.options.threads
        if crowd is None or crowd.count != count or crowd.threads != threads:
            crowd = self._kept[other.name, size] = _Crowd(count, threads)
        crowd.asked = self._step
        places = self._places.get(other.name)
        if places is None:
            places = self._places[other.name] = _Places()
        places.look(other, self._step, self._bounds, self._rooms)
        if not places.corners:
            return None
        if crowd.box is None or not crowd.box.suits(places.corners, self._step):
            box = _Box(places.corners, self._step + _AGAIN)
            shape = self._shape(other, places.arrays, box, size)
            if shape is None:
                return None
            crowd.shaped(shape)
            crowd.box = box
        crowd.lies(places.lie)
        parallel.listed(self._number, crowd.turned, threads)
        self._starts(crowd.address, 0, 0)
        parallel.listed(self._sort, crowd.listed, threads)
        parallel.listed(self._columns, crowd.listed, threads)
        return crowd

    def _shape(self, other: Population, places: list[NDArray[np.float32]], box: _Box, size: float) -> Shape | None:
        """Cells of a crowd in a box, one for all of very few agents; None where there would be too many."""
        low, high = box.low, box.high
        if size == inf:
            return Shape((0, 1, 2), low, [0.0] * 3, [_WHOLE] * 3, [1] * 3)
        shape = Shape.of(low, high, 2.0 ** (size / 4))
        if self._sheet(other, places, shape):
            shape = shape.as_sheet()
        shape = _coarser(shape, _CELLS * len(other))
        return shape if shape.cells <= max(1 << 16, 16 * len(other)) else None

    def _sheet(self, other: Population, places: list[NDArray[np.float32]], shape: Shape) -> bool:
        """Whether a crowd lies in one sheet: only speed hangs on it, so it is not asked each time."""
        if not shape.extent[2] > 0:
            return False  # one layer of cells already
        count, until, known = self._sheets.get(other.name, (-1, 0, False))
        if count != len(other) or self._step >= until:
            known, until = shape.is_sheet(places), self._step + _AGAIN
        self._sheets[other.name] = (len(other), until, known)
        return known


def _shared(count: int, threads: int) -> list[tuple[int, int]]:
    """The first row and the one after the last that each thread has of so many, where several pay; no part of no rows."""
    threads = max(1, min(threads, cores())) if count >= _PARTED else 1
    part = max(-(-count // (WIDTH * threads)), 1) * WIDTH
    return [(begin, min(begin + part, count)) for begin in range(0, count, part)]


def _coarser(shape: Shape, most: int) -> Shape:
    """Wider cells of a crowd so sparse that there are more than so many, which would have to be counted for nobody: up to four
    times along the fast axis, then up to twice along each."""
    if shape.cells <= most:
        return shape
    width, size = list(shape.width), list(shape.size)
    for axis in (0, 0, 1, 2, 0):
        if size[0] * size[1] * size[2] <= most:
            break
        if size[axis] > 1:
            width[axis] *= 2
            size[axis] = int(shape.extent[axis] / width[axis]) + 1
    return Shape(shape.axes, shape.low, shape.extent, width, size)
