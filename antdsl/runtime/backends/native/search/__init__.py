"""Reductions over neighbours as machine code: one search of the cell grid for all reductions over one species.

Eight agents are processed at a time. The cells within their radii are computed in SIMD lanes. The distances of agents in these
cells (candidates) are measured, eight at a time. Candidates that are near enough and in view are listed, one list per agent.
Then all lists are traversed in SIMD lanes: one pair of each of the eight agents is tested, weighted and added to its sums.
`crowds` handles agents with very many candidates.

Reductions of several regions share one search if its inputs are known. The first region runs the search for its agents, later
regions only for agents without results yet. Results that no region reads are computed but have no effect."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from antdsl import limits
from antdsl.machine_code.kernels.values import Number, text_type
from antdsl.machine_code.kinds import BOOL, F32, I8, I32, I64, LANE_COUNT, PTR
from antdsl.machine_code.lanes import LaneBuilder, Lanes
from antdsl.plan import ir
from antdsl.plan.traverse import required_nodes
from antdsl.runtime.backends.compile import BlockInstruction
from antdsl.runtime.backends.native.block import BlockWriter, FunctionWriter, NeighbourSearch
from antdsl.runtime.backends.native.fours import quadruple_address
from antdsl.runtime.backends.native.layout import LANE_TYPE_BY_KIND
from antdsl.runtime.backends.native.schedule import operands_of
from antdsl.runtime.backends.native.search.cells import SEARCH_SLACK_FACTOR, CellRows, append_numbers
from antdsl.runtime.backends.native.search.crowds import write_dense_search
from antdsl.runtime.backends.native.search.near import OPERAND_STRIDE_BYTES, POSITION_REGISTERS, SearchCode, measure_pairs
from antdsl.runtime.backends.native.sets import PairValues, accumulate, own_values, reduction_sets
from antdsl.runtime.backends.native.sums import RunningReduction
from antdsl.runtime.pairs import count_nearest
from antdsl.runtime.world import AXES

# Candidates of one agent that are gone through here, so that the cap leaves out none
MAX_LISTED_CANDIDATES = limits.MAX_QUERY_NEIGHBOURS
_CACHE_LINE_BYTES = 64  # bytes of a cache line
_ROWS_LOOKED_UP = 8  # rows of cells that are looked up before their agents are listed
_LIST_STRIDE = MAX_LISTED_CANDIDATES + 2 * LANE_COUNT  # distance between the lists of two agents, in numbers
_MIN_SQUARED_DISTANCE, _COSINE_SLACK = np.float32(1e-30), np.float32(1e-5)


@dataclass(slots=True, eq=False)
class ReductionGroup:
    """Reductions that one search computes.

    `own`, `out`: addresses of the areas for operands and results.
    `answered_mask`: address of the mask of agents that already have results."""

    number: int
    instructions: list[BlockInstruction]
    own: Number
    out: Number
    answered_mask: Number
    near: SearchCode


def emit_neighbour_reduction(b: BlockWriter, instruction: BlockInstruction) -> None:
    """Emit a reduction over neighbours, and all others that the same search can compute."""
    e, group = b.e, _make_group(b, instruction)
    shared = any(each.scope is not instruction.scope for each in group.instructions)
    mask = b.mask[-1]
    if not shared:
        _call_search(b, group, e.mask_bits(mask))
    else:
        answered_mask = e.load(group.answered_mask, I8)
        missing = e.mask_bits(mask) & ~answered_mask
        with e.inside(missing != 0):
            _call_search(b, group, missing)
            e.put(group.answered_mask, answered_mask | missing)
    for k, each in enumerate(group.instructions):
        if each.scope is instruction.scope and not any(each.out in names for names in e.known):
            kind = LANE_TYPE_BY_KIND[group.near.nodes[k].kind]
            b.known(each.out, _area_value(e, group.out, k, kind))
    for chosen, k in group.near.stops.items():
        if any(each.scope is instruction.scope and each.what.args[0] is chosen for each in group.instructions):  # type: ignore[union-attr]
            with e.inside(e.any_lane(_area_value(e, group.out, k, BOOL) & mask)):
                e.put(b.base("counts"), e.constant(1, I64, 1))


def _area_value(e: LaneBuilder, area: Number, k: int, kind: str) -> Lanes:
    """Return an operand or a result of a search from its area."""
    return e.convert(e.load(e.field(area, OPERAND_STRIDE_BYTES * k), I8 if kind == BOOL else kind, LANE_COUNT), kind)


def _make_group(b: BlockWriter, first: BlockInstruction) -> ReductionGroup:
    """Return the group of a reduction, with all other reductions that the same search can compute."""
    if first in b.groups:
        known_group: ReductionGroup = b.groups[first]
        return known_group
    together = [first, *(each for each in b.joint_reductions(first) if each not in b.groups)]
    number = len(b.code.near)
    name = f"near.{b.species}.{b.compiler.name}.{number}"
    nodes = [each.what for each in together if isinstance(each.what, ir.PlanNode)]
    near = SearchCode(name, number, nodes[0].args[0].attrs[0], nodes)
    operands = 0
    for instruction in together:
        operands += len(operands_of(instruction)) + 4
    e = b.e
    results = 2 * len(nodes)
    own, out = (e.allocate(count, text_type(I64, LANE_COUNT)) for count in (operands, results))
    group = ReductionGroup(number, together, own, out, e.slot(I8), near)
    b.at_top.append(lambda: e.put(group.answered_mask, e.constant(0, I8, 1)))
    for each in together:
        b.groups[each] = group
    return group


def _call_search(b: BlockWriter, group: ReductionGroup, asking: Lanes) -> None:
    """Store the operands, and call the search for the agents `asking` of eight. Its functions are written at the first call."""
    e, near = b.e, group.near
    fresh = not near.kinds
    by_scope: dict[int, list[BlockInstruction]] = {}
    for each in group.instructions:
        by_scope.setdefault(id(each.scope), []).append(each)
    values: list[Lanes] = []

    def put(value: Lanes) -> int:
        values.append(value)
        return len(values) - 1

    reach: dict[ir.PlanNode, int] = {}
    view: dict[ir.PlanNode, int] = {}
    value_indices: dict[ir.PlanNode, int] = {}
    for instructions in by_scope.values():
        for chosen, slots in reduction_sets(instructions).items():
            if chosen not in reach:
                reach[chosen] = put(b.slot(slots[0]))
                if not chosen.attrs[1]:
                    view[chosen] = put(b.slot(slots[1]))
        for node, make in own_values(b, instructions).items():
            if node not in value_indices:
                value_indices[node] = put(make())
    if fresh:
        near.kinds, near.reach, near.view, near.operand_slots = [value.kind for value in values], reach, view, value_indices
        plan = b.code.species
        stops = [chosen for chosen in near.reach if count_nearest(plan, chosen) is None]
        near.stops = {chosen: len(near.nodes) + k for k, chosen in enumerate(stops)}
        read = required_nodes(arg for node in near.nodes for arg in node.args[1:])
        names = sorted(
            {each.attrs[0] for each in read if each.op == "other" and each.kind is ir.ValueKind.F32} - {*POSITION_REGISTERS}
        )
        near.beside = [" ".join(names[k : k + 4]) for k in range(0, len(names), 4)]
        b.code.near.append(NeighbourSearch(near.other, list(near.reach), near.beside))
    for k, value in enumerate(values):
        e.put(e.field(group.own, OPERAND_STRIDE_BYTES * k), e.widened(e.as_stored(value)))
    if fresh:
        _write_functions(b, near)
    e.do("call", b.table, b.row, asking, group.own, group.out, x=f"@{near.name}")


# --- eight agents in SIMD lanes --------------------------------------------------------------------------------------


def _write_functions(b: BlockWriter, near: SearchCode) -> None:
    """Write two functions of a search: for eight agents, and for one agent with very many neighbours."""
    w = FunctionWriter(b.module, b.layout)
    e = w.e
    row, bits, own, out = (
        e.named_number(I64, "%row"),
        e.named_number(I8, "%mask"),
        e.named_number(PTR, "%own"),
        e.named_number(PTR, "%out"),
    )
    asks = e.from_bits(bits)

    def mine(k: int) -> Lanes:
        return _area_value(e, own, k, near.kinds[k])

    place = [e.read(w.base("start", f"position.{axis}"), row, F32) for axis in AXES]
    radius = {chosen: mine(k) for chosen, k in near.reach.items()}
    search = CellRows(w, near.number, place, list(radius.values()), asks)
    search.note_radius()
    heading = [e.read(w.base("start", f"heading.{axis}"), row, F32) for axis in AXES] if near.view else []
    set_test = _SetTest(e, radius, {chosen: mine(k) for chosen, k in near.view.items()}, search, heading)
    itself = e.read(w.base("grid", near.number, "at"), row, I32) if near.other == b.species else None
    buffer, number, over = _list_candidates(w, near, search, asks, set_test, itself)
    sums = [RunningReduction(e, node, many=False) for node in near.nodes]
    for each in sums:
        each.start()
    with e.loop(e.convert(e.lane_maximum(number), I64)) as k:
        is_listed = e.convert(k, I32) < number
        pair = measure_pairs(w, near, _read_lists(e, buffer, k), place, is_listed)

        def inside(chosen: ir.PlanNode) -> Lanes:
            reached = pair.is_present & (pair.distance <= radius[chosen])
            if chosen in near.view:
                hx, hy, hz = heading
                ahead = e.get_or_make("ahead", lambda: (pair.dx * hx + pair.dy * hy) + pair.dz * hz)
                reached = reached & (ahead >= mine(near.view[chosen]) * pair.distance)
            return reached

        pairs = PairValues(w, lambda node: mine(near.operand_slots[node]), pair.leaf, b.senses)
        for each, node in zip(sums, near.nodes, strict=True):
            reached = e.get_or_make(("near", node.args[0]), lambda chosen=node.args[0]: inside(chosen))  # type: ignore[misc]
            accumulate(each, node, pairs, reached, pair.ids)
    fits = asks & ~over
    for result, each in enumerate(sums):
        stored = e.as_stored(each.result())
        start = e.field(out, OPERAND_STRIDE_BYTES * result)
        e.put(start, e.where(fits, stored, e.load(start, stored.kind, LANE_COUNT)))
    for stop in near.stops.values():
        start = e.field(out, OPERAND_STRIDE_BYTES * stop)
        e.put(start, e.where(fits, e.constant(0, I8), e.load(start, I8, LANE_COUNT)))
    with e.inside(e.any_lane(over)):
        e.do("call", w.table, row, e.mask_word(over), own, out, x=f"@{near.name}.many")
    write_dense_search(b, near)
    e.end(near.name, (w.table, row, bits, own, out))


def _read_lists(e: LaneBuilder, buffer: Lanes, k: Lanes) -> Lanes:
    """Return the element at index `k` of each of the eight agents' lists."""
    first = e.address(buffer, k, I32)
    return e.combine_lanes(e.load(e.field(first, 4 * _LIST_STRIDE * lane), I32) for lane in range(LANE_COUNT))


