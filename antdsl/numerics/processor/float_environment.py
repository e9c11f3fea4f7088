"""The floating-point environment of a thread. A host program may change the rounding mode, or flush denormal numbers to zero.

A thread inherits the environment from the thread that starts it. Results computed within `use_standard_floats` do not depend
on these settings."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

# Read at run time: constant expressions would be evaluated at compile time
_ONE_AT_RUN_TIME, _HALF_AT_RUN_TIME, _HALF_ULP, _LEAST_NORMAL = 1.0, 0.5, 2.0**-53, 2.0**-1022
_ENVIRONMENT_BYTES = 256  # more bytes than any C library needs


def has_standard_floats() -> bool:
    """Return whether this thread rounds to nearest and preserves denormal numbers, as far as float64 operations can detect
    this."""
    return (
        _LEAST_NORMAL * _HALF_AT_RUN_TIME != 0.0
        and _ONE_AT_RUN_TIME + _HALF_ULP == 1.0
        and _ONE_AT_RUN_TIME + (_HALF_ULP + _HALF_ULP * _HALF_AT_RUN_TIME) != 1.0
    )


def set_standard_floats() -> None:
    """Set the standard float environment permanently for the current thread, which must be one of antdsl's own. Does nothing
    if the C library does not support it."""
    if not has_standard_floats() and (library := _load_c_library()) is not None:
        library.fesetenv(_get_default_environment())


@contextmanager
def use_standard_floats() -> Iterator[None]:
    """Use the standard float environment within the `with` block, and restore the old one afterwards. If the environment is
    already standard, this costs about a microsecond."""
    library = None if has_standard_floats() else _load_c_library()
    if library is None:
        yield
        return
    saved_environment = ctypes.create_string_buffer(_ENVIRONMENT_BYTES)
    library.fegetenv(saved_environment)
    library.fesetenv(_get_default_environment())
    try:
        yield
    finally:
        library.fesetenv(saved_environment)


@cache
def _load_c_library() -> Any:
    """Return the C library, or None if it has no floating-point environment functions (C99, 7.6)."""
    try:
        library = ctypes.CDLL(None)
        library.fegetenv.argtypes = library.fesetenv.argtypes = [ctypes.c_void_p]
    except (AttributeError, OSError, TypeError):
        return None
    return library


@cache
def _get_default_environment() -> ctypes.c_void_p:
    """Return FE_DFL_ENV, the C library's default environment. It is the address of an object, or a number on systems without
    such an object."""
    try:
        return ctypes.c_void_p(ctypes.addressof(ctypes.c_char.in_dll(ctypes.CDLL(None), "_FE_DFL_ENV")))
    except ValueError:
        return ctypes.c_void_p(-1)
