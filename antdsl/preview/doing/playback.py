"""Handlers of requests about time: play, pause, step, speed, seek, restart."""

from __future__ import annotations

from typing import TYPE_CHECKING

from antdsl.preview import requests
from antdsl.preview.viewing.messages import make_outcome_message

if TYPE_CHECKING:
    from antdsl.preview.live import Client, Live


def play(live: Live, request: requests.Play, client: Client) -> None:
    """Play from the displayed frame on."""
    live.show_exact_frame()
    live.play()


def pause(live: Live, request: requests.Pause, client: Client) -> None:
    """Pause."""
    live.pause()


def step(live: Live, request: requests.Step, client: Client) -> None:
    """Start the requested number of steps. An event such as a breakpoint may stop them early."""
    live.pause()
    live.show_exact_frame()
    live.start_steps(request.count)


def set_speed(live: Live, request: requests.SetSpeed, client: Client) -> None:
    """Set the speed of play."""
    live.set_pace(request.times)


def seek(live: Live, request: requests.Seek, client: Client) -> None:
    """Go to a frame, or display the nearest stored one."""
    live.pause()
    session = live.session
    frame = min(max(request.frame, session.first_frame), session.last_frame)
    if request.exact:
        live.go_to(frame)
    else:
        live.show_stored_frame(frame)


def restart(live: Live, request: requests.Restart, client: Client) -> None:
    """Simulate the current files again from the first frame."""
    live.pause()
    live.show_stored_frame(live.session.frame)
    result = live.session.restart()
    live.on_files_read(result.report)
    live.send_to_all(make_outcome_message(live, "restart", result))
    live.screen.on_edit(files_changed=True)
