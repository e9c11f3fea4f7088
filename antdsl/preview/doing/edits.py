"""Handlers of edits by hand, and of requests to load files."""

from __future__ import annotations

from typing import TYPE_CHECKING

from antdsl.preview import requests
from antdsl.preview.session import Outcome
from antdsl.preview.viewing.messages import outcome, scene_file_name

if TYPE_CHECKING:
    from antdsl.preview.live import Client, Live


def set_value(live: Live, ask: requests.Set, client: Client) -> None:
    """Set a param or a setting of a field, and send the outcome to all pages."""
    live.show_exact_frame()
    _report_outcome(live, "set", live.session.set(ask.name, ask.value), scene_file_name(live))


def layer(live: Live, ask: requests.Layer, client: Client) -> None:
    """Switch a layer off or on, and send the outcome."""
    live.show_exact_frame()
    plan = live.session.shot.plan.species.get(ask.species)
    layer_plan = next((each for each in plan.layers if each.span.text == ask.layer), None) if plan is not None else None
    file = live.screen.names.of(layer_plan.span.source.path) if layer_plan is not None else ""
    _report_outcome(live, "layer", live.session.layer(ask.species, ask.layer, ask.on), file)


def switch_field(live: Live, ask: requests.Field_, client: Client) -> None:
    """Switch a field off or on, and send the outcome."""
    live.show_exact_frame()
    _report_outcome(live, "field", live.session.switch_field(ask.name, ask.on), scene_file_name(live))


def reload(live: Live, ask: requests.Reload, client: Client) -> None:
    """Load the current files, and send the outcome."""
    live.reload("reload")


def _report_outcome(live: Live, of: str, result: Outcome, file: str) -> None:
    live.tell_all(outcome(live, of, result, file if result.text else ""))
    live.screen.edited(files=False)
