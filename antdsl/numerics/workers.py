"""Worker threads that wait for work in machine code. Starting work takes a few microseconds and does not need the
interpreter's lock. Each worker is a Python thread that runs a machine code function (`workers_text`) until the program ends.
Jobs that run kernels never enter the interpreter. Jobs that call Python functions acquire the interpreter's lock in each
participating thread. If threads cannot wait in machine code, an executor of `concurrent.futures` is used instead."""

from __future__ import annotations

import atexit
import ctypes
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from functools import cache, partial
from threading import Lock, Thread
from time import perf_counter
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code import llvm_compiler
from antdsl.machine_code import workers_text as words
from antdsl.machine_code.kernels import direct
from antdsl.machine_code.kernels.direct.argument_text import MAX_JOB_PARTS
from antdsl.machine_code.memory import get_array_address
from antdsl.numerics.processor.float_environment import set_standard_floats
from antdsl.numerics.processor.host import PARTS_PER_THREAD

PartResult = TypeVar("PartResult")
_LOCK_FUNCTIONS = ("PyThread_allocate_lock", "PyThread_acquire_lock", "PyThread_release_lock")
# Seconds that a thread without work spins before it blocks. Waking a thread takes 30 to 100 us, which a step of 15,000 agents
# would need up to 50 times. The serial work between two jobs of a step is mostly shorter than this.
_SPIN_SECONDS = 1e-3
_TIMED_SPIN_TURNS = 1_000  # turns that are timed
_CACHE_LINE_BYTES = 64  # bytes of a cache line
_ENTRY_SIGNATURE = (None, ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64)


