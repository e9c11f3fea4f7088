"""Reductions over items and other agents as machine code.

Items and `every` are gone through one by one, for eight asking agents at a time. Neighbours are found in the cell grid, for one
asking agent at a time: candidates of the cells in reach are measured eight at a time and those near enough written down, and then
eight of those at a time are tested, weighed and added. Terms of sums are multiples of one quantum and add without rounding, so
their order does not count (`numerics.exact_sums`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from antdsl import limits
from antdsl.numerics import exact_sums
from antdsl.numerics.elementwise import ELEMENTWISE
from antdsl.plan import ir
from antdsl.plan.traverse import needed
from antdsl.runtime.backends.compile import Does, Instruction
from antdsl.runtime.backends.native.block import BlockWriter, Near, Writer
from antdsl.runtime.backends.native.lanes import BOOL, F32, F64, I8, I32, I64, PTR, WIDTH, Emitter, Lanes
from antdsl.runtime.backends.native.layout import KINDS
from antdsl.runtime.backends.native.schedule import PAIRED, operands_of
from antdsl.runtime.pairs import nearest_asked
from antdsl.runtime.world import AXES

_SLACK, _INWARD, _BEYOND = 1.0 + 1e-6, 1.0 - 1e-6, 1.0 + 1e-5  # as in `senses.neighbours_compiled`
_NO_LABEL = (1 << 63) - 1
_STRIDE = 64  # bytes from one operand of a search to the next


def lowers(node: ir.Node, leaves: frozenset[str]) -> bool:
    """Whether a reduction has machine code: all that hangs on the other one is an operation or a leaf that has."""
    known = {"pair.x", "pair.y", "pair.z", "pair.distance", "other", "other.id", "other.row"} | leaves
    pairs = [each for each in needed(node.args[1:]) if each.rate is ir.Rate.PAIR]
    return all(each.op in ELEMENTWISE or each.op in known for each in pairs)


def reduce(b: BlockWriter, instructions: list[Instruction]) -> None:
    """Emit reductions over the items of one name or the agents of one species."""
    node = instructions[0].what
    assert isinstance(node, ir.Node)
    if node.args[0].op == "set.agents":
        _near(b, instructions)
    else:
        _one_by_one(b, instructions)


# --- what is added up ------------------------------------------------------------------------------------------------


@dataclass(slots=True, eq=False)
class _Sum:
    """Running values of one reduction, on the stack: of eight agents, or of one agent in eight parts."""

    e: Emitter
    node: ir.Node
    many: bool  # more terms than float64 adds exactly
    a: str = ""
    b: str = ""

    def start(self) -> None:
        e, op = self.e, self.node.op
        first, second = _START[op]
        if not self.a:
            self.a = e.slot(first[0])
            self.b = e.slot(second[0]) if second is not None else ""
        for place, row in ((self.a, first), (self.b, second)):
            if row is not None:
                value = e.constant(*reversed(row))
                e.do(f"store {value.typed}, ptr {place}")

    def take(self, mask: Lanes, body: Lanes | None, label: Lanes | None) -> None:
        """Take in a term of each lane for which a condition holds."""
        e = self.e
        match self.node.op:
            case "reduce.sum":
                assert body is not None
                quantum = int(self.node.attrs[0])
                wide = e.convert(body, F64)
                bound = float(np.ldexp(1.0, quantum + exact_sums.BOUND))
                wide = np.clip(wide, -bound, bound)
                magic = float(np.ldexp(1.5, quantum + 52))
                term = e.where(mask, (wide + magic) - magic, 0.0)
                if self.many:
                    magic = float(np.ldexp(1.5, quantum + exact_sums.HALF + 52))
                    high = (term + magic) - magic
                    self._put(self.a, self._at(self.a, F64) + high)
                    self._put(self.b, self._at(self.b, F64) + (term - high))
                else:
                    self._put(self.a, self._at(self.a, F64) + term)
            case "reduce.count":
                self._put(self.a, self._at(self.a, I32) + e.convert(mask, I32))
            case "reduce.any":
                self._put(self.a, self._at(self.a, I32) | e.convert(mask, I32))
            case "reduce.min":
                assert body is not None
                least = self._at(self.a, F32)
                self._put(self.a, e.where(mask & (body < least), body, least))
            case "reduce.max":
                assert body is not None
                most = self._at(self.a, F32)
                self._put(self.a, e.where(mask & (body > most), body, most))
            case _:
                assert body is not None and label is not None
                least, whose = self._at(self.a, F32), self._at(self.b, I64)
                better = mask & ((body < least) | ((body == least) & (label < whose)))
                self._put(self.a, e.where(better, body, least))
                self._put(self.b, e.where(better, label, whose))

    def _at(self, place: str, kind: str) -> Lanes:
        return self.e.op(f"load <{WIDTH} x {kind}>, ptr {place}", kind)

    def _put(self, place: str, value: Lanes) -> None:
        self.e.do(f"store {value.typed}, ptr {place}")

    def result(self) -> Lanes:
        """The reduction of each lane."""
        e = self.e
        match self.node.op:
            case "reduce.sum":
                total = self._at(self.a, F64)
                if self.many:
                    total = total + self._at(self.b, F64)
                return e.convert(total, F32)
            case "reduce.count":
                return e.convert(self._at(self.a, I32), F32)
            case "reduce.any":
                return self._at(self.a, I32) != 0
            case "reduce.min" | "reduce.max":
                return self._at(self.a, F32) + np.float32(0)
        label = self._at(self.b, I64)
        label = e.where(label == _NO_LABEL, e.constant(-1, I64), label)
        return label if self.node.op == "reduce.agent" else e.convert(label, I32)

    def fold(self) -> None:
        """Put what the eight parts hold together, into each of them."""
        e = self.e
        for width in (4, 2, 1):
            order = ", ".join(f"i32 {(k + width) % WIDTH}" for k in range(WIDTH))
            turned = {}
            for place, row in zip((self.a, self.b), _START[self.node.op], strict=True):
                if row is not None and place:
                    value = self._at(place, row[0])
                    turned[place] = e.op(
                        f"shufflevector {value.typed}, <{WIDTH} x {row[0]}> poison, <{WIDTH} x i32> <{order}>", row[0]
                    )
            self._fold(turned)

    def _fold(self, other: dict[str, Lanes]) -> None:
        e = self.e
        a = other[self.a]
        match self.node.op:
            case "reduce.sum" | "reduce.count":
                for place, value in other.items():
                    self._put(place, self._at(place, value.kind) + value)
            case "reduce.any":
                self._put(self.a, self._at(self.a, I32) | a)
            case "reduce.min":
                mine = self._at(self.a, F32)
                self._put(self.a, e.where(a < mine, a, mine))
            case "reduce.max":
                mine = self._at(self.a, F32)
                self._put(self.a, e.where(a > mine, a, mine))
            case _:
                mine, whose, label = self._at(self.a, F32), self._at(self.b, I64), other[self.b]
                better = (a < mine) | ((a == mine) & (label < whose))
                self._put(self.a, e.where(better, a, mine))
                self._put(self.b, e.where(better, label, whose))


_START: dict[str, tuple[tuple[str, Any], tuple[str, Any] | None]] = {
    "reduce.sum": ((F64, 0.0), (F64, 0.0)),
    "reduce.count": ((I32, 0), None),
    "reduce.any": ((I32, 0), None),
    "reduce.min": ((F32, np.inf), None),
    "reduce.max": ((F32, -np.inf), None),
    "reduce.agent": ((F32, np.inf), (I64, _NO_LABEL)),
    "reduce.item": ((F32, np.inf), (I64, _NO_LABEL)),
}


# --- values of a pair ------------------------------------------------------------------------------------------------


class _Pairs:
    """Values over pairs by their nodes. `own` gives a value of the asking agent, `leaf` what belongs to the pair."""

    def __init__(self, w: Writer, own: Callable[[ir.Node], Lanes], leaf: Callable[[ir.Node], Lanes], senses: Any) -> None:
        self.w, self.own, self.leaf, self.senses = w, own, leaf, senses

    def value(self, node: ir.Node) -> Lanes:
        def make() -> Lanes:
            if node.rate <= ir.Rate.STEP:
                return self.w.number(KINDS[node.kind], "node", node)
            if node.rate is not ir.Rate.PAIR:
                return self.own(node)
            if node.op in ELEMENTWISE:
                made: Lanes = self.w.apply(node.op, *(self.value(each) for each in node.args))
                return made
            if node.op in self.senses:
                made = self.senses[node.op](self.w, node, tuple(self.value(each) for each in node.args))
                return made
            return self.leaf(node)

        found: Lanes = self.w.e.once(("pair", node), make)
        return found


# --- one by one ------------------------------------------------------------------------------------------------------


def _one_by_one(b: BlockWriter, instructions: list[Instruction]) -> None:
    """For eight asking agents, all members in turn."""
    e = b.e
    nodes = [each.what for each in instructions if isinstance(each.what, ir.Node)]
    sets = _sets(instructions)
    own = _own(b, instructions)
    of_items = nodes[0].args[0].op == "set.items"
    name = nodes[0].args[0].attrs[0]
    place = [e.load(b.base("start", f"position.{axis}"), b.row, F32) for axis in AXES]
    reach = {chosen: b.slot(slots[0]) if of_items else None for chosen, slots in sets.items()}
    for each in own.values():
        each()  # here, not within the loop
    mask = b.mask[-1]
    itself = None if of_items or name != b.species else e.load(b.base("ids"), b.row, I64)
    sums = [_Sum(e, node, many=True) for node in nodes]
    for each in sums:
        each.start()
    count = b.number(I64, "items" if of_items else "agents", name, one=True)
    with e.loop(count) as number:

        def read(attribute: str, kind: str = F32) -> Lanes:
            key = ("item", name, attribute) if of_items else ("other", name, attribute)
            return e.splat(e.load_one(b.base(*key), number, kind))

        dx, dy, dz = (
            read(axis if of_items else f"position.{axis}") - mine for axis, mine in zip(AXES, place, strict=True)
        )
        distance = np.sqrt((dx * dx + dy * dy) + dz * dz)
        of_pair = {"pair.x": dx, "pair.y": dy, "pair.z": dz, "pair.distance": distance}

        def leaf(node: ir.Node) -> Lanes:
            if node.op in of_pair:
                return of_pair[node.op]
            if node.op == "other.row":
                return e.splat(e.convert(number, I32))
            if node.op == "other.id":
                return read("ids", I64)
            return read(node.attrs[0], KINDS[node.kind])

        pairs = _Pairs(b, lambda node: own[node](), leaf, b.senses)
        for each, node in zip(sums, nodes, strict=True):
            near = mask
            if of_items:
                near = near & (distance <= reach[node.args[0]])
            elif itself is not None:
                near = near & (read("ids", I64) != itself)
            _take(each, node, pairs, near, (lambda: e.splat(number)) if of_items else (lambda: read("ids", I64)))
    for each, instruction in zip(sums, instructions, strict=True):
        b.known(instruction.out, each.result())


def _take(each: _Sum, node: ir.Node, pairs: _Pairs, near: Lanes, label: Callable[[], Lanes]) -> None:
    condition = node.args[1]
    if condition.op != "const.bool" or not condition.attrs[0]:
        near = near & pairs.value(condition)
    body = pairs.value(node.args[2]) if len(node.args) > 2 else None
    each.take(near, body, label() if node.op in ("reduce.agent", "reduce.item") else None)


def _sets(instructions: list[Instruction]) -> dict[ir.Node, tuple[int, ...]]:
    """The sets of some reductions, with the slots of their operands."""
    known = {each.what: each.inputs for each in instructions[0].scope.code if each.does is Does.PAIRS}
    found: dict[ir.Node, tuple[int, ...]] = {}
    for each in instructions:
        assert isinstance(each.what, ir.Node)
        chosen = each.what.args[0]
        found[chosen] = known[chosen]
    return found


def _own(b: BlockWriter, instructions: list[Instruction]) -> dict[ir.Node, Callable[[], Any]]:
    """The asking agents' own values that reductions are made of."""
    makers = {each.out: each for each in instructions[0].scope.code if each.does in PAIRED}
    found: dict[ir.Node, Callable[[], Any]] = {}
    for instruction in instructions:
        pending, seen = list(instruction.inputs), set()
        while pending:
            slot = pending.pop()
            made = makers.get(slot)
            if made is None or slot in seen:
                continue
            seen.add(slot)
            if made.does is Does.SPREAD and isinstance(made.what, ir.Node):
                found[made.what] = lambda source=made.inputs[0]: b.slot(source)  # type: ignore[misc]
            elif made.does is not Does.PAIRS:
                pending += made.inputs
    return found


