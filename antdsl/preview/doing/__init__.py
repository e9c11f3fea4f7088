"""The handlers of page requests: one function each, called by the live thread between two steps."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from antdsl.preview import requests
from antdsl.preview.doing import edits, queries, time

if TYPE_CHECKING:
    from antdsl.preview.live import Client, Live

# By the kind of request. A handler may raise Refusal; others are reported as bugs and end nothing.
HANDLER_BY_REQUEST: Mapping[type[Any], Callable[[Live, Any, Client], None]] = {
    requests.Play: time.play,
    requests.Pause: time.pause,
    requests.Step: time.step,
    requests.Speed: time.speed,
    requests.Seek: time.seek,
    requests.Restart: time.restart,
    requests.Set: edits.set_value,
    requests.Layer: edits.layer,
    requests.Field_: edits.switch_field,
    requests.Reload: edits.reload,
    requests.Look: queries.set_look,
    requests.Explain: queries.explain,
    requests.Breaks: queries.set_breakpoints,
    requests.Profile: queries.profile,
}
SESSIONLESS_REQUESTS = frozenset([requests.Look, requests.Reload, requests.Speed])  # possible while the scene has errors
