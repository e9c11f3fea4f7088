"""A breakpoint on a fault in any agent, for example a value that is not a number."""

from __future__ import annotations

from antdsl.preview.observing.observer import Stop
from antdsl.preview.requests import FaultBreak
from antdsl.preview.session import Session


class FaultWatcher:
    """Stops even for faults that would otherwise only quarantine agents."""

    def __init__(self, session: Session, ask: FaultBreak) -> None:
        self.ask = ask

    def begin(self, session: Session) -> None:
        """Each step has its own faults."""

    def check_frame(self, session: Session) -> Stop | None:
        fault = session.world.faults.latest
        return None if fault is None else Stop(fault.brief, fault.species, (fault.agent,))
