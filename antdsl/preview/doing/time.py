"""Handlers of requests about time: play, pause, step, speed, seek, restart."""

from __future__ import annotations

from typing import TYPE_CHECKING

from antdsl.preview import requests
from antdsl.preview.viewing.messages import outcome

if TYPE_CHECKING:
    from antdsl.preview.live import Client, Live


def play(live: Live, ask: requests.Play, client: Client) -> None:
    """Play from the displayed frame on."""
    live.show_exact_frame()
    live.play()


def pause(live: Live, ask: requests.Pause, client: Client) -> None:
    """Pause."""
    live.pause()


def step(live: Live, ask: requests.Step, client: Client) -> None:
    """Start the requested number of steps. An event such as a breakpoint may stop them early."""
    live.pause()
    live.show_exact_frame()
    live.start_steps(ask.count)


def speed(live: Live, ask: requests.Speed, client: Client) -> None:
    """Set the speed of play."""
    live.set_pace(ask.times)


def seek(live: Live, ask: requests.Seek, client: Client) -> None:
    """Go to a frame, or display the nearest stored one."""
    live.pause()
    session = live.session
    frame = min(max(ask.frame, session.first), session.last_frame)
    if ask.exact:
        live.go_to(frame)
    else:
        live.show_stored_frame(frame)


def restart(live: Live, ask: requests.Restart, client: Client) -> None:
    """Simulate the current files again from the first frame."""
    live.pause()
    live.show_stored_frame(live.session.frame)
    result = live.session.restart()
    live.on_files_read(result.report)
    live.tell_all(outcome(live, "restart", result))
    live.screen.edited(files=True)
