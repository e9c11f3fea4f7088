"""CRC-32 checksums, the same as in zip files and `zlib`. They are computed with carry-less multiplications if the processor
supports these. The method is that of V. Gopal, E. Ozturk, J. Guilford, G. Wolrich, W. Feghali, M. Dixon, D. Karakoyunlu, Fast CRC
Computation for Generic Polynomials Using PCLMULQDQ Instruction, Intel 2009. Four registers stand for the data read so far: read
as polynomials, the registers and the data have the same remainder. The registers consist of blocks of 16 bytes. To advance a
block by n bits, each of its halves is multiplied by the remainder of x**n. At the end, the last 16 bytes of state and the
remaining data (fewer than 16 bytes) are processed byte by byte with a table. A register has 16 bytes, or 64 bytes if the
processor can multiply 64 bytes at once (VPCLMULQDQ) without slowing down. With 64 bytes, the computation is almost three times as
fast."""

from __future__ import annotations

import ctypes
import zlib
from collections.abc import Callable, Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code import llvm_compiler
from antdsl.machine_code.entry_functions import write_inner_function
from antdsl.machine_code.kernels.direct import ArgumentSpec, make_builtin
from antdsl.machine_code.kernels.direct.argument_text import INTEGER_KIND, RESULT_WORDS
from antdsl.machine_code.library import make_library_text
from antdsl.machine_code.llvm_module import LlvmModule
from antdsl.machine_code.memory import get_array_address

MIN_BYTES_FOR_KERNEL = 1_024  # for fewer bytes, the call costs as much as it saves
_BLOCK_BYTES = 16  # bytes of a factor
_REGISTERS_PER_STEP = 4  # registers read at once
_ALL_32_BITS = 0xFFFFFFFF
_CRC_POLYNOMIAL = 0x104C11DB7
_BYTE_DTYPE = np.dtype(np.uint8)
# Words of a call's table; the first also holds the result
_DATA_WORD, _LENGTH_WORD, _PREVIOUS_CRC_WORD = RESULT_WORDS, RESULT_WORDS + 1, RESULT_WORDS + 2
_CallTable = ctypes.c_int64 * (_PREVIOUS_CRC_WORD + 1)
# LLVM's names; `count_blocks_per_register` says which processors use the wide ones
_CARRYLESS_FEATURE, _WIDE_FEATURES = "+pclmul", ("+vpclmulqdq", "+avx512vbmi2")


def compute_crc32(data: bytes | memoryview, previous_crc: int = 0) -> int:
    """Return the CRC-32 of `data` (contiguous bytes).

    `previous_crc`: the CRC-32 of preceding bytes; the result then covers these bytes followed by `data`."""
    data = memoryview(data).cast("B")
    if len(data) < MIN_BYTES_FOR_KERNEL:
        return zlib.crc32(data, previous_crc)
    fold = _build_crc_function()
    return zlib.crc32(data, previous_crc) if fold is None else fold(np.frombuffer(data, _BYTE_DTYPE), previous_crc)


@cache
def _build_crc_function() -> Callable[[NDArray[np.uint8], int], int] | None:
    """Return a compiled function that continues a CRC-32; None if the processor has no carry-less multiplication or code
    cannot be compiled. The function takes an array [n] of at least one stride, and the CRC-32 of the preceding bytes."""
    if not llvm_compiler.is_available():
        return None
    target = llvm_compiler.find_host_target()
    if not has_carryless_products(target):
        return None
    code = build_llvm_text.code()
    function = code.function("fold")  # the function is valid as long as `code` exists

    def update_crc(data: NDArray[np.uint8], previous_crc: int) -> int:
        table = _CallTable(*[0] * _DATA_WORD, get_array_address(data), len(data), previous_crc)
        function(ctypes.addressof(table), 0, 0)
        return table[0]

    update_crc.code = code  # type: ignore[attr-defined]
    parameters = [ArgumentSpec((0,), _DATA_WORD, dtype=_BYTE_DTYPE, axes=1), ArgumentSpec((1,), _PREVIOUS_CRC_WORD, INTEGER_KIND)]
    return make_builtin("fold", code, parameters, _PREVIOUS_CRC_WORD + 1, [INTEGER_KIND], update_crc) or update_crc


