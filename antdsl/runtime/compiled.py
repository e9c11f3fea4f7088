"""Whether to use the compiled kernels: they need the extra `[fast]`, and enough agents for their start-up to pay.

Kernels give the same bits as the NumPy code that stands beside them. `NUMBA_DISABLE_JIT=1` keeps to NumPy.
"""

from __future__ import annotations

from functools import cache

LEAST = 2_000  # agents; below this a step takes few milliseconds, and loading the compiler takes half a second
_LEAST_FOR_LONG = 200  # agents; where thousands of steps follow, half a second is soon won back
_long = False


def expect_long_runs() -> None:
    """From now on this process makes very many steps: kernels pay for smaller crowds too. Changes no result."""
    global _long
    _long = True


def wanted(count: int) -> bool:
    """Whether work on so many agents goes to compiled kernels."""
    return count >= (_LEAST_FOR_LONG if _long else LEAST) and available()


@cache
def available() -> bool:
    """Whether kernels can be compiled here, and kept for the next run: compiling takes seconds."""
    try:
        import numba

        numba.njit(cache=True)(wanted)  # nothing is compiled, but it is an error where no folder can be written to
    except Exception:  # also where it is not installed, or made for another NumPy: it says so in different ways
        return False
    return not numba.config.DISABLE_JIT
