"""Reductions over neighbours as machine code: one search of the cell grid for all that is asked of one species.

For eight asking agents at a time the cells in reach are worked out side by side; candidates in them are measured, eight at a time,
and those near enough written down as pairs of a place in the grid and an asking agent. Then eight pairs of any of the eight agents
are tested, weighed and added to the sums of their agents. Who has very many neighbours is left to `crowds`.

Reductions of several regions are found in one search where what they need is known: the first region that asks has it made for its
agents, those after it only for agents that have not asked yet. What nobody asks for then is found in vain, and not seen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from antdsl import limits
from antdsl.plan import ir
from antdsl.plan.traverse import needed
from antdsl.runtime.backends.compile import Instruction
from antdsl.runtime.backends.native.block import BlockWriter, Near, Writer
from antdsl.runtime.backends.native.lanes import BOOL, F32, F64, I8, I32, I64, PTR, WIDTH, Emitter, Lanes, Module
from antdsl.runtime.backends.native.layout import KINDS
from antdsl.runtime.backends.native.schedule import operands_of
from antdsl.runtime.backends.native.sets import PairValues, Sums, own_values, sets_of, tested
from antdsl.runtime.pairs import nearest_asked
from antdsl.runtime.world import AXES

SLACK, INWARD, BEYOND = 1.0 + 1e-6, 1.0 - 1e-6, 1.0 + 1e-5  # as in `senses.neighbours_compiled`
STRIDE = 64  # bytes from one operand or result of a search to the next
MOST = 512  # candidates of one agent that are gone through here
_LANE = 28  # bits of a place in the grid in what is written down; above them stands which of the eight asks


@dataclass(slots=True, eq=False)
class Group:
    """Reductions found in one search. `own` is the address of the area of operands, `out` that of results; `done` of the mask of
    those who have them already."""

    number: int
    instructions: list[Instruction]
    own: str
    out: str
    done: str
    near: Search


@dataclass(slots=True, eq=False)
class Search:
    """What the functions of a search are written from: places of operands and results in their areas."""

    name: str
    number: int
    other: str
    nodes: list[ir.Node]
    kinds: list[str] = field(default_factory=list)  # of the operands
    reach: dict[ir.Node, int] = field(default_factory=dict)
    view: dict[ir.Node, int] = field(default_factory=dict)
    places: dict[ir.Node, int] = field(default_factory=dict)
    stops: dict[ir.Node, int] = field(default_factory=dict)  # sets of which too many are told, and where among the results
    beside: list[str] = field(default_factory=list)  # others' registers that are laid side by side, four and four


def neighbours(b: BlockWriter, instruction: Instruction) -> None:
    """Emit a reduction over neighbours, with all others that can be found together with it."""
    e, group = b.e, _group_of(b, instruction)
    shared = any(each.scope is not instruction.scope for each in group.instructions)
    mask = b.mask[-1]
    if not shared:
        _made(b, group, e.mask_bits(mask))
    else:
        done = e.get(group.done, I8, one=True)
        asking = e.mask_bits(mask)
        missing = e.one(f"and i8 {asking.name}, {e.one(f'xor i8 {done.name}, -1', I8).name}", I8)
        with e.inside(e.one(f"icmp ne i8 {missing.name}, 0", BOOL)):
            _made(b, group, missing)
            e.put(group.done, e.one(f"or i8 {done.name}, {missing.name}", I8))
    for k, each in enumerate(group.instructions):
        if each.scope is instruction.scope and not any(each.out in names for names in e.known):
            kind = KINDS[group.near.nodes[k].kind]
            place = e.field(group.out, STRIDE * k)
            b.known(each.out, e.get(place, I8) != 0 if kind == BOOL else e.get(place, kind))
    for chosen, k in group.near.stops.items():
        if any(each.scope is instruction.scope and each.what.args[0] is chosen for each in group.instructions):  # type: ignore[union-attr]
            crowd = (e.get(e.field(group.out, STRIDE * k), I8) != 0) & mask
            with e.inside(e.some(crowd)):
                e.do(f"store i64 1, ptr {b.base('crowded').name}")


def _group_of(b: BlockWriter, first: Instruction) -> Group:
    if first in b.groups:
        found: Group = b.groups[first]
        return found
    together = [first, *(each for each in b.waiting(first) if each not in b.groups)]
    number = len(b.code.near)
    name = f"near.{b.species}.{b.compiler.name}.{number}"
    nodes = [each.what for each in together if isinstance(each.what, ir.Node)]
    near = Search(name, number, nodes[0].args[0].attrs[0], nodes)
    operands = 0
    for instruction in together:
        operands += len(operands_of(instruction)) + 4
    e = b.e
    results = 2 * len(nodes)
    group = Group(number, together, e.slot(I64, count=operands), e.slot(I64, count=results), e.slot(I8, one=True), near)
    b.at_top.append(lambda: e.do(f"store i8 0, ptr {group.done}"))
    for each in together:
        b.groups[each] = group
    return group


def _made(b: BlockWriter, group: Group, asking: Lanes) -> None:
    """Store the operands and call the search for some of eight agents. Its functions are written at the first call."""
    e, near = b.e, group.near
    fresh = not near.kinds
    by_scope: dict[int, list[Instruction]] = {}
    for each in group.instructions:
        by_scope.setdefault(id(each.scope), []).append(each)
    values: list[Lanes] = []

    def put(value: Lanes) -> int:
        values.append(value)
        return len(values) - 1

    reach: dict[ir.Node, int] = {}
    view: dict[ir.Node, int] = {}
    places: dict[ir.Node, int] = {}
    for some in by_scope.values():
        for chosen, slots in sets_of(some).items():
            if chosen not in reach:
                reach[chosen] = put(b.slot(slots[0]))
                if not chosen.attrs[1]:
                    view[chosen] = put(b.slot(slots[1]))
        for node, make in own_values(b, some).items():
            if node not in places:
                places[node] = put(make())
    if fresh:
        near.kinds, near.reach, near.view, near.places = [value.kind for value in values], reach, view, places
        plan = b.code.species
        stops = [chosen for chosen in near.reach if nearest_asked(plan, chosen) is None]
        near.stops = {chosen: len(near.nodes) + k for k, chosen in enumerate(stops)}
        read = needed(arg for node in near.nodes for arg in node.args[1:])
        names = sorted({each.attrs[0] for each in read if each.op == "other" and each.kind is ir.Kind.F32})
        near.beside = names if len(names) > 1 else []
        b.code.near.append(Near(near.other, list(near.reach)))
    for k, value in enumerate(values):
        e.put(e.field(group.own, STRIDE * k), e.convert(value, I8) if value.kind == BOOL else value)
    if fresh:
        _write(b, near)
    e.do(f"call void @{near.name}(ptr %t, i64 {b.row.name}, i8 {asking.name}, ptr {group.own}, ptr {group.out})")


# --- eight agents side by side ---------------------------------------------------------------------------------------


class Cells:
    """The cell grid of a search, as lanes of values that are the same for all."""

    def __init__(self, w: Writer, number: int) -> None:
        e = w.e
        floats, whole = w.base("grid", number, "floats"), w.base("grid", number, "whole")

        def read(base: Lanes, k: int, kind: str) -> Lanes:
            return e.load_one(base, e.constant(k, I64, one=True), kind)

        self.w, self.number = w, number
        self.low = [e.splat(read(floats, k, F64)) for k in range(3)]
        self.width = [e.splat(read(floats, 3 + k, F64)) for k in range(3)]
        self.inverse = [e.splat(read(floats, 6 + k, F64)) for k in range(3)]
        self.axes = [read(whole, k, I64) for k in range(3)]
        self.size = [e.splat(read(whole, 3 + k, I64)) for k in range(3)]
        self.most = [e.convert(e.convert(size, I32), F64) for size in self.size]
        self.flat = e.splat(e.one(f"icmp eq i64 {read(whole, 5, I64).name}, 1", BOOL))
        self.count = read(whole, 6, I64)

    def span(self, axis: int, q: Lanes, half: Lanes) -> tuple[Lanes, Lanes]:
        """First and last cell along an axis that [q - half, q + half] meets, i32; the last is below the first where none."""
        e = self.w.e
        most = self.most[axis]
        first = e.between((q - half - self.low[axis]) * self.inverse[axis], e.constant(0.0, F64), most)
        last = e.between((q + half - self.low[axis]) * self.inverse[axis], e.constant(-1.0, F64), most - 1.0)
        return e.whole(np.floor(first)), e.whole(np.floor(last))

    def off(self, axis: int, q: Lanes, cell: Lanes) -> Lanes:
        """Least distance along an axis from q to a cell, squared, rounded down."""
        e = self.w.e
        edge = self.low[axis] + e.convert(cell, F64) * self.width[axis]
        before, behind = edge - q, q - (edge + self.width[axis])
        gap = e.where(before > behind, before, behind)
        gap = e.where(gap > 0.0, gap, 0.0) * INWARD
        square: Lanes = gap * gap
        return square

    def between(self, z: Lanes, y: Lanes, first: Lanes, last: Lanes, within: Lanes) -> tuple[Lanes, Lanes]:
        """Place in the grid's order of the first agent of a row of cells from one cell to another, and how many there are, i32;
        0 and 0 where a condition does not hold."""
        w, e = self.w, self.w.e
        starts, keys = w.base("grid", self.number, "starts"), w.base("grid", self.number, "keys")
        begin, end = e.slot(I32), e.slot(I32)
        none = e.constant(0, I32)
        with e.inside(e.one(f"icmp ne ptr {starts.name}, null", BOOL)):  # so few cells that 32 bits hold their numbers
            fast, middle = (e.convert(self.size[k], I32) for k in (0, 1))
            line = e.multiplied(e.multiplied(z, middle) + y, fast)
            e.put(begin, e.gather(starts, e.where(within, line + first, none), I32))
            e.put(end, e.gather(starts, e.where(within, line + last + 1, none), I32))
        with e.inside(e.one(f"icmp eq ptr {starts.name}, null", BOOL)):
            wide = [e.convert(each, I64) for each in (z, y, first, last)]
            line = e.multiplied(e.multiplied(wide[0], self.size[1]) + wide[1], self.size[0])
            name, lanes = self._bisection(), f"<{WIDTH} x i64>"
            for slot, key in ((begin, line + wide[2]), (end, line + wide[3] + 1)):
                text = f"call {lanes} @{name}(ptr {keys.name}, i64 {self.count.name}, {key.typed})"
                e.put(slot, e.convert(e.op(text, I64), I32))
        start = e.get(begin, I32)
        return start, e.where(within, e.get(end, I32) - start, none)

    def _bisection(self) -> str:
        """A function that finds how many of the sorted keys are below each of eight, i64."""
        name = "grid.before"

        def make() -> str:
            f = Emitter(self.w.module)
            sorted_keys, key = Lanes(f, PTR, "%keys", one=True), Lanes(f, I64, "%key")
            low, high = f.slot(I64), f.slot(I64)
            f.put(low, f.constant(0, I64))
            f.put(high, f.splat(Lanes(f, I64, "%count", one=True)))
            with f.loop(f.constant(32, I64, one=True)):
                a, b = f.get(low, I64), f.get(high, I64)
                middle, more = (a + b) >> 1, a < b
                probe = f.gather(sorted_keys, f.where(more, middle, f.constant(0, I64)), I64)
                less = more & (probe < key)
                f.put(low, f.where(less, middle + 1, a))
                f.put(high, f.where(more & ~less, middle, b))
            value = f.get(low, I64)
            body, lanes = "\n".join((*f.allocas, *f.entry, *f.lines)), f"<{WIDTH} x i64>"
            head = f"define internal {lanes} @{name}(ptr %keys, i64 %count, {lanes} %key) noinline"
            return f"{head} {{\nentry:\n{body}\n  ret {value.typed}\n}}"

        self.w.module.function(name, make)
        return name


def _write(b: BlockWriter, near: Search) -> None:
    """The function of a search for eight agents, and that for one with very many neighbours."""
    from antdsl.runtime.backends.native.crowds import write_many

    w = Writer(b.module, b.layout)
    e = w.e
    row = Lanes(e, I64, "%row", one=True)
    asks = e.of_bits(Lanes(e, I8, "%mask", one=True))

    def mine(k: int) -> Lanes:
        place, kind = e.field("%own", STRIDE * k), near.kinds[k]
        return e.get(place, I8) != 0 if kind == BOOL else e.get(place, kind)

    place = [e.load(w.base("start", f"position.{axis}"), row, F32) for axis in AXES]
    radius = {chosen: mine(k) for chosen, k in near.reach.items()}
    search = Rows(w, near.number, place, list(radius.values()), asks)
    search.note(w, near)
    buffer, count, over = _candidates(w, near, search, asks)
    heading = [e.load(w.base("start", f"heading.{axis}"), row, F32) for axis in AXES] if near.view else []
    sums = Sums(e, near.nodes)
    with e.loop(count, WIDTH) as index:
        there = (e.splat(index) + e.iota()) < e.splat(count)
        packed = e.where(there, e.load(buffer, index, I32), e.constant(0, I32))
        lane, at = packed >> _LANE, packed & ((1 << _LANE) - 1)
        found = measured(w, near, at, [e.permuted(each, lane) for each in place], there)
        if near.other == b.species:
            found.there = there & (found.rows != lane + e.splat(e.convert(row, I32)))

        def inside(chosen: ir.Node) -> Lanes:
            reached = found.there & (found.distance <= e.permuted(radius[chosen], lane))
            if chosen in near.view:
                hx, hy, hz = (e.once(("heading", k), lambda each=each: e.permuted(each, lane)) for k, each in enumerate(heading))  # type: ignore[misc]
                ahead = e.once("ahead", lambda: (found.dx * hx + found.dy * hy) + found.dz * hz)
                reached = reached & (ahead >= e.permuted(mine(near.view[chosen]), lane) * found.distance)
            return reached

        pairs = PairValues(w, lambda node: e.permuted(mine(near.places[node]), lane), found.leaf, b.senses)
        terms = []
        for sum_, node in zip(sums.all, near.nodes, strict=True):
            reached = e.once(("near", node.args[0]), lambda chosen=node.args[0]: inside(chosen))  # type: ignore[misc]
            terms.append(sum_.terms(*tested(node, pairs, reached), found.ids() if node.op == "reduce.agent" else None))
        sums.scatter(lane, terms)
    fits = asks & ~over
    for k, (value, node) in enumerate(zip(sums.results(), near.nodes, strict=True)):
        stored = e.convert(value, I8) if KINDS[node.kind] == BOOL else value
        start = e.field("%out", STRIDE * k)
        e.put(start, e.where(fits, stored, e.get(start, stored.kind)))
    for k in near.stops.values():
        start = e.field("%out", STRIDE * k)
        e.put(start, e.where(fits, e.constant(0, I8), e.get(start, I8)))
    with e.inside(e.some(over)):
        bits = e.one(f"zext i8 {e.mask_bits(over).name} to i64", I64)
        e.do(f"call void @{near.name}.many(ptr %t, i64 %row, i64 {bits.name}, ptr %own, ptr %out)")
    b.module.functions[near.name] = w.function(near.name, ", i64 %row, i8 %mask, ptr %own, ptr %out").replace(
        "define void", "define internal void"
    )
    write_many(b, near)


def _candidates(w: Writer, near: Search, search: Rows, asks: Lanes) -> tuple[Lanes, Lanes, Lanes]:
    """Write down who may be in the widest radius of each of eight agents. Gives where, how many, and agents with too many
    candidates, or perhaps more neighbours than the cap."""
    e = w.e
    buffer, zero = w.base("candidates"), e.constant(0, I64, one=True)
    total, seen, found, first, number, beyond = e.slot(I64, one=True), *(e.slot(kind) for kind in (I32, I32, I32, I32, F32))
    e.put(total, zero)
    for slot in (seen, found):
        e.put(slot, e.constant(0, I32))
    e.put(beyond, (search.widest * search.widest) * np.float32(BEYOND) + np.float32(1e-30))
    sx, sy, sz = (w.base("grid", near.number, axis) for axis in AXES)

    def each_of(slot: str, kind: str, lane: Lanes) -> Lanes:
        return e.load_one(Lanes(e, PTR, slot, one=True), lane, kind)

    def through(begin: Lanes, count: Lanes) -> None:
        sums = e.get(seen, I32) + count
        e.put(seen, sums)
        e.put(first, begin)
        e.put(number, e.where(sums <= MOST, count, e.constant(0, I32)))
        with e.loop(e.constant(WIDTH, I64, one=True)) as lane:
            many = e.convert(each_of(number, I32, lane), I64)
            with e.inside(e.one(f"icmp sgt i64 {many.name}, 0", BOOL)):
                start = e.convert(each_of(first, I32, lane), I64)
                x, y, z = (e.splat(each_of(e.field(search.stack, 32 * k), F32, lane)) for k in range(3))
                limit = e.splat(each_of(beyond, F32, lane))
                shifted = e.one(f"shl i64 {lane.name}, {_LANE}", I64)
                old = e.get(total, I64, one=True)
                with e.loop(many, WIDTH) as k:
                    at = e.one(f"add i64 {start.name}, {k.name}", I64)
                    dx, dy, dz = e.load(sx, at, F32) - x, e.load(sy, at, F32) - y, e.load(sz, at, F32) - z
                    inside = ((dx * dx + dy * dy) + dz * dz) <= limit
                    left = e.convert(e.one(f"sub i64 {many.name}, {k.name}", I64), I32)
                    inside = inside & (e.convert(e.iota(), I32) < e.splat(left))
                    write_down(e, buffer, total, e.convert(e.one(f"or i64 {at.name}, {shifted.name}", I64), I32), inside)
                new = e.convert(e.one(f"sub i64 {e.get(total, I64, one=True).name}, {old.name}", I64), I32)
                more = e.one(f"add i32 {each_of(found, I32, lane).name}, {new.name}", I32)
                e.put(e.address(Lanes(e, PTR, found, one=True), lane, I32).name, more)

    search.each(through)
    over = asks & ((e.get(seen, I32) > MOST) | (e.get(found, I32) > limits.NEIGHBOURS))
    count = e.get(total, I64, one=True)
    return buffer, count, over


class Rows:
    """Rows of cells in reach of eight places, within the widest of some radii of each."""

    def __init__(self, w: Writer, number: int, place: list[Lanes], radii: list[Lanes], asks: Lanes) -> None:
        e = self.e = w.e
        self.cells = cells = Cells(w, number)
        widest = radii[0]
        for each in radii[1:]:
            widest = np.fmax(widest, each)
        usable = asks & (widest >= np.float32(0))
        for each in place:
            usable = usable & np.isfinite(each)
        self.widest, self.usable = widest, usable
        self.stack = stack = e.slot(F32, count=3)
        for k, each in enumerate(place):
            e.put(e.field(stack, 32 * k), each)
        along = []
        for k, axis in enumerate(cells.axes):
            at = e.one(f"getelementptr <{WIDTH} x float>, ptr {stack}, i64 {axis.name}", PTR)
            along.append(e.where(usable, e.convert(e.get(at.name, F32), F64), cells.low[k]))
        largest = np.maximum(np.maximum(np.abs(along[0]), np.abs(along[1])), np.abs(along[2]))
        self.along, self.tiny = along, largest * 1e-14 + 1e-18
        r = e.where(usable, e.convert(widest, F64), e.constant(0.0, F64)) * SLACK + self.tiny
        self.square = r * r
        self.b0, self.b1 = cells.span(1, along[1], r)
        c0, c1 = cells.span(2, along[2], r)
        self.sheet = cells.flat & (np.abs(along[2] - cells.low[2]) <= cells.width[2])
        self.c0, self.c1 = (e.where(self.sheet, e.constant(0, I32), c) for c in (c0, c1))

    def note(self, w: Writer, near: Search) -> None:
        """Remember the greatest radius that was asked for: the next step's cells suit it."""
        e, place, zero = self.e, w.base("grid", near.number, "widest"), w.e.constant(0, I64, one=True)
        widest = e.where(self.usable & np.isfinite(self.widest), self.widest, e.constant(0.0, F32))
        e.store(place, zero, np.fmax(e.load(place, zero, F32), widest))

    def each(self, do: Callable[[Lanes, Lanes], None]) -> None:
        """Emit `do` for each row of cells: where its agents begin in the grid's order, and how many may be in reach, i32."""
        e, cells, nothing = self.e, self.cells, self.e.constant(0, I32)
        deep, tall = (
            e.convert(e.greatest(e.where(self.usable, z - a, nothing) + 1), I64)
            for a, z in ((self.c0, self.c1), (self.b0, self.b1))
        )
        with e.loop(deep) as j:
            cz = self.c0 + e.convert(e.splat(j), I32)
            far = e.where(self.sheet, e.constant(0.0, F64), cells.off(2, self.along[2], cz))
            with e.loop(tall) as i:
                cy = self.b0 + e.convert(e.splat(i), I32)
                left = (self.square - cells.off(1, self.along[1], cy)) - far
                half = np.sqrt(e.where(left > 0.0, left, 0.0)) * SLACK + self.tiny
                a0, a1 = cells.span(0, self.along[0], half)
                within = self.usable & (cy <= self.b1) & (cz <= self.c1) & (left >= 0.0) & (a0 <= a1)
                do(*cells.between(cz, cy, a0, a1, within))