# --- neighbours ------------------------------------------------------------------------------------------------------


def _near(b: BlockWriter, instructions: list[Instruction]) -> None:
    """For each of eight asking agents, its neighbours: a function of its own, which is called with the values it needs."""
    e = b.e
    sets, own = _sets(instructions), _own(b, instructions)
    first = next(iter(sets))
    number = len(b.code.near)
    b.code.near.append(Near(first.attrs[0], list(sets)))
    values: list[Lanes] = []
    places: dict[ir.Node, int] = {}

    def put(value: Lanes) -> int:
        values.append(value)
        return len(values) - 1

    reach = {chosen: put(b.slot(slots[0])) for chosen, slots in sets.items()}
    view = {chosen: put(b.slot(slots[1])) for chosen, slots in sets.items() if not chosen.attrs[1]}
    for node, make in own.items():
        places[node] = put(make())
    nodes = [each.what for each in instructions if isinstance(each.what, ir.Node)]
    kinds = [KINDS[node.kind] for node in nodes]
    area = e.slot(I64, count=len(values) + len(nodes))
    for k, value in enumerate(values):
        place = e.op(f"getelementptr i8, ptr {area}, i64 {_STRIDE * k}", PTR, one=True)
        stored = e.convert(value, I8) if value.kind == BOOL else value
        e.do(f"store {stored.typed}, ptr {place.name}")
    results = e.op(f"getelementptr i8, ptr {area}, i64 {_STRIDE * len(values)}", PTR, one=True)
    name = f"near.{b.species}.{b.compiler.name}.{number}"
    _search(b, name, number, nodes, [value.kind for value in values], reach, view, places)
    bits = e.op(f"zext i8 {e.mask_bits(b.mask[-1]).name} to i64", I64, one=True)
    e.do(f"call void @{name}(ptr %t, i64 {b.row.name}, i64 {bits.name}, ptr {area}, ptr {results.name})")
    for k, (instruction, kind) in enumerate(zip(instructions, kinds, strict=True)):
        place = e.op(f"getelementptr i8, ptr {results.name}, i64 {_STRIDE * k}", PTR, one=True)
        stored = I8 if kind == BOOL else kind
        value = e.op(f"load <{WIDTH} x {stored}>, ptr {place.name}", stored)
        b.known(instruction.out, e.compare("ne", value, 0) if kind == BOOL else value)


