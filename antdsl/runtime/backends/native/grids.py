"""The cell grid of a search, sorted by machine code: the same cells as `senses.neighbours.CellGrid`, agents of a cell in any
order.

Counting sort: number of each agent's cell and how many are in each, their sums from the first cell on, then each agent to its
place (D. E. Knuth, The Art of Computer Programming 3, 5.2)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.lanes import F32, F64, I32, I64, PTR, WIDTH, Lanes, Module
from antdsl.machine_code.memory import Addresses, address
from antdsl.runtime.backends.native.block import Writer
from antdsl.runtime.backends.native.layout import Layout
from antdsl.runtime.cell_grids import grid_for
from antdsl.runtime.world import AXES, Population, World
from antdsl.senses.neighbours import Shape

NAMES = ("grid.count", "grid.place")
_KEYS = ("numbers", "x", "y", "z", "keys", "starts", "sorted x", "sorted y", "sorted z", "places")
_AGAIN = 16  # searches of a crowd after which it is asked anew whether it lies in one sheet
_FEW = 64  # agents; fewer are sorted by NumPy
_UNUSED = 16  # steps after which arrays of a size of cells that nobody asks for are let go
_NO_KEYS = np.zeros(1, np.int64)  # cells are listed

Arrays = Mapping[str, NDArray[Any] | None]


def write(module: Module) -> None:
    """The functions of the sort."""
    layout = Layout({(name,): k for k, name in enumerate(_KEYS)})
    _count(Writer(module, layout))
    _place(Writer(module, layout))


def _real(w: Writer, k: int) -> Lanes:
    e = w.e
    return e.splat(e.load_one(w.base("numbers"), e.constant(k, I64, one=True), F64))


def _count(w: Writer) -> None:
    e = w.e
    low, inverse, most = ([_real(w, 3 * part + k) for k in range(3)] for part in range(3))
    number = [e.whole(each) for each in most]
    rows = e.op("sub i64 %end, %begin", I64, one=True)
    with e.loop(rows, WIDTH) as at:
        cells = []
        for k, axis in enumerate(AXES):
            place = (e.convert(e.load(w.base(axis), at, F32), F64) - low[k]) * inverse[k]
            cells.append(e.whole(np.floor(e.between(place, e.constant(0.0, F64), most[k] - 1.0))))
        line = e.multiplied(e.multiplied(cells[2], number[1]) + cells[1], number[0]) + cells[0]
        e.store(w.base("keys"), at, line)
    with e.loop(rows) as at:
        key = e.convert(e.load_one(w.base("keys"), at, I32), I64)
        place = e.address(w.base("starts"), e.one(f"add i64 {key.name}, 2", I64), I32)
        e.put(place.name, e.one(f"add i32 {e.get(place.name, I32, one=True).name}, 1", I32))
    w.module.functions[NAMES[0]] = w.function(NAMES[0])


def _place(w: Writer) -> None:
    e = w.e
    rows = e.op("sub i64 %end, %begin", I64, one=True)
    with e.loop(rows) as at:
        key = e.convert(e.load_one(w.base("keys"), at, I32), I64)
        cursor = e.address(w.base("starts"), e.one(f"add i64 {key.name}, 1", I64), I32)
        small = e.get(cursor.name, I32, one=True)
        e.put(cursor.name, e.one(f"add i32 {small.name}, 1", I32))
        to = e.convert(small, I64)
        four = e.one(f"getelementptr <4 x float>, ptr {w.base('places').name}, i64 {to.name}", PTR)
        for k, axis in enumerate(AXES):
            value = e.load_one(w.base(axis), at, F32)
            e.put(e.address(w.base(f"sorted {axis}"), to, F32).name, value)
            e.put(e.field(four.name, 4 * k), value)
        e.put(e.field(four.name, 12), e.convert(at, I32))
    w.module.functions[NAMES[1]] = w.function(NAMES[1])


def _with_room(array: NDArray[Any]) -> None:
    """ValueError where an array is not the beginning of one with eight more."""
    whole = array.base
    if not isinstance(whole, np.ndarray) or len(whole) < len(array) + WIDTH or whole.ctypes.data != array.ctypes.data:
        raise ValueError("machine code reads eight places at once, so that there has to be room behind the last one")


@dataclass(slots=True, eq=False)
class Grids:
    """Sorts crowds into cells; arrays are kept from step to step."""

    functions: Callable[[str], Callable[[int, int, int], None]]
    _found: dict[tuple[str, float], Arrays] = field(default_factory=dict)  # of this step
    _kept: dict[tuple[str, float], dict[str, NDArray[Any]]] = field(default_factory=dict)
    _asked: dict[tuple[str, float], int] = field(default_factory=dict)  # the last step in which somebody did
    _step: int = 0
    _lies: Addresses = field(default_factory=Addresses)
    _sheets: dict[str, tuple[int, int, bool]] = field(default_factory=dict)  # agents, searches since, whether

    def forget(self) -> None:
        """Agents have moved: another step begins."""
        self._found.clear()
        self._step += 1
        for key in [key for key, last in self._asked.items() if self._step - last > _UNUSED]:
            del self._asked[key]
            for name in self._kept.pop(key):
                self._lies.forget((*key, name))

    def of(self, world: World, other: Population, cell: float) -> Arrays:
        """What a search is run with, of cells that suit a radius."""
        size = float(np.ceil(4 * np.log2(cell)))
        if (other.name, size) not in self._found:
            self._found[other.name, size] = self._sorted(other, size) or grid_for(world, other, cell).tables
        return self._found[other.name, size]

    def _sorted(self, other: Population, size: float) -> Arrays | None:
        """The arrays of `CellGrid.tables`; None where NumPy has to sort: of very few agents, of some without a place, and of a
        crowd so far apart that its cells are not listed."""
        count = len(other)
        if count < _FEW:
            return None
        places = [other.start[f"position.{axis}"] for axis in AXES]
        low, high = [float(np.minimum.reduce(p)) for p in places], [float(np.maximum.reduce(p)) for p in places]
        if not all(map(isfinite, (*low, *high))):
            return None
        cell = float(2.0 ** (size / 4))
        shape = Shape.of(low, high, cell)
        if self._sheet(other, places, shape):
            shape = shape.as_sheet()
        if shape.cells > max(1 << 16, 16 * count):
            return None
        kept = self._kept.get((other.name, size))
        if kept is None or len(kept["keys"]) != count + WIDTH:
            kept = {name: np.zeros(count + WIDTH, np.float32) for name in AXES}
            kept |= {"keys": np.zeros(count + WIDTH, np.int32), "places": np.zeros((count + WIDTH, 4), np.float32)}
            kept |= {"floats": np.zeros(9), "whole": np.zeros(7, np.int64), "table": np.zeros(len(_KEYS), np.int64)}
            kept["numbers"] = np.zeros(9)
            self._kept[other.name, size] = kept
        self._asked[other.name, size] = self._step
        starts = np.zeros(shape.cells + 2, np.int32)
        inverse = [1 / width for width in shape.width]
        floats, table = kept["floats"], kept["table"]
        floats[:] = (*shape.low, *shape.width, *inverse)
        kept["numbers"][:] = (*shape.low, *inverse, *shape.size)
        kept["whole"][:] = (*shape.axes, *shape.size, count)
        lies = self._lies.of
        at = [lies((other.name, axis), places[axis], _with_room) for axis in range(3)]
        own = {name: lies((other.name, size, name), kept[name]) for name in (*AXES, "numbers", "keys", "places", "table")}
        table[0], table[4], table[5], table[9] = own["numbers"], own["keys"], address(starts), own["places"]
        table[1:4] = [at[axis] for axis in shape.axes]
        table[6:9] = [own[AXES[axis]] for axis in shape.axes]
        self.functions(NAMES[0])(own["table"], 0, count)
        np.cumsum(starts, out=starts)
        table[1:4] = at
        table[6:9] = [own[axis] for axis in AXES]
        self.functions(NAMES[1])(own["table"], 0, count)
        return {**kept, "keys": _NO_KEYS, "starts": starts}

    def _sheet(self, other: Population, places: list[NDArray[np.float32]], shape: Shape) -> bool:
        """Whether a crowd lies in one sheet: only speed hangs on it, so it is not asked each time."""
        if not shape.extent[2] > 0:
            return False  # one layer of cells already
        count, since, known = self._sheets.get(other.name, (-1, 0, False))
        if count != len(other) or since >= _AGAIN:
            known, since = shape.is_sheet(places), 0
        self._sheets[other.name] = (len(other), since + 1, known)
        return known
