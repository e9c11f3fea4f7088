"""What an agent can sense, as machine code: of the operations in `runtime.sensing` those that only read arrays. The others are
called between two stages."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from antdsl.machine_code.emitter import Emitter
from antdsl.machine_code.fours import quadruples
from antdsl.machine_code.lanes import BOOL, F32, F64, I8, I32, I64, PTR, WIDTH, Lanes
from antdsl.numerics import randomness
from antdsl.numerics.philox import UNIT
from antdsl.plan import ir
from antdsl.runtime.backends.native.block import Lower, Writer
from antdsl.runtime.backends.native.layout import KINDS
from antdsl.runtime.backends.native.scents import own_cell
from antdsl.runtime.moving.obstacle_clearance import may_touch
from antdsl.runtime.sensing import NO_HIT
from antdsl.runtime.world import AXES

_APART = 4  # of cells around one, which come in the order of their numbers, so many lie about within a line of memory


def _register(w: Any, node: ir.Node, args: tuple[Any, ...]) -> Lanes:
    """A register of the agent's own, at the start of the step or now."""
    found: Lanes = w.e.load(w.base("start" if node.op == "snap" else "now", node.attrs[0]), w.row, KINDS[node.kind])
    return found


def _id(w: Any, node: ir.Node, args: tuple[Any, ...]) -> Lanes:
    found: Lanes = w.e.load(w.base("ids"), w.row, I64)
    return found


def _age(w: Any, node: ir.Node, args: tuple[Any, ...]) -> Lanes:
    return _age_of(w, w.e.load(w.base("born"), w.row, I64))


def _age_of(w: Any, born: Lanes) -> Lanes:
    frames = w.number(I64, "frame") - born
    whole = w.e.convert(w.e.where(frames > 0, frames, w.e.constant(0, I64)), I32)  # a run has far fewer than 2**31 frames
    age: Lanes = w.e.convert(w.e.convert(whole, F64) * w.number(F64, "dt"), F32)
    return age


def _words(w: Any, site: str, block: int) -> list[Lanes]:
    """The four random words of a site for each id."""

    def make() -> list[Lanes]:
        e, out = w.e, w.e.slot(I64, count=4)
        shared = [
            w.number(I64, "philox", w.species, site, block, word, one=True) for word in ("first", "low", "last", "k0", "k1")
        ]
        ids = _id(w, None, ())  # type: ignore[arg-type]
        name = _philox(w)
        e.do(f"call void @{name}({ids.typed}, {', '.join(each.typed for each in shared)}, ptr {out})")
        found = []
        for k in range(4):
            place = e.op(f"getelementptr <{WIDTH} x i64>, ptr {out}, i64 {k}", PTR, one=True)
            found.append(e.op(f"load <{WIDTH} x i64>, ptr {place.name}", I64))
        return found

    words: list[Lanes] = w.e.once(("words", site, block), make)
    return words


def _philox(w: Writer) -> str:
    name = "philox"

    def make() -> str:
        e = Emitter(w.module)
        ids = Lanes(e, I64, "%ids")
        first, low, last, k0, k1 = (e.splat(Lanes(e, I64, f"%{n}", one=True)) for n in ("first", "low", "last", "k0", "k1"))
        words: Any = randomness.of_ids(ids, first, low, last, (k0, k1))
        for k, word in enumerate(words):
            place = e.op(f"getelementptr <{WIDTH} x i64>, ptr %out, i64 {k}", PTR, one=True)
            e.do(f"store {word.typed}, ptr {place.name}")
        body = "\n".join((*e.allocas, *e.entry, *e.lines))
        arguments = f"<{WIDTH} x i64> %ids, i64 %first, i64 %low, i64 %last, i64 %k0, i64 %k1, ptr %out"
        return f"define internal void @{name}({arguments}) noinline {{\nentry:\n{body}\n  ret void\n}}"

    w.module.function(name, make)
    return name


def _draw(w: Any, node: ir.Node, args: tuple[Any, ...]) -> Lanes:
    site, index = node.attrs
    word = _words(w, site, index >> 2)[index & 3]
    small: Lanes = w.e.convert(w.e.convert(word >> 8, I32), F32)  # 24 bits: as whole numbers of 32 bits they convert faster
    return small * UNIT