def _search(
    b: BlockWriter,
    name: str,
    number: int,
    nodes: list[ir.Node],
    kinds: list[str],
    reach: dict[ir.Node, int],
    view: dict[ir.Node, int],
    places: dict[ir.Node, int],
) -> None:
    """The function that goes through eight asking agents, one by one."""
    w = Writer(b.module, b.layout)
    e, other = w.e, next(iter(reach)).attrs[0]
    with e.loop(e.constant(WIDTH, I64, one=True)) as lane:
        bit = e.op(f"lshr i64 %mask, {lane.name}", I64, one=True)
        asks = e.op(f"trunc i64 {bit.name} to i1", BOOL, one=True)
        with e.inside(asks):
            row = e.op(f"add i64 %row, {lane.name}", I64, one=True)
            area = Lanes(e, PTR, "%own", one=True)

            def mine(k: int) -> Lanes:
                place = e.op(f"getelementptr i8, ptr %own, i64 {_STRIDE * k}", PTR, one=True)
                return e.load_one(place, lane, kinds[k])

            del area
            own = {node: e.splat(mine(k)) for node, k in places.items()}
            place = [e.load_one(w.base("start", f"position.{axis}"), row, F32) for axis in AXES]
            radius = {chosen: mine(k) for chosen, k in reach.items()}
            buffer, count = _candidates(w, number, place, list(radius.values()))
            sums = [_Sum(e, node, many=False) for node in nodes]
            for each in sums:
                each.start()
            measure = _Measure(w, b.species == other, other, number, [e.splat(p) for p in place], e.splat(row), buffer, count)
            plan = b.code.species
            cuts = {chosen: _cut(measure, e.splat(size), nearest_asked(plan, chosen) is None) for chosen, size in radius.items()}
            heading = [e.splat(e.load_one(w.base("start", f"heading.{axis}"), row, F32)) for axis in AXES] if view else []
            cosine = {chosen: e.splat(mine(k)) for chosen, k in view.items()}
            with e.loop(count, WIDTH) as at:
                found = measure.at(at)

                def near(chosen: ir.Node) -> Lanes:
                    inside = found.there & (found.distance <= e.splat(radius[chosen]))
                    inside = cuts[chosen](found, inside)
                    if chosen in view:
                        hx, hy, hz = heading
                        ahead = (found.dx * hx + found.dy * hy) + found.dz * hz
                        inside = inside & (ahead >= cosine[chosen] * found.distance)
                    return inside

                pairs = _Pairs(w, lambda node: own[node], found.leaf, b.senses)
                for each, node in zip(sums, nodes, strict=True):
                    inside = e.once(("near", node.args[0]), lambda chosen=node.args[0]: near(chosen))  # type: ignore[misc]
                    _take(each, node, pairs, inside, found.ids)
            for k, each in enumerate(sums):
                each.fold()
                value = each.result()
                stored = e.convert(value, I8) if value.kind == BOOL else value
                single = e.op(f"extractelement {stored.typed}, i64 0", stored.kind, one=True)
                start = e.op(f"getelementptr i8, ptr %out, i64 {_STRIDE * k}", PTR, one=True)
                at_lane = e.address(start, lane, stored.kind)
                e.do(f"store {single.typed}, ptr {at_lane.name}")
    b.module.functions[name] = w.function(name, ", i64 %row, i64 %mask, ptr %own, ptr %out")


