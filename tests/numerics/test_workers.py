"""Threads that wait in machine code: every part is done once, for any caller, and nothing is left behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from children import child_environment

from antdsl.machine_code import workers_text
from antdsl.machine_code.kernels import F64, I64, Array1, kernel, simd_range
from antdsl.machine_code.kernels.direct.argument_text import MAX_JOB_PARTS
from antdsl.numerics import parallel, workers
from antdsl.numerics.parallel import compute_buffer_index

pytestmark = pytest.mark.skipif(not workers.has_native_workers(), reason="no threads that wait in machine code")
THREADS = (1, 2, 3, 7)


@kernel
def squared(x: Array1[F64], out: Array1[F64], times: Array1[I64], begin: I64, end: I64) -> tuple[I64, F64, I64]:
    total = 0.0
    for n in simd_range(begin, end):
        out[n] = x[n] * x[n]
        times[n] += 1
    for n in range(begin, end):
        total += x[n]
    return end - begin, total, begin


@kernel
def in_rooms(rooms: Array1[I64], count: I64, begin: I64, end: I64) -> I64:
    slot = compute_buffer_index(begin, count, rooms.size)
    rooms[slot] += end - begin
    return slot


@kernel
def nothing(begin: I64, end: I64) -> None:
    pass


@pytest.fixture(autouse=True)
def many(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """As on a machine of eight cores."""
    monkeypatch.setattr(parallel, "count_available_cores", lambda: 8)
    previous_pools = dict(workers._pool_by_threads)
    yield
    for key in [key for key in workers._pool_by_threads if key not in previous_pools]:
        workers._pool_by_threads.pop(key).end_workers()


def arrays(count: int) -> tuple[Any, ...]:
    return np.arange(count, dtype=np.float64), np.zeros(count), np.zeros(count, np.int64)


@pytest.mark.parametrize("threads", THREADS)
def test_kernel_parts_run_once_and_are_returned_in_order(threads: int) -> None:
    for count in (0, 1, 2, 15, 16, 17, 100, 1_000, 4_097):
        x, out, times = arrays(count)
        results = parallel.run_in_parts(partial(squared, x, out, times), count, threads, 1)
        assert np.array_equal(out, x * x) and (times == 1).all()
        assert sum(total for _, total, _ in results) == x.sum()
        assert [begin for _, _, begin in results] == [0, *np.cumsum([many for many, _, _ in results])[:-1]]
        assert len(results) == (1 if threads == 1 else max(1, min(count // 16, 4 * threads)))
        assert count == 0 or all(many for many, _, _ in results)


@pytest.mark.parametrize("threads", THREADS)
def test_thousands_of_small_jobs(threads: int) -> None:
    x, out, times = arrays(64)
    work = partial(squared, x, out, times)
    for each in range(5_000):
        parallel.run_in_parts(work if each % 7 else nothing_at_all, 64, threads, 4)
    assert (times == 5_000 - len(range(0, 5_000, 7))).all()


def nothing_at_all(begin: int, end: int) -> None:
    pass


def test_kernels_without_results_or_with_python_arguments() -> None:
    assert parallel.run_in_parts(nothing, 40, 2, 4) == parallel.run_in_parts(partial(nothing), 40, 2, 4) == [None] * 2
    x, out, times = arrays(100)
    assert parallel.run_in_parts(partial(squared, x, out, memoryless(times)), 100, 2, 4) == [(100, x.sum(), 0)]
    with pytest.raises(ValueError, match="float64"):
        parallel.run_in_parts(partial(squared, x.astype(np.float32), out, times), 100, 2, 4)
    assert len(parallel.run_in_parts(partial(squared, x, out, times), 100, 2, 4)) == 6


def memoryless(array: Any) -> Any:
    """An array of a class that machine code does not know."""

    class Another(np.ndarray):
        pass

    return array.view(Another)


def test_concurrent_and_nested_python_jobs_complete() -> None:
    wrong: list[str] = []

    def crowd(number: int) -> None:
        for each in range(300):
            x, out, times = arrays(50 + number)
            threads = 1 + (each + number) % 4
            if each % 3:
                parallel.run_in_parts(partial(squared, x, out, times), len(x), threads, 5)
            else:
                parallel.run_in_parts(lambda a, b: within(x, out, times, a, b), len(x), threads, 5)  # noqa: B023
            if not (np.array_equal(out, x * x) and (times == 1).all()):
                wrong.append(f"{number}, {each}")

    def within(x: Any, out: Any, times: Any, a: int, b: int) -> None:
        parallel.run_in_parts(partial(squared, x[a:b], out[a:b], times[a:b]), b - a, 3, 2)

    crowds = [threading.Thread(target=crowd, args=(number,), daemon=True) for number in range(6)]
    for one in crowds:
        one.start()
    for one in crowds:
        one.join(120)
    assert not any(one.is_alive() for one in crowds) and not wrong


@pytest.mark.parametrize("threads", (2, 3, 7))
def test_the_first_failing_part_raises_after_all_running_parts_have_ended(threads: int) -> None:
    at_work: list[int] = []

    def work(begin: int, end: int) -> int:
        at_work.append(begin)
        try:
            if begin:
                raise ValueError(begin)
            return end
        finally:
            at_work.remove(begin)

    for _ in range(200):
        with pytest.raises(ValueError, match=r"^5$"):
            parallel.run_in_parts(work, 5 * threads, threads, 5)
        assert not at_work
    assert parallel.run_in_parts(lambda a, b: b - a, 10, 2, 1) == [5, 5]


@pytest.mark.parametrize("is_running", (False, True))
def test_interrupted_callers_wait_for_running_parts(is_running: bool) -> None:
    pool, start_event = workers.WorkerPool(2), threading.Event()
    start = pool._start_function
    at_work, ended = [], []

    def interrupted(*words: int) -> None:
        if is_running:
            start(*words)
            start_event.wait(60)
        raise KeyboardInterrupt

    def work(number: int) -> None:
        at_work.append(number)
        start_event.set()
        time.sleep(0.05)
        ended.append(number)

    pool._start_function = interrupted  # type: ignore[assignment]
    with pytest.raises(KeyboardInterrupt):
        pool.run_calls(work, 2)
    assert (
        bool(ended) == is_running and len(at_work) == len(ended) and not pool._shared_words[workers_text.PARTS_LEFT_WORD] % 2**32
    )
    pool._start_function = start
    pool.run_calls(work, 2)
    assert ended.count(0) == 1
    pool.end_workers()


def test_functions_of_machine_code_are_called_with_each_row() -> None:
    buffer = np.zeros(8, np.int64)  # `turns` reads one word, and only waits
    for count in (1, 3, MAX_JOB_PARTS, 3 * MAX_JOB_PARTS + 5):
        parallel.call_for_each_row(
            workers_text.load_code().function("turns"), np.array([(buffer.ctypes.data, 3, 0)] * count, np.int64), 3
        )
    pool = workers._pool_by_threads[3]
    assert isinstance(pool, workers.WorkerPool)
    assert (
        pool._shared_words[workers_text.DONE_COUNT_WORD] == pool._shared_words[workers_text.PART_COUNT_WORD] == 5
        and not pool._shared_words[workers_text.PARTS_LEFT_WORD] % 2**32
    )


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_forked_processes_start_separate_threads() -> None:
    x, out, times = arrays(400)
    work = partial(squared, x, out, times)
    parallel.run_in_parts(work, 400, 3, 10)
    child = os.fork()
    if not child:
        signal.alarm(60)
        for _ in range(100):
            parallel.run_in_parts(work, 400, 3, 10)
        os._exit(0 if (times == 101).all() and len(threading.enumerate()) >= 3 else 1)
    assert os.waitpid(child, 0)[1] == 0


ENDS = """
import os, sys, threading, time
from functools import partial
import numpy as np
from antdsl.numerics import parallel
from test_workers import squared, arrays
parallel.count_available_cores = lambda: 8
x, out, times = arrays(4000)
def go():
    while True:
        parallel.run_in_parts(partial(squared, x, out, times), 4000, 3, 10)
        parallel.run_in_parts(lambda a, b: time.sleep(0), 10, 3, 1)