def write_down(e: Emitter, buffer: Lanes, total: str, at: Lanes, inside: Lanes) -> None:
    """Append those of eight numbers from `at` (i32) on for which a condition holds. All are written, and written over where they
    are not to stay: there is no branch that is hard to foretell."""
    bits = e.one(f"zext i8 {e.mask_bits(inside).name} to i64", I64)
    count = e.get(total, I64, one=True)
    numbers = e.splat(at) + e.convert(e.iota(), I32)
    place = e.address(buffer, count, I32).name
    if e.module.avx2:
        order = e.load(e.address(Lanes(e, PTR, _orders(e.module), one=True), e.one(f"shl i64 {bits.name}, 3", I64), I8), zero_of(e), I8)
        packed = e.permuted(numbers, e.op(f"zext {order.typed} to <{WIDTH} x i32>", I32))
        e.do(f"store {packed.typed}, ptr {place}, align 4")
        e.module.declare("llvm.ctpop.i64", I64, [I64])
        e.put(total, e.one(f"add i64 {count.name}, {e.one(f'call i64 @llvm.ctpop.i64(i64 {bits.name})', I64).name}", I64))
        return
    for k in range(WIDTH):
        e.put(e.address(buffer, count, I32).name, e.one(f"add i32 {at.name}, {k}", I32))
        shifted = e.one(f"lshr i64 {bits.name}, {k}", I64) if k else bits
        count = e.one(f"add i64 {count.name}, {e.one(f'and i64 {shifted.name}, 1', I64).name}", I64)
    e.put(total, count)