def _cell(w: Writer, q: Lanes, low: Lanes, width: Lanes, least: Lanes, most: Lanes) -> Lanes:
    """Number of a cell along an axis, kept between two bounds."""
    e = w.e
    x = e.op(f"fsub double {q.name}, {low.name}", F64, one=True)
    x = e.op(f"fdiv double {x.name}, {width.name}", F64, one=True)
    below = e.op(f"fcmp ogt double {x.name}, {least.name}", BOOL, one=True)
    x = e.op(f"select i1 {below.name}, double {x.name}, double {least.name}", F64, one=True)
    above = e.op(f"fcmp olt double {x.name}, {most.name}", BOOL, one=True)
    x = e.op(f"select i1 {above.name}, double {x.name}, double {most.name}", F64, one=True)
    return e.convert(e.intrinsic("floor", x), I64)


def _one(e: Emitter, text: str, kind: str) -> Lanes:
    return e.op(text, kind, one=True)


def _candidates(w: Writer, number: int, place: list[Lanes], radii: list[Lanes]) -> tuple[Lanes, Lanes]:
    """Write down the agents that may be in the widest of some radii: where they stand in the grid's order. Gives where, and how
    many; the list goes on with zeros to a multiple of eight."""
    e = w.e
    buffer = w.base("candidates")
    total = e.slot(I64, one=True)
    e.do(f"store i64 0, ptr {total}")
    widest = radii[0]
    for each in radii[1:]:
        more = _one(e, f"fcmp ogt float {each.name}, {widest.name}", BOOL)
        known = _one(e, f"fcmp ord float {widest.name}, {widest.name}", BOOL)
        keep = _one(e, f"xor i1 {more.name}, true", BOOL)
        keep = _one(e, f"and i1 {keep.name}, {known.name}", BOOL)
        widest = _one(e, f"select i1 {keep.name}, float {widest.name}, float {each.name}", F32)
    usable = _one(e, f"fcmp oge float {widest.name}, {e.constant(0.0, F32, one=True).name}", BOOL)
    for each in place:
        size = e.intrinsic("fabs", each)
        finite = _one(e, f"fcmp olt float {size.name}, {e.constant(np.inf, F32, one=True).name}", BOOL)
        usable = _one(e, f"and i1 {usable.name}, {finite.name}", BOOL)
    with e.inside(usable):
        _note_widest(w, number, widest)
        floats = w.base("grid", number, "floats")
        whole = w.base("grid", number, "whole")

        def real(k: int) -> Lanes:
            return e.load_one(floats, e.constant(k, I64, one=True), F64)

        def integer(k: int) -> Lanes:
            return e.load_one(whole, e.constant(k, I64, one=True), I64)

        zero, less = e.constant(0.0, F64, one=True), e.constant(-1.0, F64, one=True)
        stack = e.slot(F32, one=True, count=3)
        for k, each in enumerate(place):
            at = _one(e, f"getelementptr float, ptr {stack}, i64 {k}", PTR)
            e.do(f"store {each.typed}, ptr {at.name}")
        along = []
        for k in range(3):
            axis = integer(k)
            along.append(e.convert(e.load_one(Lanes(e, PTR, stack, one=True), axis, F32), F64))
        low, width = [real(k) for k in range(3)], [real(3 + k) for k in range(3)]
        size = [integer(3 + k) for k in range(3)]
        tiny = zero
        for each in along:
            bigger = e.intrinsic("fabs", each)
            more = _one(e, f"fcmp ogt double {bigger.name}, {tiny.name}", BOOL)
            tiny = _one(e, f"select i1 {more.name}, double {bigger.name}, double {tiny.name}", F64)
        tiny = _one(e, f"fmul double {tiny.name}, {e.constant(1e-14, F64, one=True).name}", F64)
        tiny = _one(e, f"fadd double {tiny.name}, {e.constant(1e-18, F64, one=True).name}", F64)
        slack = e.constant(_SLACK, F64, one=True)
        r = _one(e, f"fmul double {e.convert(widest, F64).name}, {slack.name}", F64)
        r = _one(e, f"fadd double {r.name}, {tiny.name}", F64)
        square = _one(e, f"fmul double {r.name}, {r.name}", F64)

        def span(axis: int, half: Lanes) -> tuple[Lanes, Lanes]:
            q, cells = along[axis], e.op(f"sitofp i64 {size[axis].name} to double", F64, one=True)
            last = _one(e, f"fadd double {cells.name}, {less.name}", F64)
            begin = _one(e, f"fsub double {q.name}, {half.name}", F64)
            end = _one(e, f"fadd double {q.name}, {half.name}", F64)
            return _cell(w, begin, low[axis], width[axis], zero, cells), _cell(w, end, low[axis], width[axis], less, last)

        def off(axis: int, cell: Lanes) -> Lanes:
            """Least distance from the place to a cell, squared, rounded down."""
            where = e.op(f"sitofp i64 {cell.name} to double", F64, one=True)
            where = _one(e, f"fmul double {where.name}, {width[axis].name}", F64)
            where = _one(e, f"fadd double {where.name}, {low[axis].name}", F64)
            before = _one(e, f"fsub double {where.name}, {along[axis].name}", F64)
            behind = _one(e, f"fadd double {where.name}, {width[axis].name}", F64)
            behind = _one(e, f"fsub double {along[axis].name}, {behind.name}", F64)
            gap = zero
            for each in (before, behind):
                more = _one(e, f"fcmp ogt double {each.name}, {gap.name}", BOOL)
                gap = _one(e, f"select i1 {more.name}, double {each.name}, double {gap.name}", F64)
            gap = _one(e, f"fmul double {gap.name}, {e.constant(_INWARD, F64, one=True).name}", F64)
            return _one(e, f"fmul double {gap.name}, {gap.name}", F64)

        b0, b1 = span(1, r)
        c0, c1 = span(2, r)
        flat = _one(e, f"icmp eq i64 {size[2].name}, 1", BOOL)
        away = _one(e, f"fsub double {along[2].name}, {low[2].name}", F64)
        within = _one(e, f"fcmp ole double {e.intrinsic('fabs', away).name}, {width[2].name}", BOOL)
        sheet = _one(e, f"and i1 {flat.name}, {within.name}", BOOL)
        c0 = _one(e, f"select i1 {sheet.name}, i64 0, i64 {c0.name}", I64)
        c1 = _one(e, f"select i1 {sheet.name}, i64 0, i64 {c1.name}", I64)
        reach = _one(e, f"fmul float {widest.name}, {widest.name}", F32)
        reach = _one(e, f"fmul float {reach.name}, {e.constant(np.float32(_BEYOND), F32, one=True).name}", F32)
        beyond = e.splat(_one(e, f"fadd float {reach.name}, {e.constant(1e-30, F32, one=True).name}", F32))
        x, y, z = (e.splat(each) for each in place)
        sx, sy, sz = (w.base("grid", number, axis) for axis in AXES)
        deep = _one(e, f"add i64 {_one(e, f'sub i64 {c1.name}, {c0.name}', I64).name}, 1", I64)
        tall = _one(e, f"add i64 {_one(e, f'sub i64 {b1.name}, {b0.name}', I64).name}, 1", I64)
        with e.loop(deep) as j:
            cz = _one(e, f"add i64 {c0.name}, {j.name}", I64)
            far_z = _one(e, f"select i1 {sheet.name}, double {zero.name}, double {off(2, cz).name}", F64)
            with e.loop(tall) as i:
                cy = _one(e, f"add i64 {b0.name}, {i.name}", I64)
                left = _one(e, f"fsub double {square.name}, {off(1, cy).name}", F64)
                left = _one(e, f"fsub double {left.name}, {far_z.name}", F64)
                with e.inside(_one(e, f"fcmp oge double {left.name}, {zero.name}", BOOL)):
                    half = _one(e, f"fmul double {e.intrinsic('sqrt', left).name}, {slack.name}", F64)
                    half = _one(e, f"fadd double {half.name}, {tiny.name}", F64)
                    a0, a1 = span(0, half)
                    line = _one(e, f"mul i64 {cz.name}, {size[1].name}", I64)
                    line = _one(e, f"add i64 {line.name}, {cy.name}", I64)
                    line = _one(e, f"mul i64 {line.name}, {size[0].name}", I64)
                    with e.inside(_one(e, f"icmp sle i64 {a0.name}, {a1.name}", BOOL)):
                        begin = _before(w, number, _one(e, f"add i64 {line.name}, {a0.name}", I64))
                        behind = _one(e, f"add i64 {_one(e, f'add i64 {line.name}, {a1.name}', I64).name}, 1", I64)
                        end = _before(w, number, behind)
                        many = _one(e, f"sub i64 {end.name}, {begin.name}", I64)
                        with e.loop(many, WIDTH) as k:
                            at = _one(e, f"add i64 {begin.name}, {k.name}", I64)
                            dx, dy, dz = e.load(sx, at, F32) - x, e.load(sy, at, F32) - y, e.load(sz, at, F32) - z
                            inside = ((dx * dx + dy * dy) + dz * dz) <= beyond
                            inside = inside & ((e.splat(k) + e.iota()) < e.splat(many))
                            _write_down(e, buffer, total, at, inside)
    count = _one(e, f"load i64, ptr {total}", I64)
    end = e.address(buffer, count, I32)
    e.do(f"store <{WIDTH} x i32> zeroinitializer, ptr {end.name}, align 4")
    return buffer, count


