"""Parts of a crowd on threads: requested within parts, after a fork, without threads, and interrupted."""

import os
import signal
import threading
import time
import zlib
from itertools import chain

import numpy as np
import pytest

from antdsl.numerics import parallel
from antdsl.numerics.check_sums import compute_crc32


@pytest.fixture
def by_two(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on a machine of two cores."""
    monkeypatch.setattr(parallel, "count_available_cores", lambda: 2)


def squares(begin: int, end: int) -> list[int]:
    return [k * k for k in range(begin, end)]


def joined(parts: list[list[int]]) -> list[int]:
    return list(chain.from_iterable(parts))


@pytest.mark.parametrize("threads", [0, 1, 2, 3, 7])
def test_parts_come_in_order_whatever_the_number_of_threads(threads: int) -> None:
    for count in (0, 1, 5, 40):
        assert joined(parallel.run_in_parts(squares, count, threads, 4)) == squares(0, count)


def test_nested_parts_do_not_wait_for_free_threads() -> None:
    """Many crowds step at once, and each of their parts requests parts: perhaps no thread is free for these."""
    results: dict[int, list[list[int]]] = {}

    def crowd(number: int) -> None:
        results[number] = parallel.run_in_parts(lambda a, b: joined(parallel.run_in_parts(squares, b - a, 2, 1)), 64, 2, 1)

    crowds = [threading.Thread(target=crowd, args=(number,), daemon=True) for number in range(8)]
    for each in crowds:
        each.start()
    for each in crowds:
        each.join(60)
    assert len(results) == 8
    assert all(parts in ([squares(0, 32)] * 2, [squares(0, 64)]) for parts in results.values())


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_forked_processes_have_separate_threads() -> None:
    parallel.run_in_parts(squares, 40, 2, 4)
    child = os.fork()
    if not child:
        signal.alarm(60)
        os._exit(0 if joined(parallel.run_in_parts(squares, 40, 2, 4)) == squares(0, 40) else 1)
    assert os.waitpid(child, 0)[1] == 0


def test_an_interrupt_is_raised_after_all_running_parts_have_ended(by_two: None) -> None:
    start_event, ended = threading.Event(), []

    def work(begin: int, end: int) -> None:
        if begin == 0:
            start_event.wait(60)
            raise KeyboardInterrupt
        start_event.set()
        time.sleep(0.05)
        ended.append(end)

    with pytest.raises(KeyboardInterrupt):
        parallel.run_in_parts(work, 40, 2, 4)
    assert ended == [40]


def test_check_sums_are_those_of_zlib() -> None:
    data = np.arange(40_000, dtype=np.float64)
    assert compute_crc32(memoryview(data)) == zlib.crc32(data)
