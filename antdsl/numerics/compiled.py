"""Whether to use the compiled kernels: they need the extra `[fast]`, and enough agents for their start-up to pay.

Kernels give the same bits as the NumPy code that stands beside them. `NUMBA_DISABLE_JIT=1` keeps to NumPy.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any, TypeVar

from numpy.typing import NDArray

T = TypeVar("T")
PART = 4_096  # agents for whom a thread pays
LEAST = 2_000  # agents; below this a step takes few milliseconds, and loading the compiler takes half a second
_LEAST_FOR_LONG = 200  # agents; where thousands of steps follow, half a second is soon won back
_long = False
_FEW = 1  # agents, once kernels are in use: the small work of a large crowd goes to them too, which is most of its calls
_running = False


def expect_long_runs() -> None:
    """From now on this process makes very many steps: kernels pay for smaller crowds too. Changes no result."""
    global _long
    _long = True


def wanted(count: int) -> bool:
    """Whether work on so many agents goes to compiled kernels."""
    global _running
    least = _FEW if _running else _LEAST_FOR_LONG if _long else LEAST
    found = count >= least and available()
    _running = _running or found
    return found


@cache
def available() -> bool:
    """Whether kernels can be compiled here, and kept for the next run: compiling takes seconds."""
    try:
        import numba

        from antdsl.numerics.kernel_cache import njit

        njit(cache=True)(wanted)  # nothing is compiled, but it is an error where no folder can be written to
    except Exception:  # also where it is not installed, or made for another NumPy: it says so in different ways
        return False
    return not numba.config.DISABLE_JIT


def plain(*arrays: NDArray[Any]) -> tuple[NDArray[Any], ...]:
    """The same in one piece and writable: a kernel is compiled anew for any other kind."""
    return tuple(a if a.flags.writeable and a.flags.c_contiguous else a.copy() for a in arrays)


@cache
def workers(threads: int) -> ThreadPoolExecutor:
    """Threads that are kept for the next step; kernels run side by side in them."""
    return ThreadPoolExecutor(threads, "kernels")


def in_parts(work: Callable[[int, int], T], count: int, threads: int) -> list[T]:
    """`work(begin, end)` over so many agents, in as many parts as pay, side by side; what each gave, in order."""
    parts = min(threads, max(1, count // PART))
    bounds = [count * k // parts for k in range(parts + 1)]
    if parts == 1:
        return [work(0, count)]
    return list(workers(threads).map(work, bounds[:-1], bounds[1:]))
