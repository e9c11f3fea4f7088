"""Whether to use the compiled kernels: they need the extra `[fast]`, and enough work for their start-up to pay.

Kernels give the same bits as the NumPy code that stands beside them. `NUMBA_DISABLE_JIT=1` keeps to NumPy.

Loading them takes about as long as a hundred steps of a small crowd, and nobody knows how many follow. So a crowd that is large,
for whom a few steps make up for it, begins with them, and a small one once its steps have cost a share of what loading does, half
of it since most shots have hundreds of frames: what it pays more than had it known is bounded by the cost of loading (A. Karlin
et al., Competitive Snoopy Caching, Algorithmica 3, 1988).
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from numpy.typing import NDArray

from antdsl.numerics.float_environment import be_standard

T = TypeVar("T")
PART = 4_096  # agents for whom a thread pays
LEAST = 2_000  # agents; a step of these without kernels takes so long that a few make up for loading them
_LEAST_FOR_LONG = 200  # agents; where thousands of steps follow, half a second is soon won back
_AT_ONCE = 50_000  # numbers, worked on before any step: then a world is made ready that is large
_LOADING, _COMPILING = 0.3, 25.0  # s of processor time before it: for kernels kept from another run, and the first time
_long = False
_running = False
_spent = 0.0


def expect_long_runs() -> None:
    """From now on this process makes very many steps: kernels pay for smaller crowds too. Changes no result."""
    global _long
    _long = True


def begin_step(agents: int) -> None:
    """Start with kernels where a step of so many agents comes that will pay for them, or where steps before it would have."""
    global _running
    if not _running and _pays(agents):
        _running = available()


def end_step(seconds: float) -> None:
    """A step took so much processor time."""
    global _spent
    _spent += seconds


def pays(agents: int, spent: float) -> bool:
    """Whether code that takes about a second to make or load pays for steps of so many agents, after steps that took `spent`
    seconds without it."""
    return _many(agents) or spent >= _LOADING


def _many(agents: int) -> bool:
    return agents >= (_LEAST_FOR_LONG if _long else LEAST)


def _pays(agents: int) -> bool:
    return _many(agents) or (_spent >= _LOADING and (_spent >= _COMPILING or _kept()))


@cache
def _kept() -> bool:
    """Whether kernels of another run are found where they most likely are; those that are elsewhere count as none."""
    named = os.environ.get("NUMBA_CACHE_DIR")
    folders = Path(named).glob("*") if named else (Path(__file__).parent / "__pycache__",)
    return any(any(folder.glob("elementary_compiled.*.nbi")) for folder in folders)


def wanted(count: int) -> bool:
    """Whether work on so many numbers goes to compiled kernels: once these run, the small work of a crowd too, which is most of
    its calls."""
    global _running
    if not _running and count >= _AT_ONCE:
        _running = available()
    return _running and count > 0


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
    return ThreadPoolExecutor(threads, "kernels", be_standard)


def in_parts(work: Callable[[int, int], T], count: int, threads: int) -> list[T]:
    """`work(begin, end)` over so many agents, in as many parts as pay, side by side; what each gave, in order."""
    parts = min(threads, max(1, count // PART))
    bounds = [count * k // parts for k in range(parts + 1)]
    if parts == 1:
        return [work(0, count)]
    return list(workers(threads).map(work, bounds[:-1], bounds[1:]))
