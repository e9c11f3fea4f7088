"""The cell grid of a search, sorted by machine code: the same cells as `senses.neighbours.CellGrid`, agents of a cell in any
order.

Counting sort: number of each agent's cell and how many are in each, their sums from the first cell on, then each agent to its
place (D. E. Knuth, The Art of Computer Programming 3, 5.2)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import ceil, inf, log2
from struct import Struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.fours import FOUR, four_at, put_quadruples, quadruples_from
from antdsl.machine_code.lanes import BOOL, F32, F64, I32, I64, WIDTH, Lanes, Module
from antdsl.machine_code.memory import address
from antdsl.numerics import compiled
from antdsl.runtime.backends.native.block import Writer
from antdsl.runtime.backends.native.layout import Layout
from antdsl.runtime.backends.native.rooms import Rooms
from antdsl.runtime.cell_grids import grid_for
from antdsl.runtime.world import AXES, Population, World
from antdsl.senses.cell_order import Shape

NAMES = ("grid.bounds", "grid.keys", "grid.sort", "grid.beside")
_LAST = ("places", "bounds", "whole", "at")
_KEYS = ("numbers", "x", "y", "z", "keys", "starts", "sorted x", "sorted y", "sorted z", *_LAST)
_COLUMNS = ("at", "whole", "0", "1", "2", "3", "beside")
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

_REALS, _WHOLE_NUMBERS = Struct("=9d"), Struct("=8q")

Arrays = Mapping[str, NDArray[Any] | None]
Function = Callable[[int, int, int], Any]  # of a table, the first row and the one after the last


def write(module: Module) -> None:
    """The functions of the sort."""
    layout = Layout({(name,): k for k, name in enumerate(_KEYS)})
    beside = Layout({(name,): k for k, name in enumerate(_COLUMNS)})
    writers = ((_bounds, layout), (_keys, layout), (_sort, layout), (_beside, beside))
    for name, (made, of) in zip(NAMES, writers, strict=True):
        w = Writer(module, of)
        made(w)
        module.functions[name] = w.function(name)


def _real(w: Writer, k: int) -> Lanes:
    e = w.e
    return e.splat(e.load_one(w.base("numbers"), e.constant(k, I64, one=True), F64))


def _bounds(w: Writer) -> None:
    """Least and greatest x, y and z, and 1 where all of them are numbers, else 0."""
    e = w.e
    rows = e.op("sub i64 %end, %begin", I64, one=True)
    low, high, good = [e.slot(F32) for _ in AXES], [e.slot(F32) for _ in AXES], e.slot(I32)
    for k in range(3):
        e.put(low[k], e.constant(np.inf, F32))
        e.put(high[k], e.constant(-np.inf, F32))
    e.put(good, e.constant(1, I32))
    with e.loop(rows, WIDTH) as at:
        inside = (e.splat(at) + e.iota()) < e.splat(rows)
        for k, axis in enumerate(AXES):
            place = e.load(w.base(axis), at, F32)
            least, most = e.get(low[k], F32), e.get(high[k], F32)
            e.put(low[k], e.where(inside & (place < least), place, least))
            e.put(high[k], e.where(inside & (place > most), place, most))
            e.put(good, e.get(good, I32) & e.convert(~inside | np.isfinite(place), I32))
    for k in range(3):
        for part, slot, word in ((0, low[k], "fmin"), (3, high[k], "fmax")):
            name = f"llvm.vector.reduce.{word}.v8f32"
            e.module.declare(name, F32, [f"<{WIDTH} x {F32}>"])
            e.put(
                e.field(w.base("bounds").name, 8 * (part + k)),
                e.convert(e.one(f"call float @{name}({e.get(slot, F32).typed})", F32), F64),
            )
    all_good = e.one(f"icmp eq i8 {e.mask_bits(e.get(good, I32) != 0).name}, -1", BOOL)
    e.put(e.field(w.base("bounds").name, 48), e.one(f"uitofp i1 {all_good.name} to double", F64))


def _keys(w: Writer) -> None:
    """The number of each agent's cell."""
    e = w.e
    low, inverse, most = ([_real(w, 3 * part + k) for k in range(3)] for part in range(3))
    number = [e.whole(each) for each in most]
    rows = e.op("sub i64 %end, %begin", I64, one=True)
    with e.loop(rows, WIDTH) as offset:
        at = e.op(f"add i64 %begin, {offset.name}", I64, one=True)
        cells = []
        for k, axis in enumerate(AXES):
            place = (e.convert(e.load(w.base(axis), at, F32), F64) - low[k]) * inverse[k]
            cells.append(e.whole(np.floor(e.between(place, e.constant(0.0, F64), most[k] - 1.0))))
        line = e.multiplied(e.multiplied(cells[2], number[1]) + cells[1], number[0]) + cells[0]
        e.store(w.base("keys"), at, line)


