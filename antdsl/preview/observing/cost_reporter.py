"""Reports of the cost of steps, sent to the pages that request them. Steps are measured only while such a page is connected."""

from __future__ import annotations

from math import inf
from time import monotonic
from typing import TYPE_CHECKING, Any

from antdsl.preview.session import PreviewSession
from antdsl.preview.viewing.file_names import FileNames
from antdsl.runtime.profiling import StepProfile

if TYPE_CHECKING:
    from antdsl.preview.live import Client, LiveSimulation
    from antdsl.preview.observing.observer import PauseReason

_MESSAGE_INTERVAL_SECONDS = 0.25  # interval between two messages
_MIN_REPORTED_MS = 5e-4  # ms per frame; cheaper lines are not reported


class CostReporter:
    """An observer that sends the cost of steps. Only the live thread uses it."""

    def __init__(self, live: LiveSimulation) -> None:
        self._live = live
        self._clients: set[Client] = set()
        self._last_sent_time = -inf

    def switch_client(self, client: Client, is_on: bool) -> None:
        """Start or stop sending costs to a page, from the next step on."""
        (self._clients.add if is_on else self._clients.discard)(client)
        self._last_sent_time = -inf
        self._switch_measuring(self._live.session)

    def before_step(self, session: PreviewSession) -> None:
        """Do nothing, because the session starts its meter automatically."""

    def after_step(self, session: PreviewSession) -> PauseReason | None:
        """Send the costs if a page requests them and enough time has passed. Never pause."""
        if self._clients:
            self._clients &= self._live.clients.keys()  # drop clients that have disconnected
            self._switch_measuring(session)
            self._send_costs(session)
        return None

    def on_new_world(self, session: PreviewSession) -> None:
        """Do nothing: the session moves its meter to the new world."""

    def _switch_measuring(self, session: PreviewSession) -> None:
        """Measure steps only while at least one page requests the costs."""
        if bool(self._clients) != (session.meter is not None):
            session.set_measuring(bool(self._clients))

    def _send_costs(self, session: PreviewSession) -> None:
        """Send the latest costs to the pages that request them."""
        now = monotonic()
        if session.meter is None or now - self._last_sent_time < _MESSAGE_INTERVAL_SECONDS:
            return
        profile = session.meter.profile()
        if profile.frames:
            self._last_sent_time = now
            packet = make_profile_message(profile, self._live.screen.names)
            for client in self._clients:
                client.send_message(packet)


def make_profile_message(profile: StepProfile, names: FileNames) -> dict[str, Any]:
    """Return the message that presents a step profile on pages."""
    return {
        "op": "profile",
        "frames": profile.frames,
        "total": round(profile.total_ms, 4),
        "phases": [{"name": name, "ms": round(ms, 4)} for name, ms in profile.phases.items()],
        "layers": [
            {
                "species": each.species,
                "text": each.span.text,
                "file": names.get_short_name(each.span.source.path),
                "line": each.span.source.find_line_column(each.span.start)[0],
                "ms": round(each.ms, 4),
            }
            for each in profile.layers
        ],
        "lines": [
            {"file": names.get_short_name(each.file), "line": each.line, "text": each.text, "ms": round(each.ms, 4)}
            for each in profile.lines
            if each.ms >= _MIN_REPORTED_MS
        ],
    }
