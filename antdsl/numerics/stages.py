"""The current stage of a set-up. The code that sets up reports its stages, and progress displays listen."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_stage_listener: ContextVar[Callable[[str], None] | None] = ContextVar("listener", default=None)


def begin_stage(description: str) -> None:
    """Report the start of a stage, such as `ground` or `placing 500 agents`."""
    listener = _stage_listener.get()
    if listener is not None:
        listener(description)


@contextmanager
def report_stages_to(listener: Callable[[str], None]) -> Iterator[None]:
    """Call `listener` with the words of each stage that this thread begins within the context."""
    token = _stage_listener.set(listener)
    try:
        yield
    finally:
        _stage_listener.reset(token)
