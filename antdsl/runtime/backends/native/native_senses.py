"""Machine code for senses: the operations of `runtime.sensing` that only read arrays. All other senses are called between
stages."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from antdsl.machine_code.kernels.values import format_llvm_type
from antdsl.machine_code.lanes import LaneBuilder, Lanes
from antdsl.machine_code.number_kinds import BOOL, F32, F64, I8, I32, I64, LANE_COUNT, PTR
from antdsl.numerics import randomness
from antdsl.numerics.randomness import UNIT_FLOAT_STEP
from antdsl.plan import ir
from antdsl.runtime.backends.native.address_layout import LANE_TYPE_BY_KIND
from antdsl.runtime.backends.native.block_writer import FunctionWriter, NodeLowerer
from antdsl.runtime.backends.native.field_threshold import emit_own_cell
from antdsl.runtime.backends.native.float4 import emit_quadruple_loads
from antdsl.runtime.moving.clearance.obstacle_clearance import is_contact_possible
from antdsl.runtime.sensing.world_senses import NO_HIT
from antdsl.runtime.world import AXES

_CELL_STRIDE = 4  # neighbour cells are sorted: about this many share a cache line


def _emit_register(w: Any, node: ir.PlanNode, args: tuple[Any, ...]) -> Lanes:
    """Return a register of the agent itself: its current value, or its value at the start of the step."""
    value: Lanes = w.builder.load_lanes(
        w.emit_array_address("start" if node.op == "snap" else "now", node.attrs[0]), w.row, LANE_TYPE_BY_KIND[node.kind]
    )
    return value


def _emit_id(w: Any, node: ir.PlanNode, args: tuple[Any, ...]) -> Lanes:
    ids: Lanes = w.builder.load_lanes(w.emit_array_address("ids"), w.row, I64)
    return ids


def _emit_age(w: Any, node: ir.PlanNode, args: tuple[Any, ...]) -> Lanes:
    return _emit_age_from_birth(w, w.builder.load_lanes(w.emit_array_address("born"), w.row, I64))


def _emit_age_from_birth(w: Any, birth_frames: Lanes) -> Lanes:
    """Return the age (s) of agents, given the frames in which they were born."""
    frames = w.emit_uniform_value(I64, "frame") - birth_frames
    frame_count = w.builder.convert(
        w.builder.select_lanes(frames > 0, frames, w.builder.make_constant(0, I64)), I32
    )  # a run has far fewer than 2**31 frames
    age: Lanes = w.builder.convert(w.builder.convert(frame_count, F64) * w.emit_uniform_value(F64, "dt"), F32)
    return age


def _emit_random_words(w: Any, site: str, block: int) -> list[Lanes]:
    """Return four random words for each agent, which depend on its id and the `site` in the program. `block`: the index of the
    four."""

    def emit_words() -> list[Lanes]:
        e, wide = w.builder, format_llvm_type(I64, LANE_COUNT)
        out = e.allocate(4, wide)
        shared = [
            w.emit_uniform_value(I64, "philox", w.species, site, block, word, is_scalar=True)
            for word in ("first", "low", "last", "k0", "k1")
        ]
        ids = _emit_id(w, None, ())  # type: ignore[arg-type]
        e.emit_void("call", ids, *shared, out, x=f"@{_get_philox_function(w)}")
        return [e.load(e.address(out, k, wide), I64, LANE_COUNT) for k in range(4)]

    words: list[Lanes] = w.builder.get_or_make(("words", site, block), emit_words)
    return words


def _get_philox_function(w: FunctionWriter) -> str:
    """Return the name of the function that computes four random words of eight agents."""
    name = "philox"
    if name not in w.module.functions:
        e = LaneBuilder(w.module)
        ids, out = e.named_number(I64, "%ids", LANE_COUNT), e.named_number(PTR, "%out")
        shared = [e.named_number(I64, f"%{each}") for each in ("first", "low", "last", "k0", "k1")]
        first, low, last, k0, k1 = map(e.broadcast, shared)
        words: Any = randomness.draw_words_of_ids(ids, first, low, last, (k0, k1))
        for k, word in enumerate(words):
            e.store_number(e.address(out, k, format_llvm_type(I64, LANE_COUNT)), word)
        e.end(name, (ids, *shared, out), attribute="noinline")
    return name


def _emit_draw(w: Any, node: ir.PlanNode, args: tuple[Any, ...]) -> Lanes:
    site, index = node.attrs
    word = _emit_random_words(w, site, index >> 2)[index & 3]
    small: Lanes = w.builder.convert(
        w.builder.convert(word >> 8, I32), F32
    )  # 24 bits: as whole numbers of 32 bits they convert faster
    return small * UNIT_FLOAT_STEP


def _emit_drawn_agent(w: Any, node: ir.PlanNode, args: tuple[Any, ...]) -> Lanes:
    site, species = node.attrs
    word = _emit_random_words(w, site, 0)[0]
    count = w.emit_uniform_value(I64, "agents", species)
    at = (word * count) >> 32
    agent_id = w.builder.gather(w.emit_array_address("other", species, "sorted ids"), at, I64)
    none: Lanes = w.builder.select_lanes(count == 0, w.builder.make_constant(-1, I64), agent_id)
    return none


def _emit_event(w: Any, node: ir.PlanNode, args: tuple[Any, ...]) -> Lanes:
    has_event: Lanes = w.builder.load_lanes(w.emit_array_address("event", node.attrs[0]), w.row, BOOL)
    return has_event


def _emit_touched_surface(w: Any, node: ir.PlanNode, args: tuple[Any, ...]) -> Lanes:
    is_touching: Lanes = w.builder.load_lanes(w.emit_array_address("mesh"), w.row, I64) == w.emit_uniform_value(
        I64, "surface", node.attrs[0]
    )
    return is_touching


def _emit_rows_of_ids(w: Any, species: str, ids: Lanes) -> Lanes:
    """Return the row of each id; -1 for dead agents and for no agent. All lanes bisect the sorted ids at once."""
    e: LaneBuilder = w.builder

    def emit_rows() -> Lanes:
        known, order = (
            w.emit_array_address("other", species, "sorted ids"),
            w.emit_array_address("other", species, "rows of sorted ids"),
        )
        count = w.emit_uniform_value(I64, "agents", species)
        at, step = e.allocate_slot(I64, LANE_COUNT), e.allocate_slot(I64)
        e.store_number(at, e.make_constant(0, I64))
        e.store_number(step, w.emit_uniform_value(I64, "half", species, is_scalar=True))
        with e.write_loop(w.emit_uniform_value(I64, "turns", species, is_scalar=True)):
            size, place = e.load(step, I64), e.load(at, I64, LANE_COUNT)
            ahead = place + size
            inside = ahead < count
            probe = e.gather(known, e.select_lanes(inside, ahead, e.make_constant(0, I64)), I64)
            e.store_number(at, e.select_lanes(inside & (probe <= ids), ahead, place))
            e.store_number(step, size >> 1)
        place = e.load(at, I64, LANE_COUNT)
        is_alive = (e.gather(known, place, I64) == ids) & (count > 0)
        return e.select_lanes(is_alive, e.gather(order, place, I64), e.make_constant(-1, I64))

    rows: Lanes = e.get_or_make(("row of", species, ids.name), emit_rows)
    return rows


def _emit_agent_register(w: Any, node: ir.PlanNode, args: tuple[Any, ...]) -> Lanes:
    species, register = node.attrs
    row = _emit_rows_of_ids(w, species, args[0])
    kind, is_alive = LANE_TYPE_BY_KIND[node.kind], row >= 0
    value = w.builder.gather(
        w.emit_array_address("other", species, register),
        w.builder.select_lanes(is_alive, row, w.builder.make_constant(0, I64)),
        kind,
    )
    result: Lanes = w.builder.select_lanes(is_alive, value, w.builder.make_constant(0, kind))
    return result


def _emit_agent_age(w: Any, node: ir.PlanNode, args: tuple[Any, ...]) -> Lanes:
    row = _emit_rows_of_ids(w, node.attrs[0], args[0])
    is_alive = row >= 0
    born = w.builder.gather(
        w.emit_array_address("other", node.attrs[0], "frame of birth"),
        w.builder.select_lanes(is_alive, row, w.builder.make_constant(0, I64)),
        I64,
    )
    age: Lanes = w.builder.select_lanes(is_alive, _emit_age_from_birth(w, born), w.builder.make_constant(0.0, F32))
    return age


def _emit_agent_alive(w: Any, node: ir.PlanNode, args: tuple[Any, ...]) -> Lanes:
    return _emit_rows_of_ids(w, node.attrs[0], args[0]) >= 0


def _emit_item_presence(w: Any, items: str, item: Lanes) -> Lanes:
    """Return a mask of the lanes in which `item` is the number of an existing item."""
    has_item: Lanes = (item >= 0) & (item < w.emit_uniform_value(I32, "items", items))
    return has_item


def _emit_item_amount(w: Any, node: ir.PlanNode, args: tuple[Any, ...]) -> Lanes:
    items, attribute = node.attrs
    has_item = _emit_item_presence(w, items, args[0])
    value = w.builder.gather(
        w.emit_array_address("item", items, attribute),
        w.builder.select_lanes(has_item, args[0], w.builder.make_constant(0, I32)),
        F32,
    )
    result: Lanes = w.builder.select_lanes(has_item, value, w.builder.make_constant(0.0, F32))
    return result


def _emit_item_alive(w: Any, node: ir.PlanNode, args: tuple[Any, ...]) -> Lanes:
    return _emit_item_presence(w, node.attrs[0], args[0])


def _emit_field_value(w: Any, node: ir.PlanNode, args: tuple[Any, ...]) -> Lanes:
    held = w.builder.gather(w.emit_array_address("field", node.attrs[0], "padded_values"), emit_own_cell(w, node.attrs[0]), F64)
    amount: Lanes = w.builder.convert(held, F32)
    return amount


def _load_cells_of_later_rows(w: Any, field: str, eights: int) -> Lanes:
    """Return the cells of the agents processed `eights` iterations later; near the end of the loop, the current cells."""
    e: LaneBuilder = w.builder
    later = w.row + LANE_COUNT * eights
    return e.load_lanes(w.emit_array_address("cell", field), e.select_lanes(later < w.end, later, w.row), I32)


def _prefetch_elements(e: LaneBuilder, array: Lanes, at: Lanes, size: int) -> None:
    """Emit code that prefetches `size` bytes of an array from index `at` on. The index may be outside the array."""
    e.prefetch(e.address(array, e.convert(at, I64) * size, I8))


def prefetch_cell_amounts(w: Any, field: str, array: Lanes, size: int, eights: int = 1) -> None:
    """Emit code that prefetches what `array` has for the cells of agents `eights` iterations later. `size`: bytes per cell."""
    e: LaneBuilder = w.builder
    cells = _load_cells_of_later_rows(w, field, eights)
    for lane in range(LANE_COUNT):
        _prefetch_elements(e, array, e.extract_lane(cells, lane), size)


def _prefetch_neighbour_cells(w: Any, field: str, amounts: Lanes, positions: Lanes, block: Lanes, count: int) -> None:
    """Emit code that prefetches amounts and positions around the next eight agents, and cell lists of the eight after them."""
    e: LaneBuilder = w.builder
    prefetch_cell_amounts(w, field, block, 4 * count, 2)
    cells = _load_cells_of_later_rows(w, field, 1)
    known = e.select_lanes((cells >= 0) & (cells < w.emit_uniform_value(I32, "cells", field)), cells, e.make_constant(0, I32))
    for lane in range(LANE_COUNT):
        around = e.address(block, e.convert(e.extract_lane(known, lane), I64) * count, I32)
        for k in range(0, count, _CELL_STRIDE):
            cell = e.load_scalar(around, k, I32)
            _prefetch_elements(e, amounts, cell, 8)
            _prefetch_elements(e, positions, cell, 16)


def _emit_first_strongest(e: LaneBuilder, cell_amounts: Lanes, cells: Lanes, count: int, own_cells: Lanes) -> tuple[Lanes, Lanes]:
    """Return the greatest amount in the first `count` cells of a list, and the first cell with this amount. NaN counts as 0.

    If no amount is positive, return 0 and the agent's own cell."""
    none = e.make_constant(0.0, F64)
    eights = []
    for first in range(0, count, LANE_COUNT):
        indices = range(first, min(first + LANE_COUNT, count))
        amounts = e.combine_lanes(
            (e.load_scalar(cell_amounts, e.convert(e.load_scalar(cells, k, I32), I64), F64) for k in indices), base_vector=none
        )
        eights.append(e.select_lanes(amounts > none, amounts, none))
    most = eights[0]
    for each in eights[1:]:
        most = e.select_lanes(each > most, each, most)
    for half in (4, 2, 1):
        other = e.rotate_lanes(most, half)
        most = e.select_lanes(other > most, other, most)
    where = e.make_constant(1 << count, I64, 1)  # at least one cell has the greatest amount
    for first, each in enumerate(eights):
        where = where | (e.mask_to_i64(each == most) << LANE_COUNT * first)
    at = e.load_scalar(cells, e.op("cttz", I64, where), I32)
    best = e.extract_lane(most, 0)
    return best, e.select_lanes(best > 0.0, at, own_cells)


