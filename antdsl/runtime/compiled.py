"""Whether to use the compiled kernels: they need the extra `[fast]`, and enough agents for their start-up to pay.

Kernels give the same bits as the NumPy code that stands beside them. `NUMBA_DISABLE_JIT=1` keeps to NumPy.
"""

from __future__ import annotations

from functools import cache

LEAST = 2_000  # agents; below this a step takes few milliseconds, and loading the compiler takes half a second


def wanted(count: int) -> bool:
    """Whether work on so many agents goes to compiled kernels."""
    return count >= LEAST and _available()


@cache
def _available() -> bool:
    try:
        import numba
    except Exception:  # not installed, or made for another NumPy: it says so in different ways
        return False
    return not numba.config.DISABLE_JIT
