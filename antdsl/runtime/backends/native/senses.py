"""Senses as machine code: the operations of `runtime.sensing` that only read arrays. Others are called between two stages."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from antdsl.machine_code.kernels.values import text_type
from antdsl.machine_code.kinds import BOOL, F32, F64, I8, I32, I64, LANE_COUNT, PTR
from antdsl.machine_code.lanes import LaneBuilder, Lanes
from antdsl.numerics import randomness
from antdsl.numerics.randomness import UNIT_FLOAT_STEP
from antdsl.plan import ir
from antdsl.runtime.backends.native.block import FunctionWriter, NodeLowerer
from antdsl.runtime.backends.native.fours import load_quadruples
from antdsl.runtime.backends.native.layout import LANE_TYPE_BY_KIND
from antdsl.runtime.backends.native.scents import own_cell
from antdsl.runtime.moving.obstacle_clearance import may_touch
from antdsl.runtime.sensing import NO_HIT
from antdsl.runtime.world import AXES

_CELL_STRIDE = 4  # neighbour cells are sorted: about this many share a cache line


def _register(w: Any, node: ir.PlanNode, args: tuple[Any, ...]) -> Lanes:
    """Return a register of the agent itself, at the start of the step or now."""
    value: Lanes = w.e.read(w.base("start" if node.op == "snap" else "now", node.attrs[0]), w.row, LANE_TYPE_BY_KIND[node.kind])
    return value


def _id(w: Any, node: ir.PlanNode, args: tuple[Any, ...]) -> Lanes:
    ids: Lanes = w.e.read(w.base("ids"), w.row, I64)
    return ids


def _age(w: Any, node: ir.PlanNode, args: tuple[Any, ...]) -> Lanes:
    return _age_of(w, w.e.read(w.base("born"), w.row, I64))


def _age_of(w: Any, born: Lanes) -> Lanes:
    """Return the age (s) of agents from their frame of birth."""
    frames = w.number(I64, "frame") - born
    frame_count = w.e.convert(w.e.where(frames > 0, frames, w.e.constant(0, I64)), I32)  # a run has far fewer than 2**31 frames
    age: Lanes = w.e.convert(w.e.convert(frame_count, F64) * w.number(F64, "dt"), F32)
    return age


def _random_words(w: Any, site: str, block: int) -> list[Lanes]:
    """Return the four random words of a site for each id."""

    def make() -> list[Lanes]:
        e, wide = w.e, text_type(I64, LANE_COUNT)
        out = e.allocate(4, wide)
        shared = [
            w.number(I64, "philox", w.species, site, block, word, one=True) for word in ("first", "low", "last", "k0", "k1")
        ]
        ids = _id(w, None, ())  # type: ignore[arg-type]
        e.do("call", ids, *shared, out, x=f"@{_philox(w)}")
        return [e.load(e.address(out, k, wide), I64, LANE_COUNT) for k in range(4)]

    words: list[Lanes] = w.e.get_or_make(("words", site, block), make)
    return words


def _philox(w: FunctionWriter) -> str:
    """Return the name of the function that computes four random words of eight agents."""
    name = "philox"
    if name not in w.module.functions:
        e = LaneBuilder(w.module)
        ids, out = e.named_number(I64, "%ids", LANE_COUNT), e.named_number(PTR, "%out")
        shared = [e.named_number(I64, f"%{each}") for each in ("first", "low", "last", "k0", "k1")]
        first, low, last, k0, k1 = map(e.widened, shared)
        words: Any = randomness.words_of_ids(ids, first, low, last, (k0, k1))
        for k, word in enumerate(words):
            e.put(e.address(out, k, text_type(I64, LANE_COUNT)), word)
        e.end(name, (ids, *shared, out), attribute="noinline")
    return name


def _draw(w: Any, node: ir.PlanNode, args: tuple[Any, ...]) -> Lanes:
    site, index = node.attrs
    word = _random_words(w, site, index >> 2)[index & 3]
    small: Lanes = w.e.convert(w.e.convert(word >> 8, I32), F32)  # 24 bits: as whole numbers of 32 bits they convert faster
    return small * UNIT_FLOAT_STEP


def _draw_agent(w: Any, node: ir.PlanNode, args: tuple[Any, ...]) -> Lanes:
    site, species = node.attrs
    word = _random_words(w, site, 0)[0]
    count = w.number(I64, "agents", species)
    at = (word * count) >> 32
    agent_id = w.e.gather(w.base("other", species, "sorted ids"), at, I64)
    none: Lanes = w.e.where(count == 0, w.e.constant(-1, I64), agent_id)
    return none


def _event(w: Any, node: ir.PlanNode, args: tuple[Any, ...]) -> Lanes:
    has_event: Lanes = w.e.read(w.base("event", node.attrs[0]), w.row, BOOL)
    return has_event


def _touching(w: Any, node: ir.PlanNode, args: tuple[Any, ...]) -> Lanes:
    is_touching: Lanes = w.e.read(w.base("mesh"), w.row, I64) == w.number(I64, "surface", node.attrs[0])
    return is_touching


def _rows_of_ids(w: Any, species: str, ids: Lanes) -> Lanes:
    """Return the rows of ids, -1 for none and for dead agents. The sorted ids are bisected in all lanes at once."""
    e: LaneBuilder = w.e

    def make() -> Lanes:
        known, order = w.base("other", species, "sorted ids"), w.base("other", species, "rows of sorted ids")
        count = w.number(I64, "agents", species)
        at, step = e.slot(I64, LANE_COUNT), e.slot(I64)
        e.put(at, e.constant(0, I64))
        e.put(step, w.number(I64, "half", species, one=True))
        with e.loop(w.number(I64, "turns", species, one=True)):
            size, place = e.load(step, I64), e.load(at, I64, LANE_COUNT)
            ahead = place + size
            inside = ahead < count
            probe = e.gather(known, e.where(inside, ahead, e.constant(0, I64)), I64)
            e.put(at, e.where(inside & (probe <= ids), ahead, place))
            e.put(step, size >> 1)
        place = e.load(at, I64, LANE_COUNT)
        is_alive = (e.gather(known, place, I64) == ids) & (count > 0)
        return e.where(is_alive, e.gather(order, place, I64), e.constant(-1, I64))

    rows: Lanes = e.get_or_make(("row of", species, ids.name), make)
    return rows


def _agent_get(w: Any, node: ir.PlanNode, args: tuple[Any, ...]) -> Lanes:
    species, register = node.attrs
    row = _rows_of_ids(w, species, args[0])
    kind, is_alive = LANE_TYPE_BY_KIND[node.kind], row >= 0
    value = w.e.gather(w.base("other", species, register), w.e.where(is_alive, row, w.e.constant(0, I64)), kind)
    result: Lanes = w.e.where(is_alive, value, w.e.constant(0, kind))
    return result


def _agent_age(w: Any, node: ir.PlanNode, args: tuple[Any, ...]) -> Lanes:
    row = _rows_of_ids(w, node.attrs[0], args[0])
    is_alive = row >= 0
    born = w.e.gather(w.base("other", node.attrs[0], "frame of birth"), w.e.where(is_alive, row, w.e.constant(0, I64)), I64)
    age: Lanes = w.e.where(is_alive, _age_of(w, born), w.e.constant(0.0, F32))
    return age


def _agent_alive(w: Any, node: ir.PlanNode, args: tuple[Any, ...]) -> Lanes:
    return _rows_of_ids(w, node.attrs[0], args[0]) >= 0


def _is_item_present(w: Any, items: str, item: Lanes) -> Lanes:
    """Return which numbers are those of existing items."""
    has_item: Lanes = (item >= 0) & (item < w.number(I32, "items", items))
    return has_item


def _item_get(w: Any, node: ir.PlanNode, args: tuple[Any, ...]) -> Lanes:
    items, attribute = node.attrs
    has_item = _is_item_present(w, items, args[0])
    value = w.e.gather(w.base("item", items, attribute), w.e.where(has_item, args[0], w.e.constant(0, I32)), F32)
    result: Lanes = w.e.where(has_item, value, w.e.constant(0.0, F32))
    return result


def _item_alive(w: Any, node: ir.PlanNode, args: tuple[Any, ...]) -> Lanes:
    return _is_item_present(w, node.attrs[0], args[0])


def _field_value(w: Any, node: ir.PlanNode, args: tuple[Any, ...]) -> Lanes:
    held = w.e.gather(w.base("field", node.attrs[0], "held"), own_cell(w, node.attrs[0]), F64)
    amount: Lanes = w.e.convert(held, F32)
    return amount


def _cells_ahead(w: Any, field: str, eights: int) -> Lanes:
    """Return the cells of the eight agents that are processed `eights` iterations later. Near the end, return the current
    cells."""
    e: LaneBuilder = w.e
    later = w.row + LANE_COUNT * eights
    return e.read(w.base("cell", field), e.where(later < w.end, later, w.row), I32)


def _prefetch(e: LaneBuilder, array: Lanes, at: Lanes, size: int) -> None:
    """Prefetch `size` bytes of an array from an index on. Any index is allowed."""
    e.prefetch(e.address(array, e.convert(at, I64) * size, I8))


def prefetch_cells(w: Any, field: str, array: Lanes, size: int, eights: int = 1) -> None:
    """Prefetch the array elements (`size` bytes each) for the cells of agents that are processed `eights` iterations later."""
    e: LaneBuilder = w.e
    cells = _cells_ahead(w, field, eights)
    for lane in range(LANE_COUNT):
        _prefetch(e, array, e.one(cells, lane), size)


def _prefetch_neighbour_cells(w: Any, field: str, held: Lanes, positions: Lanes, block: Lanes, count: int) -> None:
    """Prefetch amounts and positions of the cells around the next eight agents, and the cell lists of the eight after them."""
    e: LaneBuilder = w.e
    prefetch_cells(w, field, block, 4 * count, 2)
    cells = _cells_ahead(w, field, 1)
    known = e.where((cells >= 0) & (cells < w.number(I32, "cells", field)), cells, e.constant(0, I32))
    for lane in range(LANE_COUNT):
        around = e.address(block, e.convert(e.one(known, lane), I64) * count, I32)
        for k in range(0, count, _CELL_STRIDE):
            cell = e.read_one(around, k, I32)
            _prefetch(e, held, cell, 8)
            _prefetch(e, positions, cell, 16)


def _first_strongest(e: LaneBuilder, held: Lanes, cells: Lanes, count: int, own: Lanes) -> tuple[Lanes, Lanes]:
    """Return the greatest amount in the `count` cells of a list, and the first cell that has it. NaN counts as 0.

    If no amount is above 0, return 0 and the own cell."""
    none = e.constant(0.0, F64)
    eights = []
    for first in range(0, count, LANE_COUNT):
        indices = range(first, min(first + LANE_COUNT, count))
        amounts = e.combine_lanes((e.read_one(held, e.convert(e.read_one(cells, k, I32), I64), F64) for k in indices), onto=none)
        eights.append(e.where(amounts > none, amounts, none))
    most = eights[0]
    for each in eights[1:]:
        most = e.where(each > most, each, most)
    for half in (4, 2, 1):
        other = e.turned(most, half)
        most = e.where(other > most, other, most)
    where = e.constant(1 << count, I64, 1)  # at least one cell has the greatest amount
    for first, each in enumerate(eights):
        where = where | (e.mask_word(each == most) << LANE_COUNT * first)
    at = e.read_one(cells, e.op("cttz", I64, where), I32)
    best = e.one(most, 0)
    return best, e.where(best > 0.0, at, own)


def _field_strongest(w: Any, node: ir.PlanNode, args: tuple[Any, ...]) -> Any:
    """Return the greatest amount in the cells around each agent, and the position (mm) of its cell."""
    e: LaneBuilder = w.e
    field, count = node.attrs
    held, block, own = w.base("field", field, "held"), w.base("field", field, "block", int(count)), own_cell(w, field)
    positions = w.base("field", field, "places")
    has_cell = own < w.number(I32, "cells", field)
    most, where, home_cells = e.slot(F64, LANE_COUNT), e.slot(I32, LANE_COUNT), e.slot(I32, LANE_COUNT)
    e.put(most, e.constant(0.0, F64))
    e.put(where, own)
    e.put(home_cells, e.where(has_cell, own, e.constant(0, I32)))
    asks = e.mask_word(w.mask[-1] & has_cell)
    with e.inside(asks != 0):
        _prefetch_neighbour_cells(w, field, held, positions, block, int(count))
    with e.loop(LANE_COUNT) as lane, e.inside(e.has_bit(asks, lane)):  # cells of one agent are adjacent in memory
        mine = e.read_one(home_cells, lane, I32)
        best, at = _first_strongest(e, held, e.address(block, e.convert(mine, I64) * int(count), I32), int(count), mine)
        e.put(e.address(most, lane, F64), best)
        e.put(e.address(where, lane, I32), at)
    value, cell = e.load(most, F64, LANE_COUNT), e.load(where, I32, LANE_COUNT)
    small = e.convert(value, F32)
    nothing = ~(small > 0)
    parts = [small]
    for axis, has_cell in zip(AXES, load_quadruples(e, positions, cell), strict=False):
        mine = e.read(w.base("start", f"position.{axis}"), w.row, F32)
        parts.append(e.where(nothing, mine, has_cell))
    return tuple(parts)


def _clip_value(w: Any, node: ir.PlanNode, args: tuple[Any, ...]) -> Lanes:
    """Return a value from the table of the clips of each agent's body. A body's last entry is for unknown clips."""
    e: LaneBuilder = w.e
    last = e.constant(len(w.code.species.clips), I32)
    number = e.where((args[0] >= 0) & (args[0] < last), args[0], last)
    number = number + e.read(w.base("clip body"), w.row, I32)
    value: Lanes = e.gather(w.base("clip", node.attrs[0]), number, F32)
    return value


NATIVE_LOWERERS: Mapping[str, NodeLowerer] = {
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


def _may_hit(w: Any, node: ir.PlanNode, args: tuple[Any, ...]) -> Lanes:
    """Return which agents may hit the obstacle with a ray."""
    reach = args[3]
    clear = w.e.read(w.base("clear", node.attrs[0]), w.row, F32)
    is_near: Lanes = (reach > 0) & (reach < np.inf) & may_touch(clear, reach)
    return is_near


# For called senses: which agents need the call, and the result of the others.
GUARDED_SENSES: Mapping[str, tuple[NodeLowerer, tuple[Any, ...]]] = {"ray": (_may_hit, NO_HIT)}
SENSES_CALLED_ON_MOVING_GROUND = frozenset(("field.strongest",))  # its positions rotate with moving ground, so it is called there
PAIR_SENSES = frozenset(
    ("agent.get", "agent.age", "agent.alive", "item.get", "item.alive")
)  # these may depend on the other agent of a pair
