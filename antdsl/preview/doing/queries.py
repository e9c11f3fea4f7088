"""Handlers of queries: explanations of agents, costs of steps, breakpoints, and the displayed data of a page."""

from __future__ import annotations

from typing import TYPE_CHECKING

from antdsl.preview import requests
from antdsl.preview.breaking import Breakpoints
from antdsl.preview.breaking.model import BreakpointError
from antdsl.preview.observing.explainer import Explainer
from antdsl.preview.observing.meter import CostReporter
from antdsl.preview.requests import Refusal

if TYPE_CHECKING:
    from antdsl.preview.live import Client, Live


def explain(live: Live, ask: requests.Explain, client: Client) -> None:
    """Send the explanation of an agent's step to the page that requested it."""
    if live.explainer is None or live.explainer.session is not live.session:
        live.explainer = Explainer(live.session)
    client.tell(live.explainer.message(ask.species, ask.agent, ask.frame, live.screen.names.of))


def set_breakpoints(live: Live, ask: requests.Breaks, client: Client) -> None:
    """Replace all breakpoints."""
    try:
        live.observer(Breakpoints).set(live.session, ask.breaks, ask.tried)
    except BreakpointError as why:
        raise Refusal(why.message, why.help) from None


def set_look(live: Live, ask: requests.Look, client: Client) -> None:
    """Set what a page displays in addition to the agents."""
    live.clients[client] = ask
    live.screen.on_look()


def profile(live: Live, ask: requests.Profile, client: Client) -> None:
    """Start or stop sending the costs of steps to a page."""
    live.observer(CostReporter).switch(client, ask.on)