def _write_down(e: Emitter, buffer: Lanes, total: str, at: Lanes, inside: Lanes) -> None:
    """Append those of eight numbers from `at` on for which a condition holds. Each is written, and written over where it is not
    to stay: there is no branch that is hard to foretell."""
    bits = _one(e, f"zext i8 {e.mask_bits(inside).name} to i64", I64)
    count = _one(e, f"load i64, ptr {total}", I64)
    small = e.convert(at, I32)
    for k in range(WIDTH):
        place = e.address(buffer, count, I32)
        value = _one(e, f"add i32 {small.name}, {k}", I32)
        e.do(f"store i32 {value.name}, ptr {place.name}")
        shifted = _one(e, f"lshr i64 {bits.name}, {k}", I64) if k else bits
        count = _one(e, f"add i64 {count.name}, {_one(e, f'and i64 {shifted.name}, 1', I64).name}", I64)
    e.do(f"store i64 {count.name}, ptr {total}")


def _note_widest(w: Writer, number: int, widest: Lanes) -> None:
    """Remember the greatest radius that was asked for: the next step's cells suit it."""
    e, place = w.e, w.base("grid", number, "widest")
    zero = e.constant(0, I64, one=True)
    before = e.load_one(place, zero, F32)
    more = _one(e, f"fcmp ogt float {widest.name}, {before.name}", BOOL)
    chosen = _one(e, f"select i1 {more.name}, float {widest.name}, float {before.name}", F32)
    e.do(f"store {chosen.typed}, ptr {place.name}")


