"""The interface of observers of a session. An observer sees each step, may stop there, and sees each world that replaces another.
Observing changes nothing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from antdsl.preview.session import Session


@dataclass(frozen=True, slots=True)
class PauseReason:
    """Why the session pauses, as text, and the agents concerned, of one species."""

    line: str
    species: str = ""
    agents: tuple[int, ...] = ()


class Observer(Protocol):
    def before_step(self, session: Session) -> None:
        """Called before each step; `stepped` follows."""

    def after_step(self, session: Session) -> PauseReason | None:
        """Observe a step that was requested or that play made; not those that a seek simulates again. It may add numbers to
        `session.timeline.curves[session.frame]`."""

    def on_new_world(self, session: Session) -> None:
        """Called when the session has a new world: opened, reloaded, restarted, or moved back in time."""
