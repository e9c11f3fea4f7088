"""`njit` for kernels that are kept for the next run: what is kept is a convenience, and no run fails by it or goes by an old one.

Imported only where `compiled.wanted` says so."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numba
import numpy as np
from numba.core.caching import FunctionCache

Kernel = Callable[..., Any]  # numba takes the types from the first call


def njit(**options: Any) -> Callable[[Kernel], Kernel]:
    """As numba's. With `cache=True`, kernels are compiled anew where those kept are damaged, were made with other constants or
    by other kernels than stand in their module now, or cannot be written."""
    made = numba.njit(**options)

    def decorate(function: Kernel) -> Kernel:
        kernel: Any = made(function)
        if options.get("cache") and not numba.config.DISABLE_JIT:
            kernel._cache = _Kept(function)
        compiled: Kernel = kernel
        return compiled

    return decorate


class _Kept(FunctionCache):  # type: ignore[misc]
    """Compiled code in files."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        # numba looks at the time of the kernel's own file; constants and inlined kernels come from others too
        self.stamp = (self._cache_file._source_stamp, _made_from(function))
        self._cache_file._source_stamp = self.stamp

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # a file cut short by a crash: pickle raises what it likes
            with suppress(Exception):
                self.flush()  # begins with an empty index, for else what is compiled now could not be kept either
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        with suppress(Exception):  # no room left, or no longer allowed: this run has what it needs
            super().save_overload(sig, data)


def _made_from(function: Callable[..., Any]) -> str:
    """Numbers that the kernel's module knows, and what kernels of other modules were made from."""
    found = {}
    for name, value in function.__globals__.items():
        if isinstance(value, int | float | np.number):
            found[name] = repr(value)
        elif isinstance(getattr(value, "_cache", None), _Kept) and value.__module__ != function.__module__:
            found[name] = repr(value._cache.stamp)
    return repr(sorted(found.items()))
