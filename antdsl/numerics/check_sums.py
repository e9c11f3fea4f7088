"""CRC-32, as zip files and `zlib` have it, by products without carry where the processor has them.

The method is that of V. Gopal, E. Ozturk, J. Guilford, G. Wolrich, W. Feghali, M. Dixon, D. Karakoyunlu, Fast CRC Computation for
Generic Polynomials Using PCLMULQDQ Instruction, Intel 2009: what has been read is kept as 64 bytes with the same remainder as all
of it. To go on by so many bits, each half of 16 of them is multiplied by the remainder of x to that power. What is left in the
end, 16 bytes, `zlib` finishes with the rest."""

from __future__ import annotations

import ctypes
import zlib
from collections.abc import Callable
from functools import cache

import numpy as np

from antdsl.machine_code import codes, machine
from antdsl.machine_code.entries import entry
from antdsl.machine_code.lanes import Module
from antdsl.machine_code.memory import address
from antdsl.numerics import compiled

LEAST = 16_384  # bytes; of fewer the call takes as long as it saves
_STRIDE, _BLOCK = 64, 16  # bytes read at once, and in one register
_ALL = 0xFFFFFFFF
_POLYNOMIAL = 0x104C11DB7
_FEATURE = "+pclmul"  # as LLVM names it

Fold = Callable[[int, int, int], bytes]


def crc32(data: bytes | memoryview, before: int = 0) -> int:
    """The CRC-32 of `data`; with `before`, that of what comes before them, of both together. `data`: bytes in one piece."""
    data = memoryview(data).cast("B")
    if len(data) < LEAST or not compiled.running():
        return zlib.crc32(data, before)
    fold = _fold()
    if fold is None:
        return zlib.crc32(data, before)
    whole = len(data) // _STRIDE
    kept = fold(address(np.frombuffer(data, np.uint8)), whole, before ^ _ALL)
    return zlib.crc32(data[whole * _STRIDE :], zlib.crc32(kept, _ALL))


@cache
def _fold() -> Fold | None:
    """What gives 16 bytes with the remainder of so many strides of 64 bytes from an address on, after a remainder; None where
    the processor has no products without carry."""
    target = machine.host()
    if not has_products(target):
        return None
    code = codes.code(text(target))
    function = code.function("fold")  # what is called lies in `code`

    words = ctypes.c_int64 * 5

    def fold(place: int, strides: int, before: int) -> bytes:
        table = words(place, strides, before)
        at = ctypes.addressof(table)
        function(at, 0, 0)
        return ctypes.string_at(at + 8 * 3, _BLOCK)

    fold.code = code  # type: ignore[attr-defined]
    return fold


def has_products(target: machine.Target) -> bool:
    """Whether a processor has products without carry."""
    return target.x86 and _FEATURE in target.features.split(",")


def _power(bits: int) -> int:
    """The remainder of x to a power by the polynomial, as it is multiplied by: its bits in the order in which bytes have them,
    and one further."""
    found = 1
    for _ in range(bits):
        found <<= 1
        found ^= _POLYNOMIAL if found >> 32 else 0
    return int(f"{found:032b}"[::-1], 2) << 1


def text(target: machine.Target) -> str:
    """What is compiled, in LLVM's language: a function of a table with the address, the number of strides (one or more) and the
    remainder before them, which puts 16 bytes behind these."""
    module = Module(target)
    module.declare("llvm.x86.pclmulqdq", "<2 x i64>", ["<2 x i64>", "<2 x i64>", "i8"])
    numbers = iter(range(1000))
    lines: list[str] = []

    def put(value: str) -> str:
        name = f"%v{next(numbers)}"
        lines.append(f"  {name} = {value}")
        return name

    def loaded(at: str, block: int) -> str:
        where = put(f"getelementptr i8, ptr {at}, i64 {_BLOCK * block}")
        return put(f"load <2 x i64>, ptr {where}, align 1")

    def moved(kept: str, bits: int, onto: str) -> str:
        """What is kept, so many bits further on, together with what stands there."""
        by = f"<2 x i64> <i64 {_power(bits + 32)}, i64 {_power(bits - 32)}>"
        low, high = (put(f"call <2 x i64> @llvm.x86.pclmulqdq(<2 x i64> {kept}, {by}, i8 {which})") for which in (0x00, 0x11))
        return put(f"xor <2 x i64> {put(f'xor <2 x i64> {low}, {high}')}, {onto}")

    place = put("load ptr, ptr %t")
    words = [put(f"load i64, ptr {put(f'getelementptr i64, ptr %t, i64 {k}')}") for k in (1, 2)]
    first = [loaded(place, block) for block in range(4)]
    first[0] = put(f"xor <2 x i64> {first[0]}, {put(f'insertelement <2 x i64> zeroinitializer, i64 {words[1]}, i64 0')}")
    lines.append("  br label %head\nhead:")
    kept = [f"%kept{block}" for block in range(4)]
    lines.append("  %done = phi i64 [ 1, %inside ], [ %next, %turn ]")
    lines += [f"  {kept[block]} = phi <2 x i64> [ {first[block]}, %inside ], [ %then{block}, %turn ]" for block in range(4)]
    lines.append(f"  %more = icmp slt i64 %done, {words[0]}\n  br i1 %more, label %turn, label %last\nturn:")
    at = put(f"getelementptr i8, ptr {place}, i64 {put(f'shl i64 %done, {_STRIDE.bit_length() - 1}')}")
    for block in range(4):
        then = moved(kept[block], 8 * _STRIDE, loaded(at, block))
        lines.append(f"  %then{block} = bitcast <2 x i64> {then} to <2 x i64>")
    lines.append("  %next = add i64 %done, 1\n  br label %head\nlast:")
    found = kept[0]
    for block in range(1, 4):
        found = moved(found, 8 * _BLOCK, kept[block])
    lines.append(f"  store <2 x i64> {found}, ptr {put('getelementptr i64, ptr %t, i64 3')}, align 8")
    body = "  br label %inside\ninside:\n" + "\n".join(lines)
    return module.text() + "\n" + entry(module, "fold", body) + "\n"
