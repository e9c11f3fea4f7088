"""What sorts agents into the cells of a grid, and lays what is asked of them in their order, as machine code.

Counting sort: number of each agent's cell and how many are in each, their sums from the first cell on, then each agent to its
place (D. E. Knuth, The Art of Computer Programming 3, 5.2). Each of several threads counts a part of the agents, and those of a
cell stand in the order of the parts: as if one had counted all."""

from __future__ import annotations

import numpy as np

from antdsl.machine_code.kernels.values import Number
from antdsl.machine_code.kinds import F32, F64, I32, I64, WIDTH
from antdsl.machine_code.lanes import Lanes
from antdsl.machine_code.module import Module
from antdsl.runtime.backends.native.block import Writer
from antdsl.runtime.backends.native.fours import put_four, put_quadruples, quadruples_from
from antdsl.runtime.backends.native.layout import Layout
from antdsl.runtime.world import AXES

NAMES = ("grid.bounds", "grid.keys", "grid.starts", "grid.sort", "grid.columns", "grid.beside")
_LAST = ("places", "bounds", "whole", "at")
# Where the agents of each cell begin; of a part (`own`), which is the same of the last one, and of all parts `before` that one.
_STARTS = ("starts", "own", "before")
KEYS = ("numbers", "x", "y", "z", "keys", "sorted x", "sorted y", "sorted z", *_LAST, *_STARTS)
COLUMNS = ("at", "whole", "0", "1", "2", "3", "beside")
_MANY, _BEFORE, _LENGTH = 7, 8, 9  # words of `whole`: starts, parts before the last one, and from one to the next


def write(module: Module) -> None:
    """The functions of the sort."""
    layout = Layout({(name,): k for k, name in enumerate(KEYS)})
    beside = Layout({(name,): k for k, name in enumerate(COLUMNS)})
    for name, made in zip(NAMES, (_bounds, _keys, _starts, _sort, _columns, _beside), strict=True):
        w = Writer(module, beside if made is _beside else layout)
        made(w)
        w.add(name)


def _real(w: Writer, k: int) -> Lanes:
    return w.e.widened(w.e.read_one(w.base("numbers"), k, F64))


def _word(w: Writer, k: int) -> Lanes:
    return w.e.read_one(w.base("whole"), k, I64)


def _bounds(w: Writer) -> None:
    """Least and greatest x, y and z, and 1 where all of them are numbers, else 0."""
    e = w.e
    rows = w.end - w.begin
    low, high = ([e.slot(F32, WIDTH) for _ in AXES] for _ in range(2))
    good = e.slot(I32, WIDTH)
    for k in range(3):
        e.put(low[k], e.constant(np.inf, F32))
        e.put(high[k], e.constant(-np.inf, F32))
    e.put(good, e.constant(1, I32))
    with e.loop(rows, WIDTH) as at:
        inside = at + e.iota() < rows
        for k, axis in enumerate(AXES):
            place = e.read(w.base(axis), at, F32)
            least, most = e.load(low[k], F32, WIDTH), e.load(high[k], F32, WIDTH)
            e.put(low[k], e.where(inside & (place < least), place, least))
            e.put(high[k], e.where(inside & (place > most), place, most))
            e.put(good, e.load(good, I32, WIDTH) & e.convert(~inside | np.isfinite(place), I32))
    for k in range(3):
        for part, slot, word in ((0, low[k], "fmin"), (3, high[k], "fmax")):
            bound = e.op(f"reduce.{word}", F32, e.load(slot, F32, WIDTH), lanes=1)
            e.put(e.address(w.base("bounds"), part + k, F64), e.convert(bound, F64))
    all_good = e.mask_bits(e.load(good, I32, WIDTH) != 0) == -1
    e.put(e.address(w.base("bounds"), 6, F64), e.convert(all_good, F64))


