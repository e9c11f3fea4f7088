"""Breakpoints, which pause the session when their condition is met. `WATCHER_BY_BREAK_KIND` lists all kinds."""

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
from antdsl.preview.requests import AnyBreak, ConditionBreak, FaultBreak, SpecBreak, StateBreak
from antdsl.preview.session import PreviewSession
from antdsl.runtime import World

# A watcher is made for the session's current program. The maker raises BreakpointError if the breakpoint does not fit it.
WATCHER_BY_BREAK_KIND: Mapping[type, Callable[[PreviewSession, Any, SpecObserver], BreakpointWatcher]] = {
    StateBreak: lambda session, request, specs: StateWatcher(session, request),
    ConditionBreak: lambda session, request, specs: ConditionWatcher(session, request),
    SpecBreak: SpecWatcher,
    FaultBreak: lambda session, request, specs: FaultWatcher(session, request),
}


@dataclass(slots=True, eq=False)
class Breakpoint:
    """A breakpoint that a page requested.

    `watcher`: the object that checks each frame; None while the breakpoint does not match the program. `error`: why it does not
    match."""

    request: AnyBreak
    watcher: BreakpointWatcher | None = None
    error: BreakpointError | None = None


def describe_breakpoint(request: AnyBreak) -> str:
    """Return a description of a breakpoint in terms that artists use."""
    match request:
        case StateBreak():
            return f"{request.species} enters {request.state}"
        case ConditionBreak():
            return " ".join(request.text.split())[:80]
        case SpecBreak():
            return f"`{request.spec}` fails"
    return "a value at fault"


class BreakpointObserver:
    """Checks the breakpoints after each played step.

    `send_message`: called with a message for each breakpoint that does not match the program, and with one that lists all
    breakpoints whenever they are rebuilt."""

    def __init__(self, specs: SpecObserver, send_message: Callable[[dict[str, Any]], None] = lambda message: None) -> None:
        self.specs, self.send_message = specs, send_message
        self.breakpoints: list[Breakpoint] = []
        self._shot: Shot | None = None  # the shot for which the watchers are made
        self._last_seen: tuple[World, int] | None = None  # the last world and frame that the watchers received

    def set_breakpoints(self, session: PreviewSession, requests: Sequence[AnyBreak], candidate: AnyBreak | None = None) -> None:
        """Replace all breakpoints by `requests` and, if given, `candidate`. Raises BreakpointError, and changes nothing, if
        `candidate` does not match the program."""
        if candidate is not None and candidate not in requests:
            WATCHER_BY_BREAK_KIND[type(candidate)](session, candidate, self.specs)
            requests = [*requests, candidate]
        known = {each.request: each for each in self.breakpoints}
        self.breakpoints = [known.get(ask) or Breakpoint(ask) for ask in requests]
        self.specs.require_specs([ask.spec for ask in requests if isinstance(ask, SpecBreak)])
        self._make_watchers(session)

    def make_message(self) -> dict[str, Any]:
        """Return the message that lists all breakpoints. Each has the reason why it does not match the program, or "" if it
        does."""
        reasons = [(each.request.model_dump(), _describe_reason(each.error)) for each in self.breakpoints]
        return {"op": "breaks", "breaks": [{"made": ask_fields, "why": why} for ask_fields, why in reasons]}

    def on_new_world(self, session: PreviewSession) -> None:
        """Rebuild the breakpoints for the new program, so that those that do not match it are reported at once."""
        if self.breakpoints and session.shot is not self._shot and session.frame == session.last_frame:
            self._make_watchers(session)

    def before_step(self, session: PreviewSession) -> None:
        """Let the watchers record the current frame, unless they have already received it."""
        if self.breakpoints and not self._has_seen_frame(session):
            if session.shot is not self._shot:
                self._make_watchers(session)
            for each in self.breakpoints:
                if each.watcher is not None:
                    each.watcher.begin(session)
            self._last_seen = session.world, session.frame

    def after_step(self, session: PreviewSession) -> PauseReason | None:
        """Return the reasons of all breakpoints that the step hit, joined to one. Return None if it hit none."""
        if not self.breakpoints or self._last_seen is None or session.world is not self._last_seen[0]:
            return None  # there are no watchers, or the step led into another program, which is checked before the next step
        looked = [each.watcher.check_frame(session) for each in self.breakpoints if each.watcher is not None]
        self._last_seen = session.world, session.frame
        stops = [stop for stop in looked if stop is not None]
        if not stops:
            return None
        first_stop = next((stop for stop in stops if stop.agents), stops[0])
        return replace(first_stop, line=" · ".join(stop.line for stop in stops))

    def _has_seen_frame(self, session: PreviewSession) -> bool:
        """Return whether the watchers have received the session's current frame."""
        return self._last_seen is not None and self._last_seen[0] is session.world and self._last_seen[1] == session.frame

    def _make_watchers(self, session: PreviewSession) -> None:
        """Build the watchers for the session's program, and report the breakpoints that do not match it."""
        self._shot, self._last_seen = session.shot, None
        for each in self.breakpoints:
            try:
                each.watcher, each.error = WATCHER_BY_BREAK_KIND[type(each.request)](session, each.request, self.specs), None
            except BreakpointError as why:
                old_reason, each.watcher, each.error = _describe_reason(each.error), None, why
                if old_reason == _describe_reason(why):
                    continue
                self.send_message(
                    {
                        "op": "refused",
                        "of": "breaks",
                        "message": f"{describe_breakpoint(each.request)}: {why.message}",
                        "help": why.help,
                    }
                )
        self.send_message(self.make_message())


def _describe_reason(error: BreakpointError | None) -> str:
    return "" if error is None else f"{error.message}: {error.help}" if error.help else error.message
