"""The interface of a session's observers.

An observer receives each step and may pause the session after it. It also receives each new world that replaces the previous
one. Observers do not change simulation results."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from antdsl.preview.session import PreviewSession


@dataclass(frozen=True, slots=True)
class PauseReason:
    """The reason for a pause, as text, and the agents concerned, which all belong to one species."""

    line: str
    species: str = ""
    agents: tuple[int, ...] = ()


class Observer(Protocol):
    """An object that receives the steps of a session."""

    def before_step(self, session: PreviewSession) -> None:
        """Prepare for a step. A call of `after_step` follows."""

    def after_step(self, session: PreviewSession) -> PauseReason | None:
        """Observe a step that was requested or played. Return a reason to pause, or None. It is not called for steps that a seek
        simulates again. An observer may add numbers to `session.timeline.curves[session.frame]`."""

    def on_new_world(self, session: PreviewSession) -> None:
        """Observe a new world, after the session was opened, reloaded, restarted or moved back in time."""