def _draw_agent(w: Any, node: ir.Node, args: tuple[Any, ...]) -> Lanes:
    site, species = node.attrs
    word = _words(w, site, 0)[0]
    count = w.number(I64, "agents", species)
    at = (word * count) >> 32
    found = w.e.gather(w.base("other", species, "sorted ids"), at, I64)
    none: Lanes = w.e.where(count == 0, w.e.constant(-1, I64), found)
    return none


def _event(w: Any, node: ir.Node, args: tuple[Any, ...]) -> Lanes:
    found: Lanes = w.e.load(w.base("event", node.attrs[0]), w.row, BOOL)
    return found


def _touching(w: Any, node: ir.Node, args: tuple[Any, ...]) -> Lanes:
    found: Lanes = w.e.load(w.base("mesh"), w.row, I64) == w.number(I64, "surface", node.attrs[0])
    return found


def _row_of(w: Any, species: str, ids: Lanes) -> Lanes:
    """Rows of ids; -1 for none and for the dead: by bisection of the sorted ones, all lanes at once."""
    e: Emitter = w.e

    def make() -> Lanes:
        known, order = w.base("other", species, "sorted ids"), w.base("other", species, "rows of sorted ids")
        count = w.number(I64, "agents", species)
        at, step = e.slot(I64), e.slot(I64, one=True)
        e.do(f"store <{WIDTH} x i64> zeroinitializer, ptr {at}")
        first = w.number(I64, "half", species, one=True)
        e.do(f"store i64 {first.name}, ptr {step}")
        turns = w.number(I64, "turns", species, one=True)
        with e.loop(turns):
            size = e.op(f"load i64, ptr {step}", I64, one=True)
            place = e.op(f"load <{WIDTH} x i64>, ptr {at}", I64)
            ahead = place + e.splat(size)
            inside = ahead < count
            probe = e.gather(known, e.where(inside, ahead, e.constant(0, I64)), I64)
            moved = e.where(inside & (probe <= ids), ahead, place)
            e.do(f"store {moved.typed}, ptr {at}")
            half = e.op(f"lshr i64 {size.name}, 1", I64, one=True)
            e.do(f"store {half.typed}, ptr {step}")
        place = e.op(f"load <{WIDTH} x i64>, ptr {at}", I64)
        there = (e.gather(known, place, I64) == ids) & (count > 0)
        return e.where(there, e.gather(order, place, I64), e.constant(-1, I64))

    found: Lanes = e.once(("row of", species, ids.name), make)
    return found


def _agent_get(w: Any, node: ir.Node, args: tuple[Any, ...]) -> Lanes:
    species, register = node.attrs
    row = _row_of(w, species, args[0])
    kind, there = KINDS[node.kind], row >= 0
    value = w.e.gather(w.base("other", species, register), w.e.where(there, row, w.e.constant(0, I64)), kind)
    found: Lanes = w.e.where(there, value, w.e.constant(0, kind))
    return found


def _agent_age(w: Any, node: ir.Node, args: tuple[Any, ...]) -> Lanes:
    row = _row_of(w, node.attrs[0], args[0])
    there = row >= 0
    born = w.e.gather(w.base("other", node.attrs[0], "frame of birth"), w.e.where(there, row, w.e.constant(0, I64)), I64)
    found: Lanes = w.e.where(there, _age_of(w, born), w.e.constant(0.0, F32))
    return found


def _agent_alive(w: Any, node: ir.Node, args: tuple[Any, ...]) -> Lanes:
    return _row_of(w, node.attrs[0], args[0]) >= 0


def _item_there(w: Any, items: str, item: Lanes) -> Lanes:
    there: Lanes = (item >= 0) & (item < w.number(I32, "items", items))
    return there


def _item_get(w: Any, node: ir.Node, args: tuple[Any, ...]) -> Lanes:
    items, attribute = node.attrs
    there = _item_there(w, items, args[0])
    value = w.e.gather(w.base("item", items, attribute), w.e.where(there, args[0], w.e.constant(0, I32)), F32)
    found: Lanes = w.e.where(there, value, w.e.constant(0.0, F32))
    return found


