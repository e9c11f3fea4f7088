"""Whether to use the compiled kernels, and in how many parts: they have to be made or loaded, and want enough work to pay.

Kernels give the same bits as the NumPy code that stands beside them, which is what runs where none can be compiled.
`ANTDSL_KERNELS=0` keeps to NumPy.

Kernels that are compiled are used from the first step: those that the installation has, or that an earlier run has stored
(`machine_code/codes`). Each takes 0.4 ms to load. Compiling them takes seconds, as long as a thousand steps of a small crowd, and
nobody knows how many steps follow. So where none are compiled, a large crowd begins with them, as a few steps make up for it. A
small crowd begins with NumPy, and uses kernels once its steps have cost a share of what compiling does: so what it pays more than
had it known is at most that cost (A. Karlin et al., Competitive Snoopy Caching, Algorithmica 3, 1988).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code import machine
from antdsl.numerics.cores import cores

T = TypeVar("T")
VARIABLE = "ANTDSL_KERNELS"
PART = 1_024  # agents for whom a thread pays
LIGHT = 4_096  # the same, of work that is a few operations each
LEAST = 2_000  # agents; a step of these without kernels takes so long that a few make up for loading them
_LEAST_FOR_LONG = 200  # agents; where thousands of steps follow, half a second is soon won back
_AT_ONCE = 50_000  # numbers, worked on before any step: then a world is made ready that is large
_LOADING, _COMPILING = 0.2, 2.5  # s of processor time before it: for a program's code, and kernels that are made the first time
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
        _running = _begun()


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
    return _many(agents) or _spent >= _COMPILING or _kept()


@cache
def _kept() -> bool:
    """Whether kernels are compiled, in the installation or by an earlier run: the one that is the first of all."""
    from antdsl.numerics.elementary_compiled import cosines

    return available() and cosines.kept()


def _begun() -> bool:
    """Whether kernels can be used from now on. One is made, which says to the next run that they are kept."""
    if not available():
        return False
    from antdsl.numerics.elementary_compiled import cosines

    cosines.made()
    return True


def wanted(count: int) -> bool:
    """Whether work on so many numbers goes to compiled kernels: once these run, the small work of a crowd too, which is most of
    its calls."""
    global _running
    if not _running and count >= _AT_ONCE:
        _running = _begun()
    return _running and count > 0


def running() -> bool:
    """Whether kernels are in use; starts nothing."""
    return _running


def begin() -> None:
    """Start with kernels now, whatever they cost."""
    global _running
    _running = _running or _begun()


def available() -> bool:
    """Whether kernels can be compiled here, and are not turned off."""
    return os.environ.get(VARIABLE) != "0" and machine.available()


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

    return workers.in_parts(work, count, min(threads, cores()), count // max(1, least), _running)


def parts(count: int, threads: int, least: int = PART) -> int:
    """In how many parts `in_parts`, asked the same with 16 for `least` or more, does a kernel at most: of as many rooms each part
    has one of its own (`parts_compiled.own`)."""
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

    workers.side_by_side(work, threads, _running)


def listed(function: Callable[[int, int, int], None], parts: NDArray[np.int64], threads: int) -> None:
    """Call a function of machine code with each row of `parts` [k,3]: address, begin, end; side by side."""
    threads = min(threads, cores())
    if threads < 2 or len(parts) < 2:
        for part in parts.tolist():
            function(*part)
        return
    from antdsl.numerics import workers

    workers.listed(function, parts, threads, _running)