def _before(w: Writer, number: int, key: Lanes) -> Lanes:
    """How many sorted agents lie in cells before a key: from the table of starts, or by bisection where there is none."""
    e = w.e
    name = "grid.before"

    def make() -> str:
        f = Emitter(w.module)
        f.lines.append("  %table = icmp ne ptr %starts, null")
        f.lines.append("  br i1 %table, label %listed, label %search")
        f.lines.append("listed:")
        f.lines.append("  %p = getelementptr i32, ptr %starts, i64 %key")
        f.lines.append("  %s = load i32, ptr %p")
        f.lines.append("  %w = sext i32 %s to i64")
        f.lines.append("  ret i64 %w")
        f.lines.append("search:")
        f.lines.append("  br label %head")
        f.lines.append("head:")
        f.lines.append("  %a = phi i64 [ 0, %search ], [ %a2, %body ]")
        f.lines.append("  %b = phi i64 [ %count, %search ], [ %b2, %body ]")
        f.lines.append("  %more = icmp slt i64 %a, %b")
        f.lines.append("  br i1 %more, label %body, label %done")
        f.lines.append("body:")
        f.lines.append("  %sum = add i64 %a, %b")
        f.lines.append("  %mid = lshr i64 %sum, 1")
        f.lines.append("  %kp = getelementptr i64, ptr %keys, i64 %mid")
        f.lines.append("  %k = load i64, ptr %kp")
        f.lines.append("  %less = icmp slt i64 %k, %key")
        f.lines.append("  %up = add i64 %mid, 1")
        f.lines.append("  %a2 = select i1 %less, i64 %up, i64 %a")
        f.lines.append("  %b2 = select i1 %less, i64 %b, i64 %mid")
        f.lines.append("  br label %head")
        f.lines.append("done:")
        f.lines.append("  ret i64 %a")
        body = "\n".join(f.lines)
        return f"define internal i64 @{name}(ptr %starts, ptr %keys, i64 %count, i64 %key) {{\nentry:\n{body}\n}}"

    w.module.function(name, make)
    whole = w.base("grid", number, "whole")
    count = e.load_one(whole, e.constant(6, I64, one=True), I64)
    starts, keys = w.base("grid", number, "starts"), w.base("grid", number, "keys")
    return _one(e, f"call i64 @{name}(ptr {starts.name}, ptr {keys.name}, i64 {count.name}, i64 {key.name})", I64)