def zero_of(e: Emitter) -> Lanes:
    return e.constant(0, I64, one=True)


def _orders(module: Module) -> str:
    """A table of bytes: for each of the 256 sets of eight lanes, its lanes first."""
    name = "lanes.first"

    def make() -> str:
        rows = [[k for k in range(WIDTH) if bits >> k & 1] for bits in range(256)]
        flat = [f"i8 {k}" for row in rows for k in (*row, *(0,) * (WIDTH - len(row)))]
        return f"@{name} = internal constant [{len(flat)} x i8] [{', '.join(flat)}]"

    module.function(name, make)
    return f"@{name}"


# --- a pair ----------------------------------------------------------------------------------------------------------


@dataclass(slots=True, eq=False)
class Found:
    """Eight pairs: which are there at all, others' rows, other minus own, and its length."""

    w: Writer
    near: Search
    there: Lanes
    rows: Lanes
    dx: Lanes
    dy: Lanes
    dz: Lanes
    distance: Lanes

    def ids(self) -> Lanes:
        def make() -> Lanes:
            return self.w.e.gather(self.w.base("other", self.near.other, "ids"), self.rows, I64)

        found: Lanes = self.w.e.once(("ids", self.rows.name), make)
        return found

    def leaf(self, node: ir.Node) -> Lanes:
        named = {"pair.x": self.dx, "pair.y": self.dy, "pair.z": self.dz, "pair.distance": self.distance}
        if node.op in named:
            return named[node.op]
        if node.op == "other.id":
            return self.ids()
        beside = self.near.beside
        if node.attrs[0] in beside:
            block, part = divmod(beside.index(node.attrs[0]), 4)
            names = tuple(beside[4 * block : 4 * block + 4])
            base = self.w.base("beside", self.near.other, *names)
            found: Lanes = self.w.e.once(("beside", block, self.rows.name), lambda: self.w.e.quadruples(base, self.rows))[part]
            return found
        return self.w.e.gather(self.w.base("other", self.near.other, node.attrs[0]), self.rows, KINDS[node.kind])


def measured(w: Writer, near: Search, at: Lanes, place: list[Lanes], there: Lanes) -> Found:
    """Others at places in the grid, as seen from places of the asking agents."""
    e = w.e
    *others, rows = e.quadruples(w.base("grid", near.number, "places"), at)
    dx, dy, dz = (other - own for other, own in zip(others, place, strict=True))
    return Found(w, near, there, e.bits(rows, I32), dx, dy, dz, np.sqrt((dx * dx + dy * dy) + dz * dz))