def has_carryless_products(target: llvm_compiler.Target) -> bool:
    """Return whether a processor supports carry-less multiplication."""
    return target.is_x86 and _CARRYLESS_FEATURE in target.features.split(",")


def count_blocks_per_register(target: llvm_compiler.Target) -> int:
    """Return the number of 16-byte blocks per register that the processor can multiply at once."""
    return 4 if set(_WIDE_FEATURES) <= set(target.features.split(",")) else 1


def _compute_power_remainder(bits: int) -> int:
    """Return the remainder of x**bits divided by the polynomial. Its bits have the reflected order and the shift by one that
    the multiplication needs."""
    remainder = 1
    for _ in range(bits):
        remainder <<= 1
        remainder ^= _CRC_POLYNOMIAL if remainder >> 32 else 0
    return int(f"{remainder:032b}"[::-1], 2) << 1


def _build_table_text() -> str:
    """Return the LLVM IR of a table with the CRC-32 remainder of each byte value."""
    entries = []
    for byte in range(256):
        for _ in range(8):
            byte = byte >> 1 ^ (int(f"{_CRC_POLYNOMIAL & _ALL_32_BITS:032b}"[::-1], 2) if byte & 1 else 0)
        entries.append(f"i32 {byte}")
    return f"@table = internal constant [256 x i32] [{', '.join(entries)}]"