@dataclass(slots=True, eq=False)
class _Found:
    """Eight pairs: which are there at all, others' rows, other minus own, and its length."""

    w: Writer
    other: str
    there: Lanes
    rows: Lanes
    dx: Lanes
    dy: Lanes
    dz: Lanes
    distance: Lanes

    def ids(self) -> Lanes:
        return self.w.e.once(("ids", self.rows.name), lambda: self.w.e.gather(self.w.base("other", self.other, "ids"), self.rows, I64))

    def leaf(self, node: ir.Node) -> Lanes:
        named = {"pair.x": self.dx, "pair.y": self.dy, "pair.z": self.dz, "pair.distance": self.distance}
        if node.op in named:
            return named[node.op]
        if node.op == "other.id":
            return self.ids()
        return self.w.e.gather(self.w.base("other", self.other, node.attrs[0]), self.rows, KINDS[node.kind])


@dataclass(slots=True, eq=False)
class _Measure:
    """Measures what was written down about one asking agent."""

    w: Writer
    own_kind: bool
    other: str
    number: int
    place: list[Lanes]
    row: Lanes
    buffer: Lanes
    count: Lanes

    def at(self, index: Lanes) -> _Found:
        """Eight candidates from an index on."""
        w, e = self.w, self.w.e
        at = e.load(self.buffer, index, I32)
        there = (e.splat(index) + e.iota()) < e.splat(self.count)
        at = e.where(there, at, e.constant(0, I32))
        dx, dy, dz = (
            e.gather(w.base("grid", self.number, axis), at, F32) - mine for axis, mine in zip(AXES, self.place, strict=True)
        )
        rows = e.gather(w.base("grid", self.number, "rows"), at, I32)
        distance = np.sqrt((dx * dx + dy * dy) + dz * dz)
        if self.own_kind:
            there = there & (rows != e.convert(self.row, I32))
        return _Found(w, self.other, there, rows, dx, dy, dz, distance)


