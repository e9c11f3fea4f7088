"""The state of all pages: the data that they have received, and the updates that are due.

Updates have a limited rate, contain only changes, and stop without clients."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from math import inf
from time import monotonic
from typing import TYPE_CHECKING, Any

from antdsl.preview.breaking import Breakpoints
from antdsl.preview.observing.spec_judgement import SpecObserver
from antdsl.preview.requests import MAX_PLANNED_AGENTS
from antdsl.preview.session import Session
from antdsl.preview.viewing import messages
from antdsl.preview.viewing.acting import store_poses
from antdsl.preview.viewing.agents import AgentPackets
from antdsl.preview.viewing.bodies import ItemBodyPackets, RigPackets
from antdsl.preview.viewing.charts import ChartMessages
from antdsl.preview.viewing.curves import SentCurves
from antdsl.preview.viewing.fields import FieldPackets
from antdsl.preview.viewing.geometry import CurvePackets, FlowPackets, MeshPackets, SolidPackets
from antdsl.preview.viewing.names import FileNames
from antdsl.preview.viewing.paths import PathPackets
from antdsl.preview.viewing.scene import BoundingBox, scene
from antdsl.preview.viewing.seen import PacketMaker, PageInterest, ViewState

if TYPE_CHECKING:
    from antdsl.preview.live import Client, Live

# One of each is made; the ground comes first, what takes long to make last.
PACKET_MAKERS: tuple[Callable[[], PacketMaker], ...] = (
    MeshPackets,
    SolidPackets,
    RigPackets,
    AgentPackets,
    PathPackets,
    CurvePackets,
    FieldPackets,
    FlowPackets,
    ItemBodyPackets,
)
_FRAME_INTERVAL_SECONDS = 1 / 60  # seconds
_REPORT_INTERVAL = 0.1  # the same of status and curves while it plays
_RATE_WINDOW_SECONDS = 1.0  # seconds of steps that the rate is measured over


class PageScreen:
    """Sends updates to the pages. Used only by the live thread. `due`: the time at which `refresh` has work again."""

    def __init__(self, live: Live) -> None:
        self.live, self.names = live, FileNames(live.compiler.scene)
        self.due = inf
        self._views = [make() for make in PACKET_MAKERS]
        self._charts, self._curves = ChartMessages(), SentCurves()
        self._box = BoundingBox()
        self._wanted = PageInterest()
        self._standing: dict[str, bytes] = {}  # the latest packet of each slot
        self._steps: deque[float] = deque()
        self._program = self._files = self._moved = True  # what has changed since pages heard
        self._shown_at = self._told_at = -inf
        self._scene: dict[str, Any] = {}
        self._status: dict[str, Any] = {}
        self._stops: dict[int, str] = {}
        self._hash: tuple[object, int, str] | None = None

    # --- what happened -----------------------------------------------------------------------------------------------

    def on_step(self) -> None:
        """Note a step, and store the poses of its frame if a page is connected."""
        self._steps.append(monotonic())
        self._moved = True
        if self.live.clients:
            store_poses(self.live.session)

    def needs_look_ahead(self, session: Session) -> bool:
        """Return whether any page displays planned paths."""
        return bool(self._wanted.planned) or (self._wanted.planned_of_all and len(session.world) <= MAX_PLANNED_AGENTS)

    def on_look_ahead(self) -> None:
        """Note that the set of simulated future frames changed."""
        self._moved = True

    def on_new_world(self) -> None:
        """Note that the session has another world: it went back in time, or an edit gave it another program or other values."""
        self._program = self._moved = True

    def on_seek_end(self) -> None:
        """Note that the session reached its target frame. Values set by hand may differ from those before the seek."""
        self._program = True
        self.on_action()

    def on_action(self) -> None:
        """Note that an event happened that pages may have to display."""
        self._moved, self._told_at = True, -inf

    def edited(self, *, files: bool) -> None:
        """Note that the program changed, or that a change was attempted. `files`: whether texts of files may have changed."""
        self._program, self._files = True, self._files or files
        self._hash = None  # a param may be another one at the same frame
        if self.live.is_open:
            self._curves.forget_from(self.live.session.frame)
        self.on_action()

    def on_look(self) -> None:
        """Note that the data that pages display may have changed."""
        self._wanted = PageInterest.by(self.live.clients.values())
        self._moved = True

    def greet(self, client: Client) -> None:
        """Send the complete state to one page."""
        self.on_look()
        client.tell(messages.hello(self.live))
        if len(self.live.clients) == 1:
            self._program = self._files = False  # there are no other clients
        if self.live.is_open:
            scene_message = self._scene_message()
            self._scene = self._scene if len(self.live.clients) > 1 else scene_message
            client.tell(scene_message)
        client.tell(messages.texts(self.live))
        client.tell(messages.problems(self.live))
        client.tell(messages.status(self.live, self._rate(), self._hash_now()))
        if self.live.is_open:
            timeline = self.live.session.timeline
            news = self._curves.new_values(timeline)
            for other in self.live.clients:
                if other is client:
                    client.tell(self._curves.full_history(timeline))
                elif news is not None:  # from now on all have the same
                    other.tell(news)
            client.tell(self.live.observer(SpecObserver).message())
            client.tell(self.live.observer(Breakpoints).message())
            client.tell(messages.stops(self.live))
            sent = self._show_packets(self.live.session, monotonic())
            for slot, packet in self._standing.items():
                if slot not in sent:
                    client.show(slot, packet)

    # --- telling -----------------------------------------------------------------------------------------------------

    def refresh(self, now: float) -> None:
        """Send everything that is due at the time `now` (s)."""
        live = self.live
        self.due = inf
        if not live.clients:
            return
        session = live.session if live.is_open else None
        program, files = self._program, self._files
        self._program = self._files = False
        laid = True
        if program and session is not None:
            laid = self._tell_scene(self._charts.is_laid_out(session.shot.program))
        playing = session is not None and (session.playing or live.is_seeking)
        if session is not None and self._moved:
            if playing and now - self._shown_at < _FRAME_INTERVAL_SECONDS:
                self.due = self._shown_at + _FRAME_INTERVAL_SECONDS
            else:
                self._moved = False
                self._show_packets(session, now)
        if files:
            live.tell_all(messages.texts(live))
            live.tell_all(messages.problems(live))
        if not laid:
            self._tell_scene(True)
        if not playing or now - self._told_at >= _REPORT_INTERVAL:
            self._told_at = now
            self._tell_progress(session)
        if playing:
            self.due = min(self.due, self._told_at + _REPORT_INTERVAL)

    def _show_packets(self, session: Session, now: float) -> set[str]:
        """Send the slots that changed to all pages, and return these slots."""
        self._shown_at = now
        going = session.playing or self.live.is_seeking
        view_state, sent = ViewState(session, self.live.ahead, self._wanted, self.live.light, now, going), set()
        for view in self._views:
            for slot, packet in view.packets(view_state):
                self._standing[slot] = packet
                sent.add(slot)
                for client in self.live.clients:
                    client.show(slot, packet)
        return sent

    def _tell_scene(self, laid: bool) -> bool:
        """Send the scene message if it changed, and return `laid`.

        `laid`: lay out the current charts; otherwise the message repeats the previous charts."""
        scene_message = self._scene_message(laid)
        if scene_message != self._scene:
            self._scene = scene_message
            self.live.tell_all(scene_message)
        return laid

    def _scene_message(self, laid: bool = True) -> dict[str, Any]:
        charts = self._charts.of(self.live.session.shot.program) if laid else self._scene.get("charts", [])
        return scene(self.live, self._box, charts, self._charts.need)

    def _tell_progress(self, session: Session | None) -> None:
        status = messages.status(self.live, self._rate(), self._hash_now())
        if status != self._status:
            self._status = status
            self.live.tell_all(status)
        if session is not None and session.timeline.stops != self._stops:
            self._stops = dict(session.timeline.stops)
            self.live.tell_all(messages.stops(self.live))
        news = self._curves.new_values(session.timeline) if session is not None else None
        if news is not None:
            self.live.tell_all(news)

    def _rate(self) -> float:
        """Return the recent number of steps per second; 0 while paused."""
        if not self.live.is_open or not self.live.session.playing:
            self._steps.clear()
            return 0.0
        now = monotonic()
        while self._steps and self._steps[0] < now - _RATE_WINDOW_SECONDS:
            self._steps.popleft()
        over = self._steps[-1] - self._steps[0] if len(self._steps) > 1 else 0.0
        return (len(self._steps) - 1) / over if over > 0 else 0.0

    def _hash_now(self) -> str | None:
        """Return the hash of the session's world if the session is paused and displays this world; else None."""
        live = self.live
        if not live.is_open or live.session.playing or live.is_seeking or live.light is not None:
            return None
        world = live.session.world
        if self._hash is None or self._hash[0] is not world or self._hash[1] != world.frame:
            self._hash = world, world.frame, live.session.hash
        return self._hash[2]
