"""A value at fault: a number that is none, in whichever agent."""

from __future__ import annotations

from antdsl.preview.observing.observer import Stop
from antdsl.preview.requests import FaultBreak
from antdsl.preview.session import Session


class FaultWaits:
    """Stops also where faults would only set agents aside."""

    def __init__(self, session: Session, ask: FaultBreak) -> None:
        self.ask = ask

    def begin(self, session: Session) -> None:
        """Each step has its own faults."""

    def look(self, session: Session) -> Stop | None:
        fault = session.world.faults.latest
        return None if fault is None else Stop(fault.brief, fault.species, (fault.agent,))
