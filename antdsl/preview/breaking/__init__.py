"""Breakpoints: the session pauses when one is hit. `WATCHER_BY_BREAK_KIND` lists all kinds."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from antdsl.pipeline import Shot
from antdsl.preview.breaking.conditions import ConditionWatcher
from antdsl.preview.breaking.model import BreakpointError, BreakpointWatcher
from antdsl.preview.breaking.watchers import FaultWatcher, SpecWatcher, StateWatcher
from antdsl.preview.observing.observer import PauseReason
from antdsl.preview.observing.spec_judgement import SpecObserver
from antdsl.preview.requests import Break, ConditionBreak, FaultBreak, SpecBreak, StateBreak
from antdsl.preview.session import Session
from antdsl.runtime import World

# Made for the program that a session has now; Misfit where it does not fit that.
WATCHER_BY_BREAK_KIND: Mapping[type, Callable[[Session, Any, SpecObserver], BreakpointWatcher]] = {
    StateBreak: lambda session, ask, specs: StateWatcher(session, ask),
    ConditionBreak: lambda session, ask, specs: ConditionWatcher(session, ask),
    SpecBreak: SpecWatcher,
    FaultBreak: lambda session, ask, specs: FaultWatcher(session, ask),
}


@dataclass(slots=True, eq=False)
class Breakpoint:
    """A breakpoint.

    `ask`: the request.
    `waits`: the watcher; None while the breakpoint does not match the program.
    `why`: the error if it does not match."""

    ask: Break
    waits: BreakpointWatcher | None = None
    why: BreakpointError | None = None


def breakpoint_text(ask: Break) -> str:
    """Return a breakpoint in an artist's words."""
    match ask:
        case StateBreak():
            return f"{ask.species} enters {ask.state}"
        case ConditionBreak():
            return " ".join(ask.text.split())[:80]
        case SpecBreak():
            return f"`{ask.spec}` fails"
    return "a value at fault"


class Breakpoints:
    """Checks the breakpoints after each played step.

    `tell`: receives a message for each breakpoint that does not match the program, and one with all breakpoints when they are
    built again."""

    def __init__(self, specs: SpecObserver, tell: Callable[[dict[str, Any]], None] = lambda message: None) -> None:
        self.specs, self.tell = specs, tell
        self.breaks: list[Breakpoint] = []
        self._shot: Shot | None = None  # that they are made for
        self._seen: tuple[World, int] | None = None  # the world and frame that they have seen

    def set(self, session: Session, asks: Sequence[Break], tried: Break | None = None) -> None:
        """Replace all breakpoints. `tried`: an additional one. Raises BreakpointError if `tried` does not match the program; then
        nothing changes."""
        if tried is not None and tried not in asks:
            WATCHER_BY_BREAK_KIND[type(tried)](session, tried, self.specs)
            asks = [*asks, tried]
        known = {each.ask: each for each in self.breaks}
        self.breaks = [known.get(ask) or Breakpoint(ask) for ask in asks]
        self.specs.require([ask.spec for ask in asks if isinstance(ask, SpecBreak)])
        self._make_watchers(session)

    def message(self) -> dict[str, Any]:
        """Return the message with all breakpoints, each with the reason why it does not match the program, or ""."""
        reasons = [(each.ask.model_dump(), _reason_text(each.why)) for each in self.breaks]
        return {"op": "breaks", "breaks": [{"made": ask_fields, "why": why} for ask_fields, why in reasons]}

    def on_new_world(self, session: Session) -> None:
        """Build the breakpoints again for another program, so that those that do not match are reported at once."""
        if self.breaks and session.shot is not self._shot and session.frame == session.last_frame:
            self._make_watchers(session)

    def before_step(self, session: Session) -> None:
        """Let the watchers record the current frame if they have not received it yet."""
        if self.breaks and not self._is_seen(session):
            if session.shot is not self._shot:
                self._make_watchers(session)
            for each in self.breaks:
                if each.waits is not None:
                    each.waits.begin(session)
            self._seen = session.world, session.frame

    def after_step(self, session: Session) -> PauseReason | None:
        """Return the joined reasons of all breakpoints that were hit, or None."""
        if not self.breaks or self._seen is None or session.world is not self._seen[0]:
            return None  # none waits, or the step led into another program: that is looked at before the next
        looked = [each.waits.check_frame(session) for each in self.breaks if each.waits is not None]
        self._seen = session.world, session.frame
        stops = [stop for stop in looked if stop is not None]
        if not stops:
            return None
        first_stop = next((stop for stop in stops if stop.agents), stops[0])
        return replace(first_stop, line=" · ".join(stop.line for stop in stops))

    def _is_seen(self, session: Session) -> bool:
        """Return whether the watchers have received the session's current frame."""
        return self._seen is not None and self._seen[0] is session.world and self._seen[1] == session.frame

    def _make_watchers(self, session: Session) -> None:
        """Build the watchers for the session's program, and report breakpoints that do not match it."""
        self._shot, self._seen = session.shot, None
        for each in self.breaks:
            try:
                each.waits, each.why = WATCHER_BY_BREAK_KIND[type(each.ask)](session, each.ask, self.specs), None
            except BreakpointError as why:
                old_reason, each.waits, each.why = _reason_text(each.why), None, why
                if old_reason == _reason_text(why):
                    continue
                self.tell(
                    {"op": "refused", "of": "breaks", "message": f"{breakpoint_text(each.ask)}: {why.message}", "help": why.help}
                )
        self.tell(self.message())


def _reason_text(why: BreakpointError | None) -> str:
    return "" if why is None else f"{why.message}: {why.help}" if why.help else why.message
