"""What steps spend their time on, told or no longer."""

from __future__ import annotations

from typing import TYPE_CHECKING

from antdsl.preview import requests
from antdsl.preview.observing.meter import Costs

if TYPE_CHECKING:
    from antdsl.preview.live import Client, Live


def profile(live: Live, ask: requests.Profile, client: Client) -> None:
    live.observer(Costs).switch(client, ask.on)
