"""The thread that owns a session. No other thread accesses the session.

Between two steps, it processes requests of pages, waits for the clock, loads saved files, and sends the state to pages."""

from __future__ import annotations

import sys
import traceback
from collections import deque
from pathlib import Path
from threading import Condition, Thread
from time import monotonic
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from antdsl.diagnostics import Report
from antdsl.pipeline import RunChoices
from antdsl.preview.compiling import SceneCompiler
from antdsl.preview.doing import HANDLER_BY_REQUEST, SESSIONLESS_REQUESTS
from antdsl.preview.file_watch import FileWatch
from antdsl.preview.look_ahead import LookAheadSimulation
from antdsl.preview.observing.observer import Observer, PauseReason
from antdsl.preview.requests import (
    AnyRequest,
    DraftLine,
    Explain,
    RequestRefusedError,
    Seek,
    SetBreakpoints,
    SetDisplay,
    SetValue,
    SwitchProfile,
)
from antdsl.preview.session import PreviewSession
from antdsl.runtime import Options

if TYPE_CHECKING:
    from antdsl.preview.observing.explainer import Explainer

_MAX_QUEUED_REQUESTS = 256  # maximum number of queued requests
_FILE_POLL_SECONDS = 0.02  # interval between two polls of the files
_MAX_SLEEP_SECONDS = 0.5  # maximum sleep of the thread when there is nothing to do
_MAX_CATCH_UP_SECONDS = 0.1  # late steps are caught up within this time; further steps are dropped
_EMPTY_DISPLAY = SetDisplay(op="look", columns=(), fields=(), flows=(), planned=None)  # before the first request of a page
_PAUSE_AFTER_BUG_SECONDS = 0.25  # pause after an internal error, so that the terminal is not flooded
_MAX_REQUEST_SECONDS = 0.05  # after this time, requests give way to the simulation
_MAX_SEEK_SECONDS = 0.05  # after this time, a seek gives way to requests
_MAX_LOOK_AHEAD_SECONDS = 0.02  # after this time, simulation of future frames gives way to requests
_BUG_MESSAGE = "this is a bug in antdsl: see the terminal for details"
O = TypeVar("O")  # noqa: E741


class Client(Protocol):
    """A connected page. Its methods may be called from any thread and never block."""

    def send_message(self, message: dict[str, Any]) -> None:
        """Send a message. All messages arrive, in order."""

    def show_packet(self, slot: str, packet: bytes) -> None:
        """Send a packet of arrays. It may be dropped if a later packet of the same slot follows."""


class QueueFullError(Exception):
    """Error if the queue of requests is full."""