@make_library_text
def build_llvm_text(target: llvm_compiler.Target) -> str:
    """Return the LLVM IR of a function that continues a CRC-32; empty if the processor has no carry-less multiplication.

    The function reads a table of three words: the address of the data, its number of bytes (at least one stride) and the
    CRC-32 of the preceding bytes. It stores the combined CRC-32 in the first word."""
    if not has_carryless_products(target):
        return ""
    module, block_count = LlvmModule(target), count_blocks_per_register(target)
    kinds = {count: (f"<{2 * count} x i64>", "" if count == 1 else f".{128 * count}") for count in {1, block_count}}
    for kind, ending in kinds.values():
        module.declare(f"llvm.x86.pclmulqdq{ending}", kind, [kind, kind, "i8"])
    wide, _ = kinds[block_count]
    numbers = iter(range(1000))
    lines: list[str] = []

    def add_value(value: str) -> str:
        name = f"%v{next(numbers)}"
        lines.append(f"  {name} = {value}")
        return name

    def load_register(address: str, register: int) -> str:
        where = add_value(f"getelementptr i8, ptr {address}, i64 {_BLOCK_BYTES * block_count * register}")
        return add_value(f"load {wide}, ptr {where}, align 1")

    def advance_state(remainder: str, bits: int, addend: str, count: int) -> str:
        """Emit code that advances the state of `count` blocks by a number of bits and combines it with the data `addend`.
        Return the new state."""
        kind, ending = kinds[count]
        factors = (
            f"{kind} <"
            + ", ".join([f"i64 {_compute_power_remainder(bits + 32)}, i64 {_compute_power_remainder(bits - 32)}"] * count)
            + ">"
        )
        call = f"call {kind} @llvm.x86.pclmulqdq{ending}({kind} {remainder}, {factors}, i8"
        low, high = (add_value(f"{call} {which})") for which in (0x00, 0x11))
        return add_value(f"xor {kind} {add_value(f'xor {kind} {low}, {high}')}, {addend}")

    def write_loop(
        label: str, previous_block: str, first: Sequence[str], step: int, turn: Callable[[str, str], str]
    ) -> tuple[str, str]:
        """Emit a loop that runs while at least `step` bytes remain. Return the position and the state after it.
        `previous_block`: the label before the loop. `first`: the first position, and the type and initial value of the state.
        `turn`: computes the next state from the current one and the data's address."""
        kind = first[1]
        lines.append(f"  br label %{label}\n{label}:")
        lines.append(f"  %{label}.at = phi i64 [ {first[0]}, %{previous_block} ], [ %{label}.next, %{label}.turn ]")
        lines.append(f"  %{label}.state = phi {kind} [ {first[2]}, %{previous_block} ], [ %{label}.then, %{label}.turn ]")
        lines.append(f"  %{label}.next = add i64 %{label}.at, {step}")
        lines.append(f"  %{label}.more = icmp sle i64 %{label}.next, {length}")
        lines.append(f"  br i1 %{label}.more, label %{label}.turn, label %{label}.end\n{label}.turn:")
        accumulator = turn(f"%{label}.state", add_value(f"getelementptr i8, ptr {place}, i64 %{label}.at"))
        lines.append(f"  %{label}.then = bitcast {kind} {accumulator} to {kind}\n  br label %{label}\n{label}.end:")
        return f"%{label}.at", f"%{label}.state"

    def add_byte(state: str, byte: str) -> str:
        wide = add_value(f"zext i8 {byte} to i32")
        low = add_value(f"and i32 {add_value(f'xor i32 {state}, {wide}')}, 255")
        left = add_value(f"load i32, ptr {add_value(f'getelementptr i32, ptr @table, i32 {low}')}")
        return add_value(f"xor i32 {add_value(f'lshr i32 {state}, 8')}, {left}")

    place, length, previous = (
        add_value(f"load {kind}, ptr {add_value(f'getelementptr i64, ptr %t, i64 {k}')}")
        for kind, k in (("ptr", _DATA_WORD), ("i64", _LENGTH_WORD), ("i64", _PREVIOUS_CRC_WORD))
    )
    stride = _REGISTERS_PER_STEP * _BLOCK_BYTES * block_count
    words = add_value(f"udiv i64 {length}, {stride}"), add_value(f"xor i64 {previous}, {_ALL_32_BITS}")
    first = [load_register(place, register) for register in range(_REGISTERS_PER_STEP)]
    first[0] = add_value(f"xor {wide} {first[0]}, {add_value(f'insertelement {wide} zeroinitializer, i64 {words[1]}, i64 0')}")
    lines.append("  br label %head\nhead:")
    remainder = [f"%remainder{register}" for register in range(_REGISTERS_PER_STEP)]
    lines.append("  %done = phi i64 [ 1, %inside ], [ %next, %turn ]")
    lines += [f"  {remainder[k]} = phi {wide} [ {first[k]}, %inside ], [ %then{k}, %turn ]" for k in range(_REGISTERS_PER_STEP)]
    lines.append(f"  %more = icmp slt i64 %done, {words[0]}\n  br i1 %more, label %turn, label %last\nturn:")
    address = add_value(f"getelementptr i8, ptr {place}, i64 {add_value(f'mul i64 %done, {stride}')}")
    for k in range(_REGISTERS_PER_STEP):
        then = advance_state(remainder[k], 8 * stride, load_register(address, k), block_count)
        lines.append(f"  %then{k} = bitcast {wide} {then} to {wide}")
    lines.append("  %next = add i64 %done, 1\n  br label %head\nlast:")
    accumulator = remainder[0]
    for k in range(1, _REGISTERS_PER_STEP):
        accumulator = advance_state(accumulator, 8 * _BLOCK_BYTES * block_count, remainder[k], block_count)
    parts = [
        add_value(f"shufflevector {wide} {accumulator}, {wide} poison, <2 x i32> <i32 {2 * k}, i32 {2 * k + 1}>")
        for k in range(block_count)
    ]
    accumulator = parts[0]
    for part in parts[1:]:
        accumulator = advance_state(accumulator, 8 * _BLOCK_BYTES, part, 1)
    sixteen = ("<2 x i64>", accumulator)
    address, accumulator = write_loop(
        "blocks", "last", (add_value(f"mul i64 {words[0]}, {stride}"), *sixteen), _BLOCK_BYTES,
        lambda state, address: advance_state(state, 8 * _BLOCK_BYTES, add_value(f"load <2 x i64>, ptr {address}, align 1"), 1),
    )  # fmt: skip
    state, block_bytes = "0", add_value(f"bitcast <2 x i64> {accumulator} to <16 x i8>")
    for k in range(_BLOCK_BYTES):
        state = add_byte(state, add_value(f"extractelement <16 x i8> {block_bytes}, i32 {k}"))
    _, state = write_loop(
        "bytes",
        "blocks.end",
        (address, "i32", state),
        1,
        lambda remainder, address: add_byte(remainder, add_value(f"load i8, ptr {address}")),
    )
    state = add_value(f"xor i32 {state}, -1")
    lines.append(f"  store i64 {add_value(f'zext i32 {state} to i64')}, ptr %t, align 8")
    body = "  br label %inside\ninside:\n" + "\n".join(lines)
    return module.text() + "\n" + _build_table_text() + "\n" + write_inner_function(module, "fold", body) + "\n"
