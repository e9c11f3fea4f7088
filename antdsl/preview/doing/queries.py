"""Handlers of queries: explain an agent, report the costs of steps, set breakpoints, and choose the data that a page displays."""

from __future__ import annotations

from typing import TYPE_CHECKING

from antdsl.preview import requests
from antdsl.preview.breaking import BreakpointObserver
from antdsl.preview.breaking.model import BreakpointError
from antdsl.preview.observing.cost_reporter import CostReporter
from antdsl.preview.observing.explainer import Explainer
from antdsl.preview.requests import RequestRefusedError

if TYPE_CHECKING:
    from antdsl.preview.live import Client, LiveSimulation


def handle_explain(live: LiveSimulation, request: requests.Explain, client: Client) -> None:
    """Send the explanation of an agent's step to the page that requested it."""
    if live.explainer is None or live.explainer.session is not live.session:
        live.explainer = Explainer(live.session)
    client.send_message(
        live.explainer.make_message(request.species, request.agent, request.frame, live.screen.names.get_short_name)
    )


def handle_set_breakpoints(live: LiveSimulation, request: requests.SetBreakpoints, client: Client) -> None:
    """Replace all breakpoints."""
    try:
        live.find_observer(BreakpointObserver).set_breakpoints(live.session, request.breaks, request.tried)
    except BreakpointError as why:
        raise RequestRefusedError(why.message, why.help) from None


def handle_set_display(live: LiveSimulation, request: requests.SetDisplay, client: Client) -> None:
    """Set what a page displays in addition to the agents."""
    live.clients[client] = request
    live.screen.on_display_change()


def handle_switch_profile(live: LiveSimulation, request: requests.SwitchProfile, client: Client) -> None:
    """Start or stop sending the costs of steps to the page that requested it."""
    live.find_observer(CostReporter).switch_client(client, request.on)