def _item_alive(w: Any, node: ir.Node, args: tuple[Any, ...]) -> Lanes:
    return _item_there(w, node.attrs[0], args[0])


def _field_value(w: Any, node: ir.Node, args: tuple[Any, ...]) -> Lanes:
    held = w.e.gather(w.base("field", node.attrs[0], "held"), own_cell(w, node.attrs[0]), F64)
    found: Lanes = w.e.convert(held, F32)
    return found


def _cells_ahead(w: Any, field: str, eights: int) -> Lanes:
    """The cells of eight agents who come so many turns later; those of now at the end."""
    e: Emitter = w.e
    later = e.one(f"add i64 {w.row.name}, {WIDTH * eights}", I64)
    more = e.one(f"icmp slt i64 {later.name}, %end", BOOL)
    return e.load(w.base("cell", field), e.one(f"select i1 {more.name}, {later.typed}, {w.row.typed}", I64), I32)


def _fetch(e: Emitter, array: Lanes, at: Lanes, size: int) -> None:
    """Have so many bytes of an array from an index on brought into the cache; it may be any."""
    place = e.address(array, e.one(f"mul i64 {e.convert(at, I64).name}, {size}", I64), I8)
    e.fetch(place.name)


def fetch_ahead(w: Any, field: str, array: Lanes, size: int, eights: int = 1) -> None:
    """Have what an array holds of the cells of agents who come later, so many bytes of each, brought into the cache."""
    e: Emitter = w.e
    cells = _cells_ahead(w, field, eights)
    for lane in range(WIDTH):
        _fetch(e, array, e.one(f"extractelement {cells.typed}, i64 {lane}", I32), size)


def _fetch_around(w: Any, field: str, held: Lanes, places: Lanes, block: Lanes, count: int) -> None:
    """Have what lies in the cells around the next eight agents brought into the cache, and which they are of those after them."""
    e: Emitter = w.e
    fetch_ahead(w, field, block, 4 * count, 2)
    cells = _cells_ahead(w, field, 1)
    known = e.where((cells >= 0) & (cells < w.number(I32, "cells", field)), cells, e.constant(0, I32))
    for lane in range(WIDTH):
        cell = e.convert(e.one(f"extractelement {known.typed}, i64 {lane}", I32), I64)
        around = e.address(block, e.one(f"mul i64 {cell.name}, {count}", I64), I32)
        for k in range(0, count, _APART):
            there = e.load_one(around, e.constant(k, I64, one=True), I32)
            _fetch(e, held, there, 8)
            _fetch(e, places, there, 16)


def _first_most(e: Emitter, held: Lanes, cells: Lanes, count: int, own: Lanes) -> tuple[Lanes, Lanes]:
    """The greatest of the amounts in so many cells of a list, and the first cell that has it; 0 and the own cell where none is
    above 0. What is no number counts as 0."""
    none = e.constant(0.0, F64)
    eights = []
    for first in range(0, count, WIDTH):
        value = none.typed
        for k in range(first, min(first + WIDTH, count)):
            cell = e.load_one(cells, e.constant(k, I64, one=True), I32)
            amount = e.load_one(held, e.convert(cell, I64), F64)
            value = e.op(f"insertelement {value}, {amount.typed}, i64 {k - first}", F64).typed
        amounts = Lanes(e, F64, value.removeprefix(f"<{WIDTH} x {F64}> "))
        eights.append(e.where(amounts > none, amounts, none))
    most = eights[0]
    for each in eights[1:]:
        most = e.where(each > most, each, most)
    for half in (4, 2, 1):
        order = ", ".join(f"i32 {(k + half) % WIDTH}" for k in range(WIDTH))
        other = e.op(f"shufflevector {most.typed}, {most.type} poison, <{WIDTH} x i32> <{order}>", F64)
        most = e.where(other > most, other, most)
    where = e.constant(1 << count, I64, one=True)  # there is one that is the greatest
    for first, each in enumerate(eights):
        bits = e.one(f"zext i8 {e.mask_bits(each == most).name} to i64", I64)
        where = e.one(f"or i64 {where.name}, {e.one(f'shl i64 {bits.name}, {WIDTH * first}', I64).name}", I64)
    e.module.declare("llvm.cttz.i64", I64, [I64, BOOL])
    at = e.load_one(cells, e.one(f"call i64 @llvm.cttz.i64(i64 {where.name}, i1 true)", I64), I32)
    best = e.one(f"extractelement {most.typed}, i64 0", F64)
    more = e.one(f"fcmp ogt {best.typed}, 0.0", BOOL)
    return best, e.one(f"select i1 {more.name}, {at.typed}, {own.typed}", I32)


