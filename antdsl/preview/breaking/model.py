"""The interface of breakpoints. A watcher first receives the frame at which it starts, then every following frame."""

from __future__ import annotations

from typing import Protocol

from antdsl.preview.observing.observer import PauseReason
from antdsl.preview.session import PreviewSession


class BreakpointError(Exception):
    """Error for a breakpoint that this program can never hit. The message gives the reason and suggests a correction."""

    def __init__(self, message: str, help: str = "") -> None:
        super().__init__(message)
        self.message, self.help = message, help


class BreakpointWatcher(Protocol):
    """An object that checks one breakpoint of the current program. Checking does not change the simulation."""

    def begin(self, session: PreviewSession) -> None:
        """Record whether the condition holds at the session's current frame. Only a later change from false to true is a hit."""

    def check_frame(self, session: PreviewSession) -> PauseReason | None:
        """Return the reason to pause at the session's current frame, or None. Call this once per frame, in order, without
        gaps."""
