"""Four floats that lie side by side, of eight lanes: out of memory, and put together for it."""

from __future__ import annotations

from collections.abc import Sequence

from antdsl.machine_code.emitter import Emitter
from antdsl.machine_code.lanes import F32, I64, PTR, WIDTH, Lanes

FOUR = "<4 x float>"


def _shuffled(e: Emitter, a: str, b: str, width: int, order: Sequence[int]) -> str:
    """Some values of two vectors of a width, by their places in both."""
    text = ", ".join(f"i32 {k}" for k in order)
    type = f"<{width} x float>"
    return e.op(f"shufflevector {type} {a}, {type} {b}, <{len(order)} x i32> <{text}>", F32).name


def quadruples(e: Emitter, base: Lanes, index: Lanes) -> list[Lanes]:
    """Of an array of four floats each the four of every lane's index (i32)."""
    return _columns(
        e, [four_at(e, base, e.one(f"extractelement {index.typed}, i64 {lane}", index.kind)) for lane in range(WIDTH)]
    )


def quadruples_from(e: Emitter, base: Lanes, index: Lanes) -> list[Lanes]:
    """Of an array of four floats each the four of eight in a row from a single index on."""
    first = four_at(e, base, index).name
    return _columns(e, [Lanes(e, PTR, e.field(first, 16 * lane), one=True) for lane in range(WIDTH)])


def _columns(e: Emitter, places: list[Lanes]) -> list[Lanes]:
    rows = [e.op(f"load {FOUR}, ptr {place.name}, align 4", F32).name for place in places]
    a, b, c, d = (_shuffled(e, rows[k], rows[k + 4], 4, range(8)) for k in range(4))
    low, high = (0, 8, 1, 9, 4, 12, 5, 13), (2, 10, 3, 11, 6, 14, 7, 15)
    halves = [(_shuffled(e, a, b, 8, order), _shuffled(e, c, d, 8, order)) for order in (low, high)]
    even, odd = (0, 1, 8, 9, 4, 5, 12, 13), (2, 3, 10, 11, 6, 7, 14, 15)
    return [Lanes(e, F32, _shuffled(e, x, y, 8, order)) for x, y in halves for order in (even, odd)]


def put_quadruples(e: Emitter, base: Lanes, index: Lanes, values: list[Lanes]) -> None:
    """Put four values of every lane side by side into an array of four floats each, at its index (i32)."""
    zipped = [k // 2 + k % 2 * WIDTH for k in range(2 * WIDTH)]
    halves = (zipped[:WIDTH], zipped[WIDTH:])
    one, other = ([_shuffled(e, a.name, b.name, WIDTH, half) for half in halves] for a, b in (values[:2], values[2:]))
    for lane in range(WIDTH):
        half, first = lane // 4, lane % 4 * 2
        four = _shuffled(e, one[half], other[half], WIDTH, (first, first + 1, first + WIDTH, first + 1 + WIDTH))
        place = four_at(e, base, e.one(f"extractelement {index.typed}, i64 {lane}", index.kind))
        e.do(f"store {FOUR} {four}, ptr {place.name}, align 4")


def four_at(e: Emitter, base: Lanes, index: Lanes) -> Lanes:
    """Where the four of a single index lie."""
    return e.one(f"getelementptr {FOUR}, ptr {base.name}, i64 {e.convert(index, I64).name}", PTR)