def _field_strongest(w: Any, node: ir.Node, args: tuple[Any, ...]) -> Any:
    e: Emitter = w.e
    field, count = node.attrs
    held, block, own = w.base("field", field, "held"), w.base("field", field, "block", int(count)), own_cell(w, field)
    places = w.base("field", field, "places")
    there = own < w.number(I32, "cells", field)
    most, where, whose = e.slot(F64), e.slot(I32), e.slot(I32)
    e.put(most, e.constant(0.0, F64))
    e.put(where, own)
    e.put(whose, e.where(there, own, e.constant(0, I32)))
    asks = e.one(f"zext i8 {e.mask_bits(w.mask[-1] & there).name} to i64", I64)
    with e.inside(e.one(f"icmp ne i64 {asks.name}, 0", BOOL)):
        _fetch_around(w, field, held, places, block, int(count))
    with e.loop(e.constant(WIDTH, I64, one=True)) as lane:  # cells of one agent lie side by side
        bit = e.one(f"lshr i64 {asks.name}, {lane.name}", I64)
        with e.inside(e.one(f"trunc i64 {bit.name} to i1", BOOL)):
            mine = e.load_one(Lanes(e, PTR, whose, one=True), lane, I32)
            start = e.one(f"mul i64 {e.convert(mine, I64).name}, {int(count)}", I64)
            best, at = _first_most(e, held, e.address(block, start, I32), int(count), mine)
            e.put(e.address(Lanes(e, PTR, most, one=True), lane, F64).name, best)
            e.put(e.address(Lanes(e, PTR, where, one=True), lane, I32).name, at)
    value, cell = e.get(most, F64), e.get(where, I32)
    small = e.convert(value, F32)
    nothing = ~(small > 0)
    parts = [small]
    for axis, there in zip(AXES, quadruples(e, places, cell), strict=False):
        mine = e.load(w.base("start", f"position.{axis}"), w.row, F32)
        parts.append(e.where(nothing, mine, there))
    return tuple(parts)


def _clip_value(w: Any, node: ir.Node, args: tuple[Any, ...]) -> Lanes:
    """From the table of the species' clips, where the last place is that of unknown ones."""
    e: Emitter = w.e
    last = e.constant(len(w.code.species.clips), I32)
    number = e.where((args[0] >= 0) & (args[0] < last), args[0], last)
    found: Lanes = e.gather(w.base("clip", node.attrs[0]), number, F32)
    return found


NATIVE: Mapping[str, Lower] = {
    "snap": _register,
    "load": _register,
    "id": _id,
    "age": _age,
    "draw": _draw,
    "draw.agent": _draw_agent,
    "event": _event,
    "surface.touching": _touching,
    "agent.get": _agent_get,
    "agent.age": _agent_age,
    "agent.alive": _agent_alive,
    "item.get": _item_get,
    "item.alive": _item_alive,
    "field.value": _field_value,
    "field.strongest": _field_strongest,
    "clip.value": _clip_value,
}


def _may_hit(w: Any, node: ir.Node, args: tuple[Any, ...]) -> Lanes:
    """Who may meet the obstacle with a ray."""
    reach = args[3]
    clear = w.e.load(w.base("clear", node.attrs[0]), w.row, F32)
    found: Lanes = (reach > 0) & (reach < np.inf) & may_touch(clear, reach)
    return found


# Of what is called: who needs the call at all, and what the others get.
GUARDS: Mapping[str, tuple[Lower, tuple[Any, ...]]] = {"ray": (_may_hit, NO_HIT)}
ON_MOVING_GROUND = frozenset(("field.strongest",))  # there its places turn with the ground: it is called
OF_PAIRS = frozenset(("agent.get", "agent.age", "agent.alive", "item.get", "item.alive"))  # may hang on the other one of a pair
