"""The interface of breakpoints. A waiting breakpoint receives the frame at which it begins, then every following frame."""

from __future__ import annotations

from typing import Protocol

from antdsl.preview.observing.observer import PauseReason
from antdsl.preview.session import PreviewSession


class BreakpointError(Exception):
    """Error for a breakpoint that cannot be hit in this program. The message has the reason and a correction."""

    def __init__(self, message: str, help: str = "") -> None:
        super().__init__(message)
        self.message, self.help = message, help


class BreakpointWatcher(Protocol):
    """An active breakpoint of one program. Its checks change nothing."""

    def begin(self, session: PreviewSession) -> None:
        """Record whether the condition holds at this frame. Only a later change from false to true is a hit."""

    def check_frame(self, session: PreviewSession) -> PauseReason | None:
        """Return the reason to pause at this frame, or None. Frames arrive in order: each directly follows the frame of the
        previous call."""