def _emit_field_strongest(w: Any, node: ir.PlanNode, args: tuple[Any, ...]) -> Any:
    """Return the greatest amount of a field in the cells around each agent, and the position (mm) of its cell."""
    e: LaneBuilder = w.builder
    field, count = node.attrs
    held, block, own = (
        w.emit_array_address("field", field, "padded_values"),
        w.emit_array_address("field", field, "block", int(count)),
        emit_own_cell(w, field),
    )
    positions = w.emit_array_address("field", field, "places")
    has_cell = own < w.emit_uniform_value(I32, "cells", field)
    most, where, home_cells = e.allocate_slot(F64, LANE_COUNT), e.allocate_slot(I32, LANE_COUNT), e.allocate_slot(I32, LANE_COUNT)
    e.store_number(most, e.make_constant(0.0, F64))
    e.store_number(where, own)
    e.store_number(home_cells, e.select_lanes(has_cell, own, e.make_constant(0, I32)))
    asks = e.mask_to_i64(w.mask[-1] & has_cell)
    with e.write_if(asks != 0):
        _prefetch_neighbour_cells(w, field, held, positions, block, int(count))
    with e.write_loop(LANE_COUNT) as lane, e.write_if(e.emit_bit_test(asks, lane)):  # cells of one agent are adjacent in memory
        mine = e.load_scalar(home_cells, lane, I32)
        best, at = _emit_first_strongest(e, held, e.address(block, e.convert(mine, I64) * int(count), I32), int(count), mine)
        e.store_number(e.address(most, lane, F64), best)
        e.store_number(e.address(where, lane, I32), at)
    value, cell = e.load(most, F64, LANE_COUNT), e.load(where, I32, LANE_COUNT)
    small = e.convert(value, F32)
    nothing = ~(small > 0)
    parts = [small]
    for axis, has_cell in zip(AXES, emit_quadruple_loads(e, positions, cell), strict=False):
        mine = e.load_lanes(w.emit_array_address("start", f"position.{axis}"), w.row, F32)
        parts.append(e.select_lanes(nothing, mine, has_cell))
    return tuple(parts)


