"""How commands that are long at work are stopped."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager

from antdsl.cli.exits import Exit


class Terminated(KeyboardInterrupt):
    """SIGTERM: as good as Ctrl-C, with an exit code of its own."""


def code_of(why: BaseException) -> Exit:
    """The exit code of a command that was stopped by Ctrl-C or by SIGTERM."""
    return Exit.TERMINATED if isinstance(why, Terminated) else Exit.INTERRUPTED


@contextmanager
def stoppable() -> Iterator[None]:
    """Being asked to end by SIGTERM raises too, as Ctrl-C does."""

    def stop(number: int, frame: object) -> None:
        raise Terminated if number == signal.SIGTERM else KeyboardInterrupt

    before = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
