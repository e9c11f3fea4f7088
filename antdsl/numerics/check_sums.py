"""CRC-32, as zip files and `zlib` have it, by products without carry where the processor has them.

The method is that of V. Gopal, E. Ozturk, J. Guilford, G. Wolrich, W. Feghali, M. Dixon, D. Karakoyunlu, Fast CRC Computation for
Generic Polynomials Using PCLMULQDQ Instruction, Intel 2009: what has been read is kept as four registers with the same remainder
as all of it. To go on by so many bits, each half of 16 bytes of them is multiplied by the remainder of x to that power. What is
left in the end, 16 bytes, `zlib` finishes with the rest. A register has 16 bytes, or 64 where the products of as many are made at
once (VPCLMULQDQ) and registers of that width slow nothing down (`machine`), which is almost three times as fast."""

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
_BLOCK = 16  # bytes of a factor
_REGISTERS = 4  # read at once
_ALL = 0xFFFFFFFF
_POLYNOMIAL = 0x104C11DB7
_FEATURE, _WIDE = "+pclmul", ("+vpclmulqdq", "+avx512vbmi2")  # as LLVM names them; the wide ones are used where `machine` does

Fold = Callable[[int, int, int], bytes]


def crc32(data: bytes | memoryview, before: int = 0) -> int:
    """The CRC-32 of `data`; with `before`, that of what comes before them, of both together. `data`: bytes in one piece."""
    data = memoryview(data).cast("B")
    if len(data) < LEAST or not compiled.running():
        return zlib.crc32(data, before)
    fold = _fold()
    if fold is None:
        return zlib.crc32(data, before)
    call, stride = fold
    whole = len(data) // stride
    kept = call(address(np.frombuffer(data, np.uint8)), whole, before ^ _ALL)
    return zlib.crc32(data[whole * stride :], zlib.crc32(kept, _ALL))


@cache
def _fold() -> tuple[Fold, int] | None:
    """What gives 16 bytes with the remainder of so many strides from an address on, after a remainder, and the bytes of a stride;
    None where the processor has no products without carry."""
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
    return fold, _REGISTERS * _BLOCK * blocks(target)


def has_products(target: machine.Target) -> bool:
    """Whether a processor has products without carry."""
    return target.x86 and _FEATURE in target.features.split(",")


def blocks(target: machine.Target) -> int:
    """How many blocks a register has that products are made of at once."""
    return 4 if set(_WIDE) <= set(target.features.split(",")) else 1


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
    module, many = Module(target), blocks(target)
    kinds = {count: (f"<{2 * count} x i64>", "" if count == 1 else f".{128 * count}") for count in {1, many}}
    for kind, ending in kinds.values():
        module.declare(f"llvm.x86.pclmulqdq{ending}", kind, [kind, kind, "i8"])
    wide, _ = kinds[many]
    numbers = iter(range(1000))
    lines: list[str] = []

    def put(value: str) -> str:
        name = f"%v{next(numbers)}"
        lines.append(f"  {name} = {value}")
        return name

    def loaded(at: str, register: int) -> str:
        where = put(f"getelementptr i8, ptr {at}, i64 {_BLOCK * many * register}")
        return put(f"load {wide}, ptr {where}, align 1")

    def moved(kept: str, bits: int, onto: str, count: int) -> str:
        """What is kept in so many blocks, so many bits further on, together with what stands there."""
        kind, ending = kinds[count]
        by = f"{kind} <" + ", ".join([f"i64 {_power(bits + 32)}, i64 {_power(bits - 32)}"] * count) + ">"
        call = f"call {kind} @llvm.x86.pclmulqdq{ending}({kind} {kept}, {by}, i8"
        low, high = (put(f"{call} {which})") for which in (0x00, 0x11))
        return put(f"xor {kind} {put(f'xor {kind} {low}, {high}')}, {onto}")

    place = put("load ptr, ptr %t")
    words = [put(f"load i64, ptr {put(f'getelementptr i64, ptr %t, i64 {k}')}") for k in (1, 2)]
    first = [loaded(place, register) for register in range(_REGISTERS)]
    first[0] = put(f"xor {wide} {first[0]}, {put(f'insertelement {wide} zeroinitializer, i64 {words[1]}, i64 0')}")
    lines.append("  br label %head\nhead:")
    kept = [f"%kept{register}" for register in range(_REGISTERS)]
    lines.append("  %done = phi i64 [ 1, %inside ], [ %next, %turn ]")
    lines += [f"  {kept[k]} = phi {wide} [ {first[k]}, %inside ], [ %then{k}, %turn ]" for k in range(_REGISTERS)]
    lines.append(f"  %more = icmp slt i64 %done, {words[0]}\n  br i1 %more, label %turn, label %last\nturn:")
    at = put(f"getelementptr i8, ptr {place}, i64 {put(f'mul i64 %done, {_REGISTERS * _BLOCK * many}')}")
    for k in range(_REGISTERS):
        then = moved(kept[k], 8 * _REGISTERS * _BLOCK * many, loaded(at, k), many)
        lines.append(f"  %then{k} = bitcast {wide} {then} to {wide}")
    lines.append("  %next = add i64 %done, 1\n  br label %head\nlast:")
    found = kept[0]
    for k in range(1, _REGISTERS):
        found = moved(found, 8 * _BLOCK * many, kept[k], many)
    parts = [put(f"shufflevector {wide} {found}, {wide} poison, <2 x i32> <i32 {2 * k}, i32 {2 * k + 1}>") for k in range(many)]
    found = parts[0]
    for part in parts[1:]:
        found = moved(found, 8 * _BLOCK, part, 1)
    lines.append(f"  store <2 x i64> {found}, ptr {put('getelementptr i64, ptr %t, i64 3')}, align 8")
    body = "  br label %inside\ninside:\n" + "\n".join(lines)
    return module.text() + "\n" + entry(module, "fold", body) + "\n"
