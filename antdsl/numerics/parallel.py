"""Parallel execution of kernels in parts.

Each part has at least as many agents as make a thread worthwhile. Threads wait in machine code (`workers`)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.kernels import I64, inlined
from antdsl.numerics.host import cores

T = TypeVar("T")
MIN_AGENTS_PER_THREAD = 1_024  # agents from which a thread pays
MIN_LIGHT_ITEMS_PER_THREAD = 4_096  # the same, of work that is a few operations each


def contiguous(*arrays: NDArray[Any]) -> tuple[NDArray[Any], ...]:
    """Return the arrays as contiguous ones, which most kernels need."""
    return tuple(np.ascontiguousarray(a) for a in arrays)


def in_parts(work: Callable[[int, int], T], count: int, threads: int, least: int = MIN_AGENTS_PER_THREAD) -> list[T]:
    """Call `work(begin, end)` over `count` agents, in parallel in as many parts as pay, of at least `least` each. Return the
    results in order. A kernel (a `partial` of one without its last two arguments) is passed as machine code, in more parts than
    there are threads, to even them out. Where the threads are at work for another caller, all is done in one part."""
    if threads < 2 or count < 2 * least or min(threads, cores()) < 2:
        return [work(0, count)]
    from antdsl.numerics import workers

    return workers.in_parts(work, count, min(threads, cores()), count // max(1, least))


def parts(count: int, threads: int, least: int = MIN_AGENTS_PER_THREAD) -> int:
    """Return the most parts of a kernel in `in_parts`, called with the same arguments and a `least` of 16 or more. With as many
    buffers, each part has its own (`own`)."""
    threads = min(threads, cores())
    if threads < 2 or count < 2 * least:
        return 1
    from antdsl.numerics import workers

    return workers.parts(count, min(threads, count // max(1, least)))


def join_parts(parts: Sequence[tuple[int, ...]], *arrays: NDArray[Any]) -> list[NDArray[Any]]:
    """Return the written parts of arrays [.., n], joined. `parts` has for each part its start and the number of values it has
    written."""
    if len(parts) == 1:
        begin, count, *_ = parts[0]
        return [each[..., begin : begin + count] for each in arrays]
    own = [slice(begin, begin + count) for begin, count, *_ in parts if count]
    if len(own) < 2:
        return [each[..., own[0] if own else slice(0)] for each in arrays]
    return [np.concatenate([each[..., chunk] for chunk in own], axis=-1) for each in arrays]


def side_by_side(work: Callable[[int], object], threads: int) -> None:
    """Call `work(0)`, and in parallel `work(1)` to before `work(threads)` as far as threads are free. Each takes work until
    nothing is left. All have ended on return, whatever interrupts it."""
    threads = min(threads, cores())
    if threads < 2:
        work(0)
        return
    from antdsl.numerics import workers

    workers.side_by_side(work, threads)


def call_rows(function: Callable[[int, int, int], None], parts: NDArray[np.int64], threads: int) -> None:
    """Call a function of machine code in parallel with each row of `parts` [k,3]: address, begin, end."""
    threads = min(threads, cores())
    if threads < 2 or len(parts) < 2:
        for part in parts.tolist():
            function(*part)
        return
    from antdsl.numerics import workers

    workers.call_rows(function, parts, threads)


@inlined
def buffer_index(begin: I64, count: I64, rooms: I64) -> I64:
    """Return the buffer number of the part of `count` numbers (at least 1) that starts at `begin`, for `rooms` buffers as `parts`
    says. No two parts share a buffer."""
    return (begin * rooms + count - 1) // count
