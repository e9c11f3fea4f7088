"""A limit of the processor time for a piece of work. The budget also covers the time that other processes spend on this work."""

from __future__ import annotations

import math
import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

_budget_process = 0  # the process that has a budget, 0 for none
# The processor time of this process at which it is spent; the system's timer adds a tick each time that it is set
_budget_end_seconds = 0.0
_MIN_TIMER_SECONDS = 1e-6


class CpuBudgetSpentError(BaseException):
    """Error if work has used more processor time than its budget. It is not an Exception, so that `except Exception` does not
    catch it."""


@contextmanager
def limit_cpu_seconds(seconds: float) -> Iterator[None]:
    """Raise CpuBudgetSpentError inside the context once more than `seconds` of processor time have been used.

    The time of this process and charged time count; 0 means no limit. Use this in the main thread only. On Windows, which has no
    such timer, it does nothing. A library call that is running finishes first.
    """
    global _budget_process, _budget_end_seconds
    if not seconds or not hasattr(signal, "setitimer") or threading.current_thread() is not threading.main_thread():
        yield
        return

    def raise_budget_spent(number: int, frame: object) -> None:
        raise CpuBudgetSpentError

    previous = signal.signal(signal.SIGPROF, raise_budget_spent)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    _budget_process, _budget_end_seconds = os.getpid(), time.process_time() + seconds
    try:
        yield
    finally:
        _budget_process = 0
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, previous)


def compute_remaining_cpu_seconds() -> float:
    """Return the processor time (s) that is left in the current budget; infinity if there is no budget."""
    return max(_budget_end_seconds - time.process_time(), 0.0) if _budget_process == os.getpid() else math.inf


def charge_cpu_seconds(seconds: float) -> None:
    """Subtract the processor time of another process from the budget. Raises CpuBudgetSpentError in the main thread if nothing
    is left."""
    global _budget_end_seconds
    if _budget_process != os.getpid():
        return
    _budget_end_seconds -= seconds
    left = compute_remaining_cpu_seconds()
    if left > 0.0:
        signal.setitimer(signal.ITIMER_PROF, max(left, _MIN_TIMER_SECONDS))
    elif threading.current_thread() is threading.main_thread():
        signal.setitimer(signal.ITIMER_PROF, 0)
        raise CpuBudgetSpentError
    else:
        signal.setitimer(signal.ITIMER_PROF, _MIN_TIMER_SECONDS)  # the timer tells the main thread
