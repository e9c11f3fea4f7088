"""Machine code in a process with scattered free memory: single pages here, all that is longer more than 2 GiB below.

`python tests/far_memory.py` loads a function there and prints `same` where it gives what Python does. Linux alone."""

from __future__ import annotations

import ctypes
import mmap
import struct

import numpy as np

from antdsl.machine_code import llvm_compiler

_LIBC = ctypes.CDLL(None, use_errno=True)
_LIBC.mmap.restype = ctypes.c_void_p
_LIBC.mmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int, ctypes.c_int, ctypes.c_int, ctypes.c_long]
_LIBC.munmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t]
_PAGE = mmap.PAGESIZE
_NO_ACCESS, _NO_RESERVE = 0, 0x4000
_PAGES = 3_000  # more than there are gaps of one page


def taken(size: int) -> int:
    """Where Linux puts a number of unused bytes."""
    place = _LIBC.mmap(None, size, _NO_ACCESS, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | _NO_RESERVE, -1, 0)
    assert place not in (None, ctypes.c_void_p(-1).value), ctypes.get_errno()
    address: int = place
    return address


def split() -> None:
    """Leave no gap of more than a page above 3 GiB that are taken."""
    pages = [taken(_PAGE) for _ in range(_PAGES)]
    below = taken(3 << 30)
    while taken(2 * _PAGE) > below:
        pass
    for place in pages[::2]:
        _LIBC.munmap(place, _PAGE)


def program(numbers: list[float]) -> str:
    """A function that works with all of these, which stand among its constants: its code is longer than a page."""
    lines = ["  %x0 = load double, ptr %t"]
    for k, number in enumerate(numbers):
        (bits,) = struct.unpack("<q", struct.pack("<d", number))
        bits &= (1 << 64) - 1
        lines.append(f"  %y{k} = fmul double %x{k}, 0x{bits:016X}\n  %x{k + 1} = fadd double %y{k}, 0x{bits:016X}")
    body = "\n".join(lines)
    return f"define void @far(ptr %t, i64 %a, i64 %b) {{\n{body}\n  store double %x{len(numbers)}, ptr %t\n  ret void\n}}\n"


def main() -> None:
    numbers = [1 + 1 / (3 + k) for k in range(400)]
    code = llvm_compiler.compile_object(program(numbers), llvm_compiler.find_host_target())
    buffer = np.array([0.3])
    split()
    llvm_compiler.load_object(code).function("far")(buffer.ctypes.data, 0, 0)
    expected = 0.3
    for number in numbers:
        expected = expected * number + number
    assert buffer[0] == expected, (buffer, expected)
    print("same", flush=True)


if __name__ == "__main__":
    main()
