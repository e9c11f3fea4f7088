"""The list of all observers of a running session, and the observer that prints messages of the backend in the terminal.

Such a message says that the run deviates from the request, for example because machine code is missing. Each is printed once."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import TYPE_CHECKING

from antdsl.preview.breaking import BreakpointObserver
from antdsl.preview.observing.cost_reporter import CostReporter
from antdsl.preview.observing.observer import Observer
from antdsl.preview.observing.spec_judgement import SpecObserver
from antdsl.preview.session import PreviewSession

if TYPE_CHECKING:
    from antdsl.preview.live import LiveSimulation
    from antdsl.preview.observing.observer import PauseReason


def _make_spec_observer(live: LiveSimulation) -> Observer:
    return SpecObserver(live.send_to_all)


def _make_breakpoints(live: LiveSimulation) -> Observer:
    return BreakpointObserver(live.find_observer(SpecObserver), live.send_to_all)


def _make_message_observer(live: LiveSimulation) -> Observer:
    return BackendMessageObserver()


# Observers that each Live creates, in this order. A handler gets one by `live.find_observer(Kind)`. Specs come before
# breakpoints,
# which check whether a spec failed.
OBSERVER_MAKERS: tuple[Callable[[LiveSimulation], Observer], ...] = (
    CostReporter,
    _make_message_observer,
    _make_spec_observer,
    _make_breakpoints,
)


class BackendMessageObserver:
    """An observer that prints the backend's messages. Only the live thread uses it."""

    def __init__(self) -> None:
        self._printed_messages: set[str] = set()

    def before_step(self, session: PreviewSession) -> None:
        """Do nothing: messages are printed after the step."""

    def after_step(self, session: PreviewSession) -> PauseReason | None:
        """Print new list_messages of the backend. Always return None, so the session never pauses."""
        for sentence in session.world.backend.list_messages():
            if sentence not in self._printed_messages:
                self._printed_messages.add(sentence)
                print(sentence, file=sys.stderr, flush=True)
        return None

    def on_new_world(self, session: PreviewSession) -> None:
        """Do nothing: a new world has no messages until it makes a step."""
