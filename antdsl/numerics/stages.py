"""Reports the current stage of a set-up. The code that sets up a run reports its stages; progress displays listen to them."""

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
    """Call `listener` within the context: once for each stage that this thread begins, with the stage's description."""
    token = _stage_listener.set(listener)
    try:
        yield
    finally:
        _stage_listener.reset(token)