parallel.run_in_parts(partial(squared, x, out, times), 4000, 3, 10)
if sys.argv[1] == "busy":
    threading.Thread(target=go, daemon=True).start()
    time.sleep(0.2)
elif sys.argv[1] == "asleep":
    time.sleep(0.2)
elif sys.argv[1] == "raises":
    parallel.run_in_parts(lambda a, b: 1 // 0, 10, 3, 1)
print("over")
"""


@pytest.mark.parametrize(("how", "status"), [("at once", 0), ("asleep", 0), ("busy", 0), ("raises", 1)])
def test_programs_exit_with_busy_threads(how: str, status: int) -> None:
    ran = subprocess.run(
        [sys.executable, "-c", ENDS, how],
        env=child_environment(Path(__file__).parent, Path(__file__).parents[1]),
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert ran.returncode == status and ("ZeroDivisionError" if status else "over") in ran.stderr + ran.stdout
    assert status or not ran.stderr


def test_the_executor_replaces_native_workers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "has_native_workers", lambda: False)
    monkeypatch.setattr(workers, "_pool_by_threads", {})
    x, out, times = arrays(1_000)
    for threads in THREADS:
        results = parallel.run_in_parts(partial(squared, x, out, times), 1_000, threads, 10)
        assert sum(total for _, total, _ in results) == x.sum()
        with pytest.raises(ZeroDivisionError):
            parallel.run_in_parts(lambda a, b: 1 // a, 1_000, threads, 10)
    assert (times == len(THREADS)).all() and isinstance(workers._pool_by_threads[2], workers.ExecutorPool)


@pytest.mark.parametrize("pool", [workers.WorkerPool, workers.ExecutorPool])
def test_interrupts_release_the_pool(pool: Any) -> None:
    """CPython raises it where a function begins, and in a call that is over: also in the one that takes the pool."""
    ask, code = workers._run_exclusively, workers._run_exclusively.__code__
    pool, interrupt_count = pool(1), 0

    def interrupted(at: int) -> bool:
        passed = iter(range(10_000))

        def look(frame: Any, event: str, _: Any) -> None:
            own, called = frame.f_code is code, frame.f_back is not None and frame.f_back.f_code is code
            if ((own and event in ("call", "c_return")) or (called and event == "return")) and next(passed) == at:
                raise KeyboardInterrupt

        previous_profiler = sys.getprofile()
        sys.setprofile(look)
        try:
            assert ask(pool, lambda: "together", lambda: "alone") == "together"
        except KeyboardInterrupt:
            return True
        finally:
            sys.setprofile(previous_profiler)
        return False

    while interrupted(interrupt_count):
        interrupt_count += 1
        assert ask(pool, lambda: "together", lambda: "alone") == "together"
    assert interrupt_count >= 3  # as it begins, once it is noted who asks, and after the work
    assert ask(pool, lambda: ask(pool, lambda: "together", lambda: "alone"), lambda: "nobody") == "alone"
    pool.end_workers()


@pytest.mark.parametrize("threads", THREADS)
def test_parallel_parts_have_separate_buffers(threads: int) -> None:
    for count in (1, 15, 16, 17, 100, 129, 500, 5_001, 100_003):
        for least in (16, 64, 1_000):
            rooms = np.zeros(parallel.count_parts(count, threads, least), np.int64)
            slots = parallel.run_in_parts(partial(in_rooms, rooms, count), count, threads, least)
            assert len(set(slots)) == len(slots) <= len(rooms) and rooms.sum() == count
            assert len(slots) == len(rooms)
