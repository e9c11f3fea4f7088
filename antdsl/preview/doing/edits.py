"""Handlers of changes that users make on the page (values, layers, fields), and of requests to reload files."""

from __future__ import annotations

from typing import TYPE_CHECKING

from antdsl.preview import requests
from antdsl.preview.outcomes import EditOutcome
from antdsl.preview.viewing.messages import find_scene_name, make_outcome_message

if TYPE_CHECKING:
    from antdsl.preview.live import Client, LiveSimulation


def handle_set_value(live: LiveSimulation, request: requests.SetValue, client: Client) -> None:
    """Set a param or a setting of a field, and send the outcome to all pages."""
    live.show_exact_frame()
    _send_outcome(live, "set", live.session.set_value(request.name, request.value), find_scene_name(live))


def handle_switch_layer(live: LiveSimulation, request: requests.SwitchLayer, client: Client) -> None:
    """Switch a layer on or off, and send the outcome to all pages."""
    live.show_exact_frame()
    plan = live.session.shot.plan.species.get(request.species)
    layer_plan = next((each for each in plan.layers if each.span.text == request.layer), None) if plan is not None else None
    file = live.screen.names.get_short_name(layer_plan.span.source.path) if layer_plan is not None else ""
    _send_outcome(live, "layer", live.session.switch_layer(request.species, request.layer, request.on), file)


def handle_switch_field(live: LiveSimulation, request: requests.SwitchField, client: Client) -> None:
    """Switch a field on or off, and send the outcome to all pages."""
    live.show_exact_frame()
    _send_outcome(live, "field", live.session.switch_field(request.name, request.on), find_scene_name(live))


def handle_reload(live: LiveSimulation, request: requests.Reload, client: Client) -> None:
    """Load the current files, and send the outcome to all pages."""
    live.reload("reload")


def _send_outcome(live: LiveSimulation, operation: str, result: EditOutcome, file: str) -> None:
    live.send_to_all(make_outcome_message(live, operation, result, file if result.text else ""))
    live.screen.on_edit(files_changed=False)
