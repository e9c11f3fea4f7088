"""What a breakpoint is while it waits: it is shown where it begins, then looks at every frame."""

from __future__ import annotations

from typing import Protocol

from antdsl.preview.observing.observer import Stop
from antdsl.preview.session import Session


class Misfit(Exception):
    """Why a breakpoint cannot be met in this program: in words, and what to write instead."""

    def __init__(self, message: str, help: str = "") -> None:
        super().__init__(message)
        self.message, self.help = message, help


class Waiting(Protocol):
    """A breakpoint that waits, made for one program. Looking changes nothing."""

    def begin(self, session: Session) -> None:
        """See how it is at this frame, which is not met by itself: only what comes to be so is."""

    def look(self, session: Session) -> Stop | None:
        """Why to stop at this frame, the next after the one that was seen or looked at last."""
