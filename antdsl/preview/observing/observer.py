"""The interface of observers of a session.

An observer receives each step, may pause the session after it, and receives each world that replaces another. Observers change no
simulation result."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from antdsl.preview.session import PreviewSession


@dataclass(frozen=True, slots=True)
class PauseReason:
    """The reason for a pause, as text, and the agents concerned, all of one species."""

    line: str
    species: str = ""
    agents: tuple[int, ...] = ()


class Observer(Protocol):
    """An object that receives the steps of a session."""

    def before_step(self, session: PreviewSession) -> None:
        """Prepare for a step. `after_step` follows."""

    def after_step(self, session: PreviewSession) -> PauseReason | None:
        """Observe a step that was requested or played, and return a reason to pause, or None. Not called for steps that a seek
        simulates again. May add numbers to `session.timeline.curves[session.frame]`."""

    def on_new_world(self, session: PreviewSession) -> None:
        """Observe a new world: the session was opened, reloaded, restarted, or moved back in time."""
