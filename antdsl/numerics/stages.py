"""Reports the current stage while a run is set up, so that progress displays can show it."""

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
    """Within the `with` block, call `listener` with the description of each stage that this thread begins."""
    token = _stage_listener.set(listener)
    try:
        yield
    finally:
        _stage_listener.reset(token)
