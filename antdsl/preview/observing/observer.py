"""Who looks on while a session goes on: hears of each step, may say that it stops there, and of each world that takes the place
of another. Looking on changes nothing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from antdsl.preview.session import Session


@dataclass(frozen=True, slots=True)
class Stop:
    """Why it pauses, in words, and the agents of a species that it is about."""

    line: str
    species: str = ""
    agents: tuple[int, ...] = ()


class Observer(Protocol):
    def stepping(self, session: Session) -> None:
        """Before each step that is followed by `stepped`."""

    def stepped(self, session: Session) -> Stop | None:
        """After each step that somebody asked for or that play made; not after those that a seek simulates again. It may add
        numbers of its own to `session.timeline.curves[session.frame]`."""

    def entered(self, session: Session) -> None:
        """The session has another world than before: opened, reloaded, restarted, or gone back in time."""
