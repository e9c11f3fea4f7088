"""All who look on while a session goes on."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from antdsl.preview.breaking import Breakpoints
from antdsl.preview.observing.meter import Costs
from antdsl.preview.observing.notes import Notes
from antdsl.preview.observing.observer import Observer
from antdsl.preview.observing.spec_judgement import Specs

if TYPE_CHECKING:
    from antdsl.preview.live import Live


def _specs(live: Live) -> Observer:
    return Specs(live.tell_all)


def _breakpoints(live: Live) -> Observer:
    return Breakpoints(live.observer(Specs), live.tell_all)


def _notes(live: Live) -> Observer:
    return Notes()


# What each Live makes one of, in this order; a handler gets at its own by `live.observer(Kind)`. A spec is judged before one asks
# whether it failed.
OBSERVERS: tuple[Callable[[Live], Observer], ...] = (Costs, _notes, _specs, _breakpoints)