class WorkerPool:
    """Threads that work in addition to the caller's thread.

    Only one caller can use a pool at a time; `current_caller` stores it. Other callers do not wait, but do their work without
    the pool."""

    def __init__(self, count: int) -> None:
        code = words.load_code()
        buffer = np.zeros(words.FIRST_SLEEP_WORD + words.CACHE_LINE_WORDS * (count + 1) + _CACHE_LINE_BYTES // 8, np.int64)
        self.current_caller: dict[None, object] = {}
        self.address = -(-get_array_address(buffer) // _CACHE_LINE_BYTES) * _CACHE_LINE_BYTES
        self._shared_words: NDArray[np.int64] = buffer[(self.address - get_array_address(buffer)) // 8 :]
        self._start_function = ctypes.PYFUNCTYPE(*_ENTRY_SIGNATURE)(
            code.get_function_address("start")
        )  # this call holds the interpreter's lock
        self._run_all_function, self._finish_function, self._end_function, loop = (
            code.function(name) for name in ("all", "finish", "end", "worker")
        )
        self._work: Callable[[int], object] = int
        self._exceptions: list[BaseException] = []
        self._part_callback = ctypes.CFUNCTYPE(*_ENTRY_SIGNATURE)(self._run_call)
        self._part_numbers = np.array([(0, k + 1, 0) for k in range(MAX_JOB_PARTS)], np.int64)
        locks = [_make_locked_lock() for _ in range(count + 1)]
        self._shared_words[[words.WORKER_COUNT_WORD, words.SPIN_TURNS_WORD, words.CALLER_LOCK_WORD]] = (
            count,
            _measure_spin_turns(),
            locks[count],
        )
        self._shared_words[[words.ACQUIRE_FUNCTION_WORD, words.RELEASE_FUNCTION_WORD]] = [
            _get_symbol_address(name) for name in _LOCK_FUNCTIONS[1:]
        ]
        for k in range(count):
            self._shared_words[words.FIRST_SLEEP_WORD + words.CACHE_LINE_WORDS * k + 1] = locks[k]
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(self))  # never freed: its threads may work until the process ends
        self._threads = [Thread(target=self._run_worker, args=(loop, k), name=f"kernels {k}", daemon=True) for k in range(count)]
        for each in self._threads:
            each.start()

    def _run_worker(self, loop: Callable[[int, int, int], None], number: int) -> None:
        """Run worker `number` until the pool ends. `loop`: the machine code function in which it waits for jobs and runs them."""
        set_standard_floats()
        loop(self.address, number, 0)

    def run_calls(self, work: Callable[[int], object], helpers: int) -> None:
        """Call `work(0)` in this thread, and `work(1)` to `work(helpers)` in workers that become free before `work(0)` ends.
        When the method returns, all calls have ended, even after an interruption. It raises the first exception that a call
        raised."""
        self._work, self._exceptions = work, []
        self._post_job(self._part_callback, self._part_numbers, min(helpers, MAX_JOB_PARTS))
        try:
            self._start_function(self.address, 0, 0)
            work(0)
        finally:
            try:
                self._finish_function(self.address, 0, 0)
            except BaseException:
                self._finish_function(self.address, 0, 0)
                raise
            finally:
                self._work = int
        exceptions, self._exceptions = self._exceptions, []
        if exceptions:
            raise exceptions[0]

    def run_kernel(self, work: Callable[[int, int], PartResult], count: int, parts: int) -> list[PartResult] | None:
        """Run a kernel over `count` numbers in parts, and return the result of each part. Return None if `work` is not a
        `partial` of a kernel that can run in parts."""
        if not isinstance(work, partial) or work.keywords:
            return None
        get_call = getattr(work.func, "get_parallel_call", None)
        run = None if get_call is None else get_call()
        if run is None:
            return None
        results: list[PartResult] = run(*work.args, 0, count, parts, self.address)
        return results

    def call_for_each_row(self, function: Callable[[int, int, int], None], rows: NDArray[np.int64]) -> None:
        """Call a machine code function in parallel, once for each row of an array [k,3]. A row holds the arguments of a call."""
        for first in range(0, len(rows), MAX_JOB_PARTS):
            batch = np.ascontiguousarray(rows[first : first + MAX_JOB_PARTS])
            self._post_job(function, batch, len(batch))
            self._run_all_function(self.address, 0, 0)

    def end_workers(self) -> None:
        """End the worker threads as soon as they finish their current parts. The calling thread of a running job does the
        remaining parts."""
        self._end_function(self.address, 0, 0)
        for each in self._threads:
            each.join()

    def _post_job(self, function: Any, table: NDArray[np.int64], parts: int) -> None:
        """Store a job for the workers. `function`: a machine code function. `table`: one row of arguments per part."""
        code = ctypes.cast(function, ctypes.c_void_p).value or 0
        self._shared_words[words.JOB_CODE_WORD : words.PART_COUNT_WORD + 1] = code, get_array_address(table), 0, parts
        self._shared_words[words.DONE_COUNT_WORD] = parts  # before a job is started, nothing is pending

    def _run_call(self, _: int, number: int, __: int) -> None:
        """Call the current job's Python function with `number`, and store an exception that it raises. Machine code calls this
        method and passes two more arguments, which are not used."""
        try:
            self._work(number)
        except BaseException as problem:
            self._exceptions.append(problem)


class ExecutorPool:
    """A replacement for `WorkerPool` that runs work in an executor instead of machine code."""

    def __init__(self, count: int) -> None:
        self.current_caller: dict[None, object] = {}
        self._executor = ThreadPoolExecutor(count, "kernels", set_standard_floats)

    def run_calls(self, work: Callable[[int], object], helpers: int) -> None:
        """Call `work` in this thread and in the executor's threads, like `WorkerPool.run_calls`."""
        others = [self._executor.submit(work, number) for number in range(1, helpers + 1)]
        try:
            work(0)
        finally:
            pending = [other for other in others if not other.cancel()]
            try:
                wait(pending)
            except BaseException:
                wait(pending)
                raise
        for other in pending:
            other.result()

    def end_workers(self) -> None:
        """End the threads."""
        self._executor.shutdown()


def count_parts(count: int, threads: int) -> int:
    """Return in how many parts to run a kernel over `count` numbers on `threads` threads. Each part fills at least one SIMD
    register."""
    return max(1, min(PARTS_PER_THREAD * threads, MAX_JOB_PARTS, count // words.PART_ALIGNMENT))


def run_in_parts(work: Callable[[int, int], PartResult], count: int, threads: int, max_threads: int) -> list[PartResult]:
    """Run `work` in parts, like `parallel.run_in_parts`, with at most `max_threads` threads of the pool for `threads` threads."""
    pool = _get_pool(threads)

    def run_parts_in_parallel() -> list[PartResult]:
        thread_count = min(max_threads, threads, MAX_JOB_PARTS)
        results = pool.run_kernel(work, count, count_parts(count, thread_count)) if isinstance(pool, WorkerPool) else None
        return _pull_parts(pool, work, count, thread_count) if results is None else results

    return _run_exclusively(pool, run_parts_in_parallel, lambda: [work(0, count)])


def _run_exclusively(
    pool: WorkerPool | ExecutorPool, run_together: Callable[[], PartResult], run_alone: Callable[[], PartResult]
) -> PartResult:
    """Return the result of `run_together` if no other caller uses the pool, else that of `run_alone`."""
    caller = object()
    try:
        if (
            pool.current_caller.setdefault(None, caller) is caller
        ):  # a single call registers the caller, so an interrupt comes before or after it
            return run_together()
    finally:
        # No function calls here: an interrupt after one would leave the pool occupied forever.
        if pool.current_caller == {None: caller}:
            del pool.current_caller[None]
    return run_alone()


def _pull_parts(
    pool: WorkerPool | ExecutorPool, work: Callable[[int, int], PartResult], count: int, parts: int
) -> list[PartResult]:
    """Run a Python function in parts, and return the result of each part. Free threads take the next part. If parts fail, the
    exception of the first one is raised; later parts may not have started."""
    results: dict[int, PartResult] = {}
    exception_by_part: dict[int, BaseException] = {}
    next_parts = iter(range(parts))

    def run_parts(_: int) -> None:
        for k in next_parts:  # the next part that no thread has taken yet
            try:
                results[k] = work(count * k // parts, count * (k + 1) // parts)
            except BaseException as problem:
                exception_by_part[k] = problem
                return

    pool.run_calls(run_parts, parts - 1)
    if exception_by_part:
        raise exception_by_part[min(exception_by_part)]
    return [results[k] for k in range(parts)]


def run_in_threads(work: Callable[[int], object], threads: int) -> None:
    """Call `work` in several threads of a pool. `parallel.run_in_threads` describes the details."""
    pool = _get_pool(threads)
    _run_exclusively(pool, lambda: pool.run_calls(work, threads - 1), lambda: work(0))


def call_for_each_row(function: Callable[[int, int, int], None], parts: NDArray[np.int64], threads: int) -> None:
    """Call a machine code function for each row of `parts` with a pool of threads. `parallel.call_for_each_row` describes the
    details."""
    pool = _get_pool(threads)

    def call_in_order() -> None:
        for part in parts.tolist():
            function(*part)

    _run_exclusively(
        pool, partial(pool.call_for_each_row, function, parts) if isinstance(pool, WorkerPool) else call_in_order, call_in_order
    )


@cache
def has_native_workers() -> bool:
    """Return whether threads can wait in machine code on this system."""
    return (
        llvm_compiler.is_available()
        and direct.is_supported()
        and all(hasattr(ctypes.pythonapi, name) for name in _LOCK_FUNCTIONS)
    )


_pool_by_threads: dict[int, WorkerPool | ExecutorPool] = {}
_POOL_LOCK = Lock()


def _get_pool(threads: int) -> WorkerPool | ExecutorPool:
    """Return the cached pool for `threads` threads, which include the caller's. It is a WorkerPool if possible, else an
    ExecutorPool."""
    pool = _pool_by_threads.get(threads)
    if pool is None:
        with _POOL_LOCK:
            pool = _pool_by_threads.get(threads)
            if pool is None:
                pool = _pool_by_threads[threads] = WorkerPool(threads - 1) if has_native_workers() else ExecutorPool(threads - 1)
    return pool


def _forget_pools() -> None:
    """Discard all pools after a fork, because their threads do not exist in the child process."""
    global _POOL_LOCK
    _pool_by_threads.clear()
    _POOL_LOCK = Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_pools)


@atexit.register
def _stop_pools() -> None:
    """End the threads of all pools at the end of the program."""
    for each in _pool_by_threads.values():
        each.end_workers()


def _get_symbol_address(name: str) -> int:
    """Return the address of a function of CPython's C interface."""
    return ctypes.cast(getattr(ctypes.pythonapi, name), ctypes.c_void_p).value or 0


def _make_locked_lock() -> int:
    """Return the address of a new CPython lock that is already acquired."""
    allocate = ctypes.CFUNCTYPE(ctypes.c_void_p)(_get_symbol_address(_LOCK_FUNCTIONS[0]))
    acquire = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_int)(_get_symbol_address(_LOCK_FUNCTIONS[1]))
    lock: int | None = allocate()
    if not lock:
        raise MemoryError
    acquire(lock, 1)
    return lock


@cache
def _measure_spin_turns() -> int:
    """Return for how many iterations a thread without work should spin before it blocks, from a measurement."""
    wait, buffer = words.load_code().function("turns"), np.zeros(1, np.int64)
    spent = []
    for _ in range(3):
        began = perf_counter()
        wait(get_array_address(buffer), _TIMED_SPIN_TURNS, 0)
        spent.append(perf_counter() - began)
    return max(1, int(_TIMED_SPIN_TURNS * _SPIN_SECONDS / min(spent)))
