"""Allocations of NumPy's arrays that fail: the one of a number, or all from there on, as where memory runs out.

NumPy asks a table of four functions for memory (NEP 49, `PyDataMem_SetHandler`); this one counts requests and passes them
to NumPy's own. Memory is given back to NumPy's own directly: no Python may run while NumPy raises an error."""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from unittest.mock import patch

import numpy as np

_SET_HANDLER, _GET_HANDLER = 304, 305  # their places in NumPy's table of functions
_VOID, _SIZE = ctypes.c_void_p, ctypes.c_size_t
_MALLOC = ctypes.CFUNCTYPE(_VOID, _VOID, _SIZE)
_CALLOC = ctypes.CFUNCTYPE(_VOID, _VOID, _SIZE, _SIZE)
_REALLOC = ctypes.CFUNCTYPE(_VOID, _VOID, _VOID, _SIZE)
_FREE = ctypes.CFUNCTYPE(None, _VOID, _VOID, _SIZE)


class _Allocator(ctypes.Structure):
    _fields_ = [("context", _VOID), ("malloc", _MALLOC), ("calloc", _CALLOC), ("realloc", _REALLOC), ("free", _FREE)]


class _Handler(ctypes.Structure):
    _fields_ = [("name", ctypes.c_char * 127), ("version", ctypes.c_uint8), ("allocator", _Allocator)]


class FailingMemory:
    """`at`: the allocation that fails, from 0, None for none; `lasting`: all after it too. `count`: how many there were."""

    def __init__(self) -> None:
        self.at: int | None = None
        self.lasting = False
        self.count = 0
        self._lock = threading.Lock()
        own = _Handler.from_address(_pointer(_call(_GET_HANDLER), b"mem_handler")).allocator
        malloc, calloc, realloc = (
            ctypes.PYFUNCTYPE(_VOID, *kinds)(ctypes.cast(function, _VOID).value)  # with the interpreter's lock, as NumPy calls it
            for function, kinds in (
                (own.malloc, (_VOID, _SIZE)), (own.calloc, (_VOID, _SIZE, _SIZE)), (own.realloc, (_VOID, _VOID, _SIZE)),
            )
        )  # fmt: skip
        allocator = _Allocator(
            own.context,
            _MALLOC(lambda context, size: None if self._fails() else malloc(context, size)),
            _CALLOC(lambda context, count, size: None if self._fails() else calloc(context, count, size)),
            _REALLOC(lambda context, old, size: None if self._fails() else realloc(context, old, size)),
            own.free,
        )
        self._handler = _Handler(b"failing", 1, allocator)
        new = ctypes.pythonapi.PyCapsule_New
        new.restype, new.argtypes = ctypes.py_object, [_VOID, ctypes.c_char_p, _VOID]
        self._capsule = new(ctypes.addressof(self._handler), b"mem_handler", None)

    def _fails(self) -> bool:
        with self._lock:
            number, self.count = self.count, self.count + 1
        return self.at is not None and (number == self.at or (self.lasting and number > self.at))

    @contextmanager
    def intercept(self) -> Iterator[None]:
        """Whatever NumPy allocates meanwhile, in threads that begin meanwhile too."""
        run, memory = threading.Thread.run, self

        def asking(thread: threading.Thread) -> None:
            _call(_SET_HANDLER, memory._capsule)  # each thread has its own handler
            run(thread)

        self.count = 0
        previous_handler = _call(_SET_HANDLER, self._capsule)
        try:
            with patch.object(threading.Thread, "run", asking):
                yield
        finally:
            self.at = None
            _call(_SET_HANDLER, previous_handler)


def _pointer(capsule: Any, name: bytes | None) -> int:
    get = ctypes.pythonapi.PyCapsule_GetPointer
    get.restype, get.argtypes = _VOID, [ctypes.py_object, ctypes.c_char_p]
    pointer: int = get(capsule, name)
    return pointer


def _call(place: int, *words: Any) -> Any:
    """A function of NumPy's table, of objects, that gives one."""
    table = ctypes.cast(_pointer(np._core._multiarray_umath._ARRAY_API, None), ctypes.POINTER(_VOID))  # type: ignore[attr-defined]
    return ctypes.PYFUNCTYPE(ctypes.py_object, *[ctypes.py_object for _ in words])(table[place])(*words)


MEMORY = FailingMemory()  # one for the process: arrays outlive the test that made them
