"""Runs kernels in parallel parts.

Each part has at least as many agents as pay for a thread. Threads wait in machine code (`workers`)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.kernels import I64, inlined
from antdsl.numerics.host import cores

T = TypeVar("T")
PART = 1_024  # agents for whom a thread pays
LIGHT = 4_096  # the same, of work that is a few operations each


def plain(*arrays: NDArray[Any]) -> tuple[NDArray[Any], ...]:
    """The same in one piece, as most kernels read them."""
    return tuple(np.ascontiguousarray(a) for a in arrays)


def in_parts(work: Callable[[int, int], T], count: int, threads: int, least: int = PART) -> list[T]:
    """`work(begin, end)` over so many agents, in as many parts as pay, of no fewer than `least` each, side by side; what each
    gave, in order. A kernel (a `partial` of one, whose last two arguments are missing) is handed over in machine code, in more
    parts than there are threads, to even them out. Who finds the threads at work for another takes all, in one part."""
    if threads < 2 or count < 2 * least or min(threads, cores()) < 2:
        return [work(0, count)]
    from antdsl.numerics import workers

    return workers.in_parts(work, count, min(threads, cores()), count // max(1, least))


def parts(count: int, threads: int, least: int = PART) -> int:
    """In how many parts `in_parts`, asked the same with 16 for `least` or more, does a kernel at most: of as many rooms each part
    has one of its own (`own`)."""
    threads = min(threads, cores())
    if threads < 2 or count < 2 * least:
        return 1
    from antdsl.numerics import workers

    return workers.parts(count, min(threads, count // max(1, least)))


def joined(parts: Sequence[tuple[int, ...]], *arrays: NDArray[Any]) -> list[NDArray[Any]]:
    """What parts have written to arrays [.., n], each from where it begins on: `parts` tell of each where that is, and how many
    it has written."""
    if len(parts) == 1:
        begin, count, *_ = parts[0]
        return [each[..., begin : begin + count] for each in arrays]
    own = [slice(begin, begin + count) for begin, count, *_ in parts if count]
    if len(own) < 2:
        return [each[..., own[0] if own else slice(0)] for each in arrays]
    return [np.concatenate([each[..., some] for some in own], axis=-1) for each in arrays]


def side_by_side(work: Callable[[int], object], threads: int) -> None:
    """Call `work(0)`, and meanwhile `work(1)` to before `work(threads)` as far as somebody is free for them: each is to take of
    what there is to do until nothing is left. All have ended then, whatever interrupts it."""
    threads = min(threads, cores())
    if threads < 2:
        work(0)
        return
    from antdsl.numerics import workers

    workers.side_by_side(work, threads)


def listed(function: Callable[[int, int, int], None], parts: NDArray[np.int64], threads: int) -> None:
    """Call a function of machine code with each row of `parts` [k,3]: address, begin, end; side by side."""
    threads = min(threads, cores())
    if threads < 2 or len(parts) < 2:
        for part in parts.tolist():
            function(*part)
        return
    from antdsl.numerics import workers

    workers.listed(function, parts, threads)


@inlined
def own(begin: I64, count: I64, rooms: I64) -> I64:
    """The number of the room of the part of `count` numbers (1 at least) that starts at `begin`, of as many `rooms` as
    `parts` says: no two parts have the same."""
    return (begin * rooms + count - 1) // count