class LiveSimulation:
    """The thread that owns a session. Any thread may queue requests, add clients and remove clients."""

    def __init__(self, session: PreviewSession, *, watch: bool = True) -> None:
        self._initialise(session.compiler, session, Report(), watch)

    @classmethod
    def open_scene(
        cls, scene: Path, choices: RunChoices | None = None, options: Options | None = None, *, watch: bool = True, **how: int
    ) -> LiveSimulation:
        """Return the object that will run a session of a scene file. If the file has errors, the session opens once they are
        fixed. `how`: further arguments of `PreviewSession.open`."""
        live, compiler = cls.__new__(cls), SceneCompiler(scene)
        session, report = PreviewSession.open(scene, choices, options, compiler=compiler, **how)
        live._initialise(compiler, session, report, watch)
        live._session_options = choices, options, how
        return live

    def _initialise(self, compiler: SceneCompiler, session: PreviewSession | None, report: Report, watch: bool) -> None:
        from antdsl.preview.observing.observers import OBSERVER_MAKERS
        from antdsl.preview.viewing.page_screen import PageUpdates

        self.compiler, self._session, self.report = compiler, session, report
        self._session_options: tuple[RunChoices | None, Options | None, dict[str, int]] = (None, None, {})
        self.speed = 1.0  # speed of the clock; 0 means as fast as possible
        self.displayed_frame: int | None = None  # a stored frame that is displayed while the session is at another frame
        self._target_frame: int | None = None  # the frame to which the session is simulating
        self._pending_steps = 0  # requested steps, apart from play
        self.pause_reason: PauseReason | None = None  # the reason of an automatic pause
        self.clients: dict[Client, SetDisplay] = {}
        self.screen, self.look_ahead = PageUpdates(self), LookAheadSimulation()
        self.explainer: Explainer | None = None
        self.observers: list[Observer] = []
        for make in OBSERVER_MAKERS:
            self.observers.append(make(self))
        self._watch = FileWatch(compiler.get_watched_files, open_file=compiler.open_file) if watch else None
        self._queue: deque[tuple[AnyRequest | str, Client]] = deque()
        self._postponed_requests: list[tuple[AnyRequest, Client]] = []  # requests received before the session existed
        self._wake_condition, self._is_stopped = Condition(), False
        self._next_step_time = self._next_poll_time = 0.0
        self._thread = Thread(target=self._run, name="antdsl-preview", daemon=True)
        self._attach_observers()

    # --- for all threads ---------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self) -> None:
        """Stop the thread, and return when it has ended."""
        with self._wake_condition:
            self._is_stopped = True
            self._wake_condition.notify()
        if self._thread.is_alive():
            self._thread.join()

    def enqueue_request(self, request: AnyRequest, client: Client) -> None:
        """Queue a request, which runs between two steps. Raises QueueFullError if too many requests are waiting."""
        self._enqueue_item(request, client)

    def add_client(self, client: Client) -> None:
        """Add a page as a client. It receives the complete state now, and every update from then on."""
        self._enqueue_item("join", client)

    def remove_client(self, client: Client) -> None:
        """Remove a page from the clients. It receives no further updates."""
        self._enqueue_item("leave", client)

    def _enqueue_item(self, item: AnyRequest | str, client: Client) -> None:
        with self._wake_condition:
            if len(self._queue) >= _MAX_QUEUED_REQUESTS and not isinstance(item, str):
                raise QueueFullError
            self._queue.append((item, client))
            self._wake_condition.notify()

    # --- for handlers, on the live thread ----------------------------------------------------------------------------

    @property
    def session(self) -> PreviewSession:
        """Return the session. Only request handlers may use this, because they are called only while a session exists."""
        assert self._session is not None
        return self._session

    @property
    def is_seeking(self) -> bool:
        """Return whether the session is still simulating towards a frame that was requested."""
        return self._target_frame is not None or self._pending_steps > 0

    @property
    def is_open(self) -> bool:
        """Return whether there is a session."""
        return self._session is not None

    def find_observer(self, kind: type[O]) -> O:
        """Return the observer of type `kind`."""
        return next(each for each in self.observers if isinstance(each, kind))

    def send_to_all(self, message: dict[str, Any]) -> None:
        """Send a message to all pages."""
        for client in self.clients:
            client.send_message(message)

    def show_exact_frame(self) -> None:
        """Bring the session to the frame that the page displays. Do nothing if the session is at this frame already."""
        frame = self.displayed_frame if self._target_frame is None else self._target_frame
        self.displayed_frame = self._target_frame = None
        if frame is not None:
            self.session.seek(frame)
            self.screen.on_seek_end()

    def show_stored_frame(self, frame: int) -> None:
        """Display the stored agents of a frame, or of the nearest stored frame. Nothing is simulated."""
        remembered = self.session.timeline.reduced_frames
        self._target_frame = None
        nearest = min(remembered, key=lambda stored_frame: abs(stored_frame - frame), default=None)
        self.displayed_frame = nearest if frame != self.session.frame else None

    def seek_frame(self, frame: int) -> None:
        """Start to bring the session to a frame. Requests are handled between the steps that this takes.

        Meanwhile, the stored agents of this frame are displayed."""
        self.show_stored_frame(frame)
        self._target_frame = frame
        session = self.session
        if not session.is_ahead(frame):
            session.seek(session.find_checkpoint_frame(frame))

    def set_speed(self, speed: float) -> None:
        """Set the speed of play."""
        self.speed, self._next_step_time = speed, monotonic()

    def play(self) -> None:
        """Play from the current frame on."""
        self.session.playing, self.pause_reason, self._next_step_time = True, None, monotonic()

    def pause(self, reason: PauseReason | None = None) -> None:
        """Pause, and drop pending steps. `reason`: set if the session paused automatically; the frame is then marked on the
        timeline."""
        if reason is not None:
            self.session.timeline.mark_stop(self.session.frame, reason.line)
        self.session.playing, self.pause_reason, self._pending_steps = False, reason, 0

    def start_steps(self, count: int) -> None:
        """Start to simulate `count` frames as fast as possible. Requests are handled between the steps."""
        self.pause_reason, self._pending_steps = None, count

    def step(self) -> bool:
        """Simulate one frame and run the observers. Return whether the session may continue."""
        session = self.session
        for observer in self.observers:
            observer.before_step(session)
        session.step()
        self.screen.on_step()
        for observer in self.observers:
            why = observer.after_step(session)
            if why is not None and self.pause_reason is None:
                self.pause(why)
        return session.fault_text is None and self.pause_reason is None

    def reload(self, operation: str) -> None:
        """Load the current files, and send the outcome to all clients."""
        from antdsl.preview.viewing.messages import make_outcome_message

        if self._session is None:
            self._try_to_open_session()
            return
        self.show_exact_frame()
        result = self._session.reload()
        self.on_files_read(result.report)
        self.send_to_all(make_outcome_message(self, operation, result))
        self.screen.on_edit(files_changed=True)

    def on_files_read(self, report: Report) -> None:
        """Record that the files were read, with these findings. A file that was still being saved will be read again."""
        self.report = report
        if self._watch is not None:
            self._watch.recheck_unstable_files()

    # --- the thread --------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        while not self._is_stopped:
            try:
                self._run_once()
            except Exception:  # after any error in a step, the page still works and can restart
                traceback.print_exc(file=sys.stderr)
                if self._session is not None:
                    self._target_frame = None
                    self.pause(PauseReason(_BUG_MESSAGE))
                self.send_to_all(
                    {"op": "refused", "of": "play", "message": _BUG_MESSAGE, "help": "press restart, and please report it"}
                )
                with self._wake_condition:
                    self._wake_condition.wait(_PAUSE_AFTER_BUG_SECONDS)

    def _run_once(self) -> None:
        until = monotonic() + _MAX_REQUEST_SECONDS
        while self._queue and not self._is_stopped:
            self._process_item(*self._queue.popleft())
            if monotonic() > until:
                break  # limited, so that many requests of one client do not block display to the others
        now = monotonic()
        if self._watch is not None and now >= self._next_poll_time:
            self._next_poll_time = now + _FILE_POLL_SECONDS
            changed = self._watch.find_changed_files()
            if not changed and self._watch.is_any_file_being_written() and self._session is not None:
                self._session.precompile()  # a file that has just changed may still be incomplete, so compile while waiting
                changed = self._watch.find_changed_files()
            if changed:
                self.reload("saved")
        if self._session is not None:
            self._advance_once(self._session)
            self._look_ahead(self._session)
            self.screen.settle_frames()
        self.screen.send_due_updates(monotonic())
        self._wait_for_work()

    def _advance_once(self, session: PreviewSession) -> None:
        """Run one unit of work. This is a step towards the frame of a seek, a requested step, or the next step of play."""
        if self._target_frame is not None:
            end = monotonic() + _MAX_SEEK_SECONDS
            while session.frame != self._target_frame and monotonic() < end:
                session.seek(session.frame + 1)
            if session.frame == self._target_frame:
                self.displayed_frame = self._target_frame = None
                self.screen.on_seek_end()
        elif self._pending_steps:
            self._pending_steps = self._pending_steps - 1 if self.step() else 0
        elif session.playing and monotonic() >= self._next_step_time and self.step():
            now, last = monotonic(), session.shot.frames.last
            if session.frame == last:
                self.pause(PauseReason(f"frame {last} is the scene's last frame: play continues beyond it"))
            self._next_step_time = (
                now if self.speed == 0 else max(self._next_step_time + session.world.dt / self.speed, now - _MAX_CATCH_UP_SECONDS)
            )

    def _look_ahead(self, session: PreviewSession) -> None:
        """Simulate future frames as long as a page displays them and no request waits. During play, simulate one future frame per
        played frame, and more if time is left."""
        version = self.look_ahead.version
        if not self.screen.needs_look_ahead(session):
            self.look_ahead.clear()
        elif self._may_look_ahead(session):
            until = monotonic() + _MAX_LOOK_AHEAD_SECONDS
            if session.playing:
                until = min(until, self._next_step_time)
            while not self._queue and self.look_ahead.needs_simulation(session):
                self.look_ahead.simulate_next_frame(session)
                if monotonic() >= until:
                    break
        if self.look_ahead.version != version:
            self.screen.on_look_ahead()

    def _may_look_ahead(self, session: PreviewSession) -> bool:
        return self.screen.needs_look_ahead(session) and not self.is_seeking and self.displayed_frame is None

    def _wait_for_work(self) -> None:
        until = monotonic() + _MAX_SLEEP_SECONDS
        if self._watch is not None:
            until = min(until, self._next_poll_time)
        if self._session is not None and (self._session.playing or self.is_seeking):
            until = 0.0 if self.is_seeking else min(until, self._next_step_time)
        session = self._session
        if self.screen.is_settling or (session and self._may_look_ahead(session) and self.look_ahead.needs_simulation(session)):
            until = 0.0
        until = min(until, self.screen.next_refresh_time)
        with self._wake_condition:
            if not self._queue and not self._is_stopped and (wait := until - monotonic()) > 0:
                self._wake_condition.wait(wait)

    def _process_item(self, item: AnyRequest | str, client: Client) -> None:
        if item == "join":
            self.clients[client] = _EMPTY_DISPLAY
            self.screen.send_complete_state(client)
        elif item == "leave":
            self.clients.pop(client, None)
            self.screen.on_display_change()
        elif not isinstance(item, str) and client in self.clients and not self._is_superseded(item, client):
            self._handle_request(item, client)

    def _is_superseded(self, request: AnyRequest, client: Client) -> bool:
        """Return whether a later request in the queue makes this one obsolete, such as when a slider moves."""
        following, sender = self._queue[0] if self._queue else (None, None)
        if isinstance(request, SetValue):
            return isinstance(following, SetValue) and following.name == request.name and sender is client
        if isinstance(request, DraftLine):
            return not request.apply and isinstance(following, DraftLine) and sender is client
        if isinstance(request, Explain | SetDisplay):
            return type(following) is type(request) and sender is client
        return isinstance(request, Seek) and isinstance(following, Seek)

    def _handle_request(self, request: AnyRequest, client: Client) -> None:
        if self._session is None and isinstance(request, SetBreakpoints | SwitchProfile):
            held = [
                each
                for each in self._postponed_requests
                if each[1] in self.clients and (type(each[0]), each[1]) != (type(request), client)
            ]
            self._postponed_requests = [*held, (request, client)]
            return
        try:
            if self._session is None and type(request) not in SESSIONLESS_REQUESTS:
                words = "the preview cannot play yet: the scene has errors"
                raise RequestRefusedError(words, "correct them and save; it starts automatically")
            HANDLER_BY_REQUEST[type(request)](self, request, client)
        except RequestRefusedError as why:
            client.send_message({"op": "refused", "of": request.op, "message": why.message, "help": why.help})
        except Exception:
            traceback.print_exc(file=sys.stderr)
            client.send_message({"op": "refused", "of": request.op, "message": _BUG_MESSAGE, "help": "the earlier run continues"})
        self.screen.on_action()

    def _try_to_open_session(self) -> None:
        choices, options, how = self._session_options
        self._session, report = PreviewSession.open(self.compiler.scene, choices, options, compiler=self.compiler, **how)
        self.on_files_read(report)
        self._attach_observers()
        self.screen.on_edit(files_changed=True)
        if self._session is not None:
            waiting, self._postponed_requests = self._postponed_requests, []
            for ask, client in waiting:
                if client in self.clients:
                    self._handle_request(ask, client)

    def _attach_observers(self) -> None:
        """Register a callback for each new world of the session, and pass the current world to the observers."""
        if self._session is not None:
            self._session.on_new_world = self._on_new_world
            self._on_new_world(self._session)

    def _on_new_world(self, session: PreviewSession) -> None:
        self.screen.on_new_world()
        for observer in self.observers:
            observer.on_new_world(session)