def _emit_clip_value(w: Any, node: ir.PlanNode, args: tuple[Any, ...]) -> Lanes:
    """Return a value from the clip table of each agent's body. The last entry for each body is for unknown clips."""
    e: LaneBuilder = w.builder
    last = e.make_constant(len(w.code.species.clips), I32)
    number = e.select_lanes((args[0] >= 0) & (args[0] < last), args[0], last)
    number = number + e.load_lanes(w.emit_array_address("clip body"), w.row, I32)
    value: Lanes = e.gather(w.emit_array_address("clip", node.attrs[0]), number, F32)
    return value


NATIVE_LOWERERS: Mapping[str, NodeLowerer] = {
    "snap": _emit_register,
    "load": _emit_register,
    "id": _emit_id,
    "age": _emit_age,
    "draw": _emit_draw,
    "draw.agent": _emit_drawn_agent,
    "event": _emit_event,
    "surface.touching": _emit_touched_surface,
    "agent.get": _emit_agent_register,
    "agent.age": _emit_agent_age,
    "agent.alive": _emit_agent_alive,
    "item.get": _emit_item_amount,
    "item.alive": _emit_item_alive,
    "field.value": _emit_field_value,
    "field.strongest": _emit_field_strongest,
    "clip.value": _emit_clip_value,
}


def _emit_may_ray_hit(w: Any, node: ir.PlanNode, args: tuple[Any, ...]) -> Lanes:
    """Return a mask of the agents with a feeler that may hit the obstacle."""
    reach = args[3]
    clear = w.builder.load_lanes(w.emit_array_address("clear", node.attrs[0]), w.row, F32)
    is_near: Lanes = (reach > 0) & (reach < np.inf) & is_contact_possible(clear, reach)
    return is_near


# For called senses: which agents need the call, and the result of the others.
GUARDED_SENSES: Mapping[str, tuple[NodeLowerer, tuple[Any, ...]]] = {"ray": (_emit_may_ray_hit, NO_HIT)}
SENSES_CALLED_ON_MOVING_GROUND = frozenset(("field.strongest",))  # its positions rotate with moving ground, so it is called there
PAIR_SENSES = frozenset(
    ("agent.get", "agent.age", "agent.alive", "item.get", "item.alive")
)  # these may depend on the other agent of a pair
