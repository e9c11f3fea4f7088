"""What a page wants to be shown."""

from __future__ import annotations

from typing import TYPE_CHECKING

from antdsl.preview import asks

if TYPE_CHECKING:
    from antdsl.preview.live import Client, Live


def look(live: Live, ask: asks.Look, client: Client) -> None:
    live.clients[client] = ask
    live.screen.looked()