def _keys(w: Writer) -> None:
    """The number of each agent's cell, and how many agents of a part are in each cell, two places behind its own."""
    e = w.e
    low, inverse, most = ([_real(w, 3 * part + k) for k in range(3)] for part in range(3))
    number = [e.whole(each) for each in most]
    rows, own = w.end - w.begin, w.base("own")
    with e.loop(_word(w, _MANY) + 1, WIDTH) as at:  # there is room behind the last one
        e.write(own, at, e.constant(0, I32))
    with e.loop(rows, WIDTH) as offset:
        at = w.begin + offset
        cells = []
        for k, axis in enumerate(AXES):
            place = (e.convert(e.read(w.base(axis), at, F32), F64) - low[k]) * inverse[k]
            cells.append(e.whole(np.floor(e.between(place, e.constant(0.0, F64), most[k] - 1.0))))
        line = (cells[2] * number[1] + cells[1]) * number[0] + cells[0]
        e.write(w.base("keys"), at, line)
    with e.loop(rows) as offset:
        at = w.begin + offset
        key = e.convert(e.read_one(w.base("keys"), at, I32), I64)
        place = e.address(own, key + 2, I32)
        e.put(place, e.load(place, I32) + 1)


def _starts(w: Writer) -> None:
    """Where the agents of each part and cell begin, one place behind the cell's own: part after part in a cell."""
    e = w.e
    starts, before, parts, length = w.base("starts"), w.base("before"), _word(w, _BEFORE), _word(w, _LENGTH)
    total, next_one = e.slot(I32), e.slot(I32)
    e.put(total, e.constant(0, I32, 1))

    def add(slot: Number, place: Lanes) -> None:
        e.put(slot, e.load(slot, I32) + e.load(place, I32))

    def of(part: Lanes, at: Lanes, more: int) -> Lanes:
        return e.address(before, part * length + at + more, I32)

    with e.loop(_word(w, _MANY)) as at:
        place = e.address(starts, at, I32)
        add(total, place)
        with e.loop(parts) as part:
            add(total, of(part, at, 0))
        e.put(next_one, e.load(total, I32))
        with e.loop(parts) as part:
            e.put(of(part, at, 0), e.load(next_one, I32))
            add(next_one, of(part, at, 1))
        e.put(place, e.load(next_one, I32))


def _sort(w: Writer) -> None:
    """The agents of a part to their places."""
    e = w.e
    own = w.base("own")
    with e.loop(w.end - w.begin) as offset:
        at = w.begin + offset
        key = e.convert(e.read_one(w.base("keys"), at, I32), I64)
        cursor = e.address(own, key + 1, I32)
        small = e.load(cursor, I32)
        e.put(cursor, small + 1)
        values = [e.read_one(w.base(axis), at, F32) for axis in AXES]
        put_four(e, w.base("places"), small, e.together((*values, e.bits(e.convert(at, I32), F32)), 4))
        e.put(e.address(w.base("at"), at, I32), small)


def _columns(w: Writer) -> None:
    """Places in the order of the cells, one axis after the other."""
    e = w.e
    with e.loop(w.end - w.begin, WIDTH) as offset:  # there is room behind the last one
        at = w.begin + offset
        for axis, value in zip(AXES, quadruples_from(e, w.base("places"), at), strict=False):
            e.write(w.base(f"sorted {axis}"), at, value)


def _beside(w: Writer) -> None:
    """Four registers side by side, in the order of the cells. Who is in none is written behind the last one."""
    e = w.e
    rows = w.end - w.begin
    behind = e.convert(_word(w, 6), I32)
    with e.loop(rows, WIDTH) as offset:
        row = w.begin + offset
        at = e.read(w.base("at"), row, I32)
        inside = (offset + e.iota() < rows) & (at >= 0)
        at = e.where(inside, at, behind)
        put_quadruples(e, w.base("beside"), at, [e.read(w.base(str(k)), row, F32) for k in range(4)])
