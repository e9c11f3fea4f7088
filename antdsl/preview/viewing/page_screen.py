"""The data that all pages have received, and the updates to send next.

Updates have a limited rate, contain only changes, and stop when no page is connected."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from math import inf
from time import monotonic
from typing import TYPE_CHECKING, Any

from antdsl.preview.breaking import BreakpointObserver
from antdsl.preview.directing.hand_edits import EditedRunView
from antdsl.preview.directing.hand_settling import HandSettling
from antdsl.preview.observing.spec_judgement import SpecObserver
from antdsl.preview.requests import MAX_PLANNED_AGENTS
from antdsl.preview.session import PreviewSession
from antdsl.preview.viewing import messages
from antdsl.preview.viewing.action_arrays import store_poses
from antdsl.preview.viewing.agent_packets import AgentPackets
from antdsl.preview.viewing.body_packets import ItemBodyPackets
from antdsl.preview.viewing.charts import ChartMessages
from antdsl.preview.viewing.curves import SentCurveTracker
from antdsl.preview.viewing.directing_messages import make_edits_message, make_notes_message, make_verbs_message
from antdsl.preview.viewing.field_packets import FieldPackets
from antdsl.preview.viewing.file_names import FileNames
from antdsl.preview.viewing.geometry_packets import CurvePackets, FlowPackets, MeshPackets, SolidPackets
from antdsl.preview.viewing.path_packets import PathPackets
from antdsl.preview.viewing.rig_packets import RigPackets
from antdsl.preview.viewing.scene_message import BoundingBox, make_scene_message
from antdsl.preview.viewing.view_state import PacketMaker, PageInterest, ViewState

if TYPE_CHECKING:
    from antdsl.preview.live import Client, LiveSimulation

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
_REPORT_INTERVAL_SECONDS = 0.1  # the same of status and curves while it plays
_RATE_WINDOW_SECONDS = 1.0  # seconds of steps that the rate is measured over


class PageUpdates:
    """Sends updates to the pages. Only the live thread uses it. `next_refresh_time`: the time (s) at which `send_due_updates`
    next has work."""

    def __init__(self, live: LiveSimulation) -> None:
        self.live, self.names = live, FileNames(live.compiler.scene)
        self.next_refresh_time = inf
        self._packet_makers = [make() for make in PACKET_MAKERS]
        self._charts, self._curves = ChartMessages(), SentCurveTracker()
        self._bounding_box = BoundingBox()
        self._interest = PageInterest()
        self._packet_by_slot: dict[str, bytes] = {}  # the latest packet of each slot
        self._step_times: deque[float] = deque()
        self._program_changed = self._files_changed = self._world_changed = True  # what has changed since pages heard
        self._last_packet_time = self._last_report_time = -inf
        self._scene: dict[str, Any] = {}
        self._verbs: dict[str, Any] = {}
        self._lines: list[dict[str, Any]] = [{}, {}]  # the messages with notes and edits
        self._status: dict[str, Any] = {}
        self._stops: dict[int, str] = {}
        self._hash: tuple[object, int, str] | None = None
        self._settling: HandSettling | None = None

    @property
    def edited(self) -> EditedRunView:
        """Return the simulated frames with the edits of users. Call this only while a session exists."""
        return self.settling.edited

    @property
    def settling(self) -> HandSettling:
        """Return the object that settles these frames. Call this only while a session exists."""
        if self._settling is None:
            self._settling = HandSettling(EditedRunView(self.live.session))
        return self._settling

    @property
    def is_settling(self) -> bool:
        """Return whether edited frames are being settled."""
        return self._settling is not None and self._settling.is_running

    def settle_frames(self) -> None:
        """Settle a few frames if a page has requested this."""
        if self.is_settling:
            self.settling.advance()
            if not self.is_settling:
                self.on_action()

    # --- what happened -----------------------------------------------------------------------------------------------

    def on_step(self) -> None:
        """Record that a step was made. If a page is connected, also store the poses of the new frame."""
        self._step_times.append(monotonic())
        self._world_changed = True
        if self.live.clients:
            store_poses(self.live.session)

    def needs_look_ahead(self, session: PreviewSession) -> bool:
        """Return whether any page displays planned paths."""
        return bool(self._interest.planned_agents) or (
            self._interest.plans_all_agents and len(session.world) <= MAX_PLANNED_AGENTS
        )

    def on_look_ahead(self) -> None:
        """Record that future frames were simulated or dropped."""
        self._world_changed = True

    def on_new_world(self) -> None:
        """Record that the session has a new world, because it went back in time, or an edit changed its program or values."""
        self._program_changed = self._world_changed = True

    def on_seek_end(self) -> None:
        """Record that the session has reached its target frame. The user's settings there may differ from those before the
        seek."""
        self._program_changed = True
        self.on_action()

    def on_action(self) -> None:
        """Record an event that pages may have to display."""
        self._world_changed, self._last_report_time = True, -inf

    def on_edit(self, *, files_changed: bool) -> None:
        """Record that the program was changed, or that a change failed. `files_changed`: whether texts of files may
        have changed."""
        self._program_changed, self._files_changed = True, self._files_changed or files_changed
        self._hash = None  # a param may be another one at the same frame
        if self.live.is_open:
            self._curves.mark_unsent_from(self.live.session.frame)
        self.on_action()

    def on_display_change(self) -> None:
        """Record that the data that pages want to display may have changed."""
        self._interest = PageInterest.from_displays(self.live.clients.values())
        self._world_changed = True

    def send_complete_state(self, client: Client) -> None:
        """Send the complete state to one page."""
        self.on_display_change()
        client.send_message(messages.make_hello(self.live))
        if len(self.live.clients) == 1:
            self._program_changed = self._files_changed = False  # there are no other clients
        if self.live.is_open:
            scene_message = self._make_scene_message()
            self._scene = self._scene if len(self.live.clients) > 1 else scene_message
            client.send_message(scene_message)
        client.send_message(messages.make_texts_message(self.live))
        client.send_message(messages.make_problems_message(self.live))
        client.send_message(messages.make_status_message(self.live, self._compute_step_rate(), self._find_current_hash()))
        if self.live.is_open:
            timeline = self.live.session.timeline
            news = self._curves.pop_new_values(timeline)
            for other in self.live.clients:
                if other is client:
                    client.send_message(self._curves.take_full_history(timeline))
                elif news is not None:  # from now on all have the same
                    other.send_message(news)
            client.send_message(self.live.find_observer(SpecObserver).make_message())
            client.send_message(self.live.find_observer(BreakpointObserver).make_message())
            client.send_message(messages.make_stops_message(self.live))
            client.send_message(make_verbs_message(self.live))
            client.send_message(make_notes_message(self.live))
            client.send_message(make_edits_message(self.live))
            sent = self._send_packets(self.live.session, monotonic())
            for slot, packet in self._packet_by_slot.items():
                if slot not in sent:
                    client.show_packet(slot, packet)

    # --- telling -----------------------------------------------------------------------------------------------------

    def send_due_updates(self, time: float) -> None:
        """Send everything that is due. `time`: the current time (s)."""
        live = self.live
        self.next_refresh_time = inf
        if not live.clients:
            return
        session = live.session if live.is_open else None
        program, files = self._program_changed, self._files_changed
        self._program_changed = self._files_changed = False
        laid = True
        if program and session is not None:
            laid = self._send_scene(self._charts.is_laid_out(session.shot.program))
        playing = session is not None and (session.playing or live.is_seeking or self.is_settling)
        if session is not None and self._world_changed:
            if playing and time - self._last_packet_time < _FRAME_INTERVAL_SECONDS:
                self.next_refresh_time = self._last_packet_time + _FRAME_INTERVAL_SECONDS
            else:
                self._world_changed = False
                self._send_packets(session, time)
        if files:
            live.send_to_all(messages.make_texts_message(live))
            live.send_to_all(messages.make_problems_message(live))
        if not laid:
            self._send_scene(True)
        if not playing or time - self._last_report_time >= _REPORT_INTERVAL_SECONDS:
            self._last_report_time = time
            self._send_progress(session)
        if playing:
            self.next_refresh_time = min(self.next_refresh_time, self._last_report_time + _REPORT_INTERVAL_SECONDS)

    def _send_packets(self, session: PreviewSession, time: float) -> set[str]:
        """Send all changed packets to all pages, and return the names of their slots."""
        self._last_packet_time = time
        going = session.playing or self.live.is_seeking
        stored_frame, sent = self.live.displayed_frame, set()
        view_state = ViewState(session, self.live.look_ahead, self._interest, stored_frame, time, going, self.edited)
        for view in self._packet_makers:
            for slot, packet in view.make_packets(view_state):
                self._packet_by_slot[slot] = packet
                sent.add(slot)
                for client in self.live.clients:
                    client.show_packet(slot, packet)
        if self.edited.edits:
            self._send_lines()  # a frame that cannot be shown with edits says why
        return sent

    def _send_scene(self, lays_out_charts: bool) -> bool:
        """Send the scene message if it changed. If `lays_out_charts`, also send the verbs. Return `lays_out_charts`.

        `lays_out_charts`: whether to lay out the current charts; if not, the message repeats the previous charts."""
        scene_message = self._make_scene_message(lays_out_charts)
        if scene_message != self._scene:
            self._scene = scene_message
            self.live.send_to_all(scene_message)
        if lays_out_charts:
            self._send_verbs()
        return lays_out_charts

    def _send_verbs(self) -> None:
        """Send the verbs of notes and edits if these changed. Also send the lines that users added if those changed."""
        verbs = make_verbs_message(self.live)
        if verbs != self._verbs:
            self._verbs = verbs
            self.live.send_to_all(verbs)
        self._send_lines()

    def _send_lines(self) -> None:
        """Send the list of the notes that users added, if it changed. Do the same for the list of edits."""
        for number, message in enumerate((make_notes_message(self.live), make_edits_message(self.live))):
            if message != self._lines[number]:
                self._lines[number] = message
                self.live.send_to_all(message)

    def _make_scene_message(self, lays_out_charts: bool = True) -> dict[str, Any]:
        charts = self._charts.list_charts(self.live.session.shot.program) if lays_out_charts else self._scene.get("charts", [])
        return make_scene_message(self.live, self._bounding_box, charts, self._charts.missing_package)

    def _send_progress(self, session: PreviewSession | None) -> None:
        status = messages.make_status_message(self.live, self._compute_step_rate(), self._find_current_hash())
        if status != self._status:
            self._status = status
            self.live.send_to_all(status)
        if session is not None and session.timeline.stop_reasons != self._stops:
            self._stops = dict(session.timeline.stop_reasons)
            self.live.send_to_all(messages.make_stops_message(self.live))
        if self.is_settling:
            self._send_lines()
        news = self._curves.pop_new_values(session.timeline) if session is not None else None
        if news is not None:
            self.live.send_to_all(news)

    def _compute_step_rate(self) -> float:
        """Return the recent number of steps per second (0 while paused)."""
        if not self.live.is_open or not self.live.session.playing:
            self._step_times.clear()
            return 0.0
        now = monotonic()
        while self._step_times and self._step_times[0] < now - _RATE_WINDOW_SECONDS:
            self._step_times.popleft()
        over = self._step_times[-1] - self._step_times[0] if len(self._step_times) > 1 else 0.0
        return (len(self._step_times) - 1) / over if over > 0 else 0.0

    def _find_current_hash(self) -> str | None:
        """Return the state hash of the session's world. Return None if the session is playing or displays another frame."""
        live = self.live
        if not live.is_open or live.session.playing or live.is_seeking or live.displayed_frame is not None:
            return None
        world = live.session.world
        if self._hash is None or self._hash[0] is not world or self._hash[1] != world.frame:
            self._hash = world, world.frame, live.session.state_hash
        return self._hash[2]
