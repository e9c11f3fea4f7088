"""What sorts agents into the cells of a grid, and lays what is asked of them in their order, as machine code.

Counting sort: number of each agent's cell and how many are in each, their sums from the first cell on, then each agent to its
place (D. E. Knuth, The Art of Computer Programming 3, 5.2). Each of several threads counts a part of the agents, and those of a
cell stand in the order of the parts: as if one had counted all."""

from __future__ import annotations

import numpy as np

from antdsl.machine_code.fours import FOUR, four_at, put_quadruples, quadruples_from
from antdsl.machine_code.lanes import BOOL, F32, F64, I32, I64, WIDTH, Lanes, Module
from antdsl.runtime.backends.native.block import Writer
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
        module.functions[name] = w.function(name)


def _real(w: Writer, k: int) -> Lanes:
    e = w.e
    return e.splat(e.load_one(w.base("numbers"), e.constant(k, I64, one=True), F64))


def _word(w: Writer, k: int) -> Lanes:
    return w.e.load_one(w.base("whole"), w.e.constant(k, I64, one=True), I64)


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
    """The number of each agent's cell, and how many agents of a part are in each cell, two places behind its own."""
    e = w.e
    low, inverse, most = ([_real(w, 3 * part + k) for k in range(3)] for part in range(3))
    number = [e.whole(each) for each in most]
    rows, own = e.op("sub i64 %end, %begin", I64, one=True), w.base("own")
    with e.loop(e.op(f"add i64 {_word(w, _MANY).name}, 1", I64, one=True), WIDTH) as at:  # there is room behind the last one
        e.store(own, at, e.constant(0, I32))
    with e.loop(rows, WIDTH) as offset:
        at = e.op(f"add i64 %begin, {offset.name}", I64, one=True)
        cells = []
        for k, axis in enumerate(AXES):
            place = (e.convert(e.load(w.base(axis), at, F32), F64) - low[k]) * inverse[k]
            cells.append(e.whole(np.floor(e.between(place, e.constant(0.0, F64), most[k] - 1.0))))
        line = e.multiplied(e.multiplied(cells[2], number[1]) + cells[1], number[0]) + cells[0]
        e.store(w.base("keys"), at, line)
    with e.loop(rows) as offset:
        at = e.op(f"add i64 %begin, {offset.name}", I64, one=True)
        key = e.convert(e.load_one(w.base("keys"), at, I32), I64)
        place = e.address(own, e.one(f"add i64 {key.name}, 2", I64), I32)
        e.put(place.name, e.one(f"add i32 {e.get(place.name, I32, one=True).name}, 1", I32))


def _starts(w: Writer) -> None:
    """Where the agents of each part and cell begin, one place behind the cell's own: part after part in a cell."""
    e = w.e
    starts, before, parts, length = w.base("starts"), w.base("before"), _word(w, _BEFORE), _word(w, _LENGTH)
    total, next_one = e.slot(I32, one=True), e.slot(I32, one=True)
    e.put(total, e.constant(0, I32, one=True))

    def add(slot: str, place: Lanes) -> None:
        e.put(slot, e.one(f"add i32 {e.get(slot, I32, one=True).name}, {e.get(place.name, I32, one=True).name}", I32))

    def of(part: Lanes, at: Lanes, more: int) -> Lanes:
        row = e.one(f"mul i64 {part.name}, {length.name}", I64)
        there = e.one(f"add i64 {row.name}, {at.name}", I64)
        return e.address(before, e.one(f"add i64 {there.name}, {more}", I64), I32)

    with e.loop(_word(w, _MANY)) as at:
        place = e.address(starts, at, I32)
        add(total, place)
        with e.loop(parts) as part:
            add(total, of(part, at, 0))
        e.put(next_one, e.get(total, I32, one=True))
        with e.loop(parts) as part:
            e.put(of(part, at, 0).name, e.get(next_one, I32, one=True))
            add(next_one, of(part, at, 1))
        e.put(place.name, e.get(next_one, I32, one=True))


def _sort(w: Writer) -> None:
    """The agents of a part to their places."""
    e = w.e
    rows, own = e.op("sub i64 %end, %begin", I64, one=True), w.base("own")
    with e.loop(rows) as offset:
        at = e.op(f"add i64 %begin, {offset.name}", I64, one=True)
        key = e.convert(e.load_one(w.base("keys"), at, I32), I64)
        cursor = e.address(own, e.one(f"add i64 {key.name}, 1", I64), I32)
        small = e.get(cursor.name, I32, one=True)
        e.put(cursor.name, e.one(f"add i32 {small.name}, 1", I32))
        four = f"{FOUR} poison"
        values = [e.load_one(w.base(axis), at, F32) for axis in AXES]
        for k, value in enumerate((*values, e.one(f"bitcast i32 {e.convert(at, I32).name} to float", F32))):
            four = e.op(f"insertelement {four}, {value.typed}, i64 {k}", F32).name
            four = f"{FOUR} {four}"
        e.do(f"store {four}, ptr {four_at(e, w.base('places'), small).name}, align 4")
        e.put(e.address(w.base("at"), at, I32).name, small)


def _columns(w: Writer) -> None:
    """Places in the order of the cells, one axis after the other."""
    e = w.e
    with e.loop(e.op("sub i64 %end, %begin", I64, one=True), WIDTH) as offset:  # there is room behind the last one
        at = e.op(f"add i64 %begin, {offset.name}", I64, one=True)
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
