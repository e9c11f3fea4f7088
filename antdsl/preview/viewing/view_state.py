"""The inputs and the interface of the classes that make packets."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Protocol

from antdsl.pipeline import Shot
from antdsl.preview.directing.hand_edits import EditedRunView
from antdsl.preview.look_ahead import LookAheadSimulation
from antdsl.preview.requests import AgentRef, SetDisplay
from antdsl.preview.session import PreviewSession
from antdsl.runtime import World

SlotPackets = Iterator[tuple[str, bytes]]


@dataclass(frozen=True, slots=True)
class PageInterest:
    """The data that at least one page displays."""

    columns: frozenset[tuple[str, str]] = frozenset()  # species and attribute
    fields: frozenset[str] = frozenset()
    flows: frozenset[str] = frozenset()
    shows_solids: bool = True
    followed_agents: tuple[AgentRef, ...] = ()  # each once
    planned_agents: tuple[AgentRef, ...] | None = None  # agents with future paths shown, each once; None: no page shows any
    plans_all_agents: bool = False

    @classmethod
    def from_displays(cls, looks: Iterable[SetDisplay]) -> PageInterest:
        """Return the union of the data that pages show with these display settings."""
        looks = list(looks)
        followed = dict.fromkeys(look.follow for look in looks if look.follow is not None)
        planned = [look.planned for look in looks if look.planned is not None]
        return cls(
            frozenset((column.species, column.name) for look in looks for column in look.columns),
            frozenset(name for look in looks for name in look.fields),
            frozenset(name for look in looks for name in look.flows),
            any(look.solids for look in looks),
            tuple(followed),
            tuple(dict.fromkeys(who for each in planned for who in each)) if planned else None,
            any(not each for each in planned),
        )


@dataclass(frozen=True, slots=True)
class ViewState:
    """A snapshot of the inputs from which packets are made.

    `session`, `look_ahead`: the session and its simulated future frames. `edited`: the session's frames with the edits that users
    added. `interest`: the data that pages display. `stored_frame`: the stored frame that is displayed instead of the session's
    current one, or None. `time`: the time in seconds. `is_advancing`: whether the session plays or is simulating towards a frame.
    """

    session: PreviewSession
    look_ahead: LookAheadSimulation
    interest: PageInterest
    stored_frame: int | None
    time: float
    is_advancing: bool  # it plays, or is on its way: the next moment comes soon
    edited: EditedRunView

    @property
    def world(self) -> World:
        return self.session.world

    @property
    def shot(self) -> Shot:
        return self.session.shot


class PacketMaker(Protocol):
    """An object that makes the packets of one kind. It yields only packets that have changed."""

    def make_packets(self, view_state: ViewState) -> SlotPackets: ...
