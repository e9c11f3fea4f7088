"""Four floats that lie side by side, of eight lanes: out of memory, and put together for it."""

from __future__ import annotations

from antdsl.machine_code.kinds import F32, I64, WIDTH
from antdsl.machine_code.lanes import LaneBuilder, Lanes

_FOUR, _ALIGNED = f"<4 x {F32}>", ", align 4"


def quadruples(e: LaneBuilder, base: Lanes, index: Lanes) -> list[Lanes]:
    """Of an array of four floats each the four of every lane's index (i32)."""
    return _columns(e, [four_at(e, base, e.one(index, lane)) for lane in range(WIDTH)])


def quadruples_from(e: LaneBuilder, base: Lanes, index: Lanes) -> list[Lanes]:
    """Of an array of four floats each the four of eight in a row from a single index on."""
    first = four_at(e, base, index)
    return _columns(e, [e.field(first, 16 * lane) for lane in range(WIDTH)])


def _columns(e: LaneBuilder, places: list[Lanes]) -> list[Lanes]:
    return e.columns([e.op("load", F32, place, x=_ALIGNED, lanes=4) for place in places])


def put_quadruples(e: LaneBuilder, base: Lanes, index: Lanes, values: list[Lanes]) -> None:
    """Put four values of every lane side by side into an array of four floats each, at its index (i32)."""
    zipped = [k // 2 + k % 2 * WIDTH for k in range(2 * WIDTH)]
    halves = (zipped[:WIDTH], zipped[WIDTH:])
    one, other = ([e.mixed(a, b, half) for half in halves] for a, b in (values[:2], values[2:]))
    for lane in range(WIDTH):
        half, first = lane // 4, lane % 4 * 2
        four = e.mixed(one[half], other[half], (first, first + 1, first + WIDTH, first + 1 + WIDTH))
        put_four(e, base, e.one(index, lane), four)


def put_four(e: LaneBuilder, base: Lanes, index: Lanes, four: Lanes) -> None:
    """Put four floats at a single index."""
    e.do("store", four, four_at(e, base, index), x=_ALIGNED)


def four_at(e: LaneBuilder, base: Lanes, index: Lanes) -> Lanes:
    """Where the four of a single index lie."""
    return e.address(base, e.convert(index, I64), _FOUR)
