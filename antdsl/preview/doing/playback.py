"""Handlers of requests about time: play, pause, step, speed, seek, restart."""

from __future__ import annotations

from typing import TYPE_CHECKING

from antdsl.preview import requests
from antdsl.preview.viewing.messages import make_outcome_message

if TYPE_CHECKING:
    from antdsl.preview.live import Client, LiveSimulation


def handle_play(live: LiveSimulation, request: requests.Play, client: Client) -> None:
    """Play from the displayed frame on."""
    live.show_exact_frame()
    live.play()


def handle_pause(live: LiveSimulation, request: requests.Pause, client: Client) -> None:
    """Pause."""
    live.pause()


def handle_step(live: LiveSimulation, request: requests.Step, client: Client) -> None:
    """Start to simulate the requested number of steps. An event such as a breakpoint may end them early."""
    live.pause()
    live.show_exact_frame()
    live.start_steps(request.count)


def handle_set_speed(live: LiveSimulation, request: requests.SetSpeed, client: Client) -> None:
    """Set the speed of play."""
    live.set_speed(request.times)


def handle_seek(live: LiveSimulation, request: requests.Seek, client: Client) -> None:
    """Go to a frame. While a slider is dragged, only display the nearest stored frame."""
    live.pause()
    session = live.session
    frame = min(max(request.frame, session.first_frame), session.last_frame)
    if request.exact:
        live.seek_frame(frame)
    else:
        live.show_stored_frame(frame)


def handle_restart(live: LiveSimulation, request: requests.Restart, client: Client) -> None:
    """Simulate the current files again from the first frame."""
    live.pause()
    live.show_stored_frame(live.session.frame)
    result = live.session.restart()
    live.on_files_read(result.report)
    live.send_to_all(make_outcome_message(live, "restart", result))
    live.screen.on_edit(files_changed=True)