class _SetTest:
    """Tests whether candidates may be in any set of a search.

    It compares squared distances with some slack. So no square root is needed for candidates that are too far away or out of
    view. It stores the limits of eight requesting agents, to be read one agent at a time."""

    def __init__(
        self,
        e: LaneBuilder,
        radius: Mapping[ir.PlanNode, Lanes],
        view: Mapping[ir.PlanNode, Lanes],
        search: CellRows,
        heading: list[Lanes],
    ) -> None:
        self.e, self._stack = e, search.stack
        self._heading = [self._store(each) for each in heading]
        widest = {chosen: search.widest for chosen in radius} if not view else radius
        limits_of = {
            chosen: (each * each) * np.float32(SEARCH_SLACK_FACTOR) + _MIN_SQUARED_DISTANCE for chosen, each in widest.items()
        }
        if not view:
            limits_of = dict(list(limits_of.items())[:1])
        self._sets: list[tuple[Number, Number | None]] = []
        for chosen, limit in limits_of.items():
            least = None
            if chosen in view:
                cosine = view[chosen]
                least = self._store(cosine * np.abs(cosine) - (cosine * cosine) * _COSINE_SLACK)
            self._sets.append((self._store(limit), least))

    def _store(self, value: Lanes) -> Number:
        place = self.e.slot(F32, LANE_COUNT)
        self.e.put(place, value)
        return place

    def of(self, lane: Lanes) -> Callable[[list[Lanes]], Lanes]:
        """Return the test for one agent. The input of the test is the positions of eight candidates."""
        e = self.e

        def one(place: Number) -> Lanes:
            return e.widened(e.read_one(place, lane, F32))

        own = [one(e.field(self._stack, 32 * k)) for k in range(3)]
        heading = [one(each) for each in self._heading]
        sets = [(one(limit), None if least is None else one(least)) for limit, least in self._sets]

        def test(positions: list[Lanes]) -> Lanes:
            dx, dy, dz = (coordinate - own_coordinate for coordinate, own_coordinate in zip(positions, own, strict=True))
            square = (dx * dx + dy * dy) + dz * dz
            is_candidate = None
            for limit, least in sets:
                inside = square <= limit
                if least is not None:
                    hx, hy, hz = heading
                    ahead = (dx * hx + dy * hy) + dz * hz
                    inside = inside & ~(ahead * np.abs(ahead) + _MIN_SQUARED_DISTANCE < least * square)
                is_candidate = inside if is_candidate is None else is_candidate | inside
            assert is_candidate is not None
            return is_candidate

        return test


