"""Every array of NumPy's in a separate process ends where memory ends: who reads or writes behind it ends the process.

`python tests/guarded_memory.py STEPS PROGRAMS COUNT...` runs worlds of so many agents as machine code and in NumPy and prints
`same` where all states are equal: those of one plan with every operation, and of so many random programs. `--past` reads one byte
too many, to show that it would be noticed."""

from __future__ import annotations

import ctypes
import mmap
import os
import sys
from dataclasses import replace

import numpy as np
from numpy._core import multiarray

_LIBC = ctypes.CDLL(None, use_errno=True)
_LIBC.mmap.restype = ctypes.c_void_p
_LIBC.mmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int, ctypes.c_int, ctypes.c_int, ctypes.c_long]
_LIBC.mprotect.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
_LIBC.munmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t]
_PAGE = mmap.PAGESIZE
_NO_ACCESS = 0
_SET_HANDLER = 304  # of PyDataMem_SetHandler in the table of NumPy's C interface
_known: dict[int, tuple[int, int, int]] = {}  # by address: where the pages begin, their bytes, bytes requested


def _allocate(size: int) -> int:
    capacity = -(-max(size, 1) // _PAGE) * _PAGE
    flags = mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS
    begin = _LIBC.mmap(None, capacity + _PAGE, mmap.PROT_READ | mmap.PROT_WRITE, flags, -1, 0)
    if begin in (None, ctypes.c_void_p(-1).value) or _LIBC.mprotect(begin + capacity, _PAGE, _NO_ACCESS):
        return 0
    address: int = begin + capacity - max(size, 1)
    _known[address] = (begin, capacity + _PAGE, size)
    return address


def _release(address: int | None) -> None:
    if address:
        begin, capacity, _ = _known.pop(address)
        _LIBC.munmap(begin, capacity)


def _again(address: int | None, size: int) -> int:
    new = _allocate(size)
    if address and new:
        ctypes.memmove(new, address, min(size, _known[address][2]))
        _release(address)
    return new


_ONE, _TWO = ctypes.c_void_p, ctypes.c_size_t
_MALLOC = ctypes.CFUNCTYPE(_ONE, _ONE, _TWO)
_CALLOC = ctypes.CFUNCTYPE(_ONE, _ONE, _TWO, _TWO)
_REALLOC = ctypes.CFUNCTYPE(_ONE, _ONE, _ONE, _TWO)
_FREE = ctypes.CFUNCTYPE(None, _ONE, _ONE, _TWO)


class _Handler(ctypes.Structure):
    """PyDataMem_Handler."""

    _fields_ = (
        ("name", ctypes.c_char * 127), ("version", ctypes.c_uint8), ("context", ctypes.c_void_p),
        ("malloc", _MALLOC), ("calloc", _CALLOC), ("realloc", _REALLOC), ("free", _FREE),
    )  # fmt: skip


_HANDLER = _Handler(
    b"guarded", 1, None,
    _MALLOC(lambda context, size: _allocate(size)),
    _CALLOC(lambda context, count, size: _allocate(count * size)),
    _REALLOC(lambda context, address, size: _again(address, size)),
    _FREE(lambda context, address, size: _release(address)),
)  # fmt: skip


def guard() -> None:
    """From now on. RuntimeError where this NumPy has another table."""
    python = ctypes.pythonapi
    python.PyCapsule_GetPointer.restype = ctypes.c_void_p
    python.PyCapsule_GetPointer.argtypes = [ctypes.py_object, ctypes.c_char_p]
    python.PyCapsule_New.restype = ctypes.py_object
    python.PyCapsule_New.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]
    table = python.PyCapsule_GetPointer(multiarray._ARRAY_API, None)
    place = ctypes.cast(table, ctypes.POINTER(ctypes.c_void_p))[_SET_HANDLER]
    capsule = python.PyCapsule_New(ctypes.addressof(_HANDLER), b"mem_handler", None)
    ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.py_object)(place)(capsule)
    if multiarray.get_handler_name() != "guarded":
        raise RuntimeError("NumPy has not taken the handler")


def main(arguments: list[str]) -> None:
    if arguments == ["--past"]:
        guard()
        array = np.zeros(5, np.uint8)
        print(ctypes.string_at(array.ctypes.data, 5), flush=True)
        print(ctypes.string_at(array.ctypes.data, 6), flush=True)
        return
    import plans
    import random_extremes
    from random_extremes import Extremes

    from antdsl.machine_code import llvm_compiler
    from antdsl.runtime import Options, bind, state_hash, step

    assert llvm_compiler.is_available()
    usual = Options("numpy", on_fault="quarantine")
    native = Options("native", on_fault="quarantine", wait_for_code=True)
    steps, programs, *counts = map(int, arguments)
    plan = plans.rich()
    worlds = [(plan, plans.setting(count)) for count in counts]
    for extremes in map(Extremes, range(programs)):
        plan, _ = random_extremes.plan_and_program(extremes)
        worlds += [(plan, random_extremes.setting(extremes, count)) for count in counts]
    guard()
    with np.errstate(all="ignore"):
        for plan, setting in worlds:
            hashes = []
            for options in (usual, replace(native, chunk=8) if programs else native):
                world = bind(plan, setting, options)
                for _ in range(steps):
                    step(world)
                hashes.append(state_hash(world))
            assert hashes[0] == hashes[1]
    print("same", flush=True)
    os._exit(0)  # what is released at the very end would call a Python that is gone


if __name__ == "__main__":
    main(sys.argv[1:])
