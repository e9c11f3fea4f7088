"""The handlers of page requests: one function each, called by the live thread between two steps."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from antdsl.preview import requests
from antdsl.preview.doing import directing, edits, playback, queries

if TYPE_CHECKING:
    from antdsl.preview.live import Client, LiveSimulation

# By the kind of request. A handler may raise RequestRefusedError. Other exceptions are reported as bugs, and the preview
# continues.
HANDLER_BY_REQUEST: Mapping[type[Any], Callable[[LiveSimulation, Any, Client], None]] = {
    requests.Play: playback.handle_play,
    requests.Pause: playback.handle_pause,
    requests.Step: playback.handle_step,
    requests.SetSpeed: playback.handle_set_speed,
    requests.Seek: playback.handle_seek,
    requests.Restart: playback.handle_restart,
    requests.SetValue: edits.handle_set_value,
    requests.SwitchLayer: edits.handle_switch_layer,
    requests.SwitchField: edits.handle_switch_field,
    requests.DraftLine: directing.handle_draft_line,
    requests.SwitchLine: directing.handle_switch_line,
    requests.Settle: directing.handle_settle,
    requests.Reload: edits.handle_reload,
    requests.SetDisplay: queries.handle_set_display,
    requests.Explain: queries.handle_explain,
    requests.SetBreakpoints: queries.handle_set_breakpoints,
    requests.SwitchProfile: queries.handle_switch_profile,
}
SESSIONLESS_REQUESTS = frozenset([requests.SetDisplay, requests.Reload, requests.SetSpeed])  # possible while the scene has errors
