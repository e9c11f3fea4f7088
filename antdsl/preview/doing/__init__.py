"""The handlers of page requests: one function each, called by the live thread between two steps."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from antdsl.preview import requests
from antdsl.preview.doing import directing, edits, playback, queries

if TYPE_CHECKING:
    from antdsl.preview.live import Client, Live

# By the kind of request. A handler may raise RequestRefused. Other exceptions are reported as bugs, and the preview continues.
HANDLER_BY_REQUEST: Mapping[type[Any], Callable[[Live, Any, Client], None]] = {
    requests.Play: playback.play,
    requests.Pause: playback.pause,
    requests.Step: playback.step,
    requests.SetSpeed: playback.set_speed,
    requests.Seek: playback.seek,
    requests.Restart: playback.restart,
    requests.SetValue: edits.set_value,
    requests.SwitchLayer: edits.switch_layer,
    requests.SwitchField: edits.switch_field,
    requests.DraftLine: directing.draft_line,
    requests.SwitchLine: directing.switch_line,
    requests.Settle: directing.settle,
    requests.Reload: edits.reload,
    requests.SetDisplay: queries.set_display,
    requests.Explain: queries.explain_agent,
    requests.SetBreakpoints: queries.set_breakpoints,
    requests.SwitchProfile: queries.switch_profile,
}
SESSIONLESS_REQUESTS = frozenset([requests.SetDisplay, requests.Reload, requests.SetSpeed])  # possible while the scene has errors