def _sort(w: Writer) -> None:
    """Counts of the cells, where each begins, and the agents to their places."""
    e = w.e
    rows = e.op("sub i64 %end, %begin", I64, one=True)
    starts, many = w.base("starts"), e.load_one(w.base("whole"), e.constant(7, I64, one=True), I64)
    with e.loop(many, WIDTH) as at:  # there is room behind the last one
        e.store(starts, at, e.constant(0, I32))
    with e.loop(rows) as at:
        key = e.convert(e.load_one(w.base("keys"), at, I32), I64)
        place = e.address(starts, e.one(f"add i64 {key.name}, 2", I64), I32)
        e.put(place.name, e.one(f"add i32 {e.get(place.name, I32, one=True).name}, 1", I32))
    total = e.slot(I32, one=True)
    e.put(total, e.constant(0, I32, one=True))
    with e.loop(many) as at:
        place = e.address(starts, at, I32)
        so_far = e.one(f"add i32 {e.get(total, I32, one=True).name}, {e.get(place.name, I32, one=True).name}", I32)
        e.put(total, so_far)
        e.put(place.name, so_far)
    with e.loop(rows) as at:
        key = e.convert(e.load_one(w.base("keys"), at, I32), I64)
        cursor = e.address(starts, e.one(f"add i64 {key.name}, 1", I64), I32)
        small = e.get(cursor.name, I32, one=True)
        e.put(cursor.name, e.one(f"add i32 {small.name}, 1", I32))
        four = f"{FOUR} poison"
        values = [e.load_one(w.base(axis), at, F32) for axis in AXES]
        for k, value in enumerate((*values, e.one(f"bitcast i32 {e.convert(at, I32).name} to float", F32))):
            four = e.op(f"insertelement {four}, {value.typed}, i64 {k}", F32).name
            four = f"{FOUR} {four}"
        e.do(f"store {four}, ptr {four_at(e, w.base('places'), small).name}, align 4")
        e.put(e.address(w.base("at"), at, I32).name, small)
    with e.loop(rows, WIDTH) as at:  # there is room behind the last one
        for axis, value in zip(AXES, quadruples_from(e, w.base("places"), at), strict=False):
            e.store(w.base(f"sorted {axis}"), at, value)


def _beside(w: Writer) -> None:
    """Four registers side by side, in the order of the cells. Who is in none is written behind the last one."""
    e = w.e
    rows = e.op("sub i64 %end, %begin", I64, one=True)
    behind = e.splat(e.convert(e.load_one(w.base("whole"), e.constant(6, I64, one=True), I64), I32))
    with e.loop(rows, WIDTH) as offset:
        row = e.one(f"add i64 %begin, {offset.name}", I64)
        at = e.load(w.base("at"), row, I32)
        inside = ((e.splat(offset) + e.iota()) < e.splat(rows)) & (at >= 0)
        at = e.where(inside, at, behind)
        put_quadruples(e, w.base("beside"), at, [e.load(w.base(str(k)), row, F32) for k in range(4)])


class _Places:
    """Where the agents of a species are, and the corners of the box around them, which are looked for once a step."""

    def __init__(self) -> None:
        self.arrays: list[NDArray[np.float32]] = []  # x, y, z
        self.lie: list[int] = []
        self.corners: list[float] = []  # least and greatest of each
        self.step = -1  # of the corners
        self._bounds, self._table = np.zeros(7), np.zeros(len(_KEYS), np.int64)
        self._table[_KEYS.index("bounds")] = address(self._bounds)
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
            table, laid = np.zeros(len(_COLUMNS), np.int64), np.zeros((self.count + WIDTH, 4), np.float32)
            self.tables = {**self.tables, names: laid}
            arrays = (self.tables["at"], self.tables["whole"], laid)
            table[[0, 1, -1]] = [address(each) for each in arrays if each is not None]
        self._laid[names] = step, table
        table[2:-1] = columns + columns[:1] * (4 - len(columns))
        return address(table)


