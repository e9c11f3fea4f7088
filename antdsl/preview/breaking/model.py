"""The interface of breakpoints: a waiting breakpoint receives the start frame, then looks at every frame."""

from __future__ import annotations

from typing import Protocol

from antdsl.preview.observing.observer import PauseReason
from antdsl.preview.session import Session


class BreakpointError(Exception):
    """The reason why a breakpoint cannot be hit in this program, and what to write instead."""

    def __init__(self, message: str, help: str = "") -> None:
        super().__init__(message)
        self.message, self.help = message, help


class BreakpointWatcher(Protocol):
    """A breakpoint that waits, made for one program. Looking changes nothing."""

    def begin(self, session: Session) -> None:
        """Record the condition at this frame. What holds already is no hit; only a change to it is."""

    def check_frame(self, session: Session) -> PauseReason | None:
        """Return why to stop at this frame, or None. Frames arrive in order: each is the next after the last one seen or looked
        at."""
