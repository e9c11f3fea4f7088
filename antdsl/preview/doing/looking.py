"""What a page wants to be shown."""

from __future__ import annotations

from typing import TYPE_CHECKING

from antdsl.preview import requests

if TYPE_CHECKING:
    from antdsl.preview.live import Client, Live


def look(live: Live, ask: requests.Look, client: Client) -> None:
    live.clients[client] = ask
    live.screen.looked()