def _list_candidates(
    w: FunctionWriter, near: SearchCode, search: CellRows, asks: Lanes, set_test: _SetTest, itself: Lanes | None
) -> tuple[Lanes, Lanes, Lanes]:
    """List the possible members of a set for each of eight agents.

    Returns the list addresses, the list lengths, and the mask of agents with too many candidates, which have their lists
    skipped."""
    e = w.e
    buffer = w.base("candidates")
    candidate_count, match_count, number, own_place = (e.slot(I32, LANE_COUNT) for _ in range(4))
    begins, ends = (e.allocate(_ROWS_LOOKED_UP, text_type(I32, LANE_COUNT)) for _ in range(2))
    total, numbers = e.slot(I64), e.slot(I32, LANE_COUNT)
    for slot in (candidate_count, match_count):
        e.put(slot, e.constant(0, I32))
    if itself is not None:
        e.put(own_place, itself)
    columns = [w.base("grid", near.number, axis) for axis in AXES]
    fours = [w.base("grid", near.number, each) for each in ("places", *near.beside)]

    def write_lane(lane: Lanes, rows: Lanes) -> None:
        """Write the candidates of one agent in the given rows of cells."""
        test = set_test.of(lane)
        mine = None if itself is None else e.widened(e.read_one(own_place, lane, I32))
        own = e.address(buffer, lane * _LIST_STRIDE, I32)
        so_far = e.address(match_count, lane, I32)
        e.put(total, e.convert(e.load(so_far, I32), I64))
        with e.loop(rows) as row:
            index = (row << 3) + lane
            begin, end = (e.read_one(each, index, I32) for each in (begins, ends))
            start, many = e.convert(begin, I64), e.convert(end - begin, I64)
            last = e.widened(end)
            e.put(numbers, begin + e.convert(e.iota(), I32))
            with e.loop(many, LANE_COUNT) as k:
                at = start + k
                for each in fours:  # needed when the list is traversed: eight entries are in at most three cache lines
                    for offset in (0, _CACHE_LINE_BYTES, LANE_COUNT * 16 - 4):
                        e.prefetch(e.field(quadruple_address(e, each, at), offset))
                now = e.load(numbers, I32, LANE_COUNT)
                e.put(numbers, now + LANE_COUNT)
                inside = test([e.read(column, at, F32) for column in columns]) & (now < last)
                if mine is not None:
                    inside = inside & (now != mine)
                append_numbers(e, own, total, now, inside)
        e.put(so_far, e.convert(e.load(total, I64), I32))

    every = search.row_count()
    with e.loop(every, _ROWS_LOOKED_UP) as first:
        rows = e.op("smin", I64, every - first, e.constant(_ROWS_LOOKED_UP, I64, 1))
        e.put(number, e.constant(0, I32))
        with e.loop(rows) as row:
            begin, count = search.next_row()
            sums = e.load(candidate_count, I32, LANE_COUNT) + count
            e.put(candidate_count, sums)
            count = e.where(sums <= MAX_LISTED_CANDIDATES, count, e.constant(0, I32))
            e.put(number, e.load(number, I32, LANE_COUNT) | count)
            at = row << 3
            e.write(begins, at, begin)
            e.write(ends, at, begin + count)
        with e.loop(LANE_COUNT) as lane, e.inside(e.read_one(number, lane, I32) > 0):
            write_lane(lane, rows)
    counted = e.load(match_count, I32, LANE_COUNT)
    over = asks & (e.load(candidate_count, I32, LANE_COUNT) > MAX_LISTED_CANDIDATES)
    counted = e.where(asks & ~over, counted, e.constant(0, I32))
    e.put(number, counted)
    most, zero = e.lane_maximum(counted), e.constant(0, I32)
    with e.loop(LANE_COUNT) as lane:  # all lists are traversed to the end of the longest one
        many = e.read_one(number, lane, I32)
        own = e.address(buffer, lane * _LIST_STRIDE, I32)
        end = e.address(own, e.convert(many, I64), I32)
        short = e.convert(most - many, I64)
        e.write(end, 0, zero)
        with e.inside(short > LANE_COUNT), e.loop(short, LANE_COUNT) as k:
            e.write(end, k, zero)
    return buffer, counted, over