def _cut(measure: _Measure, radius: Lanes, stops: bool) -> Callable[[_Found, Lanes], Lanes]:
    """`stops`: more than `limits.WITHIN_RADIUS` in the radius are told, and the run stops. Where more others are in a radius than the cap, only the nearest count, by (distance, id). Gives what asks that of eight
    pairs: whether their distance, as a whole number, and id are at most those of the last one that counts."""
    w, e = measure.w, measure.w.e
    far, last = e.slot(I32, one=True), e.slot(I64, one=True)
    e.do(f"store i32 {(1 << 31) - 1}, ptr {far}")
    e.do(f"store i64 {_NO_LABEL}, ptr {last}")

    def count(test: Callable[[_Found, Lanes], Lanes]) -> Lanes:
        """How many in the radius pass a test."""
        counted = e.slot(I32)
        e.do(f"store <{WIDTH} x i32> zeroinitializer, ptr {counted}")
        with e.loop(measure.count, WIDTH) as index:
            found = measure.at(index)
            good = test(found, found.there & (found.distance <= radius))
            before = e.op(f"load <{WIDTH} x i32>, ptr {counted}", I32)
            after = before + e.convert(good, I32)
            e.do(f"store {after.typed}, ptr {counted}")
        total = e.op(f"load <{WIDTH} x i32>, ptr {counted}", I32)
        w.module.declare("llvm.vector.reduce.add.v8i32", "i32", [f"<{WIDTH} x i32>"])
        return _one(e, f"call i32 @llvm.vector.reduce.add.v8i32({total.typed})", I32)

    def bisect(place: str, kind: str, low: str, high: str, enough: Callable[[Lanes], Lanes]) -> None:
        """The least whole number that is enough, between two."""
        a, z = e.slot(kind, one=True), e.slot(kind, one=True)
        e.do(f"store {kind} {low}, ptr {a}")
        e.do(f"store {kind} {high}, ptr {z}")
        turns = e.constant(31 if kind == I32 else 63, I64, one=True)
        with e.loop(turns):
            first, end = (_one(e, f"load {kind}, ptr {each}", kind) for each in (a, z))
            wide = _one(e, f"sub {kind} {end.name}, {first.name}", kind)
            middle = _one(e, f"add {kind} {first.name}, {_one(e, f'lshr {kind} {wide.name}, 1', kind).name}", kind)
            good = enough(middle)
            above = _one(e, f"add {kind} {middle.name}, 1", kind)
            over = _one(e, f"icmp sgt {kind} {above.name}, {end.name}", BOOL)
            above = _one(e, f"select i1 {over.name}, {kind} {end.name}, {kind} {above.name}", kind)
            begin = _one(e, f"select i1 {good.name}, {kind} {first.name}, {kind} {above.name}", kind)
            stop = _one(e, f"select i1 {good.name}, {kind} {middle.name}, {kind} {end.name}", kind)
            e.do(f"store {begin.typed}, ptr {a}")
            e.do(f"store {stop.typed}, ptr {z}")
        e.do(f"store {_one(e, f'load {kind}, ptr {z}', kind).typed}, ptr {place}")

    most = limits.NEIGHBOURS
    with e.inside(_one(e, f"icmp sgt i64 {measure.count.name}, {most}", BOOL)):
        every = count(lambda found, good: good)
        with e.inside(_one(e, f"icmp sgt i32 {every.name}, {most}", BOOL)):
            if stops:
                with e.inside(_one(e, f"icmp sgt i32 {every.name}, {limits.WITHIN_RADIUS}", BOOL)):
                    crowded = w.base("crowded")
                    e.do(f"store i64 1, ptr {crowded.name}")

            def by_distance(middle: Lanes) -> Lanes:
                bound = e.splat(middle)
                number = count(lambda found, good: good & (e.bits(found.distance, I32) <= bound))
                return _one(e, f"icmp sge i32 {number.name}, {most}", BOOL)

            bisect(far, I32, "0", str((1 << 31) - 1), by_distance)
            reach = e.splat(_one(e, f"load i32, ptr {far}", I32))
            nearer = count(lambda found, good: good & (e.bits(found.distance, I32) < reach))
            rest = _one(e, f"sub i32 {most}, {nearer.name}", I32)

            def by_id(middle: Lanes) -> Lanes:
                bound = e.splat(middle)
                number = count(lambda found, good: good & (e.bits(found.distance, I32) == reach) & (found.ids() <= bound))
                return _one(e, f"icmp sge i32 {number.name}, {rest.name}", BOOL)

            bisect(last, I64, "0", str(_NO_LABEL), by_id)

    reach, label = (e.splat(_one(e, f"load {kind}, ptr {place}", kind)) for place, kind in ((far, I32), (last, I64)))
    capped = _one(e, f"icmp sgt i64 {measure.count.name}, {most}", BOOL)

    def counts(found: _Found, inside: Lanes) -> Lanes:
        """Those of eight that count."""
        result = e.slot(I8)
        e.do(f"store {e.convert(inside, I8).typed}, ptr {result}")
        with e.inside(capped):
            bits = e.bits(found.distance, I32)
            kept = inside & ((bits < reach) | ((bits == reach) & (found.ids() <= label)))
            e.do(f"store {e.convert(kept, I8).typed}, ptr {result}")
        return e.op(f"load <{WIDTH} x i8>, ptr {result}", I8) != 0

    return counts


__all__ = ["lowers", "operands_of", "reduce"]
