"""Runs kernels in parallel parts.

Each part has enough agents to make the start of a thread worthwhile. Idle threads wait in machine code (`workers`)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.kernels import I64, inlined
from antdsl.numerics.processor.host import count_available_cores

PartResult = TypeVar("PartResult")
MIN_AGENTS_PER_THREAD = 1_024  # fewer agents are not worth another thread
MIN_LIGHT_ITEMS_PER_THREAD = 4_096  # the same for work of a few operations per item


def make_contiguous(*arrays: NDArray[Any]) -> tuple[NDArray[Any], ...]:
    """Return the given arrays in contiguous form, which most kernels need. Only arrays that are not contiguous are copied."""
    return tuple(np.ascontiguousarray(a) for a in arrays)


def run_in_parts(
    work: Callable[[int, int], PartResult], count: int, threads: int, min_part_size: int = MIN_AGENTS_PER_THREAD
) -> list[PartResult]:
    """Call `work(begin, end)` for consecutive parts of `count` agents, in parallel, and return the results in order. Each part
    has at least `min_part_size` agents. If `work` is a `partial` of a kernel without its last two arguments, all parts run as
    machine code. There are then more parts than threads, to balance the load. If another caller is using the threads, all work
    is done in one part."""
    if threads < 2 or count < 2 * min_part_size or min(threads, count_available_cores()) < 2:
        return [work(0, count)]
    from antdsl.numerics import workers

    return workers.run_in_parts(work, count, min(threads, count_available_cores()), count // max(1, min_part_size))


def count_parts(count: int, threads: int, min_part_size: int = MIN_AGENTS_PER_THREAD) -> int:
    """Return the maximum number of parts in which `run_in_parts` runs a kernel for the same arguments.

    If there are that many buffers, each part can have its own (`compute_buffer_index`). `min_part_size` must be at least 16."""
    threads = min(threads, count_available_cores())
    if threads < 2 or count < 2 * min_part_size:
        return 1
    from antdsl.numerics import workers

    return workers.count_parts(count, min(threads, count // max(1, min_part_size)))


def join_parts(parts: Sequence[tuple[int, ...]], *arrays: NDArray[Any]) -> list[NDArray[Any]]:
    """Return, for each array [.., n], the values that parallel parts have written into it, joined without gaps.

    `parts`: one tuple per part, with the index of its first value and its number of values; further numbers are ignored."""
    if len(parts) == 1:
        begin, count, *_ = parts[0]
        return [each[..., begin : begin + count] for each in arrays]
    chunks = [slice(begin, begin + count) for begin, count, *_ in parts if count]
    if len(chunks) < 2:
        return [each[..., chunks[0] if chunks else slice(0)] for each in arrays]
    return [np.concatenate([each[..., chunk] for chunk in chunks], axis=-1) for each in arrays]


def run_in_threads(work: Callable[[int], object], threads: int) -> None:
    """Call `work(0)` in this thread, and `work(1)` to `work(threads - 1)` in parallel if workers are free.

    Some calls may never start, so each call must continue until no work is left. All calls have ended when the function
    returns, even after an interruption."""
    threads = min(threads, count_available_cores())
    if threads < 2:
        work(0)
        return
    from antdsl.numerics import workers

    workers.run_in_threads(work, threads)


def call_for_each_row(function: Callable[[int, int, int], None], parts: NDArray[np.int64], threads: int) -> None:
    """Call a function of machine code in parallel, once for each row of `parts` [k,3]. A row contains the three arguments of a
    call: the address of a table, the first index, and the index after the last."""
    threads = min(threads, count_available_cores())
    if threads < 2 or len(parts) < 2:
        for part in parts.tolist():
            function(*part)
        return
    from antdsl.numerics import workers

    workers.call_for_each_row(function, parts, threads)


@inlined
def compute_buffer_index(begin: I64, count: I64, buffer_count: I64) -> I64:
    """Return the index of the buffer for the part of a kernel that starts at `begin`. `count`: the total number of iterations,
    at least 1. `buffer_count`: the number of buffers, as returned by `count_parts`. Different parts get different buffers."""
    return (begin * buffer_count + count - 1) // count