class _Crowd(_Sorted):
    """Arrays that a crowd is sorted with into cells of one size, kept from step to step."""

    def __init__(self, count: int) -> None:
        self._numbers, self._table = np.zeros(9), np.zeros(len(_KEYS), np.int64)
        self._keys = np.zeros(count + WIDTH, np.int32)
        self.floats, self.whole = np.zeros(9), np.zeros(8, np.int64)
        own: dict[str, NDArray[Any]] = {axis: np.zeros(count + WIDTH, np.float32) for axis in AXES}
        own |= {"places": np.zeros((count + WIDTH, 4), np.float32), "floats": self.floats, "whole": self.whole, "keys": _NO_KEYS}
        own["at"] = np.zeros(count + WIDTH, np.int32)
        super().__init__(count, own | {"starts": np.zeros(0, np.int32)})
        self.asked = 0  # the last step in which somebody did
        self._table[0], self._table[4] = address(self._numbers), address(self._keys)
        self._table[6:9] = [address(own[axis]) for axis in AXES]
        self._table[9], self._table[11], self._table[12] = (address(own[name]) for name in ("places", "whole", "at"))
        self._turned = self._table.copy()  # with places in the order of the cells' axes
        self._axes: tuple[int, ...] = ()
        self._lie: list[int] = []
        self.box: _Box | None = None  # that the cells are of
        self.address, self.turned = address(self._table), address(self._turned)

    def lies(self, lie: list[int]) -> None:
        """Where places lie in memory."""
        if lie is not self._lie:
            self._lie = lie
            self._table[1:4] = lie
            self._turned[1:4] = [lie[axis] for axis in self._axes]

    def shaped(self, shape: Shape) -> None:
        """Cells for it."""
        many = shape.cells + 2
        starts = self.tables["starts"]
        if starts is None or len(starts) < many + WIDTH:
            starts = np.zeros(many + (many >> 3) + WIDTH, np.int32)
            self.tables = {**self.tables, "starts": starts}
            self._table[5] = self._turned[5] = address(starts)
        self._axes, self._lie = shape.axes, []
        (a, b, c), low, size = shape.width, shape.low, shape.size
        inverse = (1 / a, 1 / b, 1 / c)
        _REALS.pack_into(self.floats.data, 0, *low, a, b, c, *inverse)
        _REALS.pack_into(self._numbers.data, 0, *low, *inverse, *size)
        _WHOLE_NUMBERS.pack_into(self.whole.data, 0, *shape.axes, *size, self.count, many)


class Grids:
    """Sorts crowds into cells by machine code, whose functions are had by their names; arrays are kept from step to step."""

    def __init__(self, functions: Callable[[str], Function], rooms: Rooms) -> None:
        self._bounds, self._number, self._sort, self._beside = (functions(name) for name in NAMES)
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
                self._in_parts(world, self._beside, table, len(other))
        return found.tables

    def _in_parts(self, world: World, function: Function, table: int, count: int) -> None:
        """Call a function for so many rows, by several threads where that pays."""
        threads = world.options.threads if count >= _PARTED else 1
        if threads < 2:
            function(table, 0, count)
            return
        part = -(-count // (WIDTH * threads)) * WIDTH
        parts = np.array([(table, begin, min(begin + part, count)) for begin in range(0, count, part)], np.int64)
        compiled.listed(function, parts, threads)

    def _sorted(self, world: World, other: Population, size: float) -> _Crowd | None:
        """None where NumPy has to sort: where some are without a place, and of a crowd so far apart that its cells are not
        listed."""
        count = len(other)
        crowd = self._kept.get((other.name, size))
        if crowd is None or crowd.count != count:
            crowd = self._kept[other.name, size] = _Crowd(count)
        crowd.asked = self._step
        places = self._places.get(other.name)
        if places is None:
            places = self._places[other.name] = _Places()
        places.look(other, self._step, self._bounds, self._rooms)
        if not places.corners or not count:
            return None
        if crowd.box is None or not crowd.box.suits(places.corners, self._step):
            box = _Box(places.corners, self._step + _AGAIN)
            shape = self._shape(other, places.arrays, box, size)
            if shape is None:
                return None
            crowd.shaped(shape)
            crowd.box = box
        crowd.lies(places.lie)
        self._in_parts(world, self._number, crowd.turned, count)
        self._sort(crowd.address, 0, count)
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
